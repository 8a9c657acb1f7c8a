"""Knowledge to look up: the recipes of the partial graph, or the best links of a trained scorer."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from wordcraft_kg.apps.text_agents.games import Game
from wordcraft_kg.apps.text_agents.settings import GameSettings
from wordcraft_kg.base.errors import GraphMismatchError, LeakError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph, Taught
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF

if TYPE_CHECKING:
    from wordcraft_kg.models.scorers.protocol import TripleScorer

MOST_FACTS = 40
"""Most recipes of an entity; some entities have hundreds."""
MOST_BELIEVED = 10
"""Most entities for each relation that a scorer scores."""


class Knowledge(ABC):
    """Facts that can be looked up.

    Attributes:
        scorer: hash of the scorer's weights; None without one.
        kg: triples that the scorer was trained on; a scorer of the full graph remembers the answers.
    """

    scorer: str | None = None
    kg: Taught | None = None

    @abstractmethod
    def facts(self, entity: int, game: Game) -> list[str]:
        """Return the facts about an entity, a line each, those that concern the game most first."""


class PartialGraphKnowledge(Knowledge):
    """The train recipes without those of the task's plans.

    All results of a pair of the task's plans are hidden. Facts are listed in this order: recipes that make the entity,
    recipes that use it with an entity at hand, its other uses.
    """

    def __init__(self, split: Split):
        """Take the train recipes of a split."""
        self.graph = split.graph
        self._is_known = split.is_in("train")

    def facts(self, entity: int, game: Game) -> list[str]:
        """Return the recipes of an entity, at most :data:`MOST_FACTS`."""
        graph = self.graph
        pairs = graph.recipes[:, :2]
        plans = () if game.tasks is None else game.tasks.plans[game.task]
        solving = {tuple(pairs[row].tolist()) for plan in plans for row in plan}
        at_hand = {graph.id_of(label) for label in game.labels}

        def rank(row: int) -> tuple[int, int]:
            a, b, result = graph.recipes[row].tolist()
            other = b if a == entity else a
            return (0 if result == entity else 1 if other in at_hand else 2), row

        rows = {*graph.recipes_of(entity).tolist(), *graph.uses_of(entity).tolist()}
        told = (row for row in rows if self._is_known[row] and tuple(pairs[row].tolist()) not in solving)
        known = sorted(told, key=rank)
        facts = [f"{a} + {b} -> {c}" for a, b, c in graph.recipe_labels(graph.recipes[known[:MOST_FACTS]])]
        return facts + ([f"and {len(known) - MOST_FACTS} more"] if len(known) > MOST_FACTS else [])


class ScorerKnowledge(Knowledge):
    """The best links of a scorer: entities to combine with, likely results and likely components.

    On a train task a cross-fitted scorer answers with the model that has not seen the task's recipes. Self-combinations
    are left out, because link predictors believe almost all of them.
    """

    def __init__(self, scorer: "TripleScorer", split: Split, weights: str | None = None, kg: Taught | None = None):
        """Take a scorer of the split's graph, the hash of its weights and its training triples.

        Raises:
            GraphMismatchError: if it is of another graph.
        """
        from wordcraft_kg.models.scorers.protocol import check_scorer

        check_scorer(scorer, split.graph)
        self.graph, self.scorer, self.kg, self._scorer = split.graph, weights, kg, scorer
        self._models: dict[str, Ids] = {}

    def facts(self, entity: int, game: Game) -> list[str]:
        """Return the most plausible links of an entity; partners are at hand, other ends are any entities.

        Raises:
            LeakError: for a train task, if the scorer has no model that has not seen its recipes.
        """
        scorer = self._answering(game)
        return [] if scorer is None else [*self._links(scorer, entity, game)]

    def _links(self, scorer: "TripleScorer", entity: int, game: Game) -> Iterator[str]:
        others = np.delete(np.arange(self.graph.num_entities), entity)
        at_hand = np.array([self.graph.id_of(label) for label in game.labels])
        at_hand = at_hand[at_hand != entity]
        for about, ids, (head, relation, tail) in (
            ("combines best, of what is at hand, with", at_hand, (entity, COMBINES_WITH, at_hand)),
            ("is most likely a component of", others, (entity, COMPONENT_OF, others)),
            ("is most likely made of", others, (others, COMPONENT_OF, entity)),
        ):
            if len(ids):
                scores = scorer.score(head, relation, tail).cpu().numpy()
                best = np.argsort(-scores, kind="stable")[:MOST_BELIEVED]
                believed = (f"{self.graph.entities[ids[place]]} ({scores[place]:.2f})" for place in best.tolist())
                yield f"{about}: {', '.join(believed)}"

    def _answering(self, game: Game) -> "TripleScorer | None":
        """Return the model that may be asked about a game; None if each has seen a part of the task's plans."""
        from wordcraft_kg.models.scorers.cross_fitting import folds_of, models_of_tasks

        tasks = game.tasks
        if tasks is None or tasks.part not in ("train", "all"):
            return self._scorer
        folds = folds_of(self._scorer)
        if folds is None:
            raise LeakError(
                "this scorer has no folds, so on train tasks it would leak its training recipes. Train it with folds, "
                "the default of train-complex and train-recipes, or play the test part."
            )
        if tasks.hash not in self._models:
            self._models[tasks.hash] = models_of_tasks(folds.of_recipe, tasks)
        model = int(self._models[tasks.hash][game.task])
        if model > folds.count:
            return None
        return folds.left_out(model - 1) if model else folds.whole


def open_knowledge(settings: GameSettings, opened: OpenedGraph) -> Knowledge | None:
    """Open the knowledge that settings name, for games on a graph and its split; None for nothing.

    Raises:
        ArtefactError: if the scorer's folder is unfinished or damaged.
        GraphMismatchError: if the scorer is of another graph or split.
    """
    if settings.scorer is None:
        return PartialGraphKnowledge(opened.split) if settings.knowledge == "partial" else None
    from wordcraft_kg.models.folder import open_model

    model = open_model(settings.scorer, opened.source)
    if model.opened.split.hash != opened.split.hash:
        raise GraphMismatchError(
            f"{settings.scorer} belongs to split {model.opened.split.hash[:12]}, and the games to "
            f"{opened.split.hash[:12]}: it may know their recipes. Play on the graph folder that it was trained on."
        )
    return ScorerKnowledge(model.scorer, opened.split, model.run.outputs["model.safetensors"], model.kg)
