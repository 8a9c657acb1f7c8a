"""Run records: ``run.json`` in a run folder, with command, status, inputs, versions and outputs.

A record may be published, so it holds no host name, user name or environment variables, and the
home folder in arguments becomes ``~``. :class:`RunFiles` reads the other files of a run only if
they and the training graph match the hashes in the record: a result cannot come from a file that
was changed, mixed up or half copied after the training. A model card describes the run to people.
"""

import hashlib
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import msgspec
from msgspec.structs import replace

from wordcraft_kg.base import (
    ArtefactError,
    GraphMismatchError,
    Record,
    as_values,
    dump_json,
    parse_lines,
    parse_record,
    read_large_file,
    read_record,
    sha256_of,
    staged_folder,
    what_is,
    with_a_name,
    write_atomically,
)
from wordcraft_kg.base.artefacts import is_locked
from wordcraft_kg.base.registry import check_plugins
from wordcraft_kg.graphs.graph_folder import GraphLike, OpenedGraph, TrainedOn, open_graph

if TYPE_CHECKING:
    from torch import Tensor


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


class Resumption(Record, frozen=True, kw_only=True):
    """A resumption of an interrupted run.

    Attributes:
        started: ISO 8601, UTC.
        argv: command line, with ``~`` for the home folder.
        versions: versions by package.
        git: commit of the checkout that the package runs from, with ``-dirty`` if tracked files
            were changed; None without a checkout. Earlier versions wrote an object.
    """

    started: str
    argv: tuple[str, ...]
    versions: dict[str, str]
    git: str | dict[str, Any] | None


class RunRecord(Record, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=False):
    """Run record: the content of ``run.json``; keys with default values are left out.

    Facts that another version has recorded are ignored.

    Attributes:
        format: name and version of this format.
        kind: training command, for example ``train-agent``.
        status: running, interrupted, failed or done.
        argv: command line, with ``~`` for the home folder.
        started: start of the run, ISO 8601, UTC.
        ended: end of the last process, ISO 8601, UTC; None while running.
        versions: versions by package.
        git: commit of the checkout that the package runs from, with ``-dirty`` if tracked files
            were changed; None without a checkout. Earlier versions wrote an object.
        inputs: hashes of ``graph`` and ``split``, and the SHA-256 of files that training never
            changes.
        seed: random seed.
        device: torch device.
        threads: number of CPU threads.
        kg: training graph of an agent's scorer: partial, full or none; None without a scorer.
        cross_fitted: number of cross-fitting folds in an agent's scorer; 0 if train tasks were
            scored by a model that has seen them.
        trackers: names of metric trackers, such as tensorboard.
        plugins: SHA-256 of the plugin files that the run needs, by file name.
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
    git: str | dict[str, Any] | None
    inputs: dict[str, str]
    seed: int
    device: str
    threads: int
    kg: TrainedOn | None = None
    cross_fitted: int = 0
    trackers: tuple[str, ...] = ()
    plugins: dict[str, str] = msgspec.field(default_factory=dict)
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
        versions=dict(package_versions()),
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
    resumption = Resumption(
        started=_now(),
        argv=_arguments(),
        versions=dict(package_versions()),
        git=_git_state(),
    )
    resumed = replace(
        run,
        status="running",
        ended=None,
        inputs={**run.inputs, **(inputs or {})},
        resumed=(*run.resumed, resumption),
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


def write_run(
    out: str | Path,
    kind: str,
    files: Mapping[str, str | bytes],
    *,
    inputs: Mapping[str, str],
    force: bool = False,
) -> Path:
    """Write a finished run, complete or not at all, and return its folder.

    Args:
        out: the folder.
        kind: name of the writing command.
        files: contents of the files by name.
        inputs: hashes of what they were made from, by name.
        force: replace the folder.

    Raises:
        OutputExistsError: if the folder exists and ``force`` is False.
    """
    folder = with_a_name(Path(out))
    # Written beside the folder and renamed at the end, so readers never see half of it.
    with staged_folder(folder, force=force) as staging:
        for name, content in files.items():
            write_atomically(staging / name, content)
        end_run(staging, start_run(staging, kind, inputs=inputs), "done", tuple(files))
    return folder


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
    state: str = run.status
    if state == "running":
        if is_locked(folder):
            raise ArtefactError(
                f"'{folder}' is still running ({run.kind}, since {run.started}), not done. Wait, "
                "or stop it with Ctrl-C."
            )
        # A killed process leaves the status of a running one, but no lock.
        state = "stopped, by a kill or a crash"
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
def package_versions() -> Mapping[str, str]:
    """Return the versions of Python and packages, the same while a process runs."""
    versions = {"wordcraft-kg": version("wordcraft-kg"), "python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):  # optional
            versions[package] = version(package)
    return versions


@cache
def _git_state() -> str | None:
    """Return the commit of the checkout that this package runs from; None without a checkout.

    Of several runs of a process, the first asks: this code was imported before all of them.
    """
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    # Without tags, the name of a commit is its hash.
    command = ["git", "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty"]
    with suppress(OSError, subprocess.SubprocessError):
        process = subprocess.run(
            command, cwd=root, capture_output=True, text=True, check=True, timeout=10
        )
        return process.stdout.strip()
    return None


T = TypeVar("T")


@dataclass(frozen=True)
class RunFiles:
    """Verified access to a run's files; a missing or changed file is an ArtefactError.

    Attributes:
        folder: the run folder.
        run: the run record, with the hashes.

    Raises:
        NotRegisteredError: if the run needs a plugin that is not loaded, or was changed.
    """

    folder: Path
    run: RunRecord

    def __post_init__(self) -> None:
        check_plugins(self.run.plugins, self.folder)

    def bytes(self, name: str) -> bytes:
        """Return the content of an input or output file as it was written, after a SHA-256 check.

        Git on Windows gives text files other line ends (CRLF) by default. Such a file is taken if
        its SHA-256 is right with the line ends that were written (LF); so no other change passes.

        Args:
            name: the file's name, as ``run.json`` lists it.

        Raises:
            ArtefactError: if the file is missing, damaged or was changed.
        """
        path = self.folder / name
        data = read_large_file(path)
        expected = self.run.outputs.get(name, self.run.inputs.get(name))
        if hashlib.sha256(data).hexdigest() == expected:
            return data
        # Only now: a copy of large weights takes as much memory again.
        unix_data = data.replace(b"\r\n", b"\n")
        if hashlib.sha256(unix_data).hexdigest() == expected:
            return unix_data
        raise ArtefactError(
            f"{path} is damaged or was changed: the SHA-256 differs from run.json. "
            "Train again, or restore a copy."
        )

    def record(self, name: str, kind: type[T]) -> T:
        """Read a JSON file, such as ``metrics.json``, into an instance of the class ``kind``.

        Raises:
            ArtefactError: if the file is missing, was changed, or does not fit ``kind``.
        """
        return parse_record(self.bytes(name), kind, self.folder / name, is_verified=True)

    def lines(self, name: str, kind: type[T]) -> list[T]:
        """Read a JSON Lines file, a JSON object per line, as instances of the class ``kind``.

        Raises:
            ArtefactError: if the file is missing, was changed, or a line does not fit ``kind``.
        """
        return parse_lines(self.bytes(name), kind, self.folder / name)

    def tensors(self, name: str) -> "dict[str, Tensor]":
        """Read all tensors in a safetensors file, by tensor name.

        Raises:
            ArtefactError: if the file is missing, damaged or was changed, or a tensor holds NaN or
                infinity.
        """
        # Imported here, because torch takes long and most files hold no tensors.
        from wordcraft_kg.base.tensors import read_tensors

        return read_tensors(self.folder / name, self.bytes(name))

    def graph(self, source: GraphLike) -> OpenedGraph:
        """Return the run's graph and split.

        Args:
            source: where they are: a folder, a file or a book name; or the graph.

        Raises:
            ArtefactError: if there is no such graph.
            GraphMismatchError: if graph or split are not those of the training.
        """
        try:
            opened = open_graph(source)
        except ArtefactError:  # a damaged graph folder is not a missing one
            raise
        except ValueError as error:
            raise ArtefactError(
                f"the graph that '{self.folder}' was trained on was not found ({error}) "
                "Give the path as `graph`."
            ) from None
        hashes = {"graph": opened.graph.hash, "split": opened.split.hash}
        for name, actual in hashes.items():
            expected = self.run.inputs.get(name, "")
            if actual != expected:
                raise GraphMismatchError(
                    f"'{self.folder}' was trained on {name} {expected[:12]} "
                    f"but '{opened.source}' has {actual[:12]}. "
                    "Give the right graph as `graph`, or train again."
                )
        return opened


def front_matter(*tags: str) -> str:
    """Return the YAML header of a model card, where model hubs read library name and tags."""
    lines = ["---", "library_name: wordcraft-kg", "tags:"]
    lines += [f"- {tag}" for tag in tags]
    return "\n".join([*lines, "---"])


def scorer_card(
    opened: OpenedGraph,
    title: str,
    about: str,
    facts: Mapping[str, str],
    closing: str,
    usage: Iterable[str],
) -> str:
    """Return a scorer's model card, in Markdown.

    Args:
        opened: graph and split of the training.
        title: heading.
        about: paragraph below the heading.
        facts: further facts by name, for the list that begins with graph and split.
        closing: paragraph of caveats below the list.
        usage: lines of Python that use ``scorer``.
    """
    graph = opened.graph
    split = opened.split.config
    trained_on = (
        f"graph `{graph.hash[:12]}`: {graph.num_entities:,} entities; "
        f"split `{split.kind}`, seed {split.seed}"
    )
    points = [f"{name}: {text}" for name, text in facts.items()]
    lines = "\n".join(f"- {point}" for point in (trained_on, *points))
    loading = ["from wordcraft_kg import load_scorer", "", 'scorer = load_scorer("this folder")']
    code = "\n".join([*loading, *usage])
    head = f"{front_matter('knowledge-graph', 'link-prediction')}\n# {title}"
    return f"{head}\n\n{about}\n\n{lines}\n\n{closing}\n\n```python\n{code}\n```\n"
