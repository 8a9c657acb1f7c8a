"""Hash tables of pairs and links: does a pair have recipes, how many recipes make c with x?"""

import numpy as np

from wordcraft_kg.models.scorers.neighbours.compiled import compiled, in_place


@in_place
def _place(keys, key):  # type: ignore[no-untyped-def]
    """Return the place of a key in an open hash table, or of the empty place where it belongs."""
    # The size is a power of 2, so a mask replaces the slow remainder of a division.
    mask = len(keys) - 1
    # Multiplied by 2^64 over the golden ratio (Knuth 1973): neighbouring keys end far apart.
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    # The high bits of the product are the best mixed ones; the mask takes low bits.
    folded = mixed ^ (mixed >> np.uint64(29))
    place = np.int64(folded & np.uint64(mask))
    # At most a quarter of the places is filled, so the search ends after few steps.
    while keys[place] != -1 and keys[place] != key:
        place = (place + 1) & mask
    return place


@compiled
def pair_table(pairs, size):  # type: ignore[no-untyped-def]
    """Return a hash table of ascending pair keys.

    Args:
        pairs: key of each recipe's pair, ascending, shape (n,).
        size: number of places, a power of 2.

    Returns:
        keys, -1 for empty places; the first recipe, and the number of recipes, of each key: shape
        (size,) each.
    """
    keys = np.full(size, -1, dtype=np.int64)
    starts = np.zeros(size, dtype=np.int32)
    counts = np.zeros(size, dtype=np.int32)
    for row in range(len(pairs)):
        place = _place(keys, pairs[row])
        if keys[place] == -1:
            keys[place] = pairs[row]
            starts[place] = row
        counts[place] += 1
    return keys, starts, counts


@in_place
def signatures(one, other, out):  # type: ignore[no-untyped-def]
    """Set the bit of each pair of ids in the signature of its first id.

    Args:
        one: ids, shape (n,).
        other: ids, shape (n,).
        out: zeros, shape (T, bits / 8), uint8; the number of bits is a power of 2.
    """
    mask = out.shape[1] * 8 - 1
    for row in range(len(one)):
        bit = other[row] & mask
        out[one[row], bit >> 3] |= np.uint8(1 << (bit & 7))


@in_place
def _may_hold(bits, entity, partner):  # type: ignore[no-untyped-def]
    """Return whether a signature has the bit of an id: if not, the pair is certainly unknown.

    Most look-ups are of unknown pairs. A signature is small enough for the fast cache, and saves
    them the way to the hash table.

    Args:
        bits: shape (T, bits / 8), from :func:`signatures`.
        entity: entity id.
        partner: entity id.
    """
    mask = bits.shape[1] * 8 - 1
    bit = partner & mask
    # Eight bits a byte: the byte by the higher digits, the bit in it by the last three.
    byte = bits[entity, bit >> 3]
    return (byte >> (bit & 7)) & 1 != 0


@in_place
def pair_place(pairs, a, b):  # type: ignore[no-untyped-def]
    """Return the place of a pair in the hash table, -1 if no recipe uses it.

    Args:
        pairs: ``lists.pairs``.
        a: entity id.
        b: entity id; the order does not count.
    """
    if not _may_hold(pairs.bits, a, b):
        return np.int64(-1)
    low = min(a, b)
    high = max(a, b)
    size = len(pairs.bits)
    place = _place(pairs.keys, np.int64(low) * size + high)
    return place if pairs.keys[place] != -1 else -1


@in_place
def num_links(result_bits, parts, ingredient, result):  # type: ignore[no-untyped-def]
    """Return the number of recipes that use an ingredient and make a result.

    Args:
        result_bits: ``lists.result_bits``.
        parts: ``lists.parts``.
        ingredient: entity id.
        result: entity id.
    """
    if not _may_hold(result_bits, ingredient, result):
        return np.int32(0)
    low = parts.starts[result]
    end = parts.starts[result + 1]
    place = _first_place(parts.columns, low, end, ingredient)
    is_link = place < end and parts.columns[place] == ingredient
    return parts.values[place] if is_link else np.int32(0)


@in_place
def _first_place(ids, low, high, target):  # type: ignore[no-untyped-def]
    """Return the first place of ascending ids with an id of ``target`` or more: a binary search.

    Args:
        ids: ascending from ``low`` to ``high``.
        low: first place.
        high: end of the places, which is returned if all ids are smaller.
        target: entity id.
    """
    while low < high:
        middle = (low + high) >> 1
        if ids[middle] < target:
            low = middle + 1
        else:
            high = middle
    return low


@in_place
def makes(pairs, place, goal):  # type: ignore[no-untyped-def]
    """Return whether a pair makes the goal, by its results, which are ascending.

    Args:
        pairs: ``lists.pairs``.
        place: place of the pair in the hash table, from :func:`pair_place`, 0 or more.
        goal: entity id.
    """
    low = np.int64(pairs.starts[place])
    end = low + pairs.counts[place]
    first = _first_place(pairs.results, low, end, goal)
    return first < end and pairs.results[first] == goal
