"""The base of all sources, and of those that ask another model for each fold."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
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
from wordcraft_kg.models.scorers.pair_features import Speaking
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer


@dataclass(frozen=True)
class ScoreView:
    """How a source reads a scorer; the default takes the scores as they are.

    Attributes:
        scale: see :func:`~wordcraft_kg.models.scorers.scales.scaled_table`.
        self_edges: see there.
        observed: triples that the scorer was trained on, shape (T, 3), for ``self_edges`` ``observed``.
        by_factors: take the scores of pairs from the scorer's factors, because a table of all would be too large.
        tasks: tasks that will be scored, which a cross-fitted scorer needs, see :meth:`Source.bind`.
    """

    scale: Scale = "none"
    self_edges: SelfEdges = "keep"
    observed: Ids | None = None
    by_factors: bool = False
    tasks: TaskSet | None = None


AS_IS = ScoreView()
"""Scores as the scorer gives them."""


class Source(nn.Module, ABC):
    """Scores of slots that receive no gradient, from buffers that are saved with a policy.

    Attributes:
        label: its name and symbol.
        reads_task: whether scores depend on the task; only then is the task passed.
        num_entities: E, which is also the id of nothing.
        graph_hash: hash of the graph whose ids it uses; empty if it was restored with a policy, which has the hash.
    """

    label: ClassVar[Label]
    reads_task: bool = False

    def __init__(self, num_entities: int):
        """Prepare empty constants for E entities."""
        super().__init__()
        self.num_entities = num_entities
        self.graph_hash = ""

    @property
    def name(self) -> str:
        """Name in settings and records."""
        return self.label.name

    @classmethod
    @abstractmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "Source":
        """Return the source of a scorer.

        Raises:
            ConfigError: if this scorer cannot give what the source needs.
        """

    @classmethod
    def restored(cls, num_entities: int, constants: Mapping[str, Tensor]) -> "Source":
        """Return a source whose buffers have the sizes of the saved ones, so that these can be loaded."""
        return cls(num_entities)

    @classmethod
    def num_bytes(cls, scorer: TripleScorer) -> int:
        """Return the size of the constants of a scorer, as far as it is known before they are computed."""
        return 0

    def bind(self, tasks: TaskSet) -> None:
        """Take the tasks whose numbers are passed from now on; does nothing unless scores depend on the task.

        Raises:
            LeakError: if one would be scored by a model that has been trained on its recipes.
            GraphMismatchError: if they are tasks of another graph or split.
        """

    @abstractmethod
    def forward(self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None) -> Tensor:
        """Score every slot.

        Args:
            goal: shape (B,), int64: the entity to make.
            selection: shape (B,), int64: the entity held, E for nothing.
            table: shape (B, A), int64: the entities on the table, E for an empty slot.
            task: shape (B,), int64: number of the task among those of :meth:`bind`, or their number for another task.
                None for tasks without train recipes, or if :attr:`reads_task` is False.

        Returns:
            shape (B, A), float32; 0 for an empty slot.
        """

    def evidence(
        self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None, *, limit: int = 3
    ) -> "tuple[Evidence | None, ...]":
        """Return the evidence for each slot of one state (B = 1), at most ``limit`` recipes each; None without any."""
        return (None,) * table.shape[1]


def check_constants(constants: Mapping[str, Tensor], layouts: Mapping[str, str], **sizes: int) -> None:
    """Check types and shapes of saved constants.

    Args:
        constants: tensors by name.
        layouts: type and axes by name, such as ``N N float32``; axes of the same name have the same size.
        sizes: known sizes of axes.

    Raises:
        KeyError: if a constant is missing.
        ValueError: if a constant has another type or shape.
    """
    for name, layout in layouts.items():
        *axes, dtype = layout.split()
        tensor = constants[name]
        expected = [sizes.setdefault(axis, size) for axis, size in zip(axes, tensor.shape, strict=False)]
        if str(tensor.dtype) != f"torch.{dtype}" or len(axes) != tensor.ndim or expected != list(tensor.shape):
            raise ValueError(f"{name} is of {tensor.dtype} and shape {tuple(tensor.shape)}: expected {layout}")


class Evidence(NamedTuple):
    """The evidence for a slot: its supposed partner, and supporting recipes, largest share first."""

    partner: int
    speaking: tuple[Speaking, ...]


class FoldedSource(Source):
    """A source that, of a cross-fitted scorer, asks for each task a model that has not seen its recipes.

    Models are numbered as in :func:`~wordcraft_kg.models.scorers.cross_fitting.seen_by_models`.

    Attributes:
        fold_of_recipe: buffer of a cross-fitted scorer only, shape (num_recipes,), int64; empty without tasks.
        model_of_task: model of each bound task, and then that of all train recipes, shape (N + 1,). Not saved.
    """

    fold_of_recipe: Tensor
    model_of_task: Tensor

    def __init__(self, num_entities: int, fold_of_recipe: Tensor | None):
        """Take the fold of each recipe, None if the scorer is not cross-fitted."""
        super().__init__(num_entities)
        self.reads_task = fold_of_recipe is not None
        if fold_of_recipe is not None:
            self.register_buffer("fold_of_recipe", fold_of_recipe)
            self.register_buffer("model_of_task", torch.zeros(0, dtype=torch.int64), persistent=False)
        self.bound_to = ""  # hash of the tasks

    @staticmethod
    def num_folds(constants: Mapping[str, Tensor]) -> int | None:
        """Return the number of folds of saved constants, None without a model for each fold."""
        if "fold_of_recipe" not in constants:
            return None
        check_constants(constants, {"fold_of_recipe": "recipes int64"})
        of_recipe = constants["fold_of_recipe"]
        return int(of_recipe.max()) + 1 if len(of_recipe) else None

    @staticmethod
    def fold_numbers(scorer: CrossFitted, view: ScoreView) -> Tensor:
        """Return the fold of each recipe for a source that is made with tasks; empty for one that is not."""
        if view.tasks is None:
            return torch.empty(0, dtype=torch.int64)
        check_scorer(scorer, view.tasks.graph)
        return torch.from_numpy(scorer.of_recipe.copy())

    def bound(self, view: ScoreView) -> Self:
        """Return itself, bound to the tasks of a view if it has any."""
        if view.tasks is not None:
            self.bind(view.tasks)
        return self

    def bind(self, tasks: TaskSet) -> None:  # noqa: D102 - inherited
        if not self.reads_task or tasks.hash == self.bound_to:
            return
        if not len(self.fold_of_recipe):
            raise LeakError(
                f"source '{self.name}' was made of a cross-fitted scorer without its folds, so it would answer train "
                "tasks from memory. Make it with the `tasks` that it will score, such as those of the environment's "
                "world, or with the scorer's `whole` if memory is what you want."
            )
        if len(self.fold_of_recipe) != tasks.graph.num_recipes or self.graph_hash not in ("", tasks.graph.hash):
            raise GraphMismatchError(
                f"source '{self.name}' belongs to another graph than the tasks, which are of '{tasks.graph.name}', "
                f"{tasks.graph.hash[:12]}. Take a scorer of that graph."
            )
        models = models_of_tasks(self.fold_of_recipe.cpu().numpy(), tasks)
        self.model_of_task = torch.from_numpy(np.append(models, 0)).to(self.fold_of_recipe.device)
        self.bound_to = tasks.hash

    def model_of(self, task: Tensor | None) -> Tensor | None:
        """Return the model that answers each state, shape (B,); None for that of all train recipes.

        Raises:
            LeakError: if the tasks are not known.
            IndexError: for a number that no task has.
        """
        if task is None or not self.reads_task:
            return None
        if not self.bound_to:
            raise LeakError(
                f"source '{self.name}' has a model for each fold of the train recipes, and does not know which of them "
                "has not seen a task's: bind it to the tasks first, such as those of the environment's world."
            )
        return self.model_of_task.index_select(0, task)
