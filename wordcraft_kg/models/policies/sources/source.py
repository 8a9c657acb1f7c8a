"""The base of all sources, and of those that score pairs of entities."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor, nn

from wordcraft_kg.base.errors import ConfigError, GraphMismatchError, LeakError
from wordcraft_kg.base.settings import check_memory
from wordcraft_kg.base.tensors import lazily_zero
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.tasks import TaskSet
from wordcraft_kg.models.policies.sources import Label, source_class
from wordcraft_kg.models.scorers.config import TABLE_LIMIT, Scale, SelfEdges
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, folds_of, models_of_tasks
from wordcraft_kg.models.scorers.pair_features import Speaking
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer, check_scorer
from wordcraft_kg.models.scorers.scales import FACTORED_SCALES, scaled_factors, scaled_table


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


class Source(nn.Module, ABC):
    """Scores of slots that receive no gradient.

    Everything that a source has computed from a scorer is in its buffers, which are saved with a policy and are all
    that is needed to use the source again.

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
        """Return what speaks for each slot of one state; None for a slot of which the source cannot tell.

        Args:
            goal: shape (1,), as in :meth:`forward`.
            selection: shape (1,).
            table: shape (1, A).
            task: shape (1,), or None.
            limit: the most recipes for a slot.
        """
        return (None,) * table.shape[1]


class Evidence(NamedTuple):
    """What speaks for picking a slot.

    Attributes:
        partner: the entity that the slot is thought to go with.
        speaking: recipes, those that say most first; none if no recipe says anything.
    """

    partner: int
    speaking: tuple[Speaking, ...]


class FoldedSource(Source):
    """A source that, of a cross-fitted scorer, asks for each task a model that has not seen its recipes.

    Models are numbered as in :func:`~wordcraft_kg.models.scorers.cross_fitting.seen_by_models`.

    Attributes:
        fold_of_recipe: buffer of a cross-fitted scorer only, shape (num_recipes,), int64; empty if the source was made
            without tasks, and so without the models of the folds.
        model_of_task: which model answers each task that is bound, and then that of all train recipes, shape (N + 1,).
            Not saved: it belongs to the tasks.
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


class PairSource(FoldedSource):
    """Scores each slot's entity with a key, the goal or the entity held: by a table of all pairs, or by factors.

    Of a cross-fitted scorer there are K + 2 tables, or factors: the first axis of each buffer says which model they
    are of, see :func:`~wordcraft_kg.models.scorers.cross_fitting.seen_by_models`; those of no model are 0. The task
    decides which one is asked; without a task it is that of all train recipes.

    Attributes:
        scores: buffer of a table, shape (E + 1, E + 1): by key, by the slot's entity; 0 for nothing.
        left: buffer of factors, like those below, see :class:`~wordcraft_kg.models.scorers.scales.ScaledFactors`;
            shape (E + 1, m), by the slot's entity; 0 for nothing.
        right: shape (E + 1, m), by the key; 0 for nothing.
        shift: shape (), what is taken off each product.
        dropped: shape (E + 1,), bool.
        itself: shape ().
    """

    scores: Tensor
    left: Tensor
    right: Tensor
    shift: Tensor
    dropped: Tensor
    itself: Tensor

    def __init__(self, num_entities: int, constants: Mapping[str, Tensor]):
        """Take the buffers, either ``scores`` or those of factors, and ``fold_of_recipe`` of a cross-fitted scorer."""
        super().__init__(num_entities, constants.get("fold_of_recipe"))
        self.is_table = "scores" in constants
        for name in ("scores",) if self.is_table else ("left", "right", "shift", "dropped", "itself"):
            self.register_buffer(name, constants[name])

    @classmethod
    def of_pairs(cls, scorer: TripleScorer, relation: int, view: ScoreView, *, self_edges: SelfEdges = "keep") -> Self:
        """Return the source of a scorer's scores of all pairs in one relation, slot's entity first, then key."""
        size = len(scorer.entities)
        constants = _constants(scorer, relation, replace(view, self_edges=self_edges))
        folded = folds_of(scorer)
        if folded is None:
            return cls(size, constants)
        of_recipe = cls.fold_numbers(folded, view)
        if view.tasks is not None:
            graph = view.tasks.graph
            of_folds = [
                _constants(
                    folded.left_out(fold),
                    relation,
                    replace(view, self_edges=self_edges, observed=folded.trained_on(fold, graph)),
                )
                for fold in range(folded.count)
            ]
            of_nothing = {name: torch.zeros_like(tensor) for name, tensor in constants.items()}
            models = (constants, *of_folds, of_nothing)
            constants = {name: torch.stack([model[name] for model in models]) for name in constants}
        return cls(size, {**constants, "fold_of_recipe": of_recipe}).bound(view)

    @classmethod
    def restored(cls, num_entities: int, constants: Mapping[str, Tensor]) -> Self:  # noqa: D102 - inherited
        return cls(num_entities, {name: lazily_zero(tensor) for name, tensor in constants.items()})

    @classmethod
    def num_bytes(cls, scorer: TripleScorer) -> int:  # noqa: D102 - inherited
        return (len(scorer.entities) + 1) ** 2 * 4

    @abstractmethod
    def key(self, goal: Tensor, selection: Tensor) -> Tensor:
        """Return the entity whose scores are asked for, shape (B,)."""

    def forward(self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None) -> Tensor:  # noqa: D102 - inherited
        key = self.key(goal, selection)[:, None]
        rows, width = table, self.num_entities + 1
        model = self.model_of(task)
        if self.is_table:
            cells = torch.add(table, key if model is None else key + width * model[:, None], alpha=width)
            return self.scores.view(-1).index_select(0, cells.reshape(-1)).view(cells.shape)
        shift, itself, keys = self.shift, self.itself, key[:, 0]
        if self.left.ndim == 3:  # there are several models
            model = torch.zeros_like(goal) if model is None else model
            shift, itself = shift[model][:, None], itself[model][:, None]
            rows, keys = table + width * model[:, None], keys + width * model
        slots = self.left.flatten(0, -2).index_select(0, rows.reshape(-1)).view(*table.shape, -1)
        scores = torch.bmm(slots, self.right.flatten(0, -2)[keys][:, :, None])[:, :, 0] - shift
        scores = torch.where((table == key) & self.dropped.view(-1)[rows], itself, scores)
        return scores.masked_fill((table == self.num_entities) | (key == self.num_entities), 0)


def _constants(scorer: TripleScorer, relation: int, view: ScoreView) -> dict[str, Tensor]:
    """Return the buffers of one model's scores of all pairs."""
    size = len(scorer.entities)
    settings: dict[str, Any] = {"self_edges": view.self_edges, "observed": view.observed}
    if not view.by_factors:
        table = torch.zeros(size + 1, size + 1)
        table[:-1, :-1] = scaled_table(scorer, relation, view.scale, **settings).detach().cpu().T
        return {"scores": table}
    assert isinstance(scorer, FactoredScorer)
    constants = dict(vars(scaled_factors(scorer, relation, view.scale, **settings)))
    return constants | {name: _with_nothing(constants[name]) for name in ("left", "right", "dropped")}


def _with_nothing(rows: Tensor) -> Tensor:
    """Return rows of all entities with one of zeros for nothing."""
    return torch.cat([rows, torch.zeros_like(rows[:1])])


def pairs_need_factors(names: Iterable[str], scorer: TripleScorer, scale: Scale) -> bool:
    """Return whether tables of all pairs would be too large, so that sources have to score by factors.

    Raises:
        ConfigError: if they have to and cannot, saying what they would need and what works.
    """
    size = len(scorer.entities)
    needed = sum(source_class(name).num_bytes(scorer) for name in names)
    if needed <= TABLE_LIMIT:
        if (folded := folds_of(scorer)) is not None:
            what = "tables of the scores of all pairs, one for each"
            check_memory("folds", folded.count, what, needed * (folded.count + 2))
        return False
    cost = (
        f"the scores of all pairs of {size:,} entities take {needed / 2**20:,.0f} MiB; expected at most "
        f"{TABLE_LIMIT / 2**20:.0f} MiB, because sources look them up in tables"
    )
    if not isinstance(scorer, FactoredScorer):
        raise ConfigError(
            f"{cost}; only the scores of ComplEx, DistMult and the recipe kernel of low rank can be computed without. "
            "Take one of these."
        )
    if scale not in FACTORED_SCALES:
        raise ConfigError(f"`scale` {scale}: {cost}. Choose {' or '.join(FACTORED_SCALES)}, which need none.")
    return True


def make_sources(
    names: Iterable[str], scorer: TripleScorer, view: ScoreView = ScoreView(), *, tasks: TaskSet | None = None
) -> list[Source]:
    """Return sources of a scorer by name.

    Args:
        names: names of the sources.
        scorer: the scorer.
        view: how they read it.
        tasks: tasks that they will score, such as ``world.tasks``, of which a cross-fitted scorer has to know the
            recipes. Without them, sources of a cross-fitted scorer answer for test tasks only.

    Raises:
        ConfigError: if the scorer cannot serve one, or only by a table that would be too large (before it is computed).
        LeakError: if a task would be scored by a model that has been trained on its recipes.
        GraphMismatchError: if the tasks are of another graph or split than the scorer's folds.

    Example:
        >>> u, v = make_sources(["u", "v"], load_scorer("models/kitchen"))
        >>> u.label.symbol, v.graph_hash == open_graph("kitchen").graph.hash
        ('u', True)
    """
    names = tuple(names)
    if tasks is not None:
        view = replace(view, tasks=tasks)
    if pairs_need_factors(names, scorer, view.scale):
        view = replace(view, by_factors=True)
    sources = [source_class(name).of_scorer(scorer, view) for name in names]
    for source in sources:
        source.graph_hash = scorer.graph_hash
    return sources
