"""Fit recipe scorers by stacking, for all recipes and without each fold, with shared work.

Rankers are small networks. They learn from recipes of held-out folds, whose features come from the
remaining folds, and so learn how far features can be trusted. The final scorer applies the rankers
to features from all recipes (Wolpert 1992; van der Laan, Polley and Hubbard 2007).

For cross-fitting there is a scorer without each fold. It knows the recipes of the other folds, and
its rankers learn from queries about these. Up to :data:`STRICT` train recipes, nothing of the fold
is in the queries: 1 + K + K (K - 1) / 2 sets of lists serve K + 1 scorers. In larger books the
queries are those of the main model, whose features and right answers count the fold's recipes as
known, and K + 1 sets serve all; see "A scorer in two steps" in docs/explanation/cross-fitting.md.

On large books, which have a pair encoder, whose fit costs more than all else, rankers learn from
one fold: a large book has recipes enough in it. An encoder of other books is one for all folds.
"""

import math
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.graphs import (
    COMBINES_WITH,
    COMPONENT_OF,
    Folds,
    Ids,
    is_in,
    recipe_keys,
    recipe_triples,
)
from wordcraft_kg.graphs.arrays import different_ingredients
from wordcraft_kg.models.knowledge.books import Words
from wordcraft_kg.models.knowledge.outside import NOTHING, LinkTables
from wordcraft_kg.models.recipes.committee import HIDDEN, LINKS, Examples, Schedule, fit_committee
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.links import CELLS, link_features, links_by_key
from wordcraft_kg.models.scorers.neighbours.lists import Lists
from wordcraft_kg.models.scorers.neighbours.pair_encoder import PairEncoder
from wordcraft_kg.models.scorers.neighbours.pair_features import (
    FEATURES,
    only_pair,
    pair_features,
    pairs_of,
    with_link_scores,
)
from wordcraft_kg.models.scorers.neighbours.regression import SMALL
from wordcraft_kg.models.scorers.neighbours.results import propose_results
from wordcraft_kg.models.scorers.neighbours.storage import num_features
from wordcraft_kg.models.scorers.ranker import Ranker

TABLES = (8, 2)
"""Distractors (entities outside the recipe) on each of the tables for a held-out recipe."""
EXAMPLES = 4_000
"""Most held-out recipes from which a ranker of the main model learns, over all folds.

On validation parts of `everyday`, splits 0 to 2, 3,000, 4,000 and 6,000 solve .571, .574 and .573
by goal, .770, .771 and .773 by recipe.
"""
ONE_LESSON_FROM = 20_000
"""Training recipes from which a scorer's rankers learn from a single held-out fold.

It has as many examples as all folds together. A pair encoder needs as many recipes.
"""
STRICT = 2_000
"""Most train recipes with which the rankers of a scorer without a fold learn nothing of this fold.

In larger books, whose lists cost more, they learn from queries that count its recipes as known. On
`kitchen`, of 260, that would raise success on the fold, by goal, and not on test tasks; see
docs/evidence/links.md, "Do models without a fold know of it?".
"""
DRAWS = (2, 4)
"""Fewest and most tables of each size for a held-out recipe, with different distractors.

On 20 splits of a book with 242 recipes, 2, 4, 8 and 16 solve .414, .420, .419 and .414. One would
take half the time, and on left-out folds by recipe loses .013 on Little Alchemy 2, .010 on Infinite
Craft and .002 on `everyday`.
"""
LINK_QUERIES = 1_000
"""Most links of a held-out fold that are asked for on each side, if rankers learn from all folds;
300 cost .01 of the MRR."""
CANDIDATES = 64
"""Entities that compete for a link; 256 gain nothing."""
KNOWN = 10_000
"""Most known recipes whose scores are lifted if held-out goals have none."""
RESULT_QUERIES = 2_000
"""Most pairs of a held-out fold whose results are asked for."""
RESULTS = Schedule(members=3, batch=64, epochs=12, rate=1e-2, steps=60)
"""For results of a pair; on a validation part of Infinite Craft, 6 epochs cost .007 of the MRR, and
neither batches of 128 nor half the step size gain."""
_TOGETHER = 256
"""Tables whose pairs are encoded at once."""
LeftOut = tuple[int, ...]
"""Folds whose recipes a scorer does not know: none, or one."""
LessonKey = tuple[LeftOut, int]
"""Folds that queries do not count as known, and the fold that they ask for."""


def fit_recipe_scorers(
    folds: Folds,
    words: Words,
    wanted: Sequence[LeftOut],
    *,
    outside: LinkTables = NOTHING,
    encoders: Mapping[LeftOut, PairEncoder] = MappingProxyType({}),
    seed: int = 0,
    workers: int = 1,
    after: Callable[[], None] = lambda: None,
) -> Iterator[tuple[LeftOut, RecipeKnowledge]]:
    """Fit a scorer for each entry of ``wanted``, in this order.

    The result does not depend on the other entries, nor on ``workers``: each set of examples has
    its own seed.

    Args:
        folds: folds of the train recipes.
        words: word vectors.
        wanted: the folds to leave out, () for none.
        outside: features that are the same in all folds.
        encoders: pair encoders by the folds that they have not seen, all of :func:`encoders_of`;
            none for that of other books, if there is one.
        seed: seed of tables and initial weights.
        workers: threads; compiled loops and fits run beside each other.
        after: called after each set of lists, and after a fit is taken, in the caller's thread; may
            raise to end the fits.

    Yields:
        an entry of ``wanted``, and the knowledge fitted without these folds.
    """
    needed = {*lessons_of(folds, wanted)}
    lessons: dict[LessonKey, _Lesson] = {}

    def make_lessons(key: LessonKey) -> dict[LessonKey, _Lesson]:
        unknown, held_out = key
        lists = words.lists(folds.recipes([*unknown, held_out]))
        # The same lists serve the fold that is unknown, in the other's turn.
        turned = [((held_out,), fold) for fold in unknown]
        return {
            (left_out, fold): _lesson(
                folds,
                lists,
                outside,
                # That of the book itself has not seen the fold that is asked for.
                encoders.get((fold,), outside.encoder),
                left_out,
                fold,
                seed,
                is_own_encoder=bool(encoders),
            )
            for left_out, fold in needed.intersection([key, *turned])
        }

    pool = ThreadPoolExecutor(workers)
    # Rankers are fitted beside each other, and beside the lists of the next ones.
    fits: deque[tuple[LeftOut, Future[RecipeKnowledge]]] = deque()
    try:
        for number, left_out in enumerate(wanted, 1):
            keys = lessons_of(folds, [left_out])
            for new_lessons in pool.map(make_lessons, [key for key in keys if key not in lessons]):
                lessons |= new_lessons
                after()
            fit = pool.submit(
                _fitted,
                folds,
                words,
                outside,
                encoders.get(left_out, outside.encoder),
                left_out,
                [lessons[key] for key in keys],
                # A lesson of the main model has the lists of the scorer without its fold.
                next((lessons[(), fold].lists for fold in left_out if ((), fold) in lessons), None),
                seed,
            )
            fits.append((left_out, fit))
            # Lessons of the main model serve other scorers, too.
            lessons = {key: lessons[key] for key in lessons if not key[0] or key not in keys}
            # More waiting fits would only keep what they learn from in memory.
            while len(fits) > (workers - 1 if number < len(wanted) else 0):
                fold_set, first_fit = fits.popleft()
                yield fold_set, first_fit.result()
                after()
    finally:
        # After Ctrl-C, what is not begun is never made.
        pool.shutdown(cancel_futures=True)


def lesson_folds(folds: Folds, left_out: LeftOut) -> list[int]:
    """Return the held-out folds from which the rankers of a scorer learn.

    Args:
        folds: folds of the train recipes.
        left_out: folds that the scorer has not seen.
    """
    remaining_folds = [fold for fold in range(folds.count) if fold not in left_out]
    is_large = np.count_nonzero(folds.train_sample.is_trained_on) >= ONE_LESSON_FROM
    return remaining_folds[: 1 if is_large else None]


def lessons_of(folds: Folds, wanted: Sequence[LeftOut]) -> list[LessonKey]:
    """Return the lessons from which the rankers of these scorers learn, each once.

    Args:
        folds: folds of the train recipes.
        wanted: the folds that scorers leave out, in the order of their fits.

    Returns:
        of each lesson, the folds that it does not count as known, and the fold that it holds out;
        it needs a set of lists without both.
    """
    is_strict = np.count_nonzero(folds.train_sample.is_trained_on) <= STRICT
    lessons = [
        (left_out if is_strict else (), turn)
        for left_out in wanted
        for turn in lesson_folds(folds, left_out)
    ]
    return list(dict.fromkeys(lessons))


def encoders_of(folds: Folds, wanted: Sequence[LeftOut]) -> list[LeftOut]:
    """Return the folds that pair encoders must not have seen, an entry for each encoder.

    A scorer needs two: one that has seen all that the scorer may see, and one without the fold from
    which the rankers learn. Five folds and the main model need six.

    Args:
        folds: folds of the train recipes.
        wanted: the folds that scorers leave out, in the order of their fits.
    """
    lessons = lessons_of(folds, wanted)
    return list(dict.fromkeys([*wanted, *((held_out,) for _, held_out in lessons)]))


class _Lesson(NamedTuple):
    """What the rankers of a scorer learn from a held-out fold.

    Attributes:
        queries: queries for links, by relation.
        links: features of the links of tables' slots to the goals, shape (N, A, F).
        pair_links: features of combinesWith links between slots, shape (N, P, F), where outside
            knowledge tells of them; else (N, P, 0).
        tables: queries for pairs on tables, without the scores of the link rankers, which learn
            first.
        results: queries for results of pairs, likewise; None without an encoder of the own recipes.
        result_links: as ``links``, of these queries: a table of two slots for each candidate.
        lists: those without the fold, which are those of the scorer without it, too; None of more
            than :data:`SMALL` entities, where they take hundreds of megabytes, and in lessons that
            leave out another fold.
    """

    queries: Mapping[int, Examples]
    links: Tensor
    pair_links: Tensor
    tables: Examples
    results: Examples | None = None
    result_links: Tensor | None = None
    lists: Lists | None = None


def _fitted(
    folds: Folds,
    words: Words,
    outside: LinkTables,
    encoder: PairEncoder | None,
    left_out: LeftOut,
    lessons: Sequence[_Lesson],
    lists: Lists | None,
    seed: int,
) -> RecipeKnowledge:
    """Fit the rankers of a scorer: those of links, then that of recipes, which uses their scores.

    Args:
        folds: folds of the train recipes.
        words: word vectors.
        outside: features of links that are the same in all folds.
        encoder: pair encoder that has seen what the scorer has seen; None without.
        left_out: folds that the scorer has not seen.
        lessons: the queries of each held-out fold.
        lists: those of the scorer, if a lesson has them; else None.
        seed: seed of the initial weights and the order of queries.
    """
    generator = torch.Generator().manual_seed(_seed_of(seed, left_out))
    link_rankers = {}
    lesson = _merged(lessons)
    for relation, queries in lesson.queries.items():
        if len(queries.features):
            link_rankers[relation] = fit_committee(queries, generator, LINKS)
    _add_link_scores(lesson, link_rankers)
    ranker = fit_committee(lesson.tables, generator)
    recipes = folds.recipes(left_out)
    if outside.pairs or outside.parts:
        knowledge = _with_tables(words, recipes, outside, link_rankers, encoder, lists)
    else:
        knowledge = RecipeKnowledge.of_recipes(
            recipes,
            words.vectors,
            words.near,
            link_rankers,
            encoder,
            lists,
        )
    ranker = _knowing(ranker, lesson.tables, knowledge, recipes)
    if lesson.results is not None:
        result_ranker = _result_ranker(lesson.results, generator, knowledge, recipes)
        knowledge = knowledge.with_ranker(result_ranker, "results_")
    scorer = knowledge.with_ranker(ranker)
    # Known recipes may have needed lists; those of a large book are made again when needed.
    if knowledge.num_entities <= SMALL:
        scorer.share_lists(knowledge)
    return scorer


def _result_ranker(
    examples: Examples,
    generator: torch.Generator,
    knowledge: RecipeKnowledge,
    recipes: Ids,
) -> Ranker:
    """Fit the ranker of results.

    Args:
        examples: queries for results, with the scores of the link rankers.
        generator: draws initial weights and the order of queries.
        knowledge: computes the features of known recipes.
        recipes: known recipes, ids (n, 3).
    """
    if not len(examples.competes):
        # By-goal folds of a tiny book: no candidate is ever right. As wide as other folds' rankers,
        # with which this one is stacked.
        return Ranker.empty(num_features(has_encoder=True), RESULTS.members * HIDDEN)
    return _knowing(fit_committee(examples, generator, RESULTS), examples, knowledge, recipes)


def _knowing(
    ranker: Ranker,
    examples: Examples,
    knowledge: RecipeKnowledge,
    recipes: Ids,
) -> Ranker:
    """Return a ranker that scores known recipes highest, if nothing in its examples was known.

    With folds by goal no held-out goal has a known recipe, and where each pair makes one thing no
    held-out pair has a known result. So the ranker learns nothing about the feature ``makes`` (a +
    b makes the goal), and low scores for known pairs, even with their own results. Scores of other
    pairs stay the same to the bit.

    Args:
        ranker: the fitted ranker.
        examples: what it learned from.
        knowledge: computes the features of known recipes.
        recipes: known recipes, ids (n, 3).
    """
    makes = FEATURES.index("makes")
    # A feature that is the same in all examples has weight 0.
    if ranker.first[makes].any():
        return ranker
    sampled_recipes = recipes[:: max(1, len(recipes) // KNOWN)]
    a, b, goal = torch.from_numpy(sampled_recipes.copy()).T
    table = torch.stack([a, b], dim=1)
    slots = only_pair(goal.device)
    known_features = knowledge.features(goal, table, torch.zeros_like(goal), slots)
    highest = ranker(examples.features[examples.competes]).amax()
    units = known_features[:, 0] @ ranker.first + ranker.first_bias
    positive = ranker.second.clamp(min=0)
    # A lower bound of the scores of known recipes, because relu(x) is never below x.
    negative = ranker.second - positive
    scores = units.relu() @ negative + units @ positive + ranker.bias
    # The same lift for all units that raise the score.
    lift = (highest - scores.amin()).clamp(min=0) / positive.sum()
    first = ranker.first.clone()
    first[makes] = lift * (positive > 0)
    return ranker._replace(first=first)


def _merged(lessons: Sequence[_Lesson]) -> _Lesson:
    """Return copies of the queries of all lessons: each scorer adds the scores of its links."""
    results = [lesson.results for lesson in lessons if lesson.results is not None]
    result_links = [part.result_links for part in lessons if part.result_links is not None]
    return _Lesson(
        {
            relation: _together([lesson.queries[relation] for lesson in lessons])
            for relation in (COMBINES_WITH, COMPONENT_OF)
        },
        torch.cat([lesson.links for lesson in lessons]),
        torch.cat([lesson.pair_links for lesson in lessons]),
        _together([lesson.tables for lesson in lessons]),
        _together(results) if results else None,
        torch.cat(result_links) if result_links else None,
    )


def _add_link_scores(lesson: _Lesson, link_rankers: Mapping[int, Ranker]) -> None:
    """Write the scores of the link rankers into the features of a lesson's pairs.

    Args:
        lesson: the queries; is written to.
        link_rankers: by relation; none where there was nothing to learn from.
    """
    component = link_rankers.get(COMPONENT_OF)
    # Links without a ranker have the score 0.
    if component is None:
        return
    combines = None
    combines_ranker = link_rankers.get(COMBINES_WITH)
    if combines_ranker and lesson.pair_links.shape[2]:
        combines = combines_ranker(lesson.pair_links)
    slots = pairs_of(lesson.links.shape[1], torch.device("cpu"))
    with_link_scores(lesson.tables.features, component(lesson.links), combines, slots)
    if lesson.results is not None and lesson.result_links is not None:
        # A table for each candidate, whose only pair is slot 0 with slot 1: (N C, 1, F).
        every = lesson.results.features.view(-1, 1, lesson.results.features.shape[2])
        slots_of_pair = only_pair(every.device)
        with_link_scores(every, component(lesson.result_links), None, slots_of_pair)


def _with_tables(
    words: Words,
    recipes: Ids,
    outside: LinkTables,
    link_rankers: Mapping[int, Ranker],
    encoder: PairEncoder | None,
    own_lists: Lists | None,
) -> RecipeKnowledge:
    """Return the knowledge of recipes with tables of all link scores, without a recipe ranker.

    Args:
        words: word vectors.
        recipes: training recipes, ids (n, 3).
        outside: features of links from outside the recipes.
        link_rankers: by relation, for features of recipes and of outside knowledge.
        encoder: pair encoder of other books; None without.
        own_lists: those of the recipes, if a lesson has them; else None.
    """
    # Rankers that score 0: the tables take the place of the link rankers.
    knowledge = RecipeKnowledge.of_recipes(
        recipes, words.vectors, words.near, encoder=encoder, lists=own_lists
    )
    size = knowledge.num_entities
    lists = knowledge.lists()
    every = torch.arange(size)
    # Links without a ranker have the score 0.
    tables = {relation: torch.zeros(size, size) for relation in (COMBINES_WITH, COMPONENT_OF)}
    for relation, ranker in link_rankers.items():
        scores = []
        for head_ids in every.split(max(1, CELLS // size)):
            features = link_features(lists, relation, head_ids.numpy(), every.numpy())
            from_outside = _outside(outside, relation, head_ids[:, None], every)
            scores.append(ranker(torch.cat([features, from_outside], dim=-1)))
        tables[relation] = torch.cat(scores)
    return knowledge.with_link_tables(tables)


def _outside(outside: LinkTables, relation: int, heads: Tensor, tails: Tensor) -> Tensor:
    """Return the features of links from outside the recipes, (..., F); ids broadcast."""
    tables = outside.pairs if relation == COMBINES_WITH else outside.parts
    features = [table[heads, tails] for table in tables]
    shape = torch.broadcast_shapes(heads.shape, tails.shape)
    # Without tables there is nothing to stack.
    return torch.stack(features, dim=-1) if features else torch.zeros(*shape, 0)


def _together(parts: Sequence[Examples]) -> Examples:
    return Examples(*(torch.cat(part) for part in zip(*parts, strict=True)))


def _lesson(
    folds: Folds,
    lists: Lists,
    outside: LinkTables,
    encoder: PairEncoder | None,
    unknown: LeftOut,
    held_out: int,
    seed: int,
    *,
    is_own_encoder: bool,
) -> _Lesson:
    """Make queries from a fold's recipes: for their links, and for tables with distractors.

    Args:
        folds: folds of the train recipes.
        lists: made without ``unknown`` and ``held_out``.
        outside: features of links that are the same in all folds.
        encoder: pair encoder that has not seen ``held_out``; None without.
        unknown: folds whose recipes do not count; every pair in a recipe of the others is right.
        held_out: the fold whose recipes are asked for.
        seed: seed of links and tables.
        is_own_encoder: whether the encoder is of the folds' recipes; then results are asked for,
            too.
    """
    rng = np.random.default_rng([_seed_of(seed, unknown), held_out])
    lessons = len(lesson_folds(folds, unknown))
    # A single fold has as many queries as all together would have.
    most = LINK_QUERIES * (folds.count - len(unknown)) // lessons
    queries = {
        relation: _link_examples(folds, lists, outside, unknown, held_out, relation, most, rng)
        for relation in (COMBINES_WITH, COMPONENT_OF)
    }
    recipes = folds.recipes_of(held_out)
    known_recipes = folds.recipes(unknown)
    # An equal share of the examples for each fold, rounded up.
    max_recipes = math.ceil(EXAMPLES / lessons)
    lesson_recipes = recipes[np.sort(rng.permutation(len(recipes))[:max_recipes])]
    tables, goals = drawn_tables(lesson_recipes, known_recipes, len(lists.norms), rng)
    links, examples = table_examples(lists, encoder, tables, goals, known_recipes)
    # Empty slots have no row; their pairs do not compete.
    slots = torch.from_numpy(tables).clamp(min=0)
    from_outside = _outside(outside, COMPONENT_OF, slots, torch.from_numpy(goals)[:, None])
    first_slots, second_slots = pairs_of(slots.shape[1], slots.device)
    pair_links = torch.zeros(len(slots), len(first_slots), 0)
    if outside.pairs:
        a = slots[:, first_slots]
        b = slots[:, second_slots]
        places = (a.numpy().ravel(), b.numpy().reshape(-1, 1))
        known_pairs = links_by_key(lists, COMBINES_WITH, *places).view(*a.shape, -1)
        pair_links = torch.cat([known_pairs, _outside(outside, COMBINES_WITH, a, b)], dim=-1)
    lesson = _Lesson(
        queries,
        torch.cat([links, from_outside], dim=-1),
        pair_links,
        examples,
        lists=None if unknown or len(lists.norms) > SMALL else lists,
    )
    if encoder is None or not is_own_encoder:
        return lesson
    result_links, results = _result_queries(lists, encoder, recipes, known_recipes, rng)
    return lesson._replace(results=results, result_links=result_links)


def _result_queries(
    lists: Lists,
    encoder: PairEncoder,
    recipes: Ids,
    known_recipes: Ids,
    rng: np.random.Generator,
) -> tuple[Tensor, Examples]:
    """Make queries for results of a fold's pairs, among the candidates that a scorer proposes.

    Args:
        lists: made without the fold.
        encoder: fitted without the fold.
        recipes: the fold's recipes, ids (n, 3).
        known_recipes: all recipes that may be known, ids (m, 3): every result of a pair is right.
        rng: draws pairs.

    Returns:
        features of the links of both ingredients to each candidate, shape (N C, 2, F); and queries
        for N pairs with C candidates.
    """
    sampled_rows = rng.permutation(len(recipes))[:RESULT_QUERIES]
    pairs = np.unique(recipes[np.sort(sampled_rows), :2], axis=0)
    a, b = torch.from_numpy(pairs).T.contiguous()
    candidates = propose_results(lists, encoder, a, b).numpy()
    competes = candidates >= 0
    keys = _keys(lists, pairs[:, :1], pairs[:, 1:], candidates)
    is_right = np.isin(keys, _keys(lists, *known_recipes.T)) & competes
    # A pair whose result nobody proposes has nothing to teach.
    has_right = is_right.any(1)
    competes = competes[has_right]
    is_right = is_right[has_right]
    query_candidates = candidates[has_right]
    tables = np.repeat(pairs[has_right], query_candidates.shape[1], axis=0)
    goals = query_candidates.ravel()
    slots_of_pair = only_pair(torch.device("cpu"))
    links, every = table_examples(lists, encoder, tables, goals, known_recipes, slots_of_pair)
    # (N C, 1, F) to (N, C, F).
    features = every.features.view(*query_candidates.shape, every.features.shape[-1])
    examples = Examples(features, torch.from_numpy(competes), torch.from_numpy(is_right))
    return links, examples


def _link_examples(
    folds: Folds,
    lists: Lists,
    outside: LinkTables,
    unknown: LeftOut,
    held_out: int,
    relation: int,
    queries: int,
    rng: np.random.Generator,
) -> Examples:
    """Make queries from links that a fold's recipes alone have.

    Args:
        folds: folds of the train recipes.
        lists: made without ``unknown`` and ``held_out``.
        outside: features of links that are the same in all folds.
        unknown: folds whose recipes do not count; known links of the others do not compete.
        held_out: the fold whose links are asked for.
        relation: relation id.
        queries: most links on each side.
        rng: draws links and candidates.
    """
    size = folds.split.graph.num_entities
    every = folds.triples(unknown)
    fold_triples = recipe_triples(folds.recipes_of(held_out))
    train_triples = folds.triples([*unknown, held_out])
    is_new = ~is_in(fold_triples, train_triples, size)
    new = fold_triples[is_new & (fold_triples[:, 1] == relation)]
    sampled_rows = rng.permutation(len(new))[:queries]
    query_links = new[np.sort(sampled_rows)]
    parts = []
    # combinesWith is symmetric, so head queries equal tail queries.
    asks_heads = (False,) if relation == COMBINES_WITH else (False, True)
    for heads in asks_heads:
        query_entities = query_links[:, 2 if heads else 0]
        answer_ids = query_links[:, 0 if heads else 2]
        candidates = rng.integers(size, size=(len(query_links), CANDIDATES))
        # The right candidate comes first, and once.
        candidates[:, 0] = answer_ids
        is_right = np.zeros(candidates.shape, dtype=bool)
        is_right[:, 0] = True
        queried = query_entities[:, None]
        sides = (candidates, relation, queried) if heads else (queried, relation, candidates)
        links = np.stack(np.broadcast_arrays(*sides), axis=-1)
        is_known = is_in(links.reshape(-1, 3), every, size).reshape(candidates.shape)
        # By result, which the links of a tail query do not share.
        by_key = (candidates.ravel(), np.repeat(query_entities, CANDIDATES)[:, None])
        if heads or relation == COMBINES_WITH:
            by_key = (query_entities, candidates)
        features = links_by_key(lists, relation, *by_key).view(*candidates.shape, -1)
        link_heads, _, link_tails = torch.from_numpy(links).unbind(-1)
        from_outside = _outside(outside, relation, link_heads, link_tails)
        features = torch.cat([features, from_outside], dim=-1)
        # Other right answers do not compete with the one that is asked for.
        competes = ~is_known | is_right
        parts.append(Examples(features, torch.from_numpy(competes), torch.from_numpy(is_right)))
    return _together(parts)


def drawn_tables(
    recipes: Ids,
    known: Ids,
    size: int,
    rng: np.random.Generator,
) -> tuple[Ids, Ids]:
    """Draw tables with distractors for recipes: several of each size.

    Args:
        recipes: recipes to ask for, ids (n, 3).
        known: all recipes that may be known, ids (m, 3): distractors are drawn by them.
        size: E.
        rng: draws tables.

    Returns:
        ids of slots, shape (N, A), -1 for empty slots; and goals, shape (N,).
    """
    # A small book has few recipes to learn from, so that more distractors help.
    min_draws, max_draws = DRAWS
    draws = int(np.clip(EXAMPLES // max(len(known), 1), min_draws, max_draws))
    tables = [_tables(recipes, known, size, amount, rng) for amount in TABLES * draws]
    return np.concatenate(tables), np.tile(recipes[:, 2], len(tables))


def table_examples(
    lists: Lists,
    encoder: PairEncoder | None,
    tables: Ids,
    goals: Ids,
    known: Ids,
    slot_pairs: tuple[Tensor, Tensor] | None = None,
) -> tuple[Tensor, Examples]:
    """Make queries from tables: which pairs make the goal?

    Args:
        lists: compute the features.
        encoder: pair encoder, whose features come last; None without.
        tables: ids of slots, shape (N, A), -1 for empty slots.
        goals: ids, shape (N,), -1 for no goal.
        known: all recipes that may be known, ids (m, 3): every pair that makes the goal by one of
            them is right.
        slot_pairs: first and second slot of P pairs, shape (P,) each; None for all pairs.

    Returns:
        features of the links of slots to goals, shape (N, A, 15); and queries with features of
        pairs, (N, P, F), where scores of link rankers are 0.
    """
    slots = slot_pairs or pairs_of(tables.shape[1], torch.device("cpu"))
    first_slots, second_slots = (part.numpy() for part in slots)
    links = links_by_key(lists, COMPONENT_OF, goals, tables)
    features = torch.from_numpy(
        pair_features(lists, (first_slots, second_slots), goals, tables, links.numpy())
    )
    a = tables[:, first_slots]
    b = tables[:, second_slots]
    competes = (a >= 0) & (b >= 0)
    if encoder is not None:
        # Any entity will do in an empty place.
        ids = [torch.from_numpy(np.maximum(entity_ids, 0)) for entity_ids in (a, b, goals)]
        blocks = zip(*(entity_ids.split(_TOGETHER) for entity_ids in ids), strict=True)
        encoded = torch.cat([encoder.features(*block) for block in blocks])
        encoded[~torch.from_numpy(competes)] = 0
        features = torch.cat([features, encoded], dim=-1)
    # The key of a pair with an empty slot may be that of another recipe.
    is_right = np.isin(_keys(lists, a, b, goals[:, None]), _keys(lists, *known.T)) & competes
    return links, Examples(features, torch.from_numpy(competes), torch.from_numpy(is_right))


def _keys(lists: Lists, a: Ids, b: Ids, results: Ids) -> Ids:
    """Return a number for each recipe, in which the order of its ingredients is lost."""
    return recipe_keys(a, b, results, num_entities=len(lists.norms))


def _tables(
    recipes: Ids,
    known_recipes: Ids,
    size: int,
    distractors: int,
    rng: np.random.Generator,
) -> Ids:
    """Return tables with a recipe's ingredients and drawn entities.

    Distractors are drawn by 1 + their number of recipes, as environments draw them, without the
    recipe's entities.

    Args:
        recipes: ids, shape (n, 3).
        known_recipes: recipes that are counted, ids (m, 3).
        size: E.
        distractors: number of drawn entities, fewer in a small graph.
        rng: draws the entities.

    Returns:
        ids, shape (n, 2 + most distractors); -1 is an empty slot.
    """
    # In a recipe a + a, the entity counts once.
    _, users = different_ingredients(known_recipes, size)
    # Where the interval of each entity ends, which is as long as its weight.
    ends = np.cumsum(1.0 + np.bincount(users, minlength=size))
    tables = np.full((len(recipes), 2 + max(TABLES)), -1, dtype=np.int64)
    tables[:, :2] = recipes[:, :2]
    # An entity is on a table once, also if the recipe combines it with itself.
    is_twice = recipes[:, 0] == recipes[:, 1]
    tables[is_twice, 1] = -1
    amount = max(min(distractors, size - 3), 0)
    # Some are drawn twice; the first draws of different entities count.
    draws = 4 * amount + 16
    shares = rng.random((len(recipes), draws))
    drawn_ids = np.searchsorted(ends, shares * ends[-1], "right")
    by_recipe = zip(recipes.tolist(), drawn_ids.tolist(), strict=True)
    for row, (recipe, entities) in enumerate(by_recipe):
        if len(set(entities).difference(recipe)) < amount:
            # In a small book, nearly all draws may repeat a few entities.
            entities += rng.permutation(size).tolist()
        drawn = [entity for entity in dict.fromkeys(entities) if entity not in recipe]
        tables[row, 2 : 2 + amount] = drawn[:amount]
    return tables


def _seed_of(seed: int, left_out: Collection[int]) -> int:
    """Return a seed for the scorer without these folds."""
    rng = np.random.default_rng([seed, *sorted(left_out)])
    return int(rng.integers(2**31))
