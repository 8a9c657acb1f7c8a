"""Small graphs, small mishaps and slow formulas for the tests of link prediction."""

import hashlib
import json
import math
import random
import shutil
import signal
from itertools import product

import numpy as np
import pytest
import safetensors.torch
import torch

from wordcraft_kg import LinksConfig, RecipeGraph
from wordcraft_kg.base.artefacts import sha256_of
from wordcraft_kg.runs.record import read_run


def train(opened, settings, out, **options):
    """Train a link predictor on a graph that was opened from somewhere."""
    from wordcraft_kg.models.links.link_training import train_links

    return train_links(LinksConfig(opened.source, settings), out, **options)


def random_graph(seed=0, num_entities=10, num_recipes=25):
    """A graph of random recipes, with self pairs, ambiguous pairs and self results as they come."""
    rows = np.random.default_rng(seed).integers(num_entities, size=(num_recipes, 3))
    return RecipeGraph.from_recipes(
        [tuple(f"e{i}" for i in row) for row in rows], name=f"random-{seed}"
    )


def write_random_book(path, seed, more=()):
    """Write the book of a random graph of 12 entities, and further rows; return its path."""
    graph = random_graph(seed, 12, 60)
    rows = [",".join(graph.entities[entity] for entity in row) for row in graph.recipes.tolist()]
    path.write_text("\n".join(["ingredient_a,ingredient_b,result", *rows, *more]))
    return path


def interrupt_after(*epochs, times=1):
    """A progress callback that presses Ctrl-C when an epoch is reported."""

    def progress(done, total, figures):
        if done in epochs:
            for _ in range(times):
                signal.raise_signal(signal.SIGINT)

    return progress


def interrupted(opened, settings, out, epoch):
    """The folder of a training that Ctrl-C has stopped after an epoch was reported."""
    with pytest.raises(KeyboardInterrupt):
        train(opened, settings, out, progress=interrupt_after(epoch))
    assert read_run(out).status == "interrupted"
    return out


def contents(folder):
    """SHA-256 of every file below a folder."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def same_files(one, other, *more):
    names = ["model.safetensors", "folds.safetensors", "folds.json", *more]
    return [contents(one)[name] for name in names] == [contents(other)[name] for name in names]


def rewritten(folder, out, tensors=None, record=None, inputs=None, weights=None, calibration=None):
    """Copy a cross-fitted model with its folds' tensors or records changed, as if it had been
    written that way."""
    shutil.copytree(folder, out)
    run = json.loads((out / "run.json").read_text())
    for change, name in ((tensors, "folds.safetensors"), (weights, "model.safetensors")):
        if change:
            changed = safetensors.torch.load_file(out / name)
            change(changed)
            safetensors.torch.save_file(changed, out / name)
    for change, name in ((record, "folds.json"), (calibration, "calibration.json")):
        if change:
            changed = json.loads((out / name).read_text())
            change(changed)
            (out / name).write_text(json.dumps(changed))
    names = ("folds.safetensors", "folds.json", "calibration.json", "model.safetensors")
    run["outputs"] |= {name: sha256_of(out / name) for name in names}
    run["inputs"] |= inputs or {}
    (out / "run.json").write_text(json.dumps(run))
    return out


def flip_bit(path, position, bit=0):
    data = bytearray(path.read_bytes())
    data[position] ^= 1 << bit
    path.write_bytes(data)


def global_states():
    """Everything global that PyKEEN's seeding, or a training of ours, could leave changed."""
    legacy = np.random.get_state()  # noqa: NPY002
    return {
        "python": random.getstate(),
        "numpy": (legacy[1].tobytes(), *legacy[2:]),
        "torch": torch.get_rng_state().numpy().tobytes(),
        "threads": torch.get_num_threads(),
        "sigint": signal.getsignal(signal.SIGINT),
    }


def equation_1(subject, predicate, obj):
    """``phi(s, p, o) = Re<e_s, e_p, conj(e_o)>``."""
    total = 0.0
    for s, p, o in zip(subject, predicate, obj, strict=True):
        total += (complex(s) * complex(p) * complex(o).conjugate()).real
    return total


def equation_2(entity, relation, triples, candidates=None):
    """Mean over triples of ``log sum_o exp phi(s, p, o) + log sum_s exp phi(s, p, o) - 2 phi(s, p,
    o)``.

    The sums are over all entities, or over the vectors of some ``candidates``.
    """
    total, candidates = 0.0, entity if candidates is None else candidates
    for s, p, o in triples:
        over_objects = sum(
            math.exp(equation_1(entity[s], relation[p], other)) for other in candidates
        )
        over_subjects = sum(
            math.exp(equation_1(other, relation[p], entity[o])) for other in candidates
        )
        total += math.log(over_objects) + math.log(over_subjects)
        total -= 2 * equation_1(entity[s], relation[p], entity[o])
    return total / len(triples)


def n3(entity, relation, triples):
    """Mean over triples of the cubed moduli of subject, predicate and object, summed over
    dimensions."""
    total = 0.0
    for s, p, o in triples:
        for vector in (entity[s], relation[p], entity[o]):
            total += sum(abs(complex(x)) ** 3 for x in vector)
    return total / len(triples)


def slow_ranks(table, triples, known):
    """Rank each triple's tail, then each triple's head, among all entities but the other known
    answers."""
    facts = {tuple(int(i) for i in triple) for triple in known}
    rows = []
    for side, (head, relation, tail) in product(
        ("tail", "head"), [tuple(int(i) for i in t) for t in triples]
    ):
        true = tail if side == "tail" else head

        def with_entity(entity, h=head, r=relation, t=tail, side=side):
            return (h, r, entity) if side == "tail" else (entity, r, t)

        def score(entity, with_entity=with_entity):
            h, r, t = with_entity(entity)
            return float(table[r, h, t])

        others = [e for e in range(table.shape[1]) if e != true and with_entity(e) not in facts]
        better = sum(score(e) > score(true) for e in others)
        equal = sum(score(e) == score(true) for e in others)
        everyone = [e for e in range(table.shape[1]) if e != true]
        raw_better = sum(score(e) > score(true) for e in everyone)
        raw_equal = sum(score(e) == score(true) for e in everyone)
        field = [true, *others]
        best = max(score(e) for e in field)
        rows.append(
            {
                "head": head,
                "relation": relation,
                "tail": tail,
                "side": side,
                "rank": ((better + 1) + (better + equal + 1)) / 2,
                "optimistic": better + 1,
                "pessimistic": better + equal + 1,
                "raw_rank": ((raw_better + 1) + (raw_better + raw_equal + 1)) / 2,
                "candidates": len(field),
                "score": score(true),
                "tops": {e for e in field if score(e) == best},
            }
        )
    return rows


def slow_clusters(graph, chosen, triples):
    """For each triple, the number of the first pair of a chosen recipe that gives it."""
    pairs = sorted({(a, b) for a, b, _ in graph.recipes.tolist()})
    found = []
    for head, relation, tail in triples:
        givers = []
        for is_chosen, (a, b, result) in zip(chosen, graph.recipes.tolist(), strict=True):
            given = {(a, 0, b), (b, 0, a), (a, 1, result), (b, 1, result)}
            if is_chosen and (int(head), int(relation), int(tail)) in given:
                givers.append(pairs.index((a, b)))
        found.append(min(givers))
    return found
