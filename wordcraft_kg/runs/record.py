"""Run records: what was run, on what, with which versions and which results (``run.json`` in every run's folder)."""

import os
import platform
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal, TypedDict, Unpack

from msgspec.structs import replace

from wordcraft_kg.base.artefacts import dump_json, sha256_of, what_is, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Record, as_values, read_record
from wordcraft_kg.graphs.folder import Taught

RUN_FILE = "run.json"
_SEED = re.compile(r"seed-(\d+)")
_PACKAGES = ("torch", "pykeen", "numpy", "pandas", "networkx", "safetensors")
Status = Literal["running", "interrupted", "failed", "done"]


class GitState(Record, frozen=True, kw_only=True):
    """Commit of the checkout that a run was made from, and whether there were uncommitted changes."""

    commit: str
    dirty: bool


class Resumption(Record, frozen=True, kw_only=True):
    """When, how and with which versions a run was resumed."""

    started: str
    argv: tuple[str, ...]
    versions: dict[str, str]
    git: GitState | None


class RunRecord(Record, frozen=True, kw_only=True, omit_defaults=True):
    """The content of ``run.json``; optional keys are left out where they hold the default.

    Attributes:
        kind: the command that trains such a run, for example ``train-agent``.
        argv: command line, with ``~`` for the home folder.
        started: ISO 8601, UTC.
        ended: when the last process ended, None while it runs.
        versions: by package.
        git: None if the package is not run from a checkout.
        inputs: hashes by name: ``graph`` and ``split``, and the SHA-256 of files that training never changes.
        outputs: SHA-256 of the files that training wrote.
        kg: which knowledge graph the scorer of an agent was trained on, if any.
        cross_fitted: number of folds of an agent's scorer, 0 if train tasks were scored by a model that has seen them.
        trackers: names of the trackers to which the figures go too.
        missing_words: words in entity labels for which an agent has no vector.
        resumed: each resumption of the run.
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
    kg: Taught | None = None
    cross_fitted: int = 0
    trackers: tuple[str, ...] = ()
    missing_words: tuple[str, ...] = ()
    outputs: dict[str, str]
    resumed: tuple[Resumption, ...] = ()


class RunFacts(TypedDict, total=False):
    """What a record may say of a run beside its inputs; see :class:`RunRecord`."""

    kg: Taught | None
    cross_fitted: int
    trackers: tuple[str, ...]
    missing_words: tuple[str, ...]


def start_run(
    folder: Path,
    kind: str,
    *,
    seed: int = 0,
    device: str = "cpu",
    threads: int = 1,
    inputs: Mapping[str, str] | None = None,
    **facts: Unpack[RunFacts],
) -> RunRecord:
    """Write ``run.json`` with the status ``running``.

    It holds no host name, user name or environment variables; the home folder in arguments becomes ``~``.
    """
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
    """Set a run back to ``running``, record how it was resumed, and replace hashes of inputs that have changed."""
    again = Resumption(started=_now(), argv=_arguments(), versions=_versions(), git=_git_state())
    changes = {"inputs": {**run.inputs, **(inputs or {})}, "resumed": (*run.resumed, again)}
    return _write(folder, replace(run, status="running", ended=None, **changes))


def end_run(folder: Path, run: RunRecord, status: Status, outputs: Sequence[str] = ()) -> RunRecord:
    """Write the final status (done, interrupted or failed) and the SHA-256 of the output files."""
    hashes = {name: sha256_of(folder / name) for name in outputs}
    return _write(folder, replace(run, status=status, ended=_now(), outputs=hashes))


def read_run(folder: Path, expected: str = "a run of a training command") -> RunRecord:
    """Read ``run.json``.

    Raises:
        ArtefactError: if the folder has none, holds one for each of several seeds, or it is damaged; the message says
            what was ``expected``.
    """
    if not os.path.lexists(folder / RUN_FILE):
        seeds = sorted(run.parent.name for run in folder.glob(f"seed-*/{RUN_FILE}"))
        if seeds:
            raise ArtefactError(
                f"'{folder}' holds a run for each of {len(seeds)} seeds; give one, such as {folder / seeds[0]}."
            )
        raise ArtefactError(f"'{folder}' {what_is(folder)}; expected {expected}.")
    return read_record(folder / RUN_FILE, RunRecord)


def read_finished_run(folder: Path, expected: str, result: str) -> RunRecord:
    """Read the record of a run that is done.

    Args:
        folder: folder of the run.
        expected: what it should be, for the error.
        result: a file that all such runs have when they are done.

    Raises:
        ArtefactError: if there is no such run or it is not done.
    """
    run = read_run(folder, expected)
    if run.status != "done":
        raise ArtefactError(f"'{folder}' is {run.status}, not done. Repeat the command that began it: it goes on.")
    if result not in run.outputs:
        raise ArtefactError(f"'{folder}' {what_is(folder)}; expected {expected}.")
    return run


def run_folders(path: Path) -> list[Path]:
    """Return the runs of a folder of seeds by ascending seed; any other path is returned alone, as a run would be."""
    if (path / RUN_FILE).exists() or not path.is_dir():
        return [path]
    seeds = {int(match[1]): run for run in path.iterdir() if (match := _SEED.fullmatch(run.name))}
    return [seeds[seed] for seed in sorted(seeds)] or [path]


def run_name(folder: Path) -> str:
    """Return what reports call a run: its folder's name, for a seed after the name of the folder of seeds."""
    folder = folder.resolve()
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
    found = {"wordcraft-kg": version("wordcraft-kg"), "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # an optional one
            continue
    return found


def _git_state() -> GitState | None:
    """Return the commit of the checkout that this package runs from, None if it does not run from one."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    try:
        commit, changes = (
            subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=True, timeout=10).stdout
            for arguments in (["rev-parse", "HEAD"], ["status", "--porcelain"])
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return GitState(commit=commit.strip(), dirty=bool(changes.strip()))
