"""The loop that follows known links from one entity to all others."""

from wordcraft_kg.models.scorers.neighbours.compiled import in_place


@in_place
def follow(entities, near, links, back, least, sums, sums_by_words):  # type: ignore[no-untyped-def]
    """Add up known links between the neighbours of an entity and the neighbours of each other one.

    ``sums[row, y] = Σ k²(x, x') n(x', y') k²(y', y)`` for x = ``entities[row]``, over x' near x, y'
    linked with x', and y to which y' is near; likewise by words.

    Args:
        entities: ids, shape (B,).
        near: neighbours x' of each x, the arrays of a ``link_rows.Near``.
        links: entities y' linked with each x', the arrays of a ``link_rows.Linked``.
        back: for each y', the entities y that list it as a neighbour, the most similar first.
        least: products of two similarities below this number are skipped.
        sums: zeros, shape (B, T).
        sums_by_words: zeros, shape (B, T), or (B, 0) if they are not wanted.
    """
    near_starts, near_ids, near_alike, near_words = near
    link_starts, link_ids, link_counts = links
    back_starts, back_ids, back_alike, back_words = back
    has_words = sums_by_words.shape[1] > 0
    for row in range(len(entities)):
        entity = entities[row]
        for place in range(near_starts[entity], near_starts[entity + 1]):
            other = near_ids[place]
            of_near = near_alike[place]
            for link in range(link_starts[other], link_starts[other + 1]):
                linked = link_ids[link]
                number = link_counts[link]
                for end in range(back_starts[linked], back_starts[linked + 1]):
                    weight = of_near * back_alike[end]
                    # The most similar come first, so all that follow are below, too.
                    if weight < least:
                        break
                    reached = back_ids[end]
                    sums[row, reached] += number * weight
                    if has_words:
                        by_words = near_words[place] * back_words[end]
                        sums_by_words[row, reached] += number * by_words
