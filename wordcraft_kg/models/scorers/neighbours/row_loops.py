"""The loop that follows known links from one entity to all others."""

from wordcraft_kg.models.scorers.neighbours.compiled import compiled


@compiled
def follow(entities, near, links, back, least, sums, sums_by_words):  # type: ignore[no-untyped-def]
    """Add up known links between the neighbours of an entity and the neighbours of each other one.

    ``sums[row, y] = Σ k²(x, x') n(x', y') k²(y', y)`` for x = ``entities[row]``, over x' near x, y'
    linked with x', and y to which y' is near; likewise by words.

    Args:
        entities: ids, shape (B,).
        near: neighbours x' of each x, as in ``link_rows.Near``.
        links: entities y' linked with each x', as in ``link_rows.Linked``.
        back: for each y', the entities y that list it as a neighbour, the most similar first.
        least: products of two similarities below this number are skipped.
        sums: zeros, shape (B, T).
        sums_by_words: zeros, shape (B, T).
    """
    for row in range(len(entities)):
        entity = entities[row]
        for place in range(near.starts[entity], near.starts[entity + 1]):
            other = near.ids[place]
            for link in range(links.starts[other], links.starts[other + 1]):
                linked = links.ids[link]
                number = links.counts[link]
                for end in range(back.starts[linked], back.starts[linked + 1]):
                    weight = near.alike[place] * back.alike[end]
                    if weight < least:
                        break
                    sums[row, back.ids[end]] += number * weight
                    by_words = near.words[place] * back.words[end]
                    sums_by_words[row, back.ids[end]] += number * by_words
