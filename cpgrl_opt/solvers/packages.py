"""Which optional packages are there, and what to type where one is not."""

from importlib.util import find_spec

from .interface import MissingPackageError


def has_package(package: str) -> bool:
    """Whether `package` can be imported, found without importing it."""
    return find_spec(package) is not None


def require_package(solver: str, package: str, extra: str) -> None:
    """MissingPackageError with the command that installs `package` unless it is there."""
    if not has_package(package):
        raise MissingPackageError(solver, package, extra)
