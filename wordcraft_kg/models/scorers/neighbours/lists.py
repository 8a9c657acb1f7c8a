"""Neighbour lists and look-ups of a set of recipes: arrays that grow with entities and recipes.

See the package for the mathematics. Everything follows from recipes, word vectors and the nearest
words, so a model folder stores these alone, and the lists are made again when a model is opened.
See "Lists in place of tables" in docs/explanation/recipe-scorer.md.
Ties are broken by the smaller id.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import sparse

from wordcraft_kg.base.tensors import torch_threads
from wordcraft_kg.graphs.arrays import Ids, different_ingredients
from wordcraft_kg.models.scorers.kernel import TEXT, completion_parts, profiles
from wordcraft_kg.models.scorers.neighbours import hash_loops, list_loops
from wordcraft_kg.models.scorers.neighbours.blocks import blocks_of, write_blocks
from wordcraft_kg.models.scorers.neighbours.regression import (
    RANK,
    Factors,
    link_factors,
    result_weights,
)

Numbers = NDArray[np.int32]
Floats = NDArray[np.float32]
Bits = NDArray[np.uint8]

NEAREST = 100
"""Structural neighbours of an entity, K: the entities with the most similar profiles."""
WORDS = 128
"""Neighbours by words, K_w."""
USED = 32
"""Neighbours of an ingredient: similar entities that are ingredients of known recipes."""
MADE = 40
"""Neighbours of a goal: similar entities that known recipes make."""
SUPPORT = 64
"""Recipes that make a goal's neighbours, the most similar neighbours first."""
COMMON = 1_000
"""Profile columns with more entries are skipped in the search for neighbours.

They belong to hubs, such as a partner with 5,000 recipes: they say little, and cost the square of
their length.
"""
SIGNATURE = 1024
"""Most bits in the signature of an entity's partners, or of its results; a power of 2.

A book of fewer entities has a bit for each of them.
"""
MATRIX = 2_048
"""Most entities of a book whose similarities are all kept, rather than computed for each table.

They take up to 16 MiB for each model, and 16 MiB for word cosines, which models of folds share.
"""
BLOCK = 512
"""Rows of word cosines that are in memory at once."""


class Rows(NamedTuple):
    """Rows of a sparse matrix.

    Attributes:
        starts: where the entries of each row begin and those of the last one end, shape (rows +
            1,).
        columns: column of each entry, ascending within a row.
        values: value of each entry.
    """

    starts: Ids
    columns: Numbers
    values: Floats | Numbers


class Neighbours(NamedTuple):
    """Similar entities of T entities, the most similar first, -1 at the end.

    Attributes:
        ids: shape (T, N).
        alike: shape (T, N), squared normalised similarities.
        words: shape (T, N), positive word cosines to the power 4.
    """

    ids: Numbers
    alike: Floats
    words: Floats


class PairTable(NamedTuple):
    """Hash table of ingredient pairs.

    Attributes:
        bits: shape (T, bits / 8), signatures of an ingredient's partners: they tell most unknown
            pairs without a look-up.
        keys: the pairs; -1 for empty places.
        starts: first recipe of each pair; its recipes' numbers are consecutive.
        counts: number of recipes of each pair.
        results: shape (n,), result of each recipe.
    """

    bits: Bits
    keys: Ids
    starts: Numbers
    counts: Numbers
    results: Numbers


class Lists(NamedTuple):
    """Arrays for the features of T entities and n recipes; -1 is the end of a list.

    A NamedTuple, because compiled loops take it as a whole. Its name and module must stay: machine
    code on the disk names them, and could not be read any more.

    Attributes:
        vectors: shape (T, D), unit word vectors; D is 0 without words.
        near: structural neighbours of entities, with cosines of profiles as values: those in an
            entity's own list of length K, and those that have it in theirs.
        norms: shape (T,), similarity of an entity with itself, k(x, x).
        cosines: shape (T, T), word cosines of all entities; (0, 0) above :data:`MATRIX` entities.
        kernels: shape (T, T), their similarities k; (0, 0) likewise.
        used: neighbours that are ingredients, of length N.
        made: neighbours that are results, of length G.
        support: shape (T, R), recipe numbers.
        support_alike: shape (T, R), similarities of the recipes' results to the goal.
        first, second, result: shape (n,), recipes in ascending order.
        pairs: hash table of ingredient pairs.
        result_bits: shape (T, bits / 8), signatures of an ingredient's results.
        parts: ingredients of each result, with numbers of recipes as values.
        num_uses, num_makers: shape (T,), recipes that use, and that make, an entity.
        by_kernel: links by regression with the similarity k, as products, see
            :class:`~.regression.Factors`.
        by_words: links by regression with the product of word vectors, likewise.
        result_weights: shape (2 r, r), of the regression of results, see
            :func:`~.regression.result_weights`.
        half: the matrix H, shape (T, nodes): completion is ``H R Hᵀ``, and H is ``nodesᵀ R``, with
            the matrices of :func:`~wordcraft_kg.models.scorers.kernel.completion_parts`.
        nodes: the matrix R, shape (nodes, nodes).
    """

    vectors: Floats
    near: Rows
    norms: Floats
    cosines: Floats
    kernels: Floats
    used: Neighbours
    made: Neighbours
    support: Numbers
    support_alike: Floats
    first: Numbers
    second: Numbers
    result: Numbers
    pairs: PairTable
    result_bits: Bits
    parts: Rows
    num_uses: Numbers
    num_makers: Numbers
    by_kernel: Factors
    by_words: Factors
    result_weights: Floats
    half: Rows
    nodes: Rows


def nearest_words(
    vectors: Floats,
    count: int = WORDS,
    block: int = BLOCK,
    first: int = 0,
) -> Numbers:
    """Return the entities with the largest positive cosines, shape (T, count), nearest first.

    Exact, in blocks of rows: T² D operations, and memory for ``block`` x T cosines.

    Args:
        vectors: unit vectors, shape (T, D); zeros have no neighbours, and without words lists are
            empty.
        count: length of the lists; -1 fills lists that are too short.
        block: rows at once.
        first: entity with the first list; the lists of others are known already.
    """
    size = len(vectors)
    has_words = vectors.shape[1] > 0
    # All others at most; an empty book has none.
    num_others = max(size - 1, 0)
    width = min(count, num_others) if has_words else 0
    near = np.full((size - first, width), -1, dtype=np.int32)
    if not width:
        return near
    every = torch.tensor(vectors)
    # One thread, because more threads may add in another order and so break ties differently.
    with torch_threads(1):
        for start in range(first, size, block):
            cosines = (every[start : start + block] @ every.T).numpy()
            list_loops.largest(cosines, start, near[start - first : start - first + block])
    return near


def make_lists(
    recipes: Ids,
    vectors: Floats,
    near_words: Numbers,
    *,
    nearest: int = NEAREST,
    used: int = USED,
    made: int = MADE,
    support: int = SUPPORT,
    rank: int = RANK,
) -> Lists:
    """Make the lists of a set of recipes.

    Args:
        recipes: ids (ingredient, ingredient, result), shape (n, 3), any order.
        vectors: unit word vectors, shape (T, D).
        near_words: from :func:`nearest_words`.
        nearest: K, structural neighbours.
        used: N, neighbours that are ingredients.
        made: G, neighbours that are results.
        support: R, recipes for a goal.
        rank: rank of the kernel regression.
    """
    size = len(vectors)
    ordered = ordered_recipes(recipes)
    first, second, result = (np.ascontiguousarray(column, dtype=np.int32) for column in ordered.T)
    # A recipe with twice the same ingredient is one link.
    rows_of_links, ingredients = different_ingredients(ordered, size)
    num_uses = np.bincount(ingredients, minlength=size).astype(np.int32)
    num_makers = np.bincount(result, minlength=size).astype(np.int32)
    rows = profiles(ordered, size).astype(np.float32)
    near = _structural_neighbours(rows, min(nearest, max(size, 1)))
    # A profile has length 1, words add their part; entities with neither stay at the words' part.
    norms = ((np.diff(rows.indptr) > 0) + TEXT).astype(np.float32)
    matrix_size = size if size <= MATRIX else 0
    cosines = np.empty((matrix_size, matrix_size), dtype=np.float32)
    list_loops.word_cosines(vectors[:matrix_size], cosines)
    kernels = np.zeros_like(cosines)
    list_loops.all_kernels(near, norms[:matrix_size], cosines, kernels)
    used_lists, made_lists = _merged(
        vectors,
        (near, norms, near_words),
        num_uses,
        num_makers,
        widths=(min(used, size), min(made, size)),
    )
    starts = np.concatenate([[0], np.cumsum(num_makers)]).astype(np.int64)
    supporting, support_alike = list_loops.supporting(
        made_lists.ids,
        made_lists.alike,
        starts,
        _by_result(ordered),
        min(support, max(len(ordered), 1)),
    )
    pair_keys = first.astype(np.int64) * size + second
    # A power of 2 places, of which a quarter is filled at most.
    table_size = 1 << max(4, (4 * len(pair_keys)).bit_length())
    keys, first_recipes, counts = hash_loops.pair_table(pair_keys, table_size)
    # By result and ingredient; equal cells are added up, so values are numbers of recipes.
    cells = (ordered[rows_of_links, 2], ingredients)
    parts = sparse.csr_array((np.ones(len(ingredients)), cells), shape=(size, size))
    partner_bits = np.zeros((size, _signature_bytes(size)), dtype=np.uint8)
    result_bits = np.zeros_like(partner_bits)
    for one, other in ((first, second), (second, first)):
        hash_loops.signatures(one, other, partner_bits)
        hash_loops.signatures(one, result, result_bits)
    by_kernel, by_words = link_factors(ordered, rows, vectors, rank)
    nodes, node_pairs = completion_parts(ordered, size)
    return Lists(
        vectors=vectors,
        near=near,
        norms=norms,
        cosines=cosines,
        kernels=kernels,
        used=used_lists,
        made=made_lists,
        support=supporting,
        support_alike=support_alike,
        first=first,
        second=second,
        result=result,
        pairs=PairTable(partner_bits, keys, first_recipes, counts, result),
        result_bits=result_bits,
        parts=_sparse_rows(parts, np.int32),
        num_uses=num_uses,
        num_makers=num_makers,
        by_kernel=by_kernel,
        by_words=by_words,
        result_weights=result_weights(ordered, by_words.right),
        half=_sparse_rows((nodes.T @ node_pairs).tocsr()),
        nodes=_sparse_rows(node_pairs),
    )


def _sparse_rows(matrix: Any, dtype: type[np.number[Any]] = np.float32) -> Rows:
    """Return a SciPy matrix by rows as arrays in the types that loops are compiled for."""
    # Without a copy if possible: those of a large book take hundreds of megabytes.
    starts = matrix.indptr.astype(np.int64, copy=False)
    columns = matrix.indices.astype(np.int32, copy=False)
    return Rows(starts, columns, matrix.data.astype(dtype, copy=False))


def _structural_neighbours(rows: Any, nearest: int) -> Rows:
    """Return lists in which an entity is its neighbour's neighbour, with cosines as values.

    The similarity of two entities does not depend on their order then.

    Args:
        rows: profiles, sparse, shape (T, M).
        nearest: neighbours that are searched for each entity.
    """
    # A function of its own: in a large book, its arrays take as much memory as all lists.
    columns = rows.T.tocsr()
    profiles_both_ways = (
        rows.indptr,
        rows.indices,
        rows.data,
        columns.indptr,
        columns.indices,
        columns.data,
    )
    size = rows.shape[0]
    near = np.full((size, nearest), list_loops.FAR, dtype=np.int32)
    cosines = np.zeros((size, nearest), dtype=np.float32)

    def write(block: slice) -> None:
        list_loops.structural_neighbours(
            *profiles_both_ways,
            COMMON,
            block.start,
            near[block],
            cosines[block],
        )

    write_blocks(write, blocks_of(size))
    is_listed = near < list_loops.FAR
    entities, _ = np.nonzero(is_listed)
    cells = (entities, near[is_listed])
    table = sparse.csr_array((cosines[is_listed], cells), shape=(size, size))
    # Both directions hold the same sum, added in another order: the larger one counts.
    symmetric = table.maximum(table.T).tocsr()
    symmetric.sort_indices()
    return _sparse_rows(symmetric)


def _merged(
    vectors: Floats,
    neighbours: tuple[Rows, Floats, Numbers],
    num_uses: Numbers,
    num_makers: Numbers,
    widths: tuple[int, int],
) -> list[Neighbours]:
    """Return the lists of :func:`~.list_loops.merged_neighbours` of all entities.

    Args:
        vectors: word vectors, shape (T, D).
        neighbours: by structure and by words, the loop's next arguments.
        num_uses: recipes that use an entity, shape (T,).
        num_makers: recipes that make an entity, shape (T,).
        widths: lengths of the lists of ingredients, and of results.

    Returns:
        of ingredients, and of results.
    """
    size = len(vectors)
    lists = []
    for width in widths:
        ids = np.full((size, width), -1, dtype=np.int32)
        alike = np.zeros((size, width), dtype=np.float32)
        lists.append(Neighbours(ids, alike, np.zeros_like(alike)))

    def write(block: slice) -> None:
        ingredients, results = (tuple(array[block] for array in arrays) for arrays in lists)
        list_loops.merged_neighbours(
            vectors,
            *neighbours,
            num_uses,
            num_makers,
            block.start,
            ingredients,
            results,
        )

    write_blocks(write, blocks_of(size))
    return lists


def ordered_recipes(recipes: Ids) -> Ids:
    """Return distinct recipes, shape (n, 3), in ascending order, the smaller ingredient first."""
    rows = recipes.copy()
    rows[:, :2].sort(axis=1)
    return np.unique(rows, axis=0)


def _by_result(recipes: Ids) -> Numbers:
    """Return recipe numbers by result, and within a result in an order that looks random.

    A hub has more recipes than a list holds, and a random part speaks for it better than the
    recipes with the smallest ids. The order depends on a recipe alone: other recipes that come or
    go do not change it.
    """
    # Products by two large odd numbers (Knuth 1973), which wrap around.
    a, b, results = recipes.astype(np.uint64).T
    mixed = (a * np.uint64(0x9E3779B97F4A7C15)) ^ (b * np.uint64(0xBF58476D1CE4E5B9))
    # The last key counts first: by result, then by the mixed ingredients.
    order = np.lexsort((mixed, results))
    return order.astype(np.int32)


def _signature_bytes(size: int) -> int:
    """Return the number of bytes of an entity's signature, a power of 2."""
    # A bit for each entity, and at least a byte.
    bits_of_ids = (size - 1).bit_length()
    bits = 1 << max(3, bits_of_ids)
    return min(bits, SIGNATURE) // 8
