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


class CheckResult(NamedTuple):
    """The result of a check of the installation.

    Attributes:
        check: what was checked.
        state: ok; note, about an optional part; or error.
        result: what was found.
        remedy: a command to type, or advice; empty without any.
    """

    check: str
    state: Literal["ok", "note", "error"]
    result: str
    remedy: str = ""


def doctor(*, output: Output = Output()) -> int:
    """Check the installation: Python, packages, torch, extras, folders and published books.

    The exit code is 1 if a required part is missing or broken. Missing extras are notes, with the
    command that installs the extra. Nothing is sent or written.
    """
    # Checks do not raise: one broken part must not hide the state of the others.
    findings = [*_packages(), *_torch(), *_extras(), *_words(), *_folders(), *_books()]
    passed = all(finding.state != "error" for finding in findings)
    rows = []
    for finding in findings:
        remedy = f": {finding.remedy}" if finding.remedy else ""
        rows.append((finding.state, finding.check, f"{finding.result}{remedy}"))
    values = {"passed": passed, "findings": [finding._asdict() for finding in findings]}
    output.result(values, aligned(rows))
    return 0 if passed else 1


def _packages() -> Iterator[CheckResult]:
    cores = counted(os.cpu_count() or 1, "core")
    system = f"{platform.python_version()} on {platform.platform()}, {cores}"
    yield CheckResult("Python", "ok", system)
    problems = unmet()
    if not problems:
        yield CheckResult(
            "packages", "ok", f"all {len(requirements())} required packages in supported versions"
        )
        return
    # Without torch and what needs it, graphs and environments still work: an installation that
    # somebody may have chosen. A wrong version is always an error.
    is_light = {"torch", "pykeen"} <= problems.keys() and set(problems.values()) == {NOT_INSTALLED}
    remedy = pip_install(*problems)
    if is_light:
        result = f"for graphs and environments only; {_listed(problems)}"
        yield CheckResult("packages", "note", result, remedy)
    else:
        yield CheckResult("packages", "error", _listed(problems), remedy)


def _listed(problems: dict[str, str]) -> str:
    return ", ".join(f"{name} {problem}" for name, problem in problems.items())


def _torch() -> Iterator[CheckResult]:
    if unmet().get("torch") == NOT_INSTALLED:
        # The check of packages has said so.
        return
    # Importing is the test: a broken installation has the right version, too.
    try:
        import torch
    except (ImportError, OSError) as error:
        yield CheckResult(
            "torch", "error", f"cannot be imported ({error})", CPU_TORCH + " --force-reinstall"
        )
        return
    cuda = torch.version.cuda
    has_gpu = torch.cuda.is_available()
    build = "CPU build"
    if cuda:
        build = f"CUDA {cuda} build, {'with' if has_gpu else 'no'} GPU"
    threads = counted(torch.get_num_threads(), "thread")
    result = f"{torch.__version__}, {build}, {_torch_size() / 1e9:.1f} GB, {threads}"
    if cuda and not has_gpu:
        remedy = f"the CPU build is smaller; first in a new environment, {CPU_TORCH}"
        yield CheckResult("torch", "note", result, remedy)
    else:
        yield CheckResult("torch", "ok", result)


def _torch_size() -> int:
    """Return the bytes of torch on disk, with the CUDA libraries that pip installs beside it."""
    size = 0
    for part in distributions():
        if part.name == "torch" or part.name.startswith(("nvidia-", "triton")):
            paths = [Path(str(file.locate())) for file in part.files or ()]
            size += sum(path.stat().st_size for path in paths if path.is_file())
    return size


def _extras() -> Iterator[CheckResult]:
    provided = set(metadata("wordcraft-kg").get_all("Provides-Extra") or ())
    # Those left out are for people who work on the package itself.
    for extra in sorted(provided - {"dev", "docs"}):
        if problems := unmet(extra):
            yield CheckResult(f"extra {extra}", "note", _listed(problems), pip_install(extra=extra))
        else:
            yield CheckResult(f"extra {extra}", "ok", "installed")


def _words() -> Iterator[CheckResult]:
    from wordcraft_kg.models.scorers.features import ENCODE

    result = "MiniLM for labels of the built-in books, only GloVe for those of all other books"
    yield CheckResult("words", "ok", result, f"stronger words of a book, {ENCODE}")


def _folders() -> Iterator[CheckResult]:
    for check, folder, variable in (
        ("books", cache_folder(), "XDG_CACHE_HOME"),
        ("PyKEEN", pykeen_folder(), "PYSTOW_HOME"),
    ):
        # A folder that is made later is written by whoever may write in the nearest one above.
        existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        if existing.is_dir() and os.access(existing, os.W_OK):
            yield CheckResult(f"folder for {check}", "ok", str(folder))
        else:
            advice = f"set {variable} to a folder with write permission"
            yield CheckResult(f"folder for {check}", "error", f"{folder} cannot be written", advice)


def _books() -> Iterator[CheckResult]:
    folder = data_folder()
    if folder is not None and not folder.is_dir():
        yield CheckResult(
            DATA_VARIABLE, "error", f"{folder} is not a folder", "correct or unset the variable"
        )
    for book in known_books():
        if book.name not in FETCHABLE:
            continue
        remedy = f"wordcraft-kg books --fetch {book.name}"
        if book.path is None:
            yield CheckResult(book.name, "note", "not on this machine", remedy)
            continue
        # Another state of a published book gives other splits, and results that nobody can compare.
        actual = sha256_of(book.path)
        published = FETCHABLE[book.name].sha256
        if actual == published:
            yield CheckResult(book.name, "ok", f"{book.path}, SHA-256 {actual[:12]} as published")
        else:
            result = f"{book.path} has SHA-256 {actual[:12]}, expected {published[:12]}"
            yield CheckResult(book.name, "error", result, remedy)
