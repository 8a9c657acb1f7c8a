"""What to know about a graph and its split before trusting a number: ambiguity, reachability, coverage, leakage."""

from typing import Any

import numpy as np

from wordcraft_kg.graphs.planner import layers, rounds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.triples import RELATIONS, is_in

SHOWN = 20
"""How many entities or pairs a list names; counts are always complete."""


def audit(graph: RecipeGraph, split: Split) -> dict[str, Any]:
    """Return the audit of a graph and its split as plain values, ready for JSON.

    Every list of names is cut at :data:`SHOWN`; the counts beside it are complete.
    """
    layer = layers(graph)
    return {
        "entities": graph.num_entities,
        "recipes": graph.num_recipes,
        "pairs": graph.num_pairs,
        "base": list(graph.base),
        "hash": graph.hash,
        "triples": triple_counts(graph),
        "ambiguity": _ambiguity(graph),
        "reachability": _reachability(graph, layer),
        "degrees": _degrees(graph),
        "labels": _labels(graph),
        "split": split_summary(split),
        "leakage": leakage(split),
    }


def triple_counts(graph: RecipeGraph) -> dict[str, int]:
    """Return the number of triples of each relation, and their total."""
    counts = np.bincount(graph.triples[:, 1], minlength=len(RELATIONS)).tolist()
    return {**dict(zip(RELATIONS, counts, strict=True)), "total": len(graph.triples)}


def split_summary(split: Split) -> dict[str, Any]:
    """Return settings and sizes of a split; ``leaked_triples`` counts test triples that train gives too."""
    counts = np.bincount(split.parts, minlength=3).tolist()
    evaluated = split.held_out("test")
    return {
        "kind": split.config.kind,
        "seed": split.config.seed,
        "train_ratio": split.config.train_ratio,
        "valid_ratio": split.config.valid_ratio,
        "hash": split.hash,
        "train_recipes": counts[0],
        "valid_recipes": counts[1],
        "test_recipes": counts[2],
        "partial_triples": len(split.partial),
        "unseen_triples": len(split.unseen),
        "evaluated_triples": len(evaluated),
        "leaked_triples": len(split.triples_of("test")) - len(evaluated),
        "covered": not len(split.uncovered),
        "uncovered": len(split.uncovered),
        "uncovered_entities": list(split.graph.labels(split.uncovered[:SHOWN])),
        "moved_for_coverage": split.moved_for_coverage,
        "pairs_on_both_sides": split.pairs_on_both_sides,
    }


def leakage(split: Split) -> dict[str, dict[str, int]]:
    """Return, per relation, how the test triples relate to the training triples.

    Keys of each relation: ``train`` triples, triples ``from_test_recipes``, of which ``already_in_train`` (or in the
    validation part) and left out, the ``evaluated`` rest, and how many of those have their mirror (tail, relation,
    head) in train: for combinesWith it must be 0, else the answer is given away.
    """
    evaluated = split.held_out("test")
    mirrored = is_in(evaluated[:, [2, 1, 0]], split.partial, split.graph.num_entities)
    tables = {}
    for relation, name in enumerate(RELATIONS):
        from_test = int(np.sum(split.triples_of("test")[:, 1] == relation))
        of_relation = evaluated[:, 1] == relation
        tables[name] = {
            "train": int(np.sum(split.partial[:, 1] == relation)),
            "from_test_recipes": from_test,
            "already_in_train": from_test - int(np.sum(of_relation)),
            "evaluated": int(np.sum(of_relation)),
            "mirror_in_train": int(np.sum(mirrored[of_relation])),
        }
    return tables


def _ambiguity(graph: RecipeGraph) -> dict[str, Any]:
    sizes = np.diff(graph.pair_starts)
    order = np.argsort(-sizes, kind="stable")[:SHOWN]
    examples = []
    for pair in order[sizes[order] > 1].tolist():
        start, stop = graph.pair_starts[pair : pair + 2]
        a, b = graph.labels(graph.recipes[start, :2])
        examples.append({"pair": [a, b], "results": list(graph.labels(graph.recipes[start:stop, 2]))})
    return {
        "pairs_by_number_of_results": {str(n): int(c) for n, c in enumerate(np.bincount(sizes)) if c},
        "pairs_with_several_results": int(np.sum(sizes > 1)),
        "examples": examples,
    }


def _reachability(graph: RecipeGraph, layer: np.ndarray) -> dict[str, Any]:
    unreachable = np.flatnonzero(layer < 0)
    known = rounds(layer)
    return {
        "reachable": int(np.sum(layer >= 0)),
        "rounds": max(len(known) - 1, 0),
        "known_after_round": known,
        "unreachable": len(unreachable),
        "unreachable_entities": list(graph.labels(unreachable[:SHOWN])),
    }


def _degrees(graph: RecipeGraph) -> dict[str, Any]:
    uses, recipes = graph.use_counts, graph.recipe_counts
    craftable = recipes[recipes > 0]
    firsts = graph.recipes[graph.pair_starts[:-1]]

    def top(counts: np.ndarray) -> list[list[Any]]:
        return [[graph.entities[i], int(counts[i])] for i in np.argsort(-counts, kind="stable")[:10].tolist()]

    return {
        "craftable": len(craftable),
        "recipes_per_craftable": {
            "mean": round(float(craftable.mean()), 3) if len(craftable) else 0.0,
            "median": float(np.median(craftable)) if len(craftable) else 0.0,
            "max": int(craftable.max(initial=0)),
        },
        "terminal": int(np.sum((uses == 0) & (recipes > 0))),
        "idle": int(np.sum((uses == 0) & (recipes == 0))),
        "self_pairs": int(np.sum(firsts[:, 0] == firsts[:, 1])),
        "most_used": top(uses),
        "most_recipes": top(recipes),
    }


def _labels(graph: RecipeGraph) -> dict[str, Any]:
    """Labels that differ only in case or outer and repeated blanks: most often a slip, never merged by us."""
    groups: dict[str, list[str]] = {}
    for label in graph.entities:
        groups.setdefault(" ".join(label.casefold().split()), []).append(label)
    alike = [labels for labels in groups.values() if len(labels) > 1]
    return {"alike": len(alike), "alike_labels": alike[:SHOWN]}
