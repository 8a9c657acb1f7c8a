"""Whatever happens to a file of a model or run folder, the commands that read it answer with an error, not a traceback.

Each file is cut, emptied, has a byte flipped, is replaced by a device that never ends, loses each of its keys, and gets
values of other types. Hashes are mended, as somebody who does it on purpose would.
"""

import json
import shutil
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import safetensors.torch
import torch
from fuzz.home import make_home, mended

Run = Callable[..., Any]
SCORE = ("score", "{folder}", "flour", "combinesWith", "water")
COMPARE = ("compare", "{folder}", "{folder}", "--resamples", "2")
REPORT = ("evaluate-links", "{folder}", "--out", "{out}")
LINKS = ("train-complex", "{home}/graph", "--dim", "4", "--epochs", "3", "--checkpoint-every", "1", "--out", "{folder}")
EVERY = ("--log-every", "64", "--eval-every", "160", "--checkpoint-every", "64")
TRAINER = ("--steps", "320", "--batch-size", "16", *EVERY)
AGENT = ("train-agent", "{home}/graph", "--scorer", "{home}/model", *TRAINER, "--out", "{folder}")
EVALUATE = ("evaluate-agent", "{folder}", "--distractor-seeds", "1")
JUDGE = ("compare", "{folder}", "--distractor-seeds", "1", "--distractors", "1", "--episodes", "0", "--out", "{out}")
READERS: dict[tuple[str, str], tuple[tuple[str, ...], ...]] = {
    ("model", "run.json"): (COMPARE, LINKS),
    ("model", "config.toml"): (COMPARE,),
    ("model", "vocabulary.json"): (SCORE,),
    ("model", "metrics.json"): (REPORT,),
    ("model", "trace.jsonl"): (REPORT,),
    ("model", "model.safetensors"): (SCORE,),
    ("model-interrupted", "run.json"): (SCORE, LINKS),
    ("model-interrupted", "config.toml"): (LINKS,),
    ("model-interrupted", "checkpoints/*.json"): (LINKS,),
    ("model-interrupted", "checkpoints/*.safetensors"): (LINKS,),
    ("agent", "run.json"): (EVALUATE, AGENT),
    ("agent", "config.toml"): (EVALUATE,),
    ("agent", "policy.json"): (EVALUATE,),
    ("agent", "metrics.jsonl"): (JUDGE,),
    ("agent", "evaluation.json"): (JUDGE,),
    ("agent", "policy.safetensors"): (EVALUATE,),
    ("agent", "constants.safetensors"): (EVALUATE,),
    ("agent-interrupted", "run.json"): (EVALUATE,),
    ("agent-interrupted", "config.toml"): (EVALUATE,),
    ("agent-interrupted", "policy.json"): (AGENT,),
    ("agent-interrupted", "metrics.jsonl"): (EVALUATE,),
    ("agent-interrupted", "checkpoints/*.json"): (EVALUATE, AGENT),
    ("agent-interrupted", "checkpoints/*.safetensors"): (EVALUATE, AGENT),
}
"""By kind of folder and file: the commands that read it."""
OTHERS = ("text", -1, None, [], {"a": 1}, 1e300, True)
"""Values that a key is given; most are of another type than the key's own."""
TOML_OTHERS = ('"text"', "-1", "nan", "1979-05-27", "[]", "true", "1e300")


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A graph, and on it a model and a guided agent, both finished and both interrupted."""
    return make_home(tmp_path_factory.mktemp("home"))


def of_values(content):
    """The same object without each of its keys, and with other values; in objects within it too."""
    for key, value in content.items():
        yield f"without {key}", {name: other for name, other in content.items() if name != key}
        for other in OTHERS:
            yield f"{key} = {other!r}", {**content, key: other}
        if isinstance(value, dict):
            for what, inner in of_values(value):
                yield f"{key}: {what}", {**content, key: inner}
    yield "unknown key", {**content, "unheard": 1}


def of_bytes(data):
    yield "cut", data[: len(data) // 2]
    yield "empty", b""
    for place in (0, len(data) // 3, len(data) - 2):
        yield f"byte {place} flipped", data[:place] + bytes([data[place] ^ 0x84]) + data[place + 1 :]


def of_tensors(data):
    tensors = safetensors.torch.load(data)
    for name, tensor in tensors.items():
        yield f"without {name}", safetensors.torch.save({key: value for key, value in tensors.items() if key != name})
        for what, other in (("shorter", tensor.flatten()[:-1]), ("bool", torch.ones(2, 2, dtype=torch.bool))):
            yield f"{name} {what}", safetensors.torch.save({**tensors, name: other.clone()})


def mutations(path):
    data = path.read_bytes()
    yield from of_bytes(data)
    if path.suffix == ".safetensors":
        yield from of_tensors(data)
    elif path.suffix == ".toml":
        lines = data.decode().splitlines()
        for i, line in enumerate(lines):
            yield f"without {line}", "\n".join(lines[:i] + lines[i + 1 :]).encode()
            if key := line.partition(" = ")[0].strip() * (" = " in line):
                for other in TOML_OTHERS:
                    yield f"{key} = {other}", "\n".join([*lines[:i], f"{key} = {other}", *lines[i + 1 :]]).encode()
    else:
        first, newline, rest = data.partition(b"\n") if path.suffix == ".jsonl" else (data, b"", b"")
        for what, content in of_values(json.loads(first)):
            yield what, json.dumps(content).encode() + newline + rest
        yield "another kind of JSON", b"[1, 2]" + newline + rest
        yield "a number without end", data.replace(b"1", b"1e999", 1)


def answers(run, folder, readers, what):
    """Run commands on copies of a folder; return the tracebacks."""
    found = []
    for command in readers:
        copy, out = folder.with_name("copy"), folder.with_name("out")
        shutil.rmtree(copy, ignore_errors=True)
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(folder, copy, symlinks=True)
        try:
            outcome = run(
                *(argument.format(home=folder.parent, folder=copy, out=out) for argument in command), "--quiet"
            )
        except Exception:
            found.append(f"{what}: {command[0]}: {traceback.format_exc(limit=-3)}")
        else:
            if outcome.code not in (0, 1) or "Traceback" in outcome.err:
                found.append(f"{what}: {command[0]}: exit code {outcome.code}, {outcome.err}")
    return found


def copied(home, kind):
    folder = home / "spoilt"
    shutil.rmtree(folder, ignore_errors=True)
    return Path(shutil.copytree(home / kind, folder))


CASES = pytest.mark.parametrize(("kind", "name"), READERS, ids=[" ".join(case) for case in READERS])
SOME = [pytest.param(29, id="some"), pytest.param(1, id="all", marks=pytest.mark.slow)]
"""One mutation in so many; 29 and the 8 mutations of a key have no divisor in common."""


@CASES
@pytest.mark.parametrize("every", SOME)
def test_no_damage_to_a_file_is_a_traceback(run, home, kind, name, every):
    found = []
    original = max((home / kind).glob(name))
    for what, data in list(mutations(original))[::every]:
        folder = copied(home, kind)
        path = folder / original.relative_to(home / kind)
        path.write_bytes(data)
        mended(folder, str(path.relative_to(folder)))
        found += answers(run, folder, READERS[kind, name], what)
    assert found == []


@CASES
def test_a_device_in_the_place_of_a_file_is_not_read(run, home, kind, name):
    folder = copied(home, kind)
    for path in folder.glob(name):
        path.unlink()
        path.symlink_to("/dev/zero")
    assert answers(run, folder, READERS[kind, name], "/dev/zero") == []
