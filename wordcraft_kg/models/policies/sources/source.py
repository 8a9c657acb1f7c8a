"""Base classes: for sources, and for sources with a model per left-out fold."""

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from wordcraft_kg.base.errors import GraphMismatchError, LeakError
from wordcraft_kg.base.tensors import check_tensors
from wordcraft_kg.graphs import Ids, TaskSet
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.config import Scale, SelfEdges
from wordcraft_kg.models.scorers.cross_fitting import folds_of, models_of_tasks, whole_of
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge, Support
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer

Rows = Tensor | slice
"""Rows of a batch: their numbers, or all of them as a slice."""
KEPT = 2**24
"""Most scores that a source keeps for rows of one shape: 64 MiB of float32."""
WAYS = 4
"""Places of a set. With as many rows as an eighth of all places, one in 6,000 sets has too few."""
MOST_SHAPES = 8
"""Most shapes of rows: tables grow by a slot with each result."""
_HASH_SEED = 0
"""Any seed serves: hashes are compared with hashes of the same process alone."""


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


class _KeptRows:
    """Places for scores of one shape, in sets; where all places of a set are taken, one is reused.

    Attributes:
        sets: number of sets, a power of two.
        hashes: shape (sets, WAYS, 2): hash of the inputs at each place; zeros where it is free.
        scores: shape (sets, WAYS, ...), float32.
    """

    def __init__(self, shape: tuple[int, ...]):
        """Keep nothing yet, for rows of this shape."""
        capacity = max(1, KEPT // (WAYS * max(1, math.prod(shape))))
        self.sets: int = 1 << (capacity.bit_length() - 1)
        # Memory of zeros is taken from the system only when it is written.
        self.hashes = np.zeros((self.sets, WAYS, 2), dtype=np.int64)
        self.scores = np.zeros((self.sets, WAYS, *shape), dtype=np.float32)

    def sets_of(self, hashes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the set of each row, shape (B,), by its hashes, (B, 2)."""
        return hashes[:, 0] & (self.sets - 1)

    def find(self, hashes: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Return scores, (B, ...), by hashes, (B, 2), and the numbers of rows without any, (n,)."""
        sets = self.sets_of(hashes)
        is_here = (self.hashes[sets] == hashes[:, None]).all(2)
        missing = (~is_here.any(1)).nonzero()[0]
        return self.scores[sets, is_here.argmax(1)], missing

    def keep(self, hashes: NDArray[np.int64], scores: NDArray[np.float32]) -> None:
        """Keep the scores of rows, (n, ...), with these hashes, (n, 2)."""
        sets = self.sets_of(hashes)
        is_free = (self.hashes[sets] == 0).all(2)
        ways = np.where(is_free.any(1), is_free.argmax(1), hashes[:, 1] & (WAYS - 1))
        # Where rows of a batch share a place, NumPy writes the last one, hash and scores alike.
        self.hashes[sets, ways] = hashes
        self.scores[sets, ways] = scores


class KeptScores:
    """Scores of states that recur, for sources by neighbour lists.

    A table is scored before and after the first action, for another player on the same tables, and
    whenever a training plays it again. A row must have the same bits in any batch.

    The hash of a row's inputs says where it is kept, so looking up a batch takes a few operations
    however many rows are kept. Two hashes of 64 bits stand for the inputs, whose ids are below
    2^31: that two rows are mistaken for each other has a probability below 2^-64. Threads may call
    concurrently.
    """

    def __init__(self) -> None:
        """Keep nothing yet."""
        self._rows: dict[tuple[int, ...], _KeptRows] = {}
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
        parts = list(inputs)
        device = parts[0].device
        hashes = _hashes(parts)
        with self._lock:
            cache = self._rows.pop(shape, None) or _KeptRows(shape)
            # The shape that was asked for last comes last, and the first one falls off.
            self._rows[shape] = cache
            if len(self._rows) > MOST_SHAPES:
                del self._rows[next(iter(self._rows))]
            stored_scores, missing = cache.find(hashes)
        scores = torch.from_numpy(stored_scores).to(device)
        if not len(missing):
            return scores
        is_all = len(missing) == len(hashes)
        rows = slice(None) if is_all else torch.from_numpy(missing).to(device)
        values = compute(rows)
        scores[rows] = values
        with self._lock:
            cache.keep(hashes[missing], values.cpu().numpy())
        return scores

    def forget(self, *_: object) -> None:
        """Drop all scores; takes any arguments, so that it can be a hook of torch."""
        self._rows = {}


def _hashes(parts: Sequence[Tensor]) -> NDArray[np.int64]:
    """Return two hashes of each row of all parts together, shape (B, 2)."""
    columns = [part.reshape(len(part), -1).cpu().numpy() for part in parts]
    numbers = np.concatenate(columns, axis=1, dtype=np.int64)
    factors = _factors(numbers.shape[1])
    # Sums of products with random odd numbers, which wrap around at 64 bits. A first term keeps
    # rows of zeros from the hash of a free place.
    sums = factors[0] + numbers @ factors[1:]
    # High bits depend on all bits below, and places are low bits.
    return sums ^ (sums >> 32)


@cache
def _factors(columns: int) -> NDArray[np.int64]:
    """Return random odd numbers for the hashes of rows, shape (1 + columns, 2)."""
    generator = np.random.default_rng(_HASH_SEED)
    return generator.integers(-(2**63), 2**63 - 1, (1 + columns, 2)) | 1


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
        """Make slot scores from a scorer, as ``view`` says.

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

    @classmethod
    def num_bytes(cls, scorer: TripleScorer) -> int:
        """Estimate the size of the source's buffers for a scorer, before they are computed."""
        return 0

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
    """

    fold_of_recipe: Tensor
    model_of_task: Tensor

    def __init__(self, num_entities: int, fold_of_recipe: Tensor | None):
        """Take each recipe's fold, shape (num_recipes,); None for a single model."""
        super().__init__(num_entities)
        self.reads_task = fold_of_recipe is not None
        if fold_of_recipe is not None:
            self.register_buffer("fold_of_recipe", fold_of_recipe)
            self.register_buffer(
                "model_of_task", torch.zeros(0, dtype=torch.int64), persistent=False
            )
        self.bound_to = ""

    @staticmethod
    def num_folds(constants: Mapping[str, Tensor]) -> int | None:
        """Return the number of left-out folds in saved buffers; None for a single model.

        Raises:
            ValueError: if the saved folds have an unexpected type or shape, or a number below -1.
        """
        if "fold_of_recipe" not in constants:
            return None
        check_tensors(constants, {"fold_of_recipe": "recipes int64"})
        fold_of_recipe = constants["fold_of_recipe"]
        # Without tasks there were no models of folds.
        if not len(fold_of_recipe):
            return None
        # Recipes outside train have the number -1.
        if int(fold_of_recipe.min()) < -1:
            raise ValueError(f"fold_of_recipe has the number {int(fold_of_recipe.min())}")
        return int(fold_of_recipe.max()) + 1

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

    def bound(self, view: ScoreView) -> Self:
        """Choose each task's model by :meth:`bind` if ``view`` has tasks; return this object.

        Raises:
            LeakError: if a task would be scored by a model that was trained on its recipes.
            GraphMismatchError: if the tasks belong to another graph or split.
        """
        if view.tasks is not None:
            self.bind(view.tasks)
        return self

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

    def model_of(self, task: Tensor | None) -> Tensor | None:
        """Return the number of the model that scores each state.

        Args:
            task: shape (B,), int64, as in :class:`States`; None for tasks without train recipes.

        Returns:
            shape (B,), int64; None if the model of all train recipes scores all states.

        Raises:
            LeakError: before :meth:`bind`, because a model trained on the task's recipes could
                score it.
            IndexError: for a number without a task.
        """
        if task is None or not self.reads_task:
            return None
        if not self.bound_to:
            raise LeakError(
                f"source '{self.name}' has a model per fold and needs the tasks to choose an "
                "out-of-sample model: call `bind` first, for example with `world.tasks`."
            )
        return self.model_of_task.index_select(0, task)


def models_of(scorer: TripleScorer, view: ScoreView) -> list[TripleScorer]:
    """Return a scorer's model of all recipes, then those without each fold that tasks need.

    Of a cross-fitted scorer, if ``view`` has tasks to score: K + 1 models, on all folds and without
    each fold.

    Args:
        scorer: a scorer, cross-fitted or not.
        view: the tasks to score.

    Raises:
        LeakError: if a left-out model was trained on other recipes than its folds say.
        GraphMismatchError: if the tasks' graph has another number of recipes than the scorer's.
    """
    models = [whole_of(scorer)]
    folded = folds_of(scorer)
    if folded is not None and view.tasks is not None:
        for fold in range(folded.count):
            folded.trained_on(fold, view.tasks.graph)  # raises LeakError
            models.append(folded.left_out(fold))
    return models


def knowledge_of_models(scorer: TripleScorer, view: ScoreView) -> RecipeKnowledge:
    """Return the knowledge of a recipe scorer, on the CPU, which shares its tensors.

    Args:
        scorer: a recipe scorer, cross-fitted or not.
        view: the tasks to score, as for :func:`models_of`, whose errors it raises.
    """
    recipe_models = [model for model in models_of(scorer, view) if isinstance(model, RecipeScorer)]
    # Stacked even if alone, because moving a module moves its tensors in place.
    return RecipeKnowledge.stacked([model.knowledge for model in recipe_models]).cpu()


def share_lists(sources: Iterable[Source]) -> None:
    """Let sources of the same recipes share neighbour lists, which are made when first needed."""
    every = [source.knowledge for source in sources if hasattr(source, "knowledge")]
    recipe_models = [each for each in every if isinstance(each, RecipeKnowledge)]
    for knowledge in recipe_models[1:]:
        knowledge.share_lists(recipe_models[0])
