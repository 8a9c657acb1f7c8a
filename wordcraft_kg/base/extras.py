"""Required packages and extras (optional dependencies), and the ``pip`` commands that install missing packages."""

import shlex
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, requires, version
from typing import TYPE_CHECKING

from wordcraft_kg.base.errors import MissingExtraError

if TYPE_CHECKING:
    from packaging.requirements import Requirement

CPU_TORCH = "pip install torch --index-url https://download.pytorch.org/whl/cpu"
"""Command that installs the CPU build of torch; other commands install the CUDA build on Linux, 4.4 GB more."""
NOT_INSTALLED = "is not installed"


def requirements(extra: str = "") -> "dict[str, Requirement]":
    """Return the requirements of an extra by package name, or of the package itself, from the installed metadata."""
    from packaging.requirements import Requirement

    every = map(Requirement, requires("wordcraft-kg") or ())
    return {
        one.name: one
        for one in every
        if (one.marker.evaluate({"extra": extra}) if one.marker else not extra)
    }


def unmet(extra: str = "") -> dict[str, str]:
    """Return the unmet requirements of an extra, or of the package itself: "not installed" or the version, by name."""
    problems = {}
    for name, one in requirements(extra).items():
        try:
            installed = version(name)
        except PackageNotFoundError:
            problems[name] = NOT_INSTALLED
        else:
            if not one.specifier.contains(installed, prereleases=True):
                problems[name] = f"has version {installed}, expected {one.specifier}"
    return problems


def check_extra(extra: str) -> None:
    """Raise MissingExtraError, with the command to install them, unless all packages of an extra are installed."""
    missing = [name for name, problem in unmet(extra).items() if problem == NOT_INSTALLED]
    if missing:
        raise missing_extra(extra, missing)


def missing_extra(extra: str, names: Sequence[str]) -> MissingExtraError:
    """Return the error for missing packages ``names``; the message has the command that installs the extra."""
    are = "is" if len(names) == 1 else "are"
    return MissingExtraError(
        f"{' and '.join(names)} {are} not installed: {pip_install(extra=extra)}"
    )


def missing_package(subject: str, error: ModuleNotFoundError) -> ImportError:
    """Return the error for a package that ``subject`` cannot import; for other modules, ``error`` itself."""
    name = (error.name or "").partition(".")[0]
    if name in ("", "wordcraft_kg"):
        return error
    return MissingExtraError(
        f"{subject} needs {name}, which is not installed. Install it: {pip_install(name)}"
    )


def pip_install(*names: str, extra: str = "") -> str:
    """Return the command that installs packages by import name, or all packages of an extra, in supported versions.

    The command names the packages themselves, so it works whether or not a package index has wordcraft-kg. Without
    torch, packages that require torch come after its CPU build.

    Example:
        >>> pip_install("pykeen"), pip_install(extra="explore")
        ("pip install 'pykeen<1.12,>=1.11.1'", "pip install 'starlette<2,>=0.46' 'uvicorn<1,>=0.34'")
    """
    known = requirements(extra)
    packages = [name.replace("_", "-") for name in names] or list(known)
    wanted = [
        str(known.get(name, name)).partition(";")[0].strip() for name in packages if name != "torch"
    ]
    needs_torch = "torch" in packages or (
        "pykeen" in packages and unmet().get("torch") == NOT_INSTALLED
    )
    return " && ".join(
        [CPU_TORCH] * needs_torch + [shlex.join(["pip", "install", *wanted])] * bool(wanted)
    )
