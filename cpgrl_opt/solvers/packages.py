"""Which optional packages are there, and what to type where one is not."""

from importlib import import_module
from importlib.util import find_spec

from .interface import MissingPackageError, UnusablePackageError


def has_package(package: str) -> bool:
    """Whether `package` can be imported, found without importing it."""
    return find_spec(package) is not None


def require_package(solver: str, package: str, extra: str) -> None:
    """MissingPackageError with the command that installs `package` unless it is there."""
    if not has_package(package):
        raise MissingPackageError(solver, package, extra)


def require_import(solver: str, package: str) -> None:
    """UnusablePackageError with the reason if `package`, which is there, cannot be imported."""
    try:
        import_module(package)
    except ImportError as reason:
        raise UnusablePackageError(solver, package, reason) from reason
