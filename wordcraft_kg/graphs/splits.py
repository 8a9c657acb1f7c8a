"""Split recipes into train, validation and test parts, and derive each part's triples.

Recipes are split, not triples: a recipe of two gives four triples, and one of them in train would
give the others away. Add a kind of split to :data:`SPLITS`, here or by ``@split`` of
:mod:`wordcraft_kg.plugins`. :func:`read_published_split` takes the parts from somebody's file.
"""

import hashlib
import json
import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    Count,
    GraphMismatchError,
    Hash,
    NotRegisteredError,
    Record,
    SplitError,
    as_values,
    check_file,
    counted,
    require,
    stage,
    whole,
)
from wordcraft_kg.base.artefacts import gunzip, is_gzip
from wordcraft_kg.base.registry import Registry, check_plugins
from wordcraft_kg.graphs.arrays import (
    Ids,
    absent,
    different_ingredients,
    distinct,
    frozen,
    json_recipes,
)
from wordcraft_kg.graphs.book_files.files import MAX_BOOK_SIZE, without_repeated_keys
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import MOST_INGREDIENTS, Recipe
from wordcraft_kg.graphs.triples import is_in, recipe_triples

_SPLIT_FORMAT = "wordcraft-kg split 1"
TRAIN = 0
VALID = 1
TEST = 2
PARTS = ("train", "valid", "test")
Part = Literal["train", "valid", "test"]
"""A part (subset) of a split."""
_FEWEST_BY_GOAL = 100  # recipes of a graph that may be split by-goal without being told


@dataclass(frozen=True)
class SplitConfig:
    """Settings for a split of recipes into train, validation and test parts.

    Attributes:
        kind: name in :data:`SPLITS`: by-recipe holds out ingredient pairs, by-goal results,
            by-slot groups of recipes with the same ingredient and result, by-kind kinds of
            reasoning.
        train_ratio: fraction of the pairs, goals, groups or kinds for training; between 0 and 1,
            0.8 in the paper.
        valid_ratio: fraction for validation, from 0; the rest is the test part and must not be
            empty.
        seed: random seed.

    Raises:
        ConfigError: if the kind is unknown, or a ratio or the seed is out of range.

    Example:
        >>> SplitConfig("by-goal", train_ratio=0.7, seed=1).valid_ratio
        0.0
    """

    kind: str = "by-recipe"
    train_ratio: float = 0.8
    valid_ratio: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        SPLITS.check("kind", self.kind)
        is_share = 0 < self.train_ratio < 1
        require(self, "train_ratio", is_share, "more than 0 and less than 1, such as 0.8")
        # 0.8 + 0.2 and the like may be a bit below 1.
        test_ratio = 1 - self.train_ratio - self.valid_ratio
        is_valid = self.valid_ratio >= 0 and test_ratio > 1e-9
        require(self, "valid_ratio", is_valid, "0, or a share that leaves a test part")
        whole("seed", self.seed, 0)


class Published(Record):
    """The file that a published split comes from.

    Attributes:
        file: its name.
        sha256: hash of its bytes.
        unknown: entries that name no recipe of the graph.
    """

    file: str
    sha256: Hash
    unknown: Count


@dataclass(frozen=True)
class SplitKind:
    """A method for splitting recipes.

    Attributes:
        groups: returns each recipe's group number, shape (num_recipes,); all recipes of a group are
            in the same part, and in the same cross-fitting fold.
        about: description, for the help.
        uses_kinds: whether the split depends on the kinds of recipes, which the graph's hash leaves
            out and the split's hash includes then.
        unit: names several groups in a text, such as "goals": intervals resample them.
    """

    groups: Callable[[RecipeGraph], Ids]
    about: str
    uses_kinds: bool = False
    unit: str = "recipes"


class Split:
    """A graph's recipes in train, validation and test parts, and the triples that each part gives.

    *full* triples come from all recipes, *partial* triples from the train recipes, *unseen* = full
    - partial. A test triple that a train recipe gives, too, is *leaked* and never evaluated.

    Made by :func:`make_split` and :func:`read_split`.

    Attributes:
        graph: the recipe graph.
        config: the settings.
        parts: shape (num_recipes,), int8: 0 train, 1 validation, 2 test.
        moved_for_coverage: recipes moved to train so that every entity has a train recipe.
        published: the file that names the parts; None if they were drawn.
    """

    def __init__(
        self,
        graph: RecipeGraph,
        config: SplitConfig,
        parts: NDArray[np.int8],
        moved_for_coverage: int = 0,
        published: Published | None = None,
    ):
        """Bind drawn parts to a graph; most callers want :func:`make_split`.

        Args:
            graph: the recipe graph.
            config: the settings of the draw, which are not checked against it.
            parts: shape (num_recipes,): 0 train, 1 validation, 2 test. The array becomes
                read-only.
            moved_for_coverage: number of recipes moved to train to cover all entities.
            published: the file that names the parts; None if they were drawn.
        """
        self.graph = graph
        self.config = config
        self.parts = parts
        self.parts.flags.writeable = False  # hashes and triples are cached
        self.moved_for_coverage = moved_for_coverage
        self.published = published
        self._triples: dict[str, Ids] = {}
        self._held_out: dict[str, Ids] = {}

    def __repr__(self) -> str:
        train, valid, test = np.bincount(self.parts, minlength=3).tolist()
        sizes = f"{train:,} train, {valid:,} valid, {test:,} test"
        kind = f"{self.config.kind!r}, seed {self.config.seed}"
        return f"Split({kind}, {sizes} recipes of {self.graph.name!r})"

    def is_in(self, part: Part) -> NDArray[np.bool_]:
        """Mark the recipes in a part; bool, shape (num_recipes,).

        Raises:
            ValueError: if the part is unknown.
        """
        return np.asarray(self.parts == PARTS.index(part))

    def recipes(self, part: Part) -> Ids:
        """Return a part's recipes, shape (n, 3), in the graph's order.

        Rows are (ingredient, ingredient, result).

        Raises:
            GraphError: if a recipe of the graph has more than two ingredients, or one.
            ValueError: if the part is unknown.
        """
        return self.graph.recipes[self.is_in(part)]

    def sets(self, part: Part) -> Ids:
        """Return a part's recipes as rows of ``graph.sets``, in the graph's order.

        Raises:
            ValueError: if the part is unknown.
        """
        return self.graph.sets[self.is_in(part)]

    @property
    def partial(self) -> Ids:
        """Triples that the train recipes give, shape (T, 3), sorted."""
        return self.triples_of("train")

    @cached_property
    def unseen(self) -> Ids:
        """Triples that no train recipe gives, shape (T, 3), sorted."""
        full = self.graph.triples
        is_seen = is_in(full, self.partial, self.graph.num_entities)
        return frozen(full[~is_seen])

    def triples_of(self, part: Part) -> Ids:
        """Return all triples that a part's recipes give, shape (T, 3), sorted.

        The triples of the test part include leaked ones, see :meth:`held_out`.

        Raises:
            ValueError: if the part is unknown.
        """
        if part not in self._triples:
            self._triples[part] = frozen(recipe_triples(self.sets(part), self.graph.num_entities))
        return self._triples[part]

    def held_out(self, part: Literal["valid", "test"]) -> Ids:
        """Return the triples of a part that may be evaluated, shape (T, 3), sorted.

        Triples that train recipes give, too, are left out. For the test part, so are those of the
        validation recipes, on which settings may have been chosen.

        Args:
            part: ``valid`` or ``test``.

        Raises:
            ValueError: if the part is unknown.
        """
        if part not in self._held_out:
            earlier_parts = get_args(Part)[: PARTS.index(part)]
            seen_triples = np.concatenate([self.triples_of(name) for name in earlier_parts])
            triples = self.triples_of(part)
            is_seen = is_in(triples, seen_triples, self.graph.num_entities)
            self._held_out[part] = frozen(triples[~is_seen])
        return self._held_out[part]

    def part_of(self, triples: Ids) -> NDArray[np.int8]:
        """Return the part whose recipes give each triple.

        A triple that several parts give belongs to the first of them: a leaked triple to train.

        Args:
            triples: shape (T, 3).

        Returns:
            Shape (T,): 0 train, 1 validation, 2 test, -1 for a triple of no recipe.
        """
        first = np.full(len(triples), -1, dtype=np.int8)
        for part in reversed(get_args(Part)):  # so that an earlier part overwrites a later one
            is_given = is_in(triples, self.triples_of(part), self.graph.num_entities)
            first[is_given] = PARTS.index(part)
        return first

    @cached_property
    def groups(self) -> Ids:
        """Each recipe's group, shape (num_recipes,).

        The split holds out the recipes of a group together, such as those of a goal.

        Recipes of a group are alike, so intervals resample whole groups, see :attr:`unit`.
        """
        return frozen(groups_of(self.graph, self.config.kind))

    @property
    def unit(self) -> str:
        """Name of several groups in a text: recipes, goals, slots or kinds."""
        return SPLITS[self.config.kind].unit

    @cached_property
    def uncovered(self) -> Ids:
        """Ids of all entities without a train recipe."""
        return frozen(absent(self.sets("train").ravel(), self.graph.num_entities))

    @cached_property
    def train_uses(self) -> Ids:
        """Number of train recipes that use each entity as an ingredient, shape (E,), int64.

        A self pair counts once.
        """
        num_entities = self.graph.num_entities
        _, ingredients = different_ingredients(self.sets("train"), num_entities)
        return frozen(np.bincount(ingredients, minlength=num_entities))

    @cached_property
    def pairs_on_both_sides(self) -> int:
        """Number of ingredient pairs with recipes in several parts."""
        return _num_divided(self.graph.pair_of_recipe, self.parts)

    @cached_property
    def hash(self) -> str:
        """SHA-256 hash of the graph, the settings and each recipe's part.

        Also of the kinds of recipes, if the split uses them.
        """
        facts: list[Any] = [self.graph.hash, asdict(self.config), self.moved_for_coverage]
        if SPLITS[self.config.kind].uses_kinds:
            facts.append(self.graph.kinds)
        if self.published is not None:
            facts.append(self.published.sha256)
        digest = hashlib.sha256(json.dumps(facts).encode())
        digest.update(self.parts.tobytes())
        return digest.hexdigest()

    def to_json(self) -> Iterator[str]:
        """Yield the text of ``split.json``, in pieces: settings, hashes, and each part's recipes.

        A recipe is a line with its labels, so that people can read and compare the file.
        """
        head: dict[str, Any] = {
            "format": _SPLIT_FORMAT,
            "graph": self.graph.hash,
            "hash": self.hash,
            **asdict(self.config),
            "moved_for_coverage": self.moved_for_coverage,
        }
        if self.published is not None:
            head["published"] = as_values(self.published)
        plugins = SPLITS.plugins(self.config.kind)
        if plugins:
            head["plugins"] = plugins
        dump = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
        # Each label is encoded once, not in each of its recipes.
        texts = list(map(dump, self.graph.entities))
        yield "{\n"
        for key, value in head.items():
            yield f"{dump(key)}: {dump(value)},\n"
        for index, part in enumerate(get_args(Part)):
            yield f"{dump(part)}: [\n"
            yield from json_recipes(self.sets(part), texts)
            yield "]\n" if index == len(PARTS) - 1 else "],\n"
        yield "}\n"


@stage("splitting the recipes")
def make_split(graph: RecipeGraph, config: SplitConfig) -> Split:
    """Split a graph's recipes; equal graphs and settings give equal splits on any machine.

    Args:
        graph: the recipe graph.
        config: the settings.

    Raises:
        SplitError: if a part is empty because the graph is too small for the ratios, or the graph
            has no kinds of recipes for a split by kind.

    Example:
        >>> split = make_split(open_graph("kitchen").graph, SplitConfig("by-goal"))
        >>> len(split.recipes("train")), len(split.recipes("test"))
        (271, 55)
    """
    if config.kind == "none":
        return Split(graph, config, np.full(graph.num_recipes, TRAIN, dtype=np.int8))
    rng = np.random.default_rng(config.seed)
    parts = _drawn_parts(graph, config, rng)
    num_moved = _cover_entities(graph, parts, rng) if config.kind == "by-recipe" else 0
    split = Split(graph, config, parts, num_moved)
    required_parts: tuple[Part, ...] = ("train", "test")
    if config.valid_ratio > 0:
        required_parts = (*required_parts, "valid")
    for part in required_parts:
        if not split.is_in(part).any():
            groups = counted(len(np.unique(groups_of(graph, config.kind))), "group")
            recipes = counted(graph.num_recipes, "recipe")
            moved = ""
            if num_moved:
                moved = (
                    f", after {counted(num_moved, 'recipe')} moved to train, so that train covers "
                    "every entity (`kind` by-recipe-plain moves none)"
                )
            raise SplitError(
                f"the {part} part of a {config.kind} split of {recipes} in {groups} is empty"
                f"{moved}; choose another `train_ratio` or `valid_ratio`, or `kind` none for the "
                "full graph only."
            )
    return split


def default_config(graph: RecipeGraph) -> SplitConfig:
    """Return the settings of the split that a graph gets without a choice; a warning says by-goal.

    By-recipe keeps a train recipe for each entity: where most recipes are the only one of their
    result, hardly any could be held out, and the split is by-goal.
    """
    is_only_one = graph.recipe_counts[graph.sets[:, -1]] == 1
    if graph.num_recipes < _FEWEST_BY_GOAL or 2 * np.sum(is_only_one) <= graph.num_recipes:
        return SplitConfig()
    logging.getLogger(__name__).warning(
        "no split is named, so it is by-goal: %s of %s recipes are the only one of their result, "
        "most of which by-recipe would keep in train. Name the split with build-graph --split.",
        f"{np.sum(is_only_one):,}",
        f"{graph.num_recipes:,}",
    )
    return SplitConfig("by-goal")


def groups_of(graph: RecipeGraph, kind: str) -> Ids:
    """Return each recipe's group, shape (num_recipes,), that a kind of split keeps together.

    Args:
        graph: the recipe graph.
        kind: a name in :data:`SPLITS`.

    Raises:
        SplitError: for a split by kind, if the graph has no kinds of recipes.
        ConfigError: for a plugin's split that does not give each recipe a whole number.
        KeyError: if the kind of split is unknown.
    """
    groups = np.asarray(SPLITS[kind].groups(graph))
    if groups.shape != (graph.num_recipes,) or groups.dtype.kind not in "iu":
        raise ConfigError(
            f"the split '{kind}' gives groups of shape {groups.shape}, {groups.dtype}; expected "
            f"{(graph.num_recipes,)}, a whole number for each recipe."
        )
    return groups


def read_split(
    content: Any,
    graph: RecipeGraph,
    where: str = "split.json",
) -> Split:
    """Rebuild a split from ``split.json``.

    Args:
        content: the parsed JSON.
        graph: the graph that the split belongs to.
        where: name of the file, for errors.

    Raises:
        GraphMismatchError: if the split belongs to another graph.
        ArtefactError: if the content is damaged or was edited.
    """
    try:
        if content["format"] != _SPLIT_FORMAT:
            raise ArtefactError(
                f"{where} has the format {content['format']!r}; expected {_SPLIT_FORMAT!r}."
            )
        if content["graph"] != graph.hash:
            raise GraphMismatchError(
                f"{where} belongs to graph {content['graph'][:12]} but the folder's graph is "
                f"{graph.hash[:12]} ({graph.num_entities} entities). Build the graph again with "
                "`wordcraft-kg build-graph`."
            )
        plugins = msgspec.convert(content.get("plugins", {}), dict[str, Hash])
        check_plugins(plugins, Path(where).parent)
        config = SplitConfig(**{field.name: content[field.name] for field in fields(SplitConfig)})
        # A recipe in no part keeps -1, so that the hash differs.
        parts = np.full(graph.num_recipes, -1, dtype=np.int8)
        for index, part in enumerate(PARTS):
            parts[_rows_of(graph, content[part])] = index
        published = msgspec.convert(content.get("published"), Published | None)
        split = Split(graph, config, parts, content["moved_for_coverage"], published)
        # A recipe that stands twice does not change the hash, but the number of rows.
        num_rows = sum(len(content[part]) for part in PARTS)
        if split.hash != content["hash"] or num_rows != graph.num_recipes:
            raise ArtefactError(
                f"{where} is damaged or was edited: its content does not match its hash. "
                "Build the graph again."
            )
        return split
    except NotRegisteredError as error:
        raise NotRegisteredError(f"{where}: {error}") from None
    except (KeyError, TypeError, ConfigError, msgspec.ValidationError) as error:
        raise ArtefactError(
            f"{where} is damaged ({type(error).__name__}: {error}). Build the graph again."
        ) from None


def _rows_of(graph: RecipeGraph, recipes: Sequence[Sequence[str]]) -> Ids:
    """Return the rows of recipes, given by labels, in ``graph.recipes``.

    Raises:
        KeyError: if the graph has no such recipe; names it.
        TypeError: if it is not two labels or more.
    """
    if min(map(len, recipes), default=2) < 2:
        raise TypeError("a recipe is at least one ingredient and a result")
    rows = graph.rows_of_labels(recipes)
    unknown = np.flatnonzero(rows < 0)
    if len(unknown):
        raise KeyError(Recipe.of(*recipes[unknown[0]]))
    return rows


# --- split kinds ---------------------------------------------------------------------------------


def _drawn_parts(
    graph: RecipeGraph,
    config: SplitConfig,
    rng: np.random.Generator,
) -> NDArray[np.int8]:
    """Assign whole groups to parts at random; return each recipe's part, shape (num_recipes,).

    Args:
        graph: the recipe graph.
        config: kind of split, which decides the groups, and ratios of groups.
        rng: shuffles the groups.

    Raises:
        SplitError: for a split by kind, if the graph has no kinds of recipes.
    """
    names, group = np.unique(groups_of(graph, config.kind), return_inverse=True)
    # Ratios are of groups, not recipes, so a part's share of the recipes is only about the ratio.
    order = rng.permutation(len(names))
    num_train = round(config.train_ratio * len(names))
    num_valid = round(config.valid_ratio * len(names))
    parts = np.full(len(names), TEST, dtype=np.int8)
    parts[order[:num_train]] = TRAIN
    parts[order[num_train : num_train + num_valid]] = VALID
    return parts[group]


def _cover_entities(
    graph: RecipeGraph,
    parts: NDArray[np.int8],
    rng: np.random.Generator,
) -> int:
    """Move a random pair with each entity that has no train recipe to train.

    Args:
        graph: the recipe graph.
        parts: each recipe's part, shape (num_recipes,); changed in place.
        rng: chooses the pairs.

    Returns:
        Number of recipes moved.

    Source: Jiang et al. 2020, section "Link Prediction Model": "a subgraph ... containing all
    nodes".
    """
    # A model cannot place an entity that it has never seen, so every entity gets a train recipe.
    covered = np.zeros(graph.num_entities + 1, dtype=bool)
    covered[graph.sets[parts == TRAIN]] = True
    covered[-1] = True  # the padding of small recipes is no entity
    num_moved = 0
    for entity in np.flatnonzero(~covered).tolist():
        around = np.concatenate([graph.recipes_of(entity), graph.uses_of(entity)])
        # An entity that an earlier move has covered, or an idle one, which no recipe can cover.
        if covered[entity] or not len(around):
            continue
        pair = graph.pair_of_recipe[rng.choice(around)]
        # The whole pair moves: results of a pair in two parts would give each other away.
        rows = slice(graph.pair_starts[pair], graph.pair_starts[pair + 1])
        parts[rows] = TRAIN
        covered[graph.sets[rows]] = True
        num_moved += int(rows.stop - rows.start)
    return num_moved


def _goals(graph: RecipeGraph) -> Ids:
    return graph.sets[:, -1]


def _slots(graph: RecipeGraph) -> Ids:
    """Return each recipe's group: a connected component, where links are shared slots.

    A slot is an (ingredient, result) pair. So no slot of a test recipe occurs in train; in a
    by-recipe split, 90 % of the test recipes share an ingredient and the result with a train
    recipe. Most goals form a single group, so this split is nearly by-goal. Holding out goals with
    several groups first was rejected: such goals are few, so seeds would share half the test part.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    recipes, ingredients = different_ingredients(graph.sets, graph.num_entities)
    # The slots of each recipe, as numbers: the digits (ingredient, result).
    keys = ingredients * graph.num_entities + graph.sets[recipes, -1]
    slots, slot = np.unique(keys, return_inverse=True)
    # A bipartite graph: nodes are the recipes, then the slots; an edge links a recipe and its slot.
    num_nodes = graph.num_recipes + len(slots)
    edges = (recipes, graph.num_recipes + slot)
    links = coo_array((np.ones(len(keys)), edges), shape=(num_nodes, num_nodes))
    _, component = connected_components(links, directed=False)
    # Numbers from 0 without gaps, which components of the recipes alone may have.
    _, group = np.unique(component[: graph.num_recipes], return_inverse=True)
    return group.astype(np.int64)


def _kinds(graph: RecipeGraph) -> Ids:
    if graph.kinds is None:
        raise SplitError(
            f"{graph.name} names no kinds of recipes. Add a column named kind to the book, or "
            "choose another split."
        )
    _, group = np.unique(graph.kinds, return_inverse=True)
    return group.astype(np.int64)


_PAIRS: Callable[[RecipeGraph], Ids] = attrgetter("pair_of_recipe")
_BUILT_IN = {
    "by-recipe": SplitKind(_PAIRS, "pairs are held out, every entity stays in train"),
    "by-recipe-plain": SplitKind(_PAIRS, "pairs are held out, train may lack entities"),
    "by-slot": SplitKind(_slots, "the ingredients of each result are held out", unit="slots"),
    "by-goal": SplitKind(_goals, "goals are held out", unit="goals"),
    "by-kind": SplitKind(
        _kinds,
        "kinds of reasoning are held out; the book names them",
        uses_kinds=True,
        unit="kinds",
    ),
    "none": SplitKind(_PAIRS, "full graph only"),
}
SPLITS: Registry[SplitKind] = Registry("wordcraft_kg.splits", _BUILT_IN)
"""Methods of splitting recipes, by name."""

# --- published splits ----------------------------------------------------------------------------

_PART_OF_NAME = {
    **dict.fromkeys(("train", "training"), TRAIN),
    **dict.fromkeys(("valid", "validation", "val", "dev"), VALID),
    "test": TEST,
}
_EXPECTED = 'expected JSON such as {"train": ["mud"], "test": [["mud", "fire", "brick"]]}'
_Labels = Annotated[list[str], msgspec.Meta(min_length=1)]
_Listing = list[str | _Labels] | dict[str, list[_Labels]]
"""A part in JSON: results and recipes, or sets by result; an empty set is no recipe."""
_NO_PART = -1
_Entry = tuple[tuple[str, ...], int]
"""Labels (*ingredients, result) or (result,) and the part."""


def read_published_split(path: Path, graph: RecipeGraph, *, fold: bool = False) -> Split:
    """Read a split from a file.

    JSON has a list for each part, or an object of results with their sets as in a recipe book:
    ``{"train": {"mud": [["water", "earth"]]}, "test": ["brick"]}``. A result stands for all its
    recipes. Other keys, such as a licence, are ignored.

    The split is by-goal if the file holds out whole results, else by-recipe-plain; its ratios are
    the shares of the recipes.

    Args:
        path: a JSON file, also in gzip.
        graph: the graph whose recipes it divides.
        fold: whether labels are folded to lower case, as those of the graph were.

    Raises:
        ArtefactError: if the file is missing, or larger than a recipe book may be.
        SplitError: if the file has another shape, a recipe has two parts or none, or the train or
            test part is empty.
    """
    check_file(path, MAX_BOOK_SIZE)
    packed = path.read_bytes()
    data = gunzip(path, packed, MAX_BOOK_SIZE, SplitError) if is_gzip(packed) else packed
    entries = _entries(path, data)
    if fold:
        entries = [(tuple(map(str.lower, labels)), part) for labels, part in entries]
    parts = np.full(graph.num_recipes, _NO_PART, dtype=np.int8)
    unknown = 0
    for part in (TRAIN, VALID, TEST):
        entries_of_part = [labels for labels, entry_part in entries if entry_part == part]
        rows, num_unknown = _rows(graph, entries_of_part)
        unknown += num_unknown
        conflicts = rows[(parts[rows] != _NO_PART) & (parts[rows] != part)]
        if len(conflicts):
            names = f"{PARTS[parts[conflicts[0]]]} and {PARTS[part]}"
            raise SplitError(
                f"{path}: the recipe {_recipe(graph, conflicts)} is in {names}; expected one."
            )
        parts[rows] = part
    unassigned = np.flatnonzero(parts == _NO_PART)
    if len(unassigned):
        raise SplitError(
            f"{path}: {counted(len(unassigned), 'recipe')} of {graph.num_recipes:,} without a "
            f"part, such as {_recipe(graph, unassigned)}; a published split names all recipes of "
            "the graph."
        )
    for part in (TRAIN, TEST):
        if not (parts == part).any():
            raise SplitError(f"{path}: the {PARTS[part]} part has no recipe of this graph.")
    train, valid = (float(np.mean(parts == part)) for part in (TRAIN, VALID))
    is_by_goal = _num_divided(groups_of(graph, "by-goal"), parts) == 0
    kind = "by-goal" if is_by_goal else "by-recipe-plain"
    published = Published(
        file=path.name, sha256=hashlib.sha256(packed).hexdigest(), unknown=unknown
    )
    return Split(graph, SplitConfig(kind, train, valid), parts, published=published)


def _entries(path: Path, data: bytes) -> list[_Entry]:
    """Return the entries of a file; SplitError for a file of another shape."""
    try:
        document = json.loads(data, object_pairs_hook=without_repeated_keys)
        return list(_json_entries(document))
    except RecursionError:
        raise SplitError(f"{path}: no split (nested too deeply); {_EXPECTED}.") from None
    except (ValueError, msgspec.ValidationError) as error:
        raise SplitError(f"{path}: no split ({error}); {_EXPECTED}.") from None


def _json_entries(document: Any) -> Iterator[_Entry]:
    """Yield the entries of the lists or objects below the names of parts."""
    keys = document if isinstance(document, dict) else {}
    values = [(_PART_OF_NAME.get(key.strip().lower()), value) for key, value in keys.items()]
    named = [(part, value) for part, value in values if part is not None]
    if not named:
        raise ValueError("no key is the name of a part")
    for part, value in named:
        content = msgspec.convert(value, _Listing)
        if isinstance(content, dict):
            for result, sets in content.items():
                yield from (((*labels, result), part) for labels in sets)
        else:
            for row in content:
                labels = (row,) if isinstance(row, str) else tuple(row)
                yield labels, part


def _rows(graph: RecipeGraph, entries: list[tuple[str, ...]]) -> tuple[Ids, int]:
    """Return the rows of results and recipes in the graph, and the number of unknown entries."""
    # Longer rows are no recipes, and one of a million labels would widen the table for all.
    short = (labels for labels in entries if len(labels) <= MOST_INGREDIENTS + 1)
    known_entries = [labels for labels in short if all(label in graph for label in labels)]
    results = [labels[0] for labels in known_entries if len(labels) == 1]
    recipes = [labels for labels in known_entries if len(labels) > 1]
    rows_of_recipes = graph.rows_of_labels(recipes)
    rows_of_results = [graph.recipes_of(result) for result in results]
    unknown = len(entries) - len(known_entries) + int(np.sum(rows_of_recipes < 0))
    unknown += sum(not len(rows) for rows in rows_of_results)
    rows = np.concatenate([rows_of_recipes[rows_of_recipes >= 0], *rows_of_results])
    return rows.astype(np.int64), unknown


def _recipe(graph: RecipeGraph, rows: Ids) -> str:
    return str(graph.recipe_labels(graph.sets[rows[:1]])[0])


def _num_divided(groups: Ids, parts: NDArray[np.int8]) -> int:
    """Return the number of groups with recipes in several parts.

    Args:
        groups: group of each recipe, shape (num_recipes,).
        parts: part of each recipe, same shape.
    """
    groups_of_parts = distinct(groups * len(PARTS) + parts) // len(PARTS)
    _, num_parts = np.unique(groups_of_parts, return_counts=True)
    return int(np.sum(num_parts > 1))
