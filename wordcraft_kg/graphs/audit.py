"""A recipe graph and a split in figures, and the recipes of an entity.

The audit counts ambiguity, reachability, coverage and leakage.

Lists of labels are cut at :data:`SHOWN`; the counts beside them are complete.
"""

from collections import Counter
from dataclasses import asdict

import msgspec
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import Count, Hash, Record, stage
from wordcraft_kg.graphs.arrays import Ids, distinct
from wordcraft_kg.graphs.planner import Derivation, Planner, layers, rounds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import Reading, Recipe, RecipeBook, alike_labels
from wordcraft_kg.graphs.splits import Published, Split
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS, Relation, is_in

SHOWN = 20
"""Most entities, pairs or groups in a list."""
_TOP = 10  # entities in a list of the most used


class TripleCounts(Record):
    """Triple counts by relation.

    Attributes:
        combines_with: triples of combinesWith; each unordered pair gives two, a self pair one.
        component_of: triples of componentOf.
        total: their sum.
    """

    combines_with: Count = msgspec.field(name="combinesWith")
    component_of: Count = msgspec.field(name="componentOf")
    total: Count


class AmbiguousPair(Record):
    """Ingredients, mostly two, that combine into several results, by labels.

    Attributes:
        pair: the ingredients.
        results: all results.
    """

    pair: tuple[str, ...]
    results: tuple[str, ...]


class Ambiguity(Record):
    """Ingredient pairs with several results.

    Attributes:
        pairs_by_number_of_results: number of pairs with 1, 2, ... results.
        pairs_with_several_results: number of pairs with two results or more.
        examples: the pairs with the most results, at most 20; ties in the graph's order.
    """

    pairs_by_number_of_results: dict[str, Count]
    pairs_with_several_results: Count
    examples: tuple[AmbiguousPair, ...]


class Reachability(Record):
    """Entities that can be made from the base, when every round combines all known pairs.

    Attributes:
        reachable: entities that can be made, base entities included.
        rounds: rounds until nothing new is made.
        known_after_round: entities known after 0, 1, 2, ... rounds; the first are the base.
        unreachable: entities that can never be made.
        unreachable_entities: their labels, at most 20.
    """

    reachable: Count
    rounds: Count
    known_after_round: tuple[Count, ...]
    unreachable: Count
    unreachable_entities: tuple[str, ...]


class Spread(Record):
    """Distribution of a count over entities.

    Attributes:
        mean: mean, rounded to three digits; 0 without entities.
        median: median; 0 without entities.
        max: largest count.
    """

    mean: float
    median: float
    max: Count


class Degrees(Record):
    """How often entities are made and used.

    Attributes:
        craftable: entities with a recipe.
        recipes_per_craftable: number of recipes of each craftable entity.
        terminal: craftable entities that no recipe uses.
        idle: entities in no recipe.
        self_pairs: entities that combine with themselves.
        most_used: the ten entities that the most recipes use, with the number of recipes.
        most_recipes: the ten entities that the most recipes make, with the number of recipes.
    """

    craftable: Count
    recipes_per_craftable: Spread
    terminal: Count
    idle: Count
    self_pairs: Count
    most_used: tuple[tuple[str, Count], ...]
    most_recipes: tuple[tuple[str, Count], ...]


class AlikeLabels(Record):
    """Groups of entity labels that differ only by spelling, probably typos.

    Attributes:
        alike: number of groups.
        alike_labels: the groups, at most 20.
    """

    alike: Count
    alike_labels: tuple[tuple[str, ...], ...]


class BookFigures(Record):
    """Statistics for the recipes of a book.

    Attributes:
        entities: number of entities.
        recipes: number of recipes.
        pairs: number of distinct ingredient sets, which are pairs in most books.
        base: labels of the base entities.
        ambiguity: pairs with several results.
        reachability: entities that can be made from the base.
        degrees: recipes and uses of entities.
    """

    entities: Count
    recipes: Count
    pairs: Count
    base: tuple[str, ...]
    ambiguity: Ambiguity
    reachability: Reachability
    degrees: Degrees


class SetStatistics(Record):
    """Sizes of ingredient sets, and what a split tells about the larger ones.

    Attributes:
        recipes_by_number_of_ingredients: number of recipes with 1, 2, ... ingredients.
        test_sets: test recipes of three or more ingredients.
        with_a_train_pair: those with a pair of ingredients that a train recipe combines, too.
        of_train_pairs: those of whose ingredients train recipes combine every pair. Their
            combinesWith triples are all leaked, and none of them is evaluated.
    """

    recipes_by_number_of_ingredients: dict[str, Count]
    test_sets: Count
    with_a_train_pair: Count
    of_train_pairs: Count


class SplitSummary(Record, omit_defaults=True, kw_only=True):
    """Settings of a train/validation/test split, and recipe and triple counts.

    ``test_goals_in_train`` and ``one_ingredient_away`` tell which kind of generalisation a split
    asks for: most of both by recipe, no recipe one ingredient away by slot, and by goal not even a
    known goal.

    Attributes:
        kind: name of the split.
        seed: random seed of the split.
        train_ratio: fraction of pairs, goals, groups or kinds for training.
        valid_ratio: fraction for validation.
        hash: SHA-256 of the graph, the settings and each recipe's part.
        train_recipes: number of train recipes.
        valid_recipes: number of validation recipes.
        test_recipes: number of test recipes.
        partial_triples: triples that train recipes give.
        unseen_triples: triples that no train recipe gives.
        evaluated_triples: triples of the test recipes that neither train nor validation recipes
            give.
        leaked_triples: the other triples of the test recipes, which are never evaluated.
        covered: whether every entity occurs in a train recipe.
        uncovered: number of entities in no train recipe.
        uncovered_entities: their labels, at most 20.
        moved_for_coverage: recipes moved to train so that every entity has a train recipe.
        pairs_on_both_sides: ingredient pairs with recipes in several parts.
        test_goals: entities that test recipes make.
        test_goals_in_train: those of them that train recipes make, too.
        one_ingredient_away: test recipes that share an ingredient and the result with a train
            recipe. Counting which entities make the result together with others can find them.
        published: the file that names the parts of a published split; missing for a drawn one.
    """

    kind: str
    seed: int
    train_ratio: float
    valid_ratio: float
    hash: Hash
    train_recipes: Count
    valid_recipes: Count
    test_recipes: Count
    partial_triples: Count
    unseen_triples: Count
    evaluated_triples: Count
    leaked_triples: Count
    covered: bool
    uncovered: Count
    uncovered_entities: tuple[str, ...]
    moved_for_coverage: Count
    pairs_on_both_sides: Count
    test_goals: Count
    test_goals_in_train: Count
    one_ingredient_away: Count
    published: Published | None = None

    @property
    def train_share(self) -> float:
        """Share of the recipes in the train part.

        The setting ``train_ratio`` is a share of pairs, goals, groups or kinds instead.
        """
        recipes = self.train_recipes + self.valid_recipes + self.test_recipes
        return self.train_recipes / max(recipes, 1)


class Leakage(Record):
    """How the test triples of a relation relate to its training triples.

    Attributes:
        train: training triples.
        from_test_recipes: triples of the test recipes.
        already_in_train: those of them that train or validation recipes give, too; these are not
            evaluated.
        evaluated: the remaining test triples.
        mirror_in_train: evaluated triples with (tail, relation, head) in train. For combinesWith it
            must be 0, because the mirror would give the answer away.
    """

    train: Count
    from_test_recipes: Count
    already_in_train: Count
    evaluated: Count
    mirror_in_train: Count


class Audit(Record, omit_defaults=True, kw_only=True):
    """Statistics for a recipe graph and a split.

    Attributes:
        dropped_self_results: rows of the source book that were left out, because their result is
            one of their ingredients; missing without a book.
        merged_duplicates: rows of the source book that repeat a recipe; missing without a book.
        reading: how the book's file was read; missing without a file.
        entities: number of entities.
        recipes: number of recipes.
        pairs: number of distinct ingredient sets, which are pairs in most books.
        base: labels of the base entities.
        base_is_inferred: whether the base is the entities without a recipe, because no base was
            given.
        hash: SHA-256 of entities, base and recipes.
        triples: triples of all recipes.
        sets: statistics of ingredient sets; missing for a graph of pairs.
        ambiguity: pairs with several results.
        reachability: entities that can be made from the base.
        degrees: recipes and uses of entities.
        labels: labels that are probably typos.
        split: settings and sizes of the split.
        leakage: test triples that training triples contain or mirror, by relation.
    """

    dropped_self_results: Count | None = None
    merged_duplicates: Count | None = None
    reading: Reading | None = None
    entities: Count
    recipes: Count
    pairs: Count
    base: tuple[str, ...]
    base_is_inferred: bool = False
    hash: Hash
    triples: TripleCounts
    sets: SetStatistics | None = None
    ambiguity: Ambiguity
    reachability: Reachability
    degrees: Degrees
    labels: AlikeLabels
    split: SplitSummary
    leakage: dict[Relation, Leakage]


class EntityView(Record, omit_defaults=True, kw_only=True):
    """An entity, the recipes that make it, and its uses.

    Attributes:
        entity: the label.
        base: whether the entity is a base entity.
        layer: crafting round that can first make the entity; None if it is unreachable.
        recipes: recipes that make the entity.
        uses: recipes that use the entity.
        derivation: the cheapest derivation; None if the entity is unreachable.
    """

    entity: str
    base: bool
    layer: Count | None
    recipes: tuple[Recipe, ...]
    uses: tuple[Recipe, ...]
    derivation: Derivation | None


@stage("auditing the graph")
def audit(
    graph: RecipeGraph,
    split: Split,
    book: RecipeBook | None = None,
) -> Audit:
    """Compute statistics for a graph and a split.

    Args:
        graph: the recipe graph.
        split: a split of it.
        book: the source of the graph, for the counts of omitted rows; None without a book.
    """
    alike = alike_labels(graph.entities)
    # Relation ids are 0 and 1, also where a book has no triple of one.
    relations = graph.triples[:, 1]
    combines_with, component_of = np.bincount(relations, minlength=len(RELATIONS)).tolist()
    figures = book_figures(graph)
    return Audit(
        dropped_self_results=None if book is None else book.dropped_self_results,
        merged_duplicates=None if book is None else book.merged_duplicates,
        reading=graph.reading,
        base_is_inferred=graph.base_is_inferred,
        hash=graph.hash,
        triples=TripleCounts(combines_with, component_of, len(graph.triples)),
        sets=_set_statistics(split),
        labels=AlikeLabels(len(alike), tuple(alike[:SHOWN])),
        split=split_summary(split),
        leakage=leakage(split),
        **{name: getattr(figures, name) for name in BookFigures.__struct_fields__},
    )


def book_figures(graph: RecipeGraph) -> BookFigures:
    """Return the statistics of a graph without its split."""
    return BookFigures(
        entities=graph.num_entities,
        recipes=graph.num_recipes,
        pairs=graph.num_pairs,
        base=graph.base,
        ambiguity=_ambiguity(graph),
        reachability=reachability(graph),
        degrees=degrees(graph),
    )


def split_summary(split: Split) -> SplitSummary:
    """Return a split's settings, and recipe and triple counts by part."""
    train, valid, test = np.bincount(split.parts, minlength=3).tolist()
    # Triples of test recipes that train or validation recipes give, too, are not evaluated.
    evaluated = split.held_out("test")
    test_triples = split.triples_of("test")
    goals = distinct(split.graph.sets[split.is_in("test"), -1])
    is_train_goal = np.isin(goals, split.sets("train")[:, -1])
    return SplitSummary(
        **asdict(split.config),
        hash=split.hash,
        train_recipes=train,
        valid_recipes=valid,
        test_recipes=test,
        partial_triples=len(split.partial),
        unseen_triples=len(split.unseen),
        evaluated_triples=len(evaluated),
        leaked_triples=len(test_triples) - len(evaluated),
        covered=not len(split.uncovered),
        uncovered=len(split.uncovered),
        uncovered_entities=split.graph.labels(split.uncovered[:SHOWN]),
        moved_for_coverage=split.moved_for_coverage,
        pairs_on_both_sides=split.pairs_on_both_sides,
        test_goals=len(goals),
        test_goals_in_train=int(np.sum(is_train_goal)),
        one_ingredient_away=int(np.sum(one_ingredient_away(split))),
        published=split.published,
    )


def _set_statistics(split: Split) -> SetStatistics | None:
    """Return the statistics of a graph with other recipes than pairs; None for pairs alone."""
    graph = split.graph
    sizes, numbers = np.unique(graph.sizes, return_counts=True)
    if sizes.tolist() in ([], [2]):
        return None
    is_test = split.is_in("test") & (graph.sizes > 2)
    rows, triples = graph.triples_by_recipe(is_test)
    is_pair = triples[:, 1] == COMBINES_WITH
    is_train = is_in(triples, split.partial, graph.num_entities)
    num_sets = int(np.sum(is_test))
    with_train = np.bincount(rows[is_pair & is_train], minlength=num_sets) > 0
    with_other = np.bincount(rows[is_pair & ~is_train], minlength=num_sets) > 0
    return SetStatistics(
        recipes_by_number_of_ingredients=dict(
            zip(map(str, sizes.tolist()), numbers.tolist(), strict=True)
        ),
        test_sets=num_sets,
        with_a_train_pair=int(np.sum(with_train)),
        of_train_pairs=int(np.sum(~with_other)),
    )


def one_ingredient_away(split: Split) -> NDArray[np.bool_]:
    """Mark the test recipes that share an ingredient and the result with a train recipe.

    Returns:
        Bool, shape (num_test,).
    """
    is_test = split.is_in("test")
    rows, triples = split.graph.triples_by_recipe(is_test)
    # Train recipes share a slot where their triples contain (ingredient, componentOf, result).
    is_slot = triples[:, 1] == COMPONENT_OF
    is_shared = is_slot & is_in(triples, split.partial, split.graph.num_entities)
    return np.bincount(rows[is_shared], minlength=int(np.sum(is_test))) > 0


def leakage(split: Split) -> dict[Relation, Leakage]:
    """Count test triples that the training triples contain or mirror, by relation."""
    evaluated = split.held_out("test")
    mirrors = evaluated[:, [2, 1, 0]]  # tail, relation, head
    has_mirror = is_in(mirrors, split.partial, split.graph.num_entities)

    def by_relation(triples: Ids) -> list[int]:
        return np.bincount(triples[:, 1], minlength=len(RELATIONS)).tolist()

    train = by_relation(split.partial)
    from_test = by_relation(split.triples_of("test"))
    num_evaluated = by_relation(evaluated)
    num_mirrors = by_relation(evaluated[has_mirror])
    return {
        name: Leakage(
            train=train[relation],
            from_test_recipes=from_test[relation],
            already_in_train=from_test[relation] - num_evaluated[relation],
            evaluated=num_evaluated[relation],
            mirror_in_train=num_mirrors[relation],
        )
        for relation, name in enumerate(RELATIONS)
    }


def _ambiguity(graph: RecipeGraph) -> Ambiguity:
    num_results = np.diff(graph.pair_starts)
    # Stable, so that of equally ambiguous pairs those come first that come first in the graph.
    most_ambiguous = np.argsort(-num_results, kind="stable")[:SHOWN]
    has_several = num_results[most_ambiguous] > 1
    examples = []
    for pair in most_ambiguous[has_several].tolist():
        # Recipes are sorted by pair, so those of a pair follow each other.
        start, stop = graph.pair_starts[pair : pair + 2]
        ingredients = graph.labels(graph.sets[start, : graph.sizes[start]])
        examples.append(AmbiguousPair(ingredients, graph.labels(graph.sets[start:stop, -1])))
    numbers, pairs = np.unique(num_results, return_counts=True)
    return Ambiguity(
        # Keys of JSON are texts.
        pairs_by_number_of_results=dict(zip(map(str, numbers), pairs.tolist(), strict=True)),
        pairs_with_several_results=int(np.sum(num_results > 1)),
        examples=tuple(examples),
    )


def reachability(graph: RecipeGraph) -> Reachability:
    """Count the entities that can be made from the base, by rounds."""
    layer = layers(graph)
    unreachable = np.flatnonzero(layer < 0)
    known_counts = rounds(layer)  # round 0 is the base and no round of play
    return Reachability(
        reachable=int(np.sum(layer >= 0)),
        rounds=max(len(known_counts) - 1, 0),
        known_after_round=tuple(known_counts),
        unreachable=len(unreachable),
        unreachable_entities=graph.labels(unreachable[:SHOWN]),
    )


def degrees(graph: RecipeGraph) -> Degrees:
    """Count how often entities are made and used."""
    uses = graph.use_counts
    recipes = graph.recipe_counts
    craftable = recipes[recipes > 0]

    def top(counts: Ids) -> tuple[tuple[str, int], ...]:
        # Ties stay in alphabetical order.
        count_of = Counter(dict(zip(graph.entities, counts.tolist(), strict=True)))
        return tuple(count_of.most_common(_TOP))

    # NumPy has no mean of nothing.
    counts = craftable if len(craftable) else np.zeros(1, dtype=np.int64)
    spread = Spread(round(float(counts.mean()), 3), float(np.median(counts)), int(counts.max()))
    return Degrees(
        craftable=len(craftable),
        recipes_per_craftable=spread,
        terminal=int(np.sum((uses == 0) & (recipes > 0))),
        idle=int(np.sum((uses == 0) & (recipes == 0))),
        self_pairs=graph.num_self_pairs,
        most_used=top(uses),
        most_recipes=top(recipes),
    )


def view_entity(graph: RecipeGraph, label: str) -> EntityView:
    """Return an entity's recipes and the cheapest way to make it.

    Raises:
        UnknownEntityError: if the graph has no such label.
    """
    entity = graph.id_of(label)
    layer = int(layers(graph)[entity])
    is_reachable = layer >= 0
    return EntityView(
        entity=label,
        base=label in graph.base,
        layer=layer if is_reachable else None,
        recipes=tuple(graph.recipe_labels(graph.sets[graph.recipes_of(entity)])),
        uses=tuple(graph.recipe_labels(graph.sets[graph.uses_of(entity)])),
        derivation=Planner(graph).derivation(entity) if is_reachable else None,
    )
