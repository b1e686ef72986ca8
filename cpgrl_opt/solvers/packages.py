"""Which optional packages are there, which of them can be imported, and what to type where one is not there."""

from importlib import import_module
from importlib.util import find_spec

from .interface import MissingPackageError, UnusablePackageError


def has_package(package: str) -> bool:
    """Whether `package` is there, found without importing it, so that nobody knows yet whether it can be."""
    return find_spec(package) is not None


def require_package(solver: str, package: str, extra: str) -> None:
    """MissingPackageError with the command that installs `package` unless it is there."""
    if not has_package(package):
        raise MissingPackageError(solver, package, extra)


def require_import(solver: str, package: str) -> None:
    """UnusablePackageError with the reason if `package`, which is there, cannot be imported."""
    reason = import_failure(package)
    if reason is not None:
        raise UnusablePackageError(solver, package, reason) from reason


def import_failure(package: str) -> ImportError | None:
    """What the import of `package` raises, None where it can be imported; it then is."""
    try:
        import_module(package)
    except ImportError as reason:
        return reason
    except Exception as reason:  # whatever a third party raises as it is imported
        failure = ImportError(f"{type(reason).__name__}: {reason}")
        failure.__cause__ = reason
        return failure
    return None
