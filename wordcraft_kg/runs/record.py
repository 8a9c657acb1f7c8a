"""Run records: ``run.json`` in a run folder, with command, status, inputs, versions and outputs."""

import os
import platform
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from msgspec.structs import replace

from wordcraft_kg.base.artefacts import dump_json, sha256_of, what_is, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Record, as_values, read_record
from wordcraft_kg.graphs.folder import TrainedOn

RUN_FILE = "run.json"
_SEED = re.compile(r"seed-(\d+)")
_PACKAGES = (
    "torch",
    "pykeen",
    "numpy",
    "pandas",
    "networkx",
    "safetensors",
    "transformers",
    "sentence-transformers",
)
Status = Literal["running", "interrupted", "failed", "done"]


class GitState(Record, frozen=True, kw_only=True):
    """Git state of the package's source: checked-out commit, and whether there were uncommitted changes."""

    commit: str
    dirty: bool


class Resumption(Record, frozen=True, kw_only=True):
    """A resumption of an interrupted run: start time, command line, versions and Git state."""

    started: str
    argv: tuple[str, ...]
    versions: dict[str, str]
    git: GitState | None


class RunRecord(Record, frozen=True, kw_only=True, omit_defaults=True):
    """Run record: the content of ``run.json``; keys with default values are left out.

    Attributes:
        kind: training command, for example ``train-agent``.
        argv: command line, with ``~`` for the home folder.
        started: ISO 8601, UTC.
        ended: ISO 8601, UTC; None while running.
        versions: versions by package.
        git: Git state, if the package runs from a checkout.
        inputs: hashes of ``graph`` and ``split``, and the SHA-256 of files that training never changes.
        outputs: SHA-256 of each file that training wrote.
        kg: training graph of an agent's scorer, if any: partial, full or none.
        cross_fitted: number of cross-fitting folds in an agent's scorer; 0 for in-sample scores on train tasks.
        trackers: names of metric trackers, such as tensorboard.
        missing_words: words in entity labels that have no word vector.
        resumed: all resumptions.
    """

    format: Literal["wordcraft-kg run 1"]
    kind: str
    status: Status
    argv: tuple[str, ...]
    started: str
    ended: str | None
    versions: dict[str, str]
    git: GitState | None
    inputs: dict[str, str]
    seed: int
    device: str
    threads: int
    kg: TrainedOn | None = None
    cross_fitted: int = 0
    trackers: tuple[str, ...] = ()
    missing_words: tuple[str, ...] = ()
    outputs: dict[str, str]
    resumed: tuple[Resumption, ...] = ()


def start_run(
    folder: Path,
    kind: str,
    *,
    seed: int = 0,
    device: str = "cpu",
    threads: int = 1,
    inputs: Mapping[str, str] | None = None,
    **facts: Any,
) -> RunRecord:
    """Write and return a ``running`` record with optional ``facts``, without host, user or environment."""
    run = RunRecord(
        format="wordcraft-kg run 1",
        kind=kind,
        status="running",
        argv=_arguments(),
        started=_now(),
        ended=None,
        versions=_versions(),
        git=_git_state(),
        inputs=dict(inputs or {}),
        seed=seed,
        device=device,
        threads=threads,
        outputs={},
        **facts,
    )
    return _write(folder, run)


def resume_run(folder: Path, run: RunRecord, inputs: Mapping[str, str] | None = None) -> RunRecord:
    """Write and return the record of a resumed run, with time, command and changed input hashes."""
    again = Resumption(started=_now(), argv=_arguments(), versions=_versions(), git=_git_state())
    changes = {"inputs": {**run.inputs, **(inputs or {})}, "resumed": (*run.resumed, again)}
    return _write(folder, replace(run, status="running", ended=None, **changes))


def end_run(folder: Path, run: RunRecord, status: Status, outputs: Sequence[str] = ()) -> RunRecord:
    """Write and return the run record with the final status, the end time and the SHA-256 of each output file."""
    hashes = {name: sha256_of(folder / name) for name in outputs}
    return _write(folder, replace(run, status=status, ended=_now(), outputs=hashes))


def read_run(folder: Path, expected: str = "a run of a training command") -> RunRecord:
    """Read ``run.json``; ArtefactError naming ``expected``, if missing, damaged or of several seeds."""
    if not os.path.lexists(folder / RUN_FILE):
        seeds = sorted(run.parent.name for run in folder.glob(f"seed-*/{RUN_FILE}"))
        if seeds:
            raise ArtefactError(
                f"'{folder}' holds a run for each of {len(seeds)} seeds; give one run, such as {folder / seeds[0]}."
            )
        raise ArtefactError(f"'{folder}' {what_is(folder)}; expected {expected}.")
    return read_record(folder / RUN_FILE, RunRecord)


def read_finished_run(folder: Path, expected: str, result: str) -> RunRecord:
    """Read a finished run's record as :func:`read_run`; ArtefactError if unfinished, or without ``result``."""
    run = read_run(folder, expected)
    if run.status != "done":
        raise ArtefactError(
            f"'{folder}' is {run.status}, not done. Repeat the training command to resume."
        )
    if result not in run.outputs:
        raise ArtefactError(f"'{folder}' {what_is(folder)}; expected {expected}.")
    return run


def run_folders(path: Path) -> list[Path]:
    """Return the run folders ``seed-N`` in a folder with several seeds, by ascending seed; else the path alone."""
    if (path / RUN_FILE).exists() or not path.is_dir():
        return [path]
    seeds = {int(match[1]): run for run in path.iterdir() if (match := _SEED.fullmatch(run.name))}
    return [seeds[seed] for seed in sorted(seeds)] or [path]


def run_name(folder: Path) -> str:
    """Return a display name for a run: the folder name; for a folder ``seed-N``, ``<parent folder>-seed-N``."""
    folder = Path(
        os.path.realpath(folder)
    )  # Path.resolve raises on a loop of links before Python 3.13
    return f"{folder.parent.name}-{folder.name}" if _SEED.fullmatch(folder.name) else folder.name


def _write(folder: Path, run: RunRecord) -> RunRecord:
    write_atomically(folder / RUN_FILE, dump_json(as_values(run)), durable=True)
    return run


def _arguments() -> tuple[str, ...]:
    home = str(Path.home())
    shown = [argument if home == "/" else argument.replace(home, "~") for argument in sys.argv[1:]]
    return (Path(sys.argv[0]).name, *shown)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _versions() -> dict[str, str]:
    versions = {"wordcraft-kg": version("wordcraft-kg"), "python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):  # optional
            versions[package] = version(package)
    return versions


def _git_state() -> GitState | None:
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    try:
        commit, changes = (
            subprocess.run(
                ["git", *arguments],
                cwd=root,
                capture_output=True,
                text=True,
                check=True,
                timeout=10,
            ).stdout
            for arguments in (["rev-parse", "HEAD"], ["status", "--porcelain"])
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return GitState(commit=commit.strip(), dirty=bool(changes.strip()))
