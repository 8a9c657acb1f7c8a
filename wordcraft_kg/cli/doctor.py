"""``wordcraft-kg doctor``."""

import os
import platform
from collections.abc import Iterator
from importlib.metadata import metadata
from typing import Literal, NamedTuple

from wordcraft_kg.base.extras import CPU_TORCH, NOT_INSTALLED, pip_install, unmet
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Output, aligned

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
    """Check the installation: Python, packages, torch and extras.

    The exit code is 1 if a required part is missing or broken. Missing extras are notes, with the
    command that installs the extra. Nothing is sent or written.
    """
    findings = list(_findings())
    passed = all(finding.state != "error" for finding in findings)
    rows = [
        (state, check, f"{result}: {remedy}" if remedy else result)
        for check, state, result, remedy in findings
    ]
    values = {"passed": passed, "findings": [finding._asdict() for finding in findings]}
    output.result(values, aligned(rows))
    return 0 if passed else 1


def _findings() -> Iterator[CheckResult]:
    """Yield the results of all checks, which do not raise: one must not hide the others."""
    cores = counted(os.cpu_count() or 1, "core")
    system = f"{platform.python_version()} on {platform.platform()}, {cores}"
    yield CheckResult("Python", "ok", system)
    problems = unmet()
    # Without torch and what needs it, graphs and environments still work: an installation that
    # somebody may have chosen. A wrong version is always an error.
    is_light = {"torch", "pykeen"} <= problems.keys() and set(problems.values()) == {NOT_INSTALLED}
    yield _of_packages("packages", problems, "note" if is_light else "error", *problems)
    if problems.get("torch") != NOT_INSTALLED:
        yield _torch()
    provided = set(metadata("wordcraft-kg").get_all("Provides-Extra") or ())
    # Those left out are for people who work on the package itself.
    for extra in sorted(provided - {"dev", "docs"}):
        yield _of_packages(f"extra {extra}", unmet(extra), "note", extra=extra)


def _of_packages(
    check: str,
    problems: dict[str, str],
    state: Literal["note", "error"],
    *names: str,
    extra: str = "",
) -> CheckResult:
    """Return the result for packages, with the command that installs ``names`` or the extra."""
    if not problems:
        return CheckResult(check, "ok", "installed in supported versions")
    result = ", ".join(f"{name} {problem}" for name, problem in problems.items())
    return CheckResult(check, state, result, pip_install(*names, extra=extra))


def _torch() -> CheckResult:
    # Importing is the test: a broken installation has the right version, too.
    try:
        import torch
    except (ImportError, OSError) as error:
        remedy = f"{CPU_TORCH} --force-reinstall"
        return CheckResult("torch", "error", f"cannot be imported ({error})", remedy)
    gpu = "with" if torch.cuda.is_available() else "no"
    build = f"CUDA {torch.version.cuda} build, {gpu} GPU" if torch.version.cuda else "CPU build"
    threads = counted(torch.get_num_threads(), "thread")
    return CheckResult("torch", "ok", f"{torch.__version__}, {build}, {threads}")
