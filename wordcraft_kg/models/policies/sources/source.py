"""Base classes: for sources, and for sources with a model per left-out fold."""

import threading
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from wordcraft_kg.base.errors import GraphMismatchError, LeakError
from wordcraft_kg.base.tensors import check_tensors
from wordcraft_kg.graphs import Ids, TaskSet
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.cross_fitting import folds_of, models_of_tasks, whole_of
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge, Support
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.score_limits import Scale, SelfEdges

Rows = Tensor | slice
"""Rows of a batch: their numbers, or all of them as a slice."""
KEPT = 2**28
"""Most bytes that a source keeps: 256 MiB, some 600,000 tables."""
ROW_BYTES = 400
"""Bytes of a kept row beside its scores: key, array, and their places in a dictionary; measured."""


@dataclass(frozen=True)
class ScoreView:
    """Settings that turn a scorer's triple scores into slot scores; by default raw scores.

    Attributes:
        scale: common scale, see :func:`~wordcraft_kg.models.scorers.scales.scaled_table`.
        self_edges: keep or drop scores of an entity with itself, or keep only ``observed`` triples.
        observed: ids of the scorer's training triples, shape (T, 3); None unless ``self_edges`` is
            ``observed``.
        without_tables: score by factors or by lists, for graphs too large for a score table.
        width: most intermediates per search for a plan; 0 for the default.
        tasks: tasks to score, required by scorers with a model per left-out fold, see
            :meth:`Source.bind`. None for tasks without train recipes.
    """

    scale: Scale = "none"
    self_edges: SelfEdges = "keep"
    observed: Ids | None = None
    without_tables: bool = False
    width: int = 0
    tasks: TaskSet | None = None


AS_IS = ScoreView()
"""Raw scores."""


class KeptScores:
    """Scores of states that recur, for sources by neighbour lists.

    A table is scored before and after the first action, for another player on the same tables, and
    whenever a training plays it again. A row must have the same bits in any batch. Threads may call
    concurrently.
    """

    def __init__(self) -> None:
        """Keep nothing yet."""
        # A plain dictionary looks for its oldest key among the places of all that were dropped.
        self._rows = OrderedDict[tuple[tuple[int, ...], bytes], NDArray[np.float32]]()
        self._size = 0
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type["KeptScores"], tuple[()]]:
        # A copied or saved policy begins anew: locks cannot be copied, and scores need not be.
        return KeptScores, ()

    def scores(
        self,
        inputs: Iterable[Tensor],
        compute: Callable[[Rows], Tensor],
        shape: tuple[int, ...],
    ) -> Tensor:
        """Return the scores of a batch; only rows that are not kept are computed.

        Args:
            inputs: everything that the scores depend on, whole numbers, shape (B, ...) each.
            compute: returns the scores of some rows of the batch, shape (n, ...).
            shape: shape of a row of scores.

        Returns:
            shape (B, ...), float32, on the device of the inputs.
        """
        parts = [part.reshape(len(part), -1) for part in inputs]
        device = parts[0].device
        numbers = torch.cat(parts, dim=1).cpu().numpy().astype(np.int64)
        # The bytes of a row's inputs are its key.
        keys = [(shape, row) for row in numbers.view(f"V{8 * numbers.shape[1]}").ravel().tolist()]
        with self._lock:
            scores = [self._rows.get(key) for key in keys]
        missing = [place for place, row in enumerate(scores) if row is None]
        if missing:
            is_all = len(missing) == len(keys)
            rows = slice(None) if is_all else torch.tensor(missing, device=device)
            values = compute(rows).float().cpu().numpy()
            with self._lock:
                for place, row in zip(missing, values, strict=True):
                    scores[place] = row
                    self._keep(keys[place], row)
        return torch.from_numpy(np.array(scores, np.float32).reshape(-1, *shape)).to(device)

    def _keep(self, key: tuple[tuple[int, ...], bytes], row: NDArray[np.float32]) -> None:
        """Keep the scores of a row; beyond :data:`KEPT` bytes, the oldest rows are dropped."""
        if key not in self._rows:
            self._size += ROW_BYTES + row.nbytes
        # A copy, so that one row does not hold on to the scores of its batch.
        self._rows[key] = row.copy()
        while self._size > KEPT:
            _, oldest = self._rows.popitem(last=False)
            self._size -= ROW_BYTES + oldest.nbytes

    def forget(self, *_: object) -> None:
        """Drop all scores; takes any arguments, so that it can be a hook of torch."""
        with self._lock:
            self._rows.clear()
            self._size = 0


class Source(nn.Module, ABC):
    """Base class of sources, which score each table slot, from buffers saved with a policy.

    Scores have no gradients: nothing that an agent learns changes a source. A subclass defines
    ``label``, :meth:`of_scorer` and :meth:`forward`, and registers as a buffer whatever its scores
    need; buffers travel with the policy, so an agent's folder is complete without the scorer.

    Attributes:
        label: name and symbol of the source.
        reads_task: True if scores depend on ``states.task``.
        reads_attempts: True if scores depend on ``states.attempts``, which are then required.
        takes_sets: True if the source can score with several selected entities.
        scores_combine: True if the source scores the action to combine, too.
        needs_scorer: False if the source asks nothing of a scorer but its labels.
        num_entities: E, also the id for empty slots and no selection.
        graph_hash: content hash of the recipe graph; empty for sources restored with a policy.
    """

    label: ClassVar[Label]
    reads_task: bool = False
    reads_attempts: ClassVar[bool] = False
    takes_sets: ClassVar[bool] = False
    scores_combine: ClassVar[bool] = False
    needs_scorer: ClassVar[bool] = True

    def __init__(self, num_entities: int):
        """Prepare a source for E entities, without buffers."""
        super().__init__()
        self.num_entities = num_entities
        self.graph_hash = ""

    @property
    def name(self) -> str:
        """Name of the source in settings and records."""
        return self.label.name

    @classmethod
    @abstractmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "Source":
        """Make slot scores from a scorer, as ``view`` says, for tasks that :meth:`bind` will set.

        Raises:
            ConfigError: if the scorer lacks the scores that the source needs.
        """

    @classmethod
    def restored(cls, num_entities: int, constants: Mapping[str, Tensor]) -> "Source":
        """Return a source of saved buffers; their values are loaded once more afterwards.

        Args:
            num_entities: E.
            constants: the buffers in a policy folder by name, as found, perhaps damaged.

        Raises:
            KeyError: if a buffer is missing.
            ValueError: if a buffer has an unexpected type or shape, or holds a number out of range.
        """
        return cls(num_entities)

    def bind(self, tasks: TaskSet) -> None:
        """Set the tasks that ``states.task`` indexes from now on, if :attr:`reads_task`.

        Raises:
            LeakError: if a task would be scored by a model that was trained on its recipes.
            GraphMismatchError: if the tasks belong to another graph or split.
        """

    @abstractmethod
    def forward(self, states: States) -> Tensor:
        """Score every slot of B tables.

        Returns:
            shape (B, A), float32; 0 for empty slots.
        """

    def scores_of_pairs(self, states: States) -> Tensor:
        """Score every pair of slots of B tables, whatever the selection.

        By default the mean over both orders: the score of one slot with the other selected.

        Returns:
            shape (B, A, A), float32, symmetric; scores of pairs with an empty slot mean nothing.
        """
        size, slots = states.table.shape
        # Each slot's entity is selected once: B · A states.
        rows = torch.arange(size, device=states.table.device).repeat_interleave(slots)
        selections = states.table.reshape(-1)
        scores = self(states.of(rows)._replace(selection=selections)).view(size, slots, slots)
        return (scores + scores.transpose(1, 2)) / 2

    def score_observation(self, observation: Mapping[str, Any], task: Any = None) -> Tensor:
        """Score the slots in an environment's observation, for wrappers, which know no models.

        Args:
            observation: see :meth:`States.of_observation`.
            task: index into the tasks of :meth:`bind`; None for tasks without train recipes.

        Returns:
            shape (B, A), float32; B is 1 for a single environment.

        Raises:
            LeakError: if a task is given before :meth:`bind`, and scores depend on it.
        """
        return self(States.of_observation(observation, task))

    def evidence(self, states: States) -> "tuple[Evidence | None, ...]":
        """Return the recipes behind each slot's score in a single state (B = 1).

        Returns:
            Evidence with up to three recipes for each of A slots; None for empty slots, and for
            slots whose score this source cannot justify by recipes. By default None everywhere.
        """
        return (None,) * states.table.shape[1]


class Evidence(NamedTuple):
    """Evidence for the score of a slot's entity.

    Attributes:
        partner: id of the assumed second ingredient: the selection, or the best partner.
        supporting: training recipes that speak for the pair: those for the goal first, then by
            their share of the score.
        plan: expected attempts, each as ids of both ingredients and the result, and the result's
            probability; empty for sources that do not look ahead.
    """

    partner: int
    supporting: tuple[Support, ...]
    plan: tuple[tuple[int, int, int, float], ...] = ()


class FoldedSource(Source):
    """A source that scores each task by a model that has not seen all recipes of any plan.

    Such models exist for cross-fitted scorers: one for each left-out fold of the train recipes.
    Models are numbered as in :func:`~wordcraft_kg.models.scorers.cross_fitting.seen_by_models`.

    Attributes:
        fold_of_recipe: buffer, the fold of each recipe, shape (num_recipes,), int64; empty if made
            without tasks, and so without the models of the folds.
        model_of_task: model number for each of N tasks, then 0 for unlisted tasks, shape (N + 1,).
            Not saved, because the numbers belong to the tasks of :meth:`bind`, not to the policy.
        bound_to: hash of these tasks; empty before :meth:`bind`.
        num_models: number of models but for the empty one of tasks without an out-of-sample model.
        kept: scores of states that recur.
    """

    fold_of_recipe: Tensor
    model_of_task: Tensor

    def __init__(self, num_entities: int, fold_of_recipe: Tensor | None, num_models: int = 1):
        """Prepare a source with one model or more.

        Args:
            num_entities: E.
            fold_of_recipe: shape (num_recipes,); None for a single model.
            num_models: number of models that have arrays of their own.
        """
        super().__init__(num_entities)
        self.num_models = num_models
        self.kept = KeptScores()
        # Other weights give other scores.
        self.register_load_state_dict_post_hook(self.kept.forget)
        self.reads_task = fold_of_recipe is not None
        if fold_of_recipe is not None:
            self.register_buffer("fold_of_recipe", fold_of_recipe)
            self.register_buffer(
                "model_of_task", torch.zeros(0, dtype=torch.int64), persistent=False
            )
        self.bound_to = ""

    @staticmethod
    def num_stored(constants: Mapping[str, Tensor]) -> int:
        """Return the number of models in saved buffers: on all folds, and without each fold.

        Raises:
            ValueError: if the saved folds have an unexpected type or shape, or a number below -1.
        """
        if "fold_of_recipe" not in constants:
            return 1
        check_tensors(constants, {"fold_of_recipe": "recipes int64"})
        fold_of_recipe = constants["fold_of_recipe"]
        # Without tasks there were no models of folds.
        if not len(fold_of_recipe):
            return 1
        # Recipes outside train have the number -1.
        if int(fold_of_recipe.min()) < -1:
            raise ValueError(f"fold_of_recipe has the number {int(fold_of_recipe.min())}")
        return int(fold_of_recipe.max()) + 2

    @staticmethod
    def fold_numbers(scorer: TripleScorer, view: ScoreView) -> Tensor | None:
        """Return each recipe's fold in a cross-fitted scorer; empty if ``view`` has no tasks.

        None for a single model.

        Raises:
            GraphMismatchError: if the tasks belong to another graph than the scorer.
        """
        folded = folds_of(scorer)
        if folded is None:
            return None
        if view.tasks is None:
            return torch.empty(0, dtype=torch.int64)
        check_scorer(folded, view.tasks.graph)
        # Copied, because a buffer on a shared array would change with it.
        return torch.from_numpy(folded.of_recipe.copy())

    def bind(self, tasks: TaskSet) -> None:  # noqa: D102 - inherited
        # Binding again and again is cheap, so that trainers and players bind before each use.
        if not self.reads_task or tasks.hash == self.bound_to:
            return
        if not len(self.fold_of_recipe):
            raise LeakError(
                f"source '{self.name}' was made from a cross-fitted scorer without folds, so train "
                "tasks would have in-sample scores. Make the source with the `tasks` to score, "
                "such as `world.tasks`, or with the scorer's `whole` for in-sample scores."
            )
        # A restored source has no graph hash: the number of recipes is all that can be checked.
        is_same_graph = self.graph_hash in ("", tasks.graph.hash)
        if len(self.fold_of_recipe) != tasks.graph.num_recipes or not is_same_graph:
            raise GraphMismatchError(
                f"source '{self.name}' and the tasks belong to different graphs; the tasks to "
                f"'{tasks.graph.name}', {tasks.graph.hash[:12]}. Use a scorer for the tasks' graph."
            )
        models = models_of_tasks(self.fold_of_recipe.cpu().numpy(), tasks)
        # The last number, for unlisted tasks, is 0: the model that was trained on all folds.
        self.model_of_task = torch.from_numpy(np.append(models, 0)).to(self.fold_of_recipe.device)
        self.bound_to = tasks.hash

    def model_of(self, states: States) -> Tensor:
        """Return the number of the model that scores each of B states.

        Returns:
            shape (B,), int64; 0, the model of all train recipes, for tasks without train recipes.

        Raises:
            LeakError: before :meth:`bind`, because a model trained on the task's recipes could
                score it.
            IndexError: for a number without a task.
        """
        if states.task is None or not self.reads_task:
            return torch.zeros_like(states.goal)
        if not self.bound_to:
            raise LeakError(
                f"source '{self.name}' has a model per fold and needs the tasks to choose an "
                "out-of-sample model: call `bind` first, for example with `world.tasks`."
            )
        return self.model_of_task.index_select(0, states.task)

    def counted_models(self, states: States) -> tuple[Tensor, Tensor]:
        """Return the model that scores each state, and whether its scores count, (B,) each."""
        model = self.model_of(states)
        # The empty model of tasks without an out-of-sample model has the last number, and no
        # arrays: another model computes its scores, which do not count.
        return model.clamp(max=self.num_models - 1), model < self.num_models


def models_of(scorer: TripleScorer, view: ScoreView) -> list[tuple[TripleScorer, ScoreView]]:
    """Return a scorer's model of all recipes, then those without each fold that tasks need.

    Of a cross-fitted scorer, if ``view`` has tasks to score: K + 1 models, on all folds and without
    each fold. Each comes with its view, whose observed triples are its own training triples.

    Args:
        scorer: a scorer, cross-fitted or not.
        view: the tasks to score, and the training triples of the model of all recipes.

    Raises:
        LeakError: if a left-out model was trained on other recipes than its folds say.
        GraphMismatchError: if the tasks' graph has another number of recipes than the scorer's.
    """
    models = [(whole_of(scorer), view)]
    folded = folds_of(scorer)
    if folded is not None and view.tasks is not None:
        for fold in range(folded.count):
            observed = folded.trained_on(fold, view.tasks.graph)
            models.append((folded.left_out(fold), replace(view, observed=observed)))
    return models


def knowledge_of_models(scorer: TripleScorer, view: ScoreView) -> RecipeKnowledge:
    """Return the knowledge of a recipe scorer, on the CPU, which shares its tensors.

    Args:
        scorer: a recipe scorer, cross-fitted or not.
        view: the tasks to score, as for :func:`models_of`, whose errors it raises.
    """
    models = [cast("RecipeScorer", model).knowledge for model, _ in models_of(scorer, view)]
    # Stacked even if alone, because moving a module moves its tensors in place.
    return RecipeKnowledge.stacked(models).cpu()


def share_lists(sources: Iterable[Source]) -> None:
    """Let sources of the same recipes share neighbour lists, which are made when first needed."""
    every = [source.knowledge for source in sources if hasattr(source, "knowledge")]
    recipe_models = [each for each in every if isinstance(each, RecipeKnowledge)]
    for knowledge in recipe_models[1:]:
        knowledge.share_lists(recipe_models[0])
