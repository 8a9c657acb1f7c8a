"""Look-ups of a trained scorer: an entity's best links, never those that the scorer remembers."""

from pathlib import Path

import numpy as np

from wordcraft_kg.apps.text_agents.games import Game
from wordcraft_kg.base import GraphMismatchError, LeakError
from wordcraft_kg.envs.words import prompt_text
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, Ids, OpenedGraph, RecipeGraph, TaskSet
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.model_folder import open_model
from wordcraft_kg.models.scorers.cross_fitting import folds_of, models_of_tasks
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer

_MOST_LINKS = 10
"""Most entities in a reply for each kind of link."""


def open_scorer(folder: Path, opened: OpenedGraph) -> Model:
    """Return the model in a folder, for games on its split.

    Raises:
        ArtefactError: if the folder is unfinished or damaged.
        GraphMismatchError: if the scorer is of another graph or split.
    """
    model = open_model(folder, opened.source)
    if model.opened.split.hash != opened.split.hash:
        raise GraphMismatchError(
            f"{folder} belongs to split {model.opened.split.hash[:12]}, and the games to "
            f"{opened.split.hash[:12]}: the scorer may know test recipes. Use the graph folder of "
            "the scorer."
        )
    return model


class LikelyLinks:
    """A scorer's best partners, results and ingredients of an entity, as text lines.

    On a train task, the cross-fitted model trained without the task's recipes gives the scores. An
    entity's combination with the same entity is omitted, because link predictors score almost all
    of these high.
    """

    def __init__(self, scorer: TripleScorer, graph: RecipeGraph, tasks: TaskSet | None):
        """Take a scorer.

        Args:
            scorer: a scorer for the graph.
            graph: the graph of the games.
            tasks: the tasks of the games; None in the open-ended world.

        Raises:
            GraphMismatchError: if the scorer is for another graph.
            LeakError: for train tasks and a scorer without folds: it has seen the answers.
        """
        check_scorer(scorer, graph)
        self._graph = graph
        self._scorer = scorer
        self._folds = folds_of(scorer)
        # For each task the number of the model that may answer; None if the scorer itself may.
        self._models: Ids | None = None
        if tasks is not None and tasks.part in ("train", "all"):
            if self._folds is None:
                raise LeakError(
                    "the scorer has no folds, so look-ups on train tasks would leak training "
                    "recipes. Train with folds, the default for train-complex and train-recipes, "
                    "or play the test part."
                )
            self._models = models_of_tasks(self._folds.of_recipe, tasks)

    def __call__(self, game: Game, entity: int) -> list[str]:
        """Return an entity's (id) best links; empty if no model may answer in the game."""
        scorer = self._answering(game.task)
        if scorer is None:
            return []
        candidates = np.delete(np.arange(self._graph.num_entities), entity)
        at_hand = np.array([self._graph.id_of(label) for label in game.labels])
        at_hand = at_hand[at_hand != entity]
        lines = []
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
                labels = self._graph.labels(ids[best].tolist())
                links = [
                    f"{label} ({score:.2f})"
                    for label, score in zip(labels, scores[best].tolist(), strict=True)
                ]
                lines.append(prompt_text(prompt, entities=", ".join(links)))
        return lines

    def _answering(self, task: int) -> TripleScorer | None:
        """Return the model that may answer in a game on a task; None if none may."""
        if self._models is None or self._folds is None:
            return self._scorer
        # 0: the main model, if each plan has a recipe outside train. 1 to K: the model without this
        # fold. K + 1: no single fold has a recipe of each plan, so no model may answer.
        model = int(self._models[task])
        if model > self._folds.count:
            return None
        return self._folds.left_out(model - 1) if model else self._folds.whole
