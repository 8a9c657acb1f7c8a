"""What the graph code must compute, written as loops over labels that are too plain to be wrong."""

import math
from itertools import permutations

from wordcraft_kg.graphs import RELATIONS


def results(rows, *ingredients):
    return sorted({made for *parts, made in rows if sorted(parts) == sorted(ingredients)})


def triples(rows):
    made = {(one, "componentOf", result) for *parts, result in rows for one in parts}
    pairs = [pair for *parts, _ in rows for pair in permutations(parts, 2)]
    return made | {(one, "combinesWith", other) for one, other in pairs}


def labelled(graph, triples):
    return [
        (graph.entities[head], RELATIONS[relation], graph.entities[tail])
        for head, relation, tail in triples.tolist()
    ]


def known_after_rounds(rows, start):
    """Return what is known after 0, 1, 2, ... rounds, up to the round that adds nothing."""
    known = [set(start)]
    while True:
        made = {result for *parts, result in rows if known[-1].issuperset(parts)}
        if made <= known[-1]:
            return known
        known.append(known[-1] | made)


def layer(rows, entity, start):
    for round_, known in enumerate(known_after_rounds(rows, start)):
        if entity in known:
            return round_
    return -1


def costs(rows, entities, start):
    """Lower the costs until no recipe lowers one any more."""
    start = set(start)
    cost = {entity: 0 if entity in start else math.inf for entity in entities}
    lowered = True
    while lowered:
        lowered = False
        for *parts, result in rows:
            lower = 1 + sum(map(cost.__getitem__, parts))
            if lower < cost[result]:
                cost[result] = lower
                lowered = True
    return cost
