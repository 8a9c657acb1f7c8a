"""Run records: ``run.json`` in a run folder, with command, status, inputs, versions and outputs.

A record may be published, so it holds no host name, user name or environment variables, and the
home folder in arguments becomes ``~``.
"""

import os
import platform
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from msgspec.structs import replace

from wordcraft_kg.base.artefacts import dump_json, sha256_of, what_is, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.locks import is_locked
from wordcraft_kg.base.records import Record, as_values, read_record
from wordcraft_kg.graphs.folder import TrainedOn

RUN_FILE = "run.json"
_SEED = re.compile(r"seed-(\d+)")
# Packages whose versions may change results.
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
    """Git state of the package's source.

    Attributes:
        commit: hash of the checked-out commit.
        dirty: whether there were uncommitted changes.
    """

    commit: str
    dirty: bool


class Resumption(Record, frozen=True, kw_only=True):
    """A resumption of an interrupted run.

    Attributes:
        started: ISO 8601, UTC.
        argv: command line, with ``~`` for the home folder.
        versions: versions by package.
        git: Git state; None if the package does not run from a checkout.
    """

    started: str
    argv: tuple[str, ...]
    versions: dict[str, str]
    git: GitState | None


class RunRecord(Record, frozen=True, kw_only=True, omit_defaults=True):
    """Run record: the content of ``run.json``; keys with default values are left out.

    Attributes:
        format: name and version of this format.
        kind: training command, for example ``train-agent``.
        status: running, interrupted, failed or done.
        argv: command line, with ``~`` for the home folder.
        started: start of the run, ISO 8601, UTC.
        ended: end of the last process, ISO 8601, UTC; None while running.
        versions: versions by package.
        git: Git state; None if the package does not run from a checkout.
        inputs: hashes of ``graph`` and ``split``, and the SHA-256 of files that training never
            changes.
        seed: random seed.
        device: torch device.
        threads: number of CPU threads.
        kg: training graph of an agent's scorer: partial, full or none; None without a scorer.
        cross_fitted: number of cross-fitting folds in an agent's scorer; 0 if train tasks were
            scored by a model that has seen them.
        trackers: names of metric trackers, such as tensorboard.
        missing_words: words in entity labels that have no word vector.
        outputs: SHA-256 of each file that training wrote, by name; empty until the run is done.
        resumed: all resumptions, in order.
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
    """Write and return the record of a new run, with the status ``running``.

    Args:
        folder: the run folder.
        kind: training command.
        seed: random seed.
        device: torch device.
        threads: number of CPU threads.
        inputs: hashes of the training data, by name.
        facts: optional fields of :class:`RunRecord`.

    Returns:
        the record as it lies in ``run.json``.
    """
    run = RunRecord(
        format="wordcraft-kg run 1",
        kind=kind,
        status="running",
        argv=_arguments(),
        started=_now(),
        ended=None,
        versions=dict(_versions()),
        git=_git_state(),
        inputs=dict(inputs or {}),
        seed=seed,
        device=device,
        threads=threads,
        outputs={},
        **facts,
    )
    return _write(folder, run)


def resume_run(
    folder: Path,
    run: RunRecord,
    inputs: Mapping[str, str] | None = None,
) -> RunRecord:
    """Write and return the record of a resumed run.

    Args:
        folder: the run folder.
        run: the record until now.
        inputs: hashes that have changed, such as of ``config.toml`` with other paths.

    Returns:
        the record with the status ``running`` and this resumption.
    """
    again = Resumption(
        started=_now(),
        argv=_arguments(),
        versions=dict(_versions()),
        git=_git_state(),
    )
    resumed = replace(
        run,
        status="running",
        ended=None,
        inputs={**run.inputs, **(inputs or {})},
        resumed=(*run.resumed, again),
    )
    return _write(folder, resumed)


def end_run(
    folder: Path,
    run: RunRecord,
    status: Status,
    outputs: Sequence[str] = (),
) -> RunRecord:
    """Write and return the record of a run that has ended.

    Args:
        folder: the run folder.
        run: the record until now.
        status: how the run has ended.
        outputs: names of the files that training wrote; their SHA-256 are recorded.

    Returns:
        the record as it lies in ``run.json``.
    """
    hashes = {name: sha256_of(folder / name) for name in outputs}
    return _write(folder, replace(run, status=status, ended=_now(), outputs=hashes))


def read_run(folder: Path, expected: str = "a run of a training command") -> RunRecord:
    """Read ``run.json``.

    Args:
        folder: the run folder.
        expected: description of the folder that was expected, for the error.

    Raises:
        ArtefactError: if there is no such file or it is damaged, or the folder holds a run for each
            of several seeds.
    """
    # lexists: a dangling link is a damaged record, not a missing one.
    if not os.path.lexists(folder / RUN_FILE):
        seeds = sorted(run.parent.name for run in folder.glob(f"seed-*/{RUN_FILE}"))
        if seeds:
            raise ArtefactError(
                f"'{folder}' holds a run for each of {len(seeds)} seeds; "
                f"give one run, such as {folder / seeds[0]}."
            )
        if is_locked(folder):
            raise ArtefactError(
                f"'{folder}' is still running, and has written nothing to read yet. Wait."
            )
        raise ArtefactError(f"'{folder}' {what_is(folder)}; expected {expected}.")
    return read_record(folder / RUN_FILE, RunRecord)


def read_finished_run(
    folder: Path,
    expected: str,
    result: str,
) -> RunRecord:
    """Read the record of a finished run.

    Args:
        folder: the run folder.
        expected: description of the folder that was expected, for the error.
        result: name of a file that all such runs have when they are done.

    Raises:
        ArtefactError: if there is no such run, or it is not done.
    """
    run = read_run(folder, expected)
    check_done(folder, run)
    # A training of another kind is a finished run, too, but without this file.
    if result not in run.outputs:
        raise ArtefactError(f"'{folder}' {what_is(folder)}; expected {expected}.")
    return run


def check_done(folder: Path, run: RunRecord) -> None:
    """Raise an ArtefactError unless a run is done; it says whether to wait or to resume."""
    if run.status == "done":
        return
    # A killed process leaves the status of a running one, but no lock.
    is_live = is_locked(folder) if run.status == "running" else False
    if is_live:
        raise ArtefactError(
            f"'{folder}' is still running ({run.kind}, since {run.started}), not done. Wait, or "
            "stop it with Ctrl-C."
        )
    state: str = run.status
    if state == "running":
        state = "still running or stopped" if is_live is None else "stopped, by a kill or a crash"
    raise ArtefactError(f"'{folder}' is {state}, not done. Repeat the training command to resume.")


def run_folders(path: Path) -> list[Path]:
    """Return the run folders ``seed-N`` in a folder with several seeds, else the path alone.

    By ascending seed, not by name: seed 10 comes after seed 9.
    """
    if (path / RUN_FILE).exists() or not path.is_dir():
        return [path]
    seeds = [run for run in path.iterdir() if _SEED.fullmatch(run.name)]
    return sorted(seeds, key=lambda run: int(run.name.removeprefix("seed-"))) or [path]


def run_name(folder: Path) -> str:
    """Return a display name for a run: the folder's, or ``<parent>-seed-N`` for one of several."""
    # Not Path.resolve, which raises on a loop of links before Python 3.13.
    folder = Path(os.path.realpath(folder))
    return f"{folder.parent.name}-{folder.name}" if _SEED.fullmatch(folder.name) else folder.name


def _write(folder: Path, run: RunRecord) -> RunRecord:
    # Durable: the record decides after a power failure whether the results count.
    write_atomically(folder / RUN_FILE, dump_json(as_values(run)), durable=True)
    return run


def _arguments() -> tuple[str, ...]:
    home = str(Path.home())
    # The home folder has the user's name. In a container it may be "/", which is in every path.
    shown = [argument if home == "/" else argument.replace(home, "~") for argument in sys.argv[1:]]
    return (Path(sys.argv[0]).name, *shown)


def _now() -> str:
    # UTC: the local time zone would tell where the machine is.
    return datetime.now(UTC).isoformat(timespec="seconds")


@cache
def _versions() -> Mapping[str, str]:
    """Return the versions of Python and packages, the same while a process runs."""
    versions = {"wordcraft-kg": version("wordcraft-kg"), "python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):  # optional
            versions[package] = version(package)
    return versions


@cache
def _git_state() -> GitState | None:
    """Return the state of the checkout that this package runs from; None without a checkout.

    Of several runs of a process, the first asks: this code was imported before all of them.
    """
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    try:
        commit = _git(root, "rev-parse", "HEAD")
        changes = _git(root, "status", "--porcelain")
    except (OSError, subprocess.SubprocessError):
        return None
    return GitState(commit=commit, dirty=bool(changes))


def _git(root: Path, *arguments: str) -> str:
    done = subprocess.run(
        ["git", *arguments],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
        timeout=10,
    )
    return done.stdout.strip()
