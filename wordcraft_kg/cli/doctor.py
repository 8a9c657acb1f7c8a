"""``wordcraft-kg doctor``."""

import os
import platform
from collections.abc import Iterator
from importlib.metadata import metadata
from typing import Literal, NamedTuple

from wordcraft_kg.base.extras import CPU_TORCH, NOT_INSTALLED, pip_install, requirements, unmet
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

    @property
    def text(self) -> str:
        """Result and remedy."""
        return f"{self.result}: {self.remedy}" if self.remedy else self.result


def doctor(*, output: Output = Output()) -> int:
    """Check the installation: Python, packages, torch and extras.

    The exit code is 1 if a required part is missing or broken. Missing extras are notes, with the
    command that installs the extra. Nothing is sent or written.
    """
    # Checks do not raise: one broken part must not hide the state of the others.
    findings = [*_packages(), *_torch(), *_extras()]
    passed = all(finding.state != "error" for finding in findings)
    rows = [(finding.state, finding.check, finding.text) for finding in findings]
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
    result = _listed(problems)
    if is_light:
        result = f"for graphs and environments only; {result}"
    yield CheckResult("packages", "note" if is_light else "error", result, pip_install(*problems))


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
    cuda_build = f"CUDA {cuda} build, {'with' if has_gpu else 'no'} GPU"
    threads = counted(torch.get_num_threads(), "thread")
    result = f"{torch.__version__}, {cuda_build if cuda else 'CPU build'}, {threads}"
    if cuda and not has_gpu:
        remedy = f"the CPU build is smaller; first in a new environment, {CPU_TORCH}"
        yield CheckResult("torch", "note", result, remedy)
    else:
        yield CheckResult("torch", "ok", result)


def _extras() -> Iterator[CheckResult]:
    provided = set(metadata("wordcraft-kg").get_all("Provides-Extra") or ())
    # Those left out are for people who work on the package itself.
    for extra in sorted(provided - {"dev", "docs"}):
        if problems := unmet(extra):
            yield CheckResult(f"extra {extra}", "note", _listed(problems), pip_install(extra=extra))
        else:
            yield CheckResult(f"extra {extra}", "ok", "installed")
