"""Folders that the package wrote itself, spoilt by accident or, with the hashes
mended, on purpose."""

import json
import os
import random
import shutil
from itertools import pairwise

from .harness import CONTINUED, IN, Trial
from .home import copied, linked, mended, records_of
from .spoiling import ODD_VALUES, as_json, spoilt_bytes, spoilt_lines, spoilt_value, toml_of

GRAPH = (
    ("describe", "{}"),
    ("describe", "{}", "--entity", "flour", "--json"),
    ("export", "{}", "--format", "graphml", "--out", "out"),
    ("export", "{}", "--format", "json", "--out", "out"),
    ("check-book", "{}"),
    ("build-graph", "{}", "--out", "out"),
    ("describe", "{}", "--tasks", "--limit", "2", "--json"),
    ("evaluate-agent", "{}", "--distractor-seeds", "1", "--distractors", "1"),
    ("discover", "{}", "--runs", "1", "--attempts", "3"),
    ("evaluate-agent", "in/agent", "--graph", "{}", "--distractor-seeds", "1"),
    ("evaluate-links", "in/model", "--graph", "{}", "--out", "out"),
)
LINKS = (
    "train-complex",
    "in/graph",
    "--dim",
    "4",
    "--epochs",
    "3",
    "--config",
    "in/often.toml",
    "--out",
    "{}",
)
OFTEN = """[train-complex]
checkpoint_every = 1
[train-agent]
batch_size = 16
checkpoint_every = 64
log_every = 64
"""
"""Settings that only a file takes: steps and checkpoints that are small enough for these tests."""
EVERY = ("--eval-every", "160", "--config", "in/often.toml")
TRAINED = (
    *(
        "train-agent",
        "in/graph",
        "--scorer",
        "in/model",
        "--distractors",
        "1",
        "--steps",
        "320",
    ),
    *(*EVERY, "--out", "{}"),
)
MODEL = (
    ("score", "{}", "flour", "combinesWith", "water"),
    ("score", "{}", "?", "componentOf", "bread", "--json"),
    ("evaluate-links", "{}", "--out", "out"),
    ("compare", "{}", "in/model"),
    LINKS,
    (
        "evaluate-agent",
        "in/graph",
        "--distractor-seeds",
        "1",
        "--distractors",
        "1",
        "--scorer",
        "{}",
    ),
    (
        "discover",
        "in/graph",
        "--runs",
        "1",
        "--attempts",
        "3",
        "--scorer",
        "{}",
    ),
    (
        "train-agent",
        "in/graph",
        "--scorer",
        "{}",
        "--steps",
        "64",
        "--out",
        "out",
    ),
    (
        "train-complex",
        "in/graph",
        "--config",
        "{}/config.toml",
        "--epochs",
        "1",
        "--dim",
        "4",
        "--out",
        "out",
    ),
)
AGENT = (
    ("evaluate-agent", "{}", "--distractor-seeds", "1", "--json"),
    ("explain", "{}", "--episodes", "1"),
    (
        "compare",
        "{}",
        "--distractor-seeds",
        "1",
        "--distractors",
        "1",
        "--episodes",
        "1",
        "--out",
        "out",
    ),
    (
        "compare",
        "{}",
        "in/agent",
        "--distractor-seeds",
        "1",
        "--distractors",
        "1",
        "--episodes",
        "0",
        "--out",
        "out",
    ),
    TRAINED,
)
SERVED = ("--port", "0", "--no-browser")
STUDY = (
    ("people", "summary", "{}"),
    ("people", "summary", "{}", "--run", "in/agent"),
    ("people", "summary", "{}", "--export", "out"),
    (
        *(
            "people",
            "serve",
            "in/graph",
            "--tasks",
            "3",
            "--forms",
            "2",
            "--distractors",
            "1,2",
            "--out",
            "{}",
        ),
        *SERVED,
    ),
)
PLAYED = ("evaluate-agent", "in/graph", "--player", "program:cat")
PLAYED = (*PLAYED, "--distractors", "2", "--limit", "4")
TEXT = ((*PLAYED, "--out", "{}"),)
READERS = {
    "graph": GRAPH,
    **dict.fromkeys(("model", "model-table", "model-interrupted"), MODEL),
    **dict.fromkeys(("agent", "agent-interrupted"), AGENT),
    **{"study": STUDY, "text": TEXT},
}
"""By kind of folder: the commands that read it; ``{}`` is the spoilt one."""


def trial(number, home, sandbox):
    """Spoil a copy of an artefact and choose two commands that read it; kinds and their files take
    turns."""
    rng = random.Random(f"artefacts {number}")
    (sandbox / IN).mkdir()
    (sandbox / IN / "often.toml").write_text(OFTEN)
    for kind in ("graph", "model", "agent"):
        linked(home, kind, sandbox / IN / kind)
    turn, which = divmod(number, len(READERS))
    kind = list(READERS)[which]
    chosen = rng.sample(READERS[kind], 2)
    goes_on = any(
        one == "--out" and "{}" in other for command in chosen for one, other in pairwise(command)
    )
    place = CONTINUED if goes_on else f"{IN}/spoilt"
    folder = copied(home, kind, sandbox / place)
    is_mended = rng.random() < 0.67
    done = [kind, "mended" if is_mended else "not mended"]
    for more in range(rng.choice((1, 1, 1, 2))):
        # What is a device, a pipe or a hole by now is left as it is.
        files = sorted(
            path for path in folder.rglob("*") if path.is_file() and 0 < path.stat().st_size < 2**30
        )
        if not files:  # the only one is gone
            break
        path = rng.choice(files) if more else files[turn % len(files)]
        name = str(path.relative_to(folder))
        done.append(f"{name}: {_spoil(path, home, rng)}")
        if is_mended:
            _mend(folder, name)
    commands = tuple(
        tuple(
            f"{part}{number}" if part == "out" else part.replace("{}", place)
            for part in (*command, "--quiet")
        )
        for number, command in enumerate(chosen)
    )
    return Trial(
        "; ".join(done),
        commands,
        may_be_interrupted=goes_on or any("--config" in one for one in chosen),
    )


def _spoil(path, home, rng):
    if rng.random() < 0.2:
        return _replace(path, home, rng)
    data = path.read_bytes()
    by_kind = {
        **{
            ".json": _of_json,
            ".jsonl": _of_json_lines,
            ".toml": _of_toml,
            ".safetensors": _of_tensors,
        },
        **dict.fromkeys((".tsv", ".csv"), _of_text),
    }
    spoil = by_kind.get(path.suffix, spoilt_bytes) if rng.random() < 0.75 else spoilt_bytes
    try:
        what, new = spoil(data, rng)
    except ValueError:  # spoilt already, so that it cannot be read
        what, new = spoilt_bytes(data, rng)
    path.write_bytes(new)
    return what


def _replace(path, home, rng):
    """Put something else in the place of a file."""
    others = sorted(other for other in home.rglob("*") if other.is_file())
    other = rng.choice(
        [one for one in others if one.suffix == path.suffix] if rng.random() < 0.6 else others
    )
    ways = {
        "/dev/zero": lambda: path.symlink_to("/dev/zero"),
        "/dev/null": lambda: path.symlink_to("/dev/null"),
        "a pipe": lambda: os.mkfifo(path),
        "a loop": lambda: path.symlink_to(path.name),
        "nothing": lambda: None,
        "a dangling link": lambda: path.symlink_to("nowhere"),
        "a folder": lambda: path.mkdir(),
        f"{other.relative_to(home)}": lambda: shutil.copyfile(other, path),
        f"a link to {other.relative_to(home)}": lambda: path.symlink_to(other),
        "a hole of 1 TB": lambda: os.truncate(os.open(path, os.O_CREAT | os.O_RDWR), 2**40),
    }
    ways["another file"] = ways["yet another"] = ways[f"{other.relative_to(home)}"]
    way = rng.choice(list(ways))
    path.unlink()
    ways[way]()
    return f"{way} in its place"


def _of_json(data, rng):
    what, value = spoilt_value(json.loads(data), rng)
    return what, as_json(value)


def _of_text(data, rng):
    what, text = spoilt_lines(data.decode(), rng)
    return what, text.encode("utf-8", "replace")


def _of_json_lines(data, rng):
    lines = data.split(b"\n")
    at = rng.randrange(len(lines))
    what, value = spoilt_value(json.loads(lines[at] or b"0"), rng)
    return f"line {at + 1}: {what}", b"\n".join([*lines[:at], as_json(value), *lines[at + 1 :]])


def _of_toml(data, rng):
    lines = data.decode().split("\n")
    at = rng.randrange(len(lines))
    key, equals, _ = lines[at].partition(" = ")
    odd = toml_of(rng.choice(ODD_VALUES))[:200]
    new = rng.choice(
        (
            [f"{key} = {odd}"],
            [f"{key} = {odd}"],
            [],
            [lines[at], lines[at]],
            [f"unheard = {odd}", lines[at]],
        )
    )
    if not equals:
        new = rng.choice(([f"[{odd}]"], [], ["[tasks]"], [lines[at], "x = 1"]))
    return f"{lines[at]} -> {new}"[:200], "\n".join([*lines[:at], *new, *lines[at + 1 :]]).encode(
        "utf-8", "replace"
    )


def _of_tensors(data, rng):
    import safetensors.torch
    import torch

    try:
        tensors = safetensors.torch.load(data)
    except Exception as error:
        raise ValueError from error
    name = rng.choice(list(tensors))
    tensor = tensors[name]
    flat = tensor.flatten().clone()
    if flat.is_floating_point() and len(flat):
        flat[rng.randrange(len(flat))] = rng.choice(
            (float("nan"), float("inf"), -float("inf"), 3e38)
        )
    ways = {
        "gone": lambda: {key: value for key, value in tensors.items() if key != name},
        "not finite": lambda: {**tensors, name: flat.reshape(tensor.shape)},
        "all not finite": lambda: {
            **tensors,
            name: torch.full_like(tensor, 1, dtype=torch.float32) / 0,
        },
        "shorter": lambda: {**tensors, name: flat[:-1].clone()},
        "transposed": lambda: {
            **tensors,
            name: tensor.permute(tuple(range(tensor.ndim))[::-1]).contiguous(),
        },
        "flat": lambda: {**tensors, name: flat},
        "whole numbers": lambda: {**tensors, name: torch.ones(tensor.shape, dtype=torch.int64)},
        "halves": lambda: {**tensors, name: tensor.to(torch.float16)},
        "doubles": lambda: {**tensors, name: tensor.to(torch.float64)},
        "complex": lambda: {**tensors, name: tensor.to(torch.complex64)},
        "empty": lambda: {**tensors, name: torch.zeros(0)},
        "more": lambda: {**tensors, "unheard": torch.zeros(2)},
        "renamed": lambda: {
            f"{key}x" if key == name else key: value for key, value in tensors.items()
        },
        "a number": lambda: {**tensors, name: torch.tensor(1.0)},
    }
    way = rng.choice(list(ways))
    return f"{name} {way}", safetensors.torch.save(ways[way]())


def _mend(folder, name):
    """Make the records agree with a file as far as they can still be read."""
    try:
        if name == "graph.json":
            _mend_graph(folder)
        elif all(
            path.is_file() and path.stat().st_size < 2**30 for path in records_of(folder, name)
        ):
            mended(folder, name)
    except Exception:
        return


def _mend_graph(folder):
    from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split
    from wordcraft_kg.graphs.book_files import read_book

    graph = RecipeGraph.from_book(read_book(folder, keep_self_results=True))
    content = {**json.loads((folder / "graph.json").read_text()), "hash": graph.hash}
    (folder / "graph.json").write_text(json.dumps(content))
    split = make_split(graph, SplitConfig(train_ratio=0.6, valid_ratio=0.1))
    (folder / "split.json").write_text("".join(split.to_json()))
