"""Run records: what was run, on what, with which versions, and what came of it (``run.json`` in every run's folder)."""

import hashlib
import json
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from wordcraft_kg import __version__
from wordcraft_kg.artefacts import dump_json, read_json, sha256_of, with_a_name, write_atomically
from wordcraft_kg.errors import ArtefactError

RUN_FORMAT = "wordcraft-kg run 1"
_PACKAGES = ("torch", "pykeen", "numpy", "pandas", "networkx", "safetensors")


def start_run(folder: Path, kind: str, **facts: Any) -> dict[str, Any]:
    """Write ``run.json`` with the status ``running`` and return its content.

    No host or user name and no environment variable goes in; the home folder in arguments becomes ``~``.
    """
    run = {
        "format": RUN_FORMAT,
        "kind": kind,
        "status": "running",
        "argv": _arguments(),
        "started": _now(),
        "ended": None,
        "versions": _versions(),
        "git": _git_state(),
        "inputs": {},
        **facts,
        "outputs": {},
    }
    write_atomically(folder / "run.json", dump_json(run))
    return run


def resume_run(folder: Path, run: dict[str, Any]) -> None:
    """Put a run back to ``running`` and note when, how and with which versions it went on."""
    again = {"started": _now(), "argv": _arguments(), "versions": _versions(), "git": _git_state()}
    run |= {"status": "running", "ended": None, "resumed": [*run.get("resumed", []), again]}
    write_atomically(folder / "run.json", dump_json(run))


def end_run(folder: Path, run: dict[str, Any], status: str, outputs: tuple[str, ...] = ()) -> None:
    """Write the final status (done, interrupted or failed) and the SHA-256 of the output files."""
    run |= {"status": status, "ended": _now(), "outputs": {name: sha256_of(folder / name) for name in outputs}}
    write_atomically(folder / "run.json", dump_json(run))


def read_run(folder: Path) -> dict[str, Any]:
    """Read ``run.json``.

    Raises:
        ArtefactError: if the folder has none, or it is damaged.
    """
    if not folder.is_dir():
        raise ArtefactError(f"'{folder}' is not a folder; expected one written by a training command.")
    run = read_json(folder / "run.json")
    if not isinstance(run, dict) or run.get("format") != RUN_FORMAT:
        raise ArtefactError(f"{folder / 'run.json'} is not a run record of this version ({RUN_FORMAT}).")
    expected = {"kind": str, "status": str, "argv": list, "versions": dict, "inputs": dict, "outputs": dict}
    damaged = [key for key, kind in expected.items() if not isinstance(run.get(key), kind)]
    if damaged:
        raise ArtefactError(f"{folder / 'run.json'} is damaged: '{damaged[0]}' is missing or of another kind.")
    return run


def read_finished_run(folder: Path, command: str) -> dict[str, Any]:
    """Read the record of a run that is done.

    Raises:
        ArtefactError: if there is no such folder or the run is not done; the message names ``command``.
    """
    folder = with_a_name(folder)
    unfinished = folder.with_name(folder.name + ".unfinished")
    if not folder.exists() and unfinished.exists():
        raise ArtefactError(f"'{folder}' is not finished yet. Go on with: wordcraft-kg resume {unfinished}")
    if not folder.exists():
        raise ArtefactError(f"'{folder}' does not exist. Make it with `{command}`.")
    run = read_run(folder)
    if run["status"] != "done":
        raise ArtefactError(f"'{folder}' is {run['status']}, not done. Go on with: wordcraft-kg resume {folder}")
    return run


def verified_bytes(folder: Path, run: dict[str, Any], name: str) -> bytes:
    """Return a file's bytes if they are those that the run wrote.

    Raises:
        ArtefactError: if the file is missing or differs by a bit.
    """
    path = folder / name
    if not path.is_file():
        raise ArtefactError(f"{path} is missing; '{folder}' is incomplete. Train the model again, or restore a copy.")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != run["outputs"].get(name):
        raise ArtefactError(
            f"{path} is damaged or was changed: its SHA-256 is not the one that run.json records. "
            "Train again, or restore a copy."
        )
    return data


def toml_value(value: Any) -> str:
    """Write a string or a number as TOML; the two formats agree on these when no character is escaped as a pair."""
    return json.dumps(value, ensure_ascii=False)


def _arguments() -> list[str]:
    home = str(Path.home())
    shown = [argument if home == "/" else argument.replace(home, "~") for argument in sys.argv[1:]]
    return [Path(sys.argv[0]).name, *shown]


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _versions() -> dict[str, str]:
    found = {"wordcraft-kg": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # an optional one
            continue
    return found


def _git_state() -> dict[str, Any] | None:
    """Commit of the checkout that this package runs from, or None when it is installed."""
    root = Path(__file__).parent.parent
    if not (root / ".git").exists():
        return None
    try:
        commit, changes = (
            subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=True, timeout=10).stdout
            for arguments in (["rev-parse", "HEAD"], ["status", "--porcelain"])
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": commit.strip(), "dirty": bool(changes.strip())}
