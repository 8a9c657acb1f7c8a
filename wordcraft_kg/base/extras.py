"""Other packages: required ones, and extras with ``pip`` commands."""

import shlex
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, requires, version
from typing import TYPE_CHECKING

from wordcraft_kg.base.errors import MissingExtraError

if TYPE_CHECKING:
    from packaging.requirements import Requirement


CPU_TORCH = "pip install torch --index-url https://download.pytorch.org/whl/cpu"
"""Command that installs torch for the CPU; on Linux the usual build is for CUDA, 4.4 GB more."""
NOT_INSTALLED = "is not installed"


def requirements(extra: str = "") -> "dict[str, Requirement]":
    """Return the requirements of an extra, or of the package itself, by package name.

    They come from the installed metadata, so that versions stand in ``pyproject.toml`` alone.
    """
    from packaging.requirements import Requirement

    needed_packages: dict[str, Requirement] = {}
    for text in requires("wordcraft-kg") or ():
        requirement = Requirement(text)
        # A requirement of an extra has the marker ``extra == "name"``; others may have none.
        is_wanted = (
            requirement.marker.evaluate({"extra": extra}) if requirement.marker else not extra
        )
        if is_wanted:
            needed_packages[requirement.name] = requirement
    return needed_packages


def unmet(extra: str = "") -> dict[str, str]:
    """Return the unmet requirements of an extra, or of the package itself.

    Returns:
        By package name, :data:`NOT_INSTALLED` or a text with the version found and expected.
    """
    problems = {}
    for name, requirement in requirements(extra).items():
        try:
            installed = version(name)
        except PackageNotFoundError:
            problems[name] = NOT_INSTALLED
        else:
            if not requirement.specifier.contains(installed, prereleases=True):
                problems[name] = f"has version {installed}, expected {requirement.specifier}"
    return problems


def check_extra(extra: str) -> None:
    """Check that all packages of an extra are installed, in any version.

    Raises:
        MissingExtraError: if one is missing; the message has the command that installs them.
    """
    missing = [name for name, problem in unmet(extra).items() if problem == NOT_INSTALLED]
    if missing:
        raise missing_extra(extra, missing)


def missing_extra(extra: str, names: Sequence[str]) -> MissingExtraError:
    """Return the error for missing packages ``names``, with the command that installs the extra."""
    are = "is" if len(names) == 1 else "are"
    return MissingExtraError(
        f"{' and '.join(names)} {are} not installed: {pip_install(extra=extra)}"
    )


def missing_package(subject: str, error: ModuleNotFoundError) -> ImportError:
    """Return the error for a package that ``subject`` cannot import.

    Args:
        subject: the command or file that needs the package.
        error: the failed import.

    Returns:
        A MissingExtraError, or ``error`` itself if a module of wordcraft-kg is missing: that is a
        fault of this package, which no ``pip`` command mends.
    """
    name = (error.name or "").partition(".")[0]
    if name in ("", "wordcraft_kg"):
        return error
    return MissingExtraError(
        f"{subject} needs {name}, which is not installed. Install it: {pip_install(name)}"
    )


def pip_install(*names: str, extra: str = "") -> str:
    """Return the command that installs packages, or those of an extra, in supported versions.

    The command names the packages themselves, so it works whether or not a package index has
    wordcraft-kg. Without torch, packages that require torch come after its CPU build.

    Args:
        names: packages by import name.
        extra: extra to install if there are no ``names``.

    Example:
        >>> pip_install(extra="explore")
        "pip install 'starlette<2,>=0.46' 'uvicorn<1,>=0.34'"
    """
    package_requirements = requirements(extra)
    packages = [name.replace("_", "-") for name in names] or list(package_requirements)
    needs_torch = "torch" in packages or (
        "pykeen" in packages and unmet().get("torch") == NOT_INSTALLED
    )
    # Requirements such as ``name<2; marker`` without their markers.
    specifiers = [
        str(package_requirements.get(name, name)).partition(";")[0].strip()
        for name in packages
        if name != "torch"
    ]
    commands = [CPU_TORCH] if needs_torch else []
    if specifiers:
        commands.append(shlex.join(["pip", "install", *specifiers]))
    return " && ".join(commands)
