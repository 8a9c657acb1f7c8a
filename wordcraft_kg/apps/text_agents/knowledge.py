"""What a player may look up: nothing, the recipes of the partial graph, or what a trained scorer believes."""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, get_args

import numpy as np

from wordcraft_kg.apps.text_agents.config import KnowledgeKind
from wordcraft_kg.apps.text_agents.games import Game
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError, LeakError
from wordcraft_kg.base.settings import one_of
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph, Taught
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF

if TYPE_CHECKING:
    from wordcraft_kg.models.scorers.protocol import TripleScorer

MOST_FACTS = 40
"""Most recipes told of a thing; there are things with hundreds."""
MOST_BELIEVED = 10
"""Most things told for each relation that a scorer scores."""


class Knowledge(Protocol):
    """What can be looked up."""

    kind: KnowledgeKind

    def facts(self, entity: int, game: Game) -> list[str]:
        """Return what is known of a thing, a line each, what concerns the game most first."""
        ...


class PartialGraphKnowledge:
    """The train recipes, which are the partial graph; never a recipe that solves the task of the game.

    A pair of the task's plans that makes two things is hidden with both: to combine it is what solves the task.

    Of a thing are told the recipes that make it, then those that use it with something at hand, then its other uses.
    """

    kind: KnowledgeKind = "partial"

    def __init__(self, split: Split):
        """Take a split."""
        self.graph = split.graph
        self._is_known = split.is_in("train")

    def facts(self, entity: int, game: Game) -> list[str]:
        """Return the recipes of a thing, at most :data:`MOST_FACTS`."""
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


class ScorerKnowledge:
    """What a scorer believes: with what a thing combines, what it is a component of, and what its components are.

    On a train task the model of a cross-fitted scorer answers that has not seen the task's recipes. That a thing
    combines with itself is never told, because link predictors believe it of almost everything.
    """

    kind: KnowledgeKind = "scorer"

    def __init__(self, scorer: "TripleScorer", split: Split):
        """Take a scorer of the split's graph.

        Raises:
            GraphMismatchError: if it is of another graph.
        """
        from wordcraft_kg.models.scorers.protocol import check_scorer

        check_scorer(scorer, split.graph)
        self.graph, self._scorer = split.graph, scorer
        self._models: dict[str, Ids] = {}

    def facts(self, entity: int, game: Game) -> list[str]:
        """Return the most plausible links of a thing; it combines with things at hand, the other ends are any.

        Raises:
            LeakError: for a train task, if the scorer has no model that has not seen its recipes.
        """
        scorer = self._answering(game)
        if scorer is None:
            return []
        others = np.delete(np.arange(self.graph.num_entities), entity)
        at_hand = np.array([self.graph.id_of(label) for label in game.labels])
        at_hand = at_hand[at_hand != entity]
        facts = []
        for about, ids, (head, relation, tail) in (
            ("combines best, of what is at hand, with", at_hand, (entity, COMBINES_WITH, at_hand)),
            ("is most likely a component of", others, (entity, COMPONENT_OF, others)),
            ("is most likely made of", others, (others, COMPONENT_OF, entity)),
        ):
            if len(ids):
                scores = scorer.score(head, relation, tail).cpu().numpy()
                best = np.argsort(-scores, kind="stable")[:MOST_BELIEVED]
                believed = (f"{self.graph.entities[ids[place]]} ({scores[place]:.2f})" for place in best.tolist())
                facts.append(f"{about}: {', '.join(believed)}")
        return facts

    def _answering(self, game: Game) -> "TripleScorer | None":
        """Return the model that may be asked about a game; None if each has seen a part of the task's plans."""
        from wordcraft_kg.models.scorers.cross_fitting import folds_of, models_of_tasks

        tasks = game.tasks
        if tasks is None or tasks.part not in ("train", "all"):
            return self._scorer
        folds = folds_of(self._scorer)
        if folds is None:
            raise LeakError(
                "of train tasks this scorer would tell what it remembers: it has no folds. Train it with folds, the "
                "default of train-complex and train-recipes, or play the test part."
            )
        if tasks.hash not in self._models:
            self._models[tasks.hash] = models_of_tasks(folds.of_recipe, tasks)
        model = int(self._models[tasks.hash][game.task])
        if model > folds.count:
            return None
        return folds.left_out(model - 1) if model else folds.whole


def knowledge_of(
    kind: KnowledgeKind, split: Split, scorer: "TripleScorer | None" = None
) -> "PartialGraphKnowledge | ScorerKnowledge | None":
    """Return what a player may look up; None for nothing.

    Raises:
        ConfigError: for ``scorer`` without a scorer, or another kind with one.
        GraphMismatchError: if the scorer is of another graph.
    """
    one_of("knowledge", kind, get_args(KnowledgeKind))
    if (kind == "scorer") != (scorer is not None):
        raise ConfigError(
            f"`knowledge` {kind}: "
            + ("name the scorer's model folder." if scorer is None else "only 'scorer' asks a scorer; leave it out.")
        )
    if scorer is not None:
        return ScorerKnowledge(scorer, split)
    return PartialGraphKnowledge(split) if kind == "partial" else None


class OpenedKnowledge(NamedTuple):
    """What a player may look up, and what is recorded of it.

    Attributes:
        knowledge: what it may look up; None for nothing.
        scorer: hash of the weights of the scorer that is asked; None without one.
        kg: what this scorer was trained on; one of the full graph remembers the answers.
    """

    knowledge: Knowledge | None
    scorer: str | None
    kg: Taught | None


def open_knowledge(kind: KnowledgeKind, opened: OpenedGraph, scorer: Path | None = None) -> OpenedKnowledge:
    """Open what a player may look up.

    Args:
        kind: none, the partial graph, or a scorer.
        opened: the graph and split of the games.
        scorer: model folder of the scorer.

    Raises:
        ConfigError: for ``scorer`` without a folder, or another kind with one.
        ArtefactError: if the folder is unfinished or damaged.
        GraphMismatchError: if the scorer is of another graph or split.
    """
    if scorer is None or kind != "scorer":
        if scorer is not None:
            raise ConfigError(f"`scorer` {scorer}: only `knowledge` scorer asks one; add it, or leave the scorer out.")
        return OpenedKnowledge(knowledge_of(kind, opened.split), None, None)
    from wordcraft_kg.models.folder import open_model

    model = open_model(scorer, opened.source)
    if model.opened.split.hash != opened.split.hash:
        raise GraphMismatchError(
            f"{scorer} belongs to split {model.opened.split.hash[:12]}, and the games to {opened.split.hash[:12]}: it "
            "may know their recipes. Play on the graph folder that it was trained on."
        )
    return OpenedKnowledge(
        ScorerKnowledge(model.scorer, opened.split), model.run.outputs["model.safetensors"], model.kg
    )
