"""Sources of facts for look-ups: the train recipes, or a trained scorer's best links."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from wordcraft_kg.apps.text_agents.games import Game, TaskGame
from wordcraft_kg.apps.text_agents.settings import GameSettings
from wordcraft_kg.base.errors import GraphMismatchError, LeakError
from wordcraft_kg.base.wording import counted
from wordcraft_kg.envs.words import combined, prompt_text
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph, TrainedOn
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF

if TYPE_CHECKING:
    from wordcraft_kg.models.scorers.protocol import TripleScorer

_MOST_FACTS = 40
"""Most recipes in a reply; some entities have hundreds."""
_MOST_LINKS = 10
"""Most entities in a reply for each kind of link."""


class Knowledge(ABC):
    """Base class for facts to look up.

    Attributes:
        scorer: hash of a scorer's weights; None for facts without a scorer.
        kg: training triples of the scorer (full or partial); one of the full graph remembers the
            test recipes. None for facts without a scorer.
    """

    scorer: str | None = None
    kg: TrainedOn | None = None
    _prompt: ClassVar[str]

    @abstractmethod
    def facts(self, entity: int, game: Game) -> list[str]:
        """Return the facts about an entity (id) as text lines, the most relevant first."""

    def reply(self, label: str, facts: list[str]) -> str:
        """Return the reply to a look-up: a text with the facts about the entity with this label."""
        prompt = self._prompt if facts else "no_facts"
        return prompt_text(prompt, entity=label, facts="\n".join(facts))


def hidden_pairs(game: Game) -> set[int]:
    """Return the pairs (``graph.pair_of_recipe``) that look-ups hide in a game.

    Hidden are all pairs in the task's plans, and every pair that makes the goal in this world with
    both ingredients on the starting table or makeable from this table before the last attempt (a
    crafting round per attempt): no look-up completes a way to the goal. A pair that makes two
    entities is hidden with both, because to combine it is what solves the task. None are hidden in
    the open-ended world.
    """
    if not isinstance(game, TaskGame):
        return set()
    graph = game.graph
    usable = game.world.usable
    goal_rows = graph.recipes_of(game.goal)
    goal_rows = goal_rows[usable[goal_rows]]
    # Rounds of crafting until an ingredient can be at hand; -1 if it never can. Shape (R, 2).
    rounds = layers(graph, game.start, usable)[graph.recipes[goal_rows, :2]]
    in_time = ((rounds >= 0) & (rounds < game.attempts)).all(axis=1)
    rows = goal_rows[in_time].tolist()
    for plan in game.tasks.plans[game.task]:
        rows += plan
    return {*graph.pair_of_recipe[rows].tolist()}


class PartialGraphKnowledge(Knowledge):
    """Look-ups in the train recipes without :func:`hidden_pairs`.

    First come the recipes that make the entity, then those that use it with something at hand, then
    its other uses.
    """

    _prompt = "known_recipes"

    def __init__(self, split: Split):
        self.graph = split.graph
        self._is_known = split.is_in("train")

    def facts(self, entity: int, game: Game) -> list[str]:
        """Return the train recipes with an entity (id) as text lines, at most 40."""
        graph = self.graph
        hidden = hidden_pairs(game)
        at_hand = {graph.id_of(label) for label in game.labels}

        def rank(row: int) -> tuple[int, int]:
            first, second, result = graph.recipes[row].tolist()
            partner = second if first == entity else first
            if result == entity:
                relevance = 0
            elif partner in at_hand:
                relevance = 1
            else:
                relevance = 2
            # The row breaks ties, so that replies never depend on a set.
            return relevance, row

        rows = {*graph.recipes_of(entity).tolist(), *graph.uses_of(entity).tolist()}
        visible = [
            row for row in rows if self._is_known[row] and graph.pair_of_recipe[row] not in hidden
        ]
        ranked = sorted(visible, key=rank)
        labels = graph.recipe_labels(graph.recipes[ranked[:_MOST_FACTS]])
        facts = [combined((first, second), (result,)) for first, second, result in labels]
        if len(ranked) > _MOST_FACTS:
            rest_text = counted(len(ranked) - _MOST_FACTS, "more recipe")
            facts.append(prompt_text("more_recipes", more=rest_text))
        return facts


class ScorerKnowledge(Knowledge):
    """Facts from a scorer: its best partners, results and ingredients of an entity.

    On a train task, the cross-fitted model trained without the task's recipes gives the scores. An
    entity's combination with the same entity is omitted, because link predictors score almost all
    of these high.
    """

    _prompt = "likely_links"

    def __init__(
        self,
        scorer: "TripleScorer",
        split: Split,
        weights: str | None = None,
        kg: TrainedOn | None = None,
    ):
        """Take a scorer.

        Args:
            scorer: a scorer for the split's graph.
            split: the split of the games.
            weights: hash of the scorer's weights; None if it was not read from a folder.
            kg: training triples of the scorer (full or partial); None if unknown.

        Raises:
            GraphMismatchError: if the scorer is for another graph.
        """
        from wordcraft_kg.models.scorers.protocol import check_scorer

        check_scorer(scorer, split.graph)
        self.graph = split.graph
        self.scorer = weights
        self.kg = kg
        self._scorer = scorer
        # By hash of the tasks: for each task the number of the model that may answer.
        self._models: dict[str, Ids] = {}

    def facts(self, entity: int, game: Game) -> list[str]:
        """Return an entity's best links as text lines; empty if no model may answer.

        Raises:
            LeakError: on a train task, for a scorer without folds: it has seen the answers.
        """
        scorer = self._answering(game)
        return [] if scorer is None else [*self._links(scorer, entity, game)]

    def _links(self, scorer: "TripleScorer", entity: int, game: Game) -> Iterator[str]:
        candidates = np.delete(np.arange(self.graph.num_entities), entity)
        at_hand = np.array([self.graph.id_of(label) for label in game.labels])
        at_hand = at_hand[at_hand != entity]
        # A partner must be at hand to be of use; what an entity makes, or is made of, may be any.
        for prompt, ids, (head, relation, tail) in (
            ("likely_partners", at_hand, (entity, COMBINES_WITH, at_hand)),
            ("likely_results", candidates, (entity, COMPONENT_OF, candidates)),
            ("likely_ingredients", candidates, (candidates, COMPONENT_OF, entity)),
        ):
            if len(ids):
                scores = scorer.score(head, relation, tail).cpu().numpy()
                # Stable: of equal scores, the entity that comes first in the graph wins.
                best = np.argsort(-scores, kind="stable")[:_MOST_LINKS].tolist()
                labels = self.graph.labels(ids[best].tolist())
                links = [
                    f"{label} ({score:.2f})"
                    for label, score in zip(labels, scores[best].tolist(), strict=True)
                ]
                yield prompt_text(prompt, entities=", ".join(links))

    def _answering(self, game: Game) -> "TripleScorer | None":
        """Return the model that may answer in a game; None if none may."""
        from wordcraft_kg.models.scorers.cross_fitting import folds_of, models_of_tasks

        tasks = game.tasks
        if tasks is None or tasks.part not in ("train", "all"):
            return self._scorer
        folds = folds_of(self._scorer)
        if folds is None:
            raise LeakError(
                "the scorer has no folds, so look-ups on train tasks would leak training recipes. "
                "Train with folds, "
                "the default for train-complex and train-recipes, or play the test part."
            )
        if tasks.hash not in self._models:
            self._models[tasks.hash] = models_of_tasks(folds.of_recipe, tasks)
        # 0: the main model, if each plan has a recipe outside train. 1 to K: the model without this
        # fold. K + 1: no single fold has a recipe of each plan, so no model may answer.
        model = int(self._models[tasks.hash][game.task])
        if model > folds.count:
            return None
        return folds.left_out(model - 1) if model else folds.whole


def open_knowledge(settings: GameSettings, opened: OpenedGraph) -> Knowledge | None:
    """Return the source of facts that the settings name.

    Args:
        settings: the games; ``scorer`` is a model folder.
        opened: graph and split of the games.

    Returns:
        The source of facts; None if the settings offer no look-ups.

    Raises:
        ArtefactError: if the model folder is unfinished or damaged.
        GraphMismatchError: if the scorer is of another graph or split.
    """
    if settings.scorer is None:
        return PartialGraphKnowledge(opened.split) if settings.knowledge == "partial" else None
    from wordcraft_kg.models.folder import open_model

    model = open_model(settings.scorer, opened.source)
    if model.opened.split.hash != opened.split.hash:
        raise GraphMismatchError(
            f"{settings.scorer} belongs to split {model.opened.split.hash[:12]}, and the games to "
            f"{opened.split.hash[:12]}: the scorer may know test recipes. Use the graph folder of "
            "the scorer."
        )
    return ScorerKnowledge(
        model.scorer, opened.split, model.run.outputs["model.safetensors"], model.kg
    )
