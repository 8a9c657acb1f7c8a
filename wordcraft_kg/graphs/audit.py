"""Statistics for a recipe graph and a split: ambiguity, reachability, coverage, leakage."""

from dataclasses import asdict

import msgspec
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.records import Count, Hash, Record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.planner import layers, rounds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import RecipeBook, alike_labels
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.triples import COMPONENT_OF, RELATIONS, Relation, is_in

SHOWN = 20  # entities or pairs in a list, at most; counts are complete


class TripleCounts(Record):
    """Triple counts by relation."""

    combines_with: Count = msgspec.field(name="combinesWith")
    component_of: Count = msgspec.field(name="componentOf")
    total: Count


class AmbiguousPair(Record):
    """Two ingredients that combine into several results, by labels."""

    pair: tuple[str, str]
    results: tuple[str, ...]


class Ambiguity(Record):
    """Counts of ingredient pairs by number of results; ``examples`` are up to 20 pairs with the most results."""

    pairs_by_number_of_results: dict[str, Count]
    pairs_with_several_results: Count
    examples: tuple[AmbiguousPair, ...]


class Reachability(Record):
    """Entities that rounds of all known pairs make from the base; ``known_after_round`` begins with round 0."""

    reachable: Count
    rounds: Count
    known_after_round: tuple[Count, ...]
    unreachable: Count
    unreachable_entities: tuple[str, ...]


class Spread(Record):
    """Mean, median and maximum recipe count per entity."""

    mean: float
    median: float
    max: Count


class Degrees(Record):
    """Recipes by entity: ``terminal`` entities have a recipe and no use, ``idle`` ones neither; lists have ten."""

    craftable: Count
    recipes_per_craftable: Spread
    terminal: Count
    idle: Count
    self_pairs: Count
    most_used: tuple[tuple[str, Count], ...]
    most_recipes: tuple[tuple[str, Count], ...]


class AlikeLabels(Record):
    """Groups of entity labels that differ only by spelling, probably typos; at most 20 groups are listed."""

    alike: Count
    alike_labels: tuple[tuple[str, ...], ...]


class SplitSummary(Record):
    """Settings of a train/validation/test split, and recipe and triple counts.

    Attributes:
        partial_triples: triples that train recipes give.
        unseen_triples: the remaining triples.
        evaluated_triples: test triples that neither train nor validation recipes give.
        leaked_triples: the remaining test triples, never evaluated.
        covered: whether every entity occurs in a train recipe; ``uncovered`` counts the missing entities.
        moved_for_coverage: recipes moved to train so that every entity has a train recipe.
        pairs_on_both_sides: ingredient pairs with recipes in several parts.
        test_goals_in_train: results of test recipes that train recipes make, too.
        one_ingredient_away: test recipes that share an ingredient and the result with a train recipe.
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

    @property
    def train_share(self) -> float:
        """Share of the recipes in the train part; ``train_ratio`` is the setting, of pairs, goals or groups."""
        recipes = self.train_recipes + self.valid_recipes + self.test_recipes
        return self.train_recipes / max(recipes, 1)


class Leakage(Record):
    """Numbers of test and training triples of a relation.

    ``already_in_train`` counts the test triples that train or validation recipes give, too; these are not evaluated.
    ``mirror_in_train`` counts evaluated triples with (tail, relation, head) in train; 0 for combinesWith.
    """

    train: Count
    from_test_recipes: Count
    already_in_train: Count
    evaluated: Count
    mirror_in_train: Count


class Audit(Record, omit_defaults=True, kw_only=True):
    """Statistics for a recipe graph and a split; the first two fields count rows omitted from the source book."""

    dropped_self_results: Count | None = None
    merged_duplicates: Count | None = None
    entities: Count
    recipes: Count
    pairs: Count
    base: tuple[str, ...]
    base_is_inferred: bool = False
    hash: Hash
    triples: TripleCounts
    ambiguity: Ambiguity
    reachability: Reachability
    degrees: Degrees
    labels: AlikeLabels
    split: SplitSummary
    leakage: dict[Relation, Leakage]


@stage("auditing the graph")
def audit(graph: RecipeGraph, split: Split, book: RecipeBook | None = None) -> Audit:
    """Compute statistics for a graph and a split; the source ``book`` adds counts of omitted rows."""
    alike = alike_labels(graph.entities)
    combines_with, component_of = np.bincount(
        graph.triples[:, 1], minlength=len(RELATIONS)
    ).tolist()
    return Audit(
        dropped_self_results=None if book is None else book.dropped_self_results,
        merged_duplicates=None if book is None else book.merged_duplicates,
        entities=graph.num_entities,
        recipes=graph.num_recipes,
        pairs=graph.num_pairs,
        base=graph.base,
        base_is_inferred=graph.base_is_inferred,
        hash=graph.hash,
        triples=TripleCounts(combines_with, component_of, len(graph.triples)),
        ambiguity=_ambiguity(graph),
        reachability=_reachability(graph),
        degrees=_degrees(graph),
        labels=AlikeLabels(len(alike), tuple(alike[:SHOWN])),
        split=split_summary(split),
        leakage=leakage(split),
    )


def split_summary(split: Split) -> SplitSummary:
    """Return a split's settings, and recipe and triple counts by part."""
    train, valid, test = np.bincount(split.parts, minlength=3).tolist()
    evaluated = split.held_out("test")
    goals = np.unique(split.recipes("test")[:, 2])
    return SplitSummary(
        **asdict(split.config),
        hash=split.hash,
        train_recipes=train,
        valid_recipes=valid,
        test_recipes=test,
        partial_triples=len(split.partial),
        unseen_triples=len(split.unseen),
        evaluated_triples=len(evaluated),
        leaked_triples=len(split.triples_of("test")) - len(evaluated),
        covered=not len(split.uncovered),
        uncovered=len(split.uncovered),
        uncovered_entities=split.graph.labels(split.uncovered[:SHOWN]),
        moved_for_coverage=split.moved_for_coverage,
        pairs_on_both_sides=split.pairs_on_both_sides,
        test_goals=len(goals),
        test_goals_in_train=int(np.sum(np.isin(goals, split.recipes("train")[:, 2]))),
        one_ingredient_away=int(np.sum(one_ingredient_away(split))),
    )


def one_ingredient_away(split: Split) -> NDArray[np.bool_]:
    """Mark the test recipes that share an ingredient and the result with a train recipe; bool, shape (num_test,)."""
    test = split.recipes("test")
    slots = np.insert(test[:, [0, 2, 1, 2]].reshape(-1, 2), 1, COMPONENT_OF, axis=1)
    return np.asarray(
        is_in(slots, split.partial, split.graph.num_entities).reshape(-1, 2).any(axis=1)
    )


def leakage(split: Split) -> dict[Relation, Leakage]:
    """Count test triples that the training triples contain or mirror, by relation."""
    evaluated = split.held_out("test")
    mirrored = is_in(evaluated[:, [2, 1, 0]], split.partial, split.graph.num_entities)
    tables: dict[Relation, Leakage] = {}
    for relation, name in enumerate(RELATIONS):
        from_test = int(np.sum(split.triples_of("test")[:, 1] == relation))
        of_relation = evaluated[:, 1] == relation
        tables[name] = Leakage(
            train=int(np.sum(split.partial[:, 1] == relation)),
            from_test_recipes=from_test,
            already_in_train=from_test - int(np.sum(of_relation)),
            evaluated=int(np.sum(of_relation)),
            mirror_in_train=int(np.sum(mirrored[of_relation])),
        )
    return tables


def _ambiguity(graph: RecipeGraph) -> Ambiguity:
    sizes = np.diff(graph.pair_starts)
    order = np.argsort(-sizes, kind="stable")[:SHOWN]
    examples = []
    for pair in order[sizes[order] > 1].tolist():
        start, stop = graph.pair_starts[pair : pair + 2]
        a, b = graph.labels(graph.recipes[start, :2])
        examples.append(AmbiguousPair((a, b), graph.labels(graph.recipes[start:stop, 2])))
    return Ambiguity(
        pairs_by_number_of_results={str(n): int(c) for n, c in enumerate(np.bincount(sizes)) if c},
        pairs_with_several_results=int(np.sum(sizes > 1)),
        examples=tuple(examples),
    )


def _reachability(graph: RecipeGraph) -> Reachability:
    layer = layers(graph)
    unreachable = np.flatnonzero(layer < 0)
    known = rounds(layer)
    return Reachability(
        reachable=int(np.sum(layer >= 0)),
        rounds=max(len(known) - 1, 0),
        known_after_round=tuple(known),
        unreachable=len(unreachable),
        unreachable_entities=graph.labels(unreachable[:SHOWN]),
    )


def _degrees(graph: RecipeGraph) -> Degrees:
    uses, recipes = graph.use_counts, graph.recipe_counts
    craftable = recipes[recipes > 0]

    def top(counts: Ids) -> tuple[tuple[str, int], ...]:
        most = np.argsort(-counts, kind="stable")[:10].tolist()
        return tuple((graph.entities[entity], int(counts[entity])) for entity in most)

    return Degrees(
        craftable=len(craftable),
        recipes_per_craftable=Spread(
            mean=round(float(craftable.mean()), 3) if len(craftable) else 0.0,
            median=float(np.median(craftable)) if len(craftable) else 0.0,
            max=int(craftable.max(initial=0)),
        ),
        terminal=int(np.sum((uses == 0) & (recipes > 0))),
        idle=int(np.sum((uses == 0) & (recipes == 0))),
        self_pairs=graph.num_self_pairs,
        most_used=top(uses),
        most_recipes=top(recipes),
    )
