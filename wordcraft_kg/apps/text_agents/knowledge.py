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


class Knowledge(ABC):
    """Base class for facts to look up; for a scorer with the hash of its weights and its training triples."""

    scorer: str | None = None
    kg: TrainedOn | None = None
    _prompt: ClassVar[str]

    @abstractmethod
    def facts(self, entity: int, game: Game) -> list[str]:
        """Return the facts about an entity (id) as text lines, the most relevant first."""

    def reply(self, label: str, facts: list[str]) -> str:
        """Return the reply to a look-up: a text with the facts about the entity with this label."""
        return prompt_text(
            self._prompt if facts else "no_facts", entity=label, facts="\n".join(facts)
        )


def hidden_pairs(game: Game) -> set[int]:
    """Return the pairs (``graph.pair_of_recipe``) that look-ups hide in a game; none in the open-ended world.

    Hidden are all pairs in the task's plans, and every pair for the goal with both ingredients on the starting table or
    makeable from this table before the last attempt (a crafting round per attempt): no look-up completes a way to the
    goal.
    """
    if not isinstance(game, TaskGame):
        return set()
    graph = game.graph
    last, layer = graph.recipes_of(game.goal), layers(graph, game.start)
    rounds = layer[graph.recipes[last, :2]]
    in_time = ((rounds >= 0) & (rounds < game.attempts)).all(axis=1)
    rows = last[in_time].tolist() + [row for plan in game.tasks.plans[game.task] for row in plan]
    return {*graph.pair_of_recipe[rows].tolist()}


class PartialGraphKnowledge(Knowledge):
    """Look-ups in the train recipes without :func:`hidden_pairs`; recipes that make the entity come first."""

    _prompt = "known_recipes"

    def __init__(self, split: Split):
        self.graph = split.graph
        self._is_known = split.is_in("train")

    def facts(self, entity: int, game: Game) -> list[str]:
        """Return the train recipes with an entity (id) as text lines, at most 40."""
        graph, hidden = self.graph, hidden_pairs(game)
        at_hand = {graph.id_of(label) for label in game.labels}

        def rank(row: int) -> tuple[int, int]:
            a, b, result = graph.recipes[row].tolist()
            other = b if a == entity else a
            return (0 if result == entity else 1 if other in at_hand else 2), row

        rows = {*graph.recipes_of(entity).tolist(), *graph.uses_of(entity).tolist()}
        known = sorted(
            (
                row
                for row in rows
                if self._is_known[row] and graph.pair_of_recipe[row] not in hidden
            ),
            key=rank,
        )
        facts = [
            combined((a, b), (c,))
            for a, b, c in graph.recipe_labels(graph.recipes[known[:_MOST_FACTS]])
        ]
        more = counted(len(known) - _MOST_FACTS, "more recipe")
        return facts + (
            [prompt_text("more_recipes", more=more)] if len(known) > _MOST_FACTS else []
        )


class ScorerKnowledge(Knowledge):
    """Facts from a scorer: the entities with the highest scores as partner, result or ingredient of an entity.

    On a train task, the cross-fitted model trained without the task's recipes gives the scores. An entity's combination
    with the same entity is omitted, because link predictors score almost all of these high.
    """

    _prompt = "likely_links"

    def __init__(
        self,
        scorer: "TripleScorer",
        split: Split,
        weights: str | None = None,
        kg: TrainedOn | None = None,
    ):
        """Take a scorer for this graph, the hash of its weights, and its training triples (full or partial)."""
        from wordcraft_kg.models.scorers.protocol import check_scorer

        check_scorer(scorer, split.graph)
        self.graph, self.scorer, self.kg, self._scorer = split.graph, weights, kg, scorer
        self._models: dict[str, Ids] = {}

    def facts(self, entity: int, game: Game) -> list[str]:
        """Return an entity's best links as text; LeakError for a scorer without folds on a train task."""
        scorer = self._answering(game)
        return [] if scorer is None else [*self._links(scorer, entity, game)]

    def _links(self, scorer: "TripleScorer", entity: int, game: Game) -> Iterator[str]:
        others = np.delete(np.arange(self.graph.num_entities), entity)
        at_hand = np.array([self.graph.id_of(label) for label in game.labels])
        at_hand = at_hand[at_hand != entity]
        for prompt, ids, (head, relation, tail) in (
            ("likely_partners", at_hand, (entity, COMBINES_WITH, at_hand)),
            ("likely_results", others, (entity, COMPONENT_OF, others)),
            ("likely_ingredients", others, (others, COMPONENT_OF, entity)),
        ):
            if len(ids):
                scores = scorer.score(head, relation, tail).cpu().numpy()
                best = np.argsort(-scores, kind="stable")[:_MOST_LINKS].tolist()
                links = (
                    f"{self.graph.entities[ids[index]]} ({scores[index]:.2f})" for index in best
                )
                yield prompt_text(prompt, entities=", ".join(links))

    def _answering(self, game: Game) -> "TripleScorer | None":
        from wordcraft_kg.models.scorers.cross_fitting import folds_of, models_of_tasks

        tasks = game.tasks
        if tasks is None or tasks.part not in ("train", "all"):
            return self._scorer
        folds = folds_of(self._scorer)
        if folds is None:
            raise LeakError(
                "the scorer has no folds, so look-ups on train tasks would leak training recipes. Train with folds, "
                "the default for train-complex and train-recipes, or play the test part."
            )
        if tasks.hash not in self._models:
            self._models[tasks.hash] = models_of_tasks(folds.of_recipe, tasks)
        model = int(self._models[tasks.hash][game.task])
        if model > folds.count:
            return None
        return folds.left_out(model - 1) if model else folds.whole


def open_knowledge(settings: GameSettings, opened: OpenedGraph) -> Knowledge | None:
    """Return the settings' source of facts for this graph and split (else GraphMismatchError), or None."""
    if settings.scorer is None:
        return PartialGraphKnowledge(opened.split) if settings.knowledge == "partial" else None
    from wordcraft_kg.models.folder import open_model

    model = open_model(settings.scorer, opened.source)
    if model.opened.split.hash != opened.split.hash:
        raise GraphMismatchError(
            f"{settings.scorer} belongs to split {model.opened.split.hash[:12]}, and the games to "
            f"{opened.split.hash[:12]}: the scorer may know test recipes. Use the graph folder of the scorer."
        )
    return ScorerKnowledge(
        model.scorer, opened.split, model.run.outputs["model.safetensors"], model.kg
    )
