"""Records that a model folder of opinions holds beside its tensors."""

from wordcraft_kg.base.records import Count, Hash, Record, Share


class Agreement(Record, frozen=True, kw_only=True):
    """The agreement of opinions with recipes of the graph, all of them or those of a part.

    Attributes:
        opinions: opinions that are judged: all, or those that are no recipe of another part.
        recipes: number of recipes.
        right: opinions that are one of these recipes.
        precision: share of the opinions that are right; None without any.
        recall: share of the recipes that are among the opinions; None without any.
        goals: entities that these recipes make.
        first_right: share of these for which the pair that is named first makes them; None without any.
    """

    opinions: Count
    recipes: Count
    right: Count
    precision: Share | None
    recall: Share | None
    goals: Count
    first_right: Share | None


class OpinionMetrics(Record, frozen=True, kw_only=True):
    """``metrics.json``: prompts, answers, and the agreement with the graph.

    Attributes:
        template: hash of the wording of the prompts.
        prompts: number of prompts.
        goals: number of entities that they ask about.
        goals_with_opinions: entities of which something could be read.
        opinions: number of opinions.
        unread: lines without an opinion, by reason.
        cut: answers that ended at the limit of their length.
        models: names of the models that have answered.
        tokens_in: tokens of the prompts as the endpoint counts them; None if it does not.
        tokens_out: tokens of the answers.
        agreement: with the recipes of the graph, ``all`` and ``test``.
    """

    template: Hash
    prompts: Count
    goals: Count
    goals_with_opinions: Count
    opinions: Count
    unread: dict[str, Count]
    cut: Count
    models: tuple[str, ...]
    tokens_in: Count | None
    tokens_out: Count | None
    agreement: dict[str, Agreement]
