"""``wordcraft-kg doctor``."""

import os
import platform
from collections.abc import Iterator
from importlib.metadata import distributions, metadata
from pathlib import Path
from typing import Literal, NamedTuple

from wordcraft_kg.base.artefacts import sha256_of
from wordcraft_kg.base.extras import CPU_TORCH, NOT_INSTALLED, pip_install, requirements, unmet
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Output, aligned
from wordcraft_kg.cli.failures import pykeen_folder
from wordcraft_kg.graphs.library import (
    DATA_VARIABLE,
    FETCHABLE,
    cache_folder,
    data_folder,
    known_books,
)

EXAMPLES = ("wordcraft-kg doctor", "wordcraft-kg doctor --json")


class Finding(NamedTuple):
    """The result of a check; a ``note`` is about an optional part, ``remedy`` is a command or advice."""

    check: str
    state: Literal["ok", "note", "error"]
    result: str
    remedy: str = ""


def doctor(*, output: Output = Output()) -> int:
    """Check the installation: Python, packages, torch, extras, folders and published books.

    The exit code is 1 if a required part is missing or broken. Missing extras are notes, with the
    command that installs the extra. Nothing is sent or written.
    """
    findings = [*_packages(), *_torch(), *_extras(), *_folders(), *_books()]
    passed = all(finding.state != "error" for finding in findings)
    rows = [
        (one.state, one.check, ": ".join(filter(None, (one.result, one.remedy))))
        for one in findings
    ]
    output.result(
        {"passed": passed, "findings": [finding._asdict() for finding in findings]}, aligned(rows)
    )
    return 0 if passed else 1


def _packages() -> Iterator[Finding]:
    system = f"{platform.python_version()} on {platform.platform()}, {counted(os.cpu_count() or 1, 'core')}"
    yield Finding("Python", "ok", system)
    problems = unmet()
    if not problems:
        yield Finding(
            "packages", "ok", f"all {len(requirements())} required packages in supported versions"
        )
        return
    is_light = {"torch", "pykeen"} <= problems.keys() and set(problems.values()) == {NOT_INSTALLED}
    result = "for graphs and environments only; " * is_light + _listed(problems)
    yield Finding("packages", "note" if is_light else "error", result, pip_install(*problems))


def _listed(problems: dict[str, str]) -> str:
    return ", ".join(f"{name} {problem}" for name, problem in problems.items())


def _torch() -> Iterator[Finding]:
    if unmet().get("torch") == NOT_INSTALLED:
        return
    try:
        import torch
    except (ImportError, OSError) as error:
        yield Finding(
            "torch", "error", f"cannot be imported ({error})", CPU_TORCH + " --force-reinstall"
        )
        return
    parts = [
        one
        for one in distributions()
        if one.name.startswith(("nvidia-", "triton")) or one.name == "torch"
    ]
    files = [Path(str(file.locate())) for part in parts for file in part.files or ()]
    size = sum(file.stat().st_size for file in files if file.is_file()) / 1e9
    cuda, has_gpu = torch.version.cuda, torch.cuda.is_available()
    build = f"CUDA {cuda} build, {'with' if has_gpu else 'no'} GPU" if cuda else "CPU build"
    result = (
        f"{torch.__version__}, {build}, {size:.1f} GB, {counted(torch.get_num_threads(), 'thread')}"
    )
    if cuda and not has_gpu:
        yield Finding(
            "torch",
            "note",
            result,
            f"the CPU build is smaller; first in a new environment, {CPU_TORCH}",
        )
    else:
        yield Finding("torch", "ok", result)


def _extras() -> Iterator[Finding]:
    for extra in sorted(
        {*(metadata("wordcraft-kg").get_all("Provides-Extra") or ())} - {"dev", "docs"}
    ):
        if problems := unmet(extra):
            yield Finding(f"extra {extra}", "note", _listed(problems), pip_install(extra=extra))
        else:
            yield Finding(f"extra {extra}", "ok", "installed")


def _folders() -> Iterator[Finding]:
    for check, folder, variable in (
        ("books", cache_folder(), "XDG_CACHE_HOME"),
        ("PyKEEN", pykeen_folder(), "PYSTOW_HOME"),
    ):
        existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        if existing.is_dir() and os.access(existing, os.W_OK):
            yield Finding(f"folder for {check}", "ok", str(folder))
        else:
            advice = f"set {variable} to a folder with write permission"
            yield Finding(f"folder for {check}", "error", f"{folder} cannot be written", advice)


def _books() -> Iterator[Finding]:
    folder = data_folder()
    if folder is not None and not folder.is_dir():
        yield Finding(
            DATA_VARIABLE, "error", f"{folder} is not a folder", "correct or unset the variable"
        )
    for book in known_books():
        if book.name in FETCHABLE and book.path is None:
            yield Finding(
                book.name, "note", "not on this machine", f"wordcraft-kg books --fetch {book.name}"
            )
        elif book.name in FETCHABLE and book.path is not None:
            actual, published = sha256_of(book.path), FETCHABLE[book.name].sha256
            if actual == published:
                yield Finding(book.name, "ok", f"{book.path}, SHA-256 {actual[:12]} as published")
            else:
                result = f"{book.path} has SHA-256 {actual[:12]}, expected {published[:12]}"
                yield Finding(book.name, "error", result, f"wordcraft-kg books --fetch {book.name}")
