"""Small graphs and small mishaps for the tests of link prediction."""

import hashlib
import json
import random
import shutil
import signal

import numpy as np
import safetensors.torch
import torch

from wordcraft_kg import LinksConfig, RecipeGraph
from wordcraft_kg.base.artefacts import sha256_of


def train(opened, settings, out, **options):
    """Train a link predictor on a graph that was opened from somewhere."""
    from wordcraft_kg.models.links.training import train_links

    return train_links(LinksConfig(opened.source, settings), out, **options)


def random_graph(seed=0, num_entities=10, num_recipes=25):
    """A graph of random recipes, with self pairs, ambiguous pairs and self results as they come."""
    rows = np.random.default_rng(seed).integers(num_entities, size=(num_recipes, 3))
    return RecipeGraph.from_recipes(
        [tuple(f"e{i}" for i in row) for row in rows], name=f"random-{seed}"
    )


def interrupt_after(*epochs, times=1):
    """A progress callback that presses Ctrl-C when an epoch is reported."""

    def progress(done, total, figures):
        if done in epochs:
            for _ in range(times):
                signal.raise_signal(signal.SIGINT)

    return progress


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
