"""Base classes: for sources, and for sources with a model per left-out fold."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor, nn

from wordcraft_kg.base.errors import GraphMismatchError, LeakError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.tasks import TaskSet
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.scorers.config import Scale, SelfEdges
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, models_of_tasks
from wordcraft_kg.models.scorers.pair_features import Support
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer


@dataclass(frozen=True)
class ScoreView:
    """Settings that turn a scorer's triple scores into slot scores; by default raw scores.

    Attributes:
        scale: common scale, see :func:`~wordcraft_kg.models.scorers.scales.scaled_table`.
        self_edges: keep or drop scores of an entity with itself, or keep only ``observed`` triples.
        observed: the scorer's training triples, shape (T, 3).
        by_factors: use the scorer's matrix factors, for graphs too large for a score table.
        width: most intermediates per search for a plan; 0 for the default.
        tasks: tasks to score, required by scorers with a model per left-out fold, see :meth:`Source.bind`.
    """

    scale: Scale = "none"
    self_edges: SelfEdges = "keep"
    observed: Ids | None = None
    by_factors: bool = False
    width: int = 0
    tasks: TaskSet | None = None


AS_IS = ScoreView()
"""Raw scores."""


class Attempts(NamedTuple):
    """Attempts left in B episodes, and the pairs combined so far (B, n, 2), padded with E; None if unknown."""

    left: Tensor
    tried: Tensor | None = None


class Source(nn.Module, ABC):
    """Base class of sources, which score each table slot without gradients, from buffers saved with a policy.

    Attributes:
        label: name and symbol of the source.
        reads_task: True if scores depend on the task.
        reads_attempts: True if scores depend on :class:`Attempts`, a further argument ``attempts`` of calls.
        num_entities: E, also the id for empty slots and no selection.
        graph_hash: content hash of the recipe graph; empty for sources restored with a policy.
    """

    label: ClassVar[Label]
    reads_task: bool = False
    reads_attempts: ClassVar[bool] = False

    def __init__(self, num_entities: int):
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
        """Make slot scores from a scorer, as ``view`` says; ConfigError if the scorer lacks the needed scores."""

    @classmethod
    def restored(cls, num_entities: int, constants: Mapping[str, Tensor]) -> "Source":
        """Return a source with buffers that have the saved constants' shapes, before loading values."""
        return cls(num_entities)

    @classmethod
    def num_bytes(cls, scorer: TripleScorer) -> int:
        """Estimate how many bytes the source's buffers would take for a scorer."""
        return 0

    def bind(self, tasks: TaskSet) -> None:
        """Set the tasks that task numbers index, if :attr:`reads_task`; LeakError or GraphMismatchError."""

    @abstractmethod
    def forward(
        self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None
    ) -> Tensor:
        """Score every slot: shape (B, A), float32; 0 for empty slots. Arguments as for a policy's ``forward``."""

    def evidence(
        self,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        task: Tensor | None = None,
        attempts: Attempts | None = None,
    ) -> "tuple[Evidence | None, ...]":
        """Return up to three recipes that support each slot's score in a single state (B = 1); None without any."""
        return (None,) * table.shape[1]


def ask(
    source: Callable[..., Tensor],
    goal: Tensor,
    selection: Tensor,
    table: Tensor,
    task: Tensor | None = None,
    attempts: Attempts | None = None,
) -> Tensor:
    """Return a source's scores, (B, A); ``attempts`` go only to sources that look ahead."""
    if getattr(source, "reads_attempts", False):
        return source(goal, selection, table, task, attempts=attempts)
    return source(goal, selection, table, task)


def check_constants(
    constants: Mapping[str, Tensor], layouts: Mapping[str, str], **sizes: int
) -> None:
    """Check types and shapes of a source's saved tensors; KeyError if one is missing, ValueError if one is wrong.

    ``layouts`` gives each tensor's axis names, then the type, such as ``N N float32``; axes with the same name have the
    same size. ``sizes`` are known sizes by axis name.
    """
    for name, layout in layouts.items():
        *axes, dtype = layout.split()
        tensor = constants[name]
        expected = [
            sizes.setdefault(axis, size) for axis, size in zip(axes, tensor.shape, strict=False)
        ]
        if (
            str(tensor.dtype) != f"torch.{dtype}"
            or len(axes) != tensor.ndim
            or expected != list(tensor.shape)
        ):
            raise ValueError(
                f"{name} has type {tensor.dtype}, shape {tuple(tensor.shape)}: expected {layout}"
            )


class Evidence(NamedTuple):
    """Evidence for a slot's score: the assumed second ingredient, and supporting recipes, those for the goal first.

    Attributes:
        plan: expected attempts, each as ids of both ingredients and the result, and the result's probability; empty
            for sources that do not look ahead.
    """

    partner: int
    supporting: tuple[Support, ...]
    plan: tuple[tuple[int, int, int, float], ...] = ()


class FoldedSource(Source):
    """A source that scores each task by a model that has not seen all recipes of any plan.

    Models are numbered as in :func:`~wordcraft_kg.models.scorers.cross_fitting.seen_by_models`.

    Attributes:
        fold_of_recipe: buffer, the fold of each recipe, shape (num_recipes,), int64; empty if made without tasks.
        model_of_task: model number for each of N tasks, then 0 for unlisted tasks, shape (N + 1,). Not saved.
    """

    fold_of_recipe: Tensor
    model_of_task: Tensor

    def __init__(self, num_entities: int, fold_of_recipe: Tensor | None):
        super().__init__(num_entities)
        self.reads_task = fold_of_recipe is not None
        if fold_of_recipe is not None:
            self.register_buffer("fold_of_recipe", fold_of_recipe)
            self.register_buffer(
                "model_of_task", torch.zeros(0, dtype=torch.int64), persistent=False
            )
        self.bound_to = ""  # task hash

    @staticmethod
    def num_folds(constants: Mapping[str, Tensor]) -> int | None:
        """Return the number of left-out folds in a policy folder's tensors by name; None for a single model."""
        if "fold_of_recipe" not in constants:
            return None
        check_constants(constants, {"fold_of_recipe": "recipes int64"})
        of_recipe = constants["fold_of_recipe"]
        return int(of_recipe.max()) + 1 if len(of_recipe) else None

    @staticmethod
    def fold_numbers(scorer: CrossFitted, view: ScoreView) -> Tensor:
        """Return each recipe's fold in a cross-fitted scorer; empty if ``view`` has no tasks."""
        if view.tasks is None:
            return torch.empty(0, dtype=torch.int64)
        check_scorer(scorer, view.tasks.graph)
        return torch.from_numpy(scorer.of_recipe.copy())

    def bound(self, view: ScoreView) -> Self:
        """Choose each task's model by :meth:`bind` if ``view`` has tasks; return this object."""
        if view.tasks is not None:
            self.bind(view.tasks)
        return self

    def bind(self, tasks: TaskSet) -> None:  # noqa: D102 - inherited
        if not self.reads_task or tasks.hash == self.bound_to:
            return
        if not len(self.fold_of_recipe):
            raise LeakError(
                f"source '{self.name}' was made from a cross-fitted scorer without folds, so train tasks would have "
                "in-sample scores. Make the source with the `tasks` to score, such as `world.tasks`, or with the "
                "scorer's `whole` for in-sample scores."
            )
        if len(self.fold_of_recipe) != tasks.graph.num_recipes or self.graph_hash not in (
            "",
            tasks.graph.hash,
        ):
            raise GraphMismatchError(
                f"source '{self.name}' and the tasks belong to different graphs; the tasks to '{tasks.graph.name}', "
                f"{tasks.graph.hash[:12]}. Use a scorer for the tasks' graph."
            )
        models = models_of_tasks(self.fold_of_recipe.cpu().numpy(), tasks)
        self.model_of_task = torch.from_numpy(np.append(models, 0)).to(self.fold_of_recipe.device)
        self.bound_to = tasks.hash

    def model_of(self, task: Tensor | None) -> Tensor | None:
        """Return each state's model number, (B,); LeakError before :meth:`bind`, IndexError out of range."""
        if task is None or not self.reads_task:
            return None
        if not self.bound_to:
            raise LeakError(
                f"source '{self.name}' has a model per fold and needs the tasks to choose an out-of-sample model: call "
                "`bind` first, for example with `world.tasks`."
            )
        return self.model_of_task.index_select(0, task)
