"""Which optional packages are there, which of them can be imported, and what to type where one is not there."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from .facts import facts_of


class MissingPackageError(ImportError):
    """A solver's package is not installed; the message is the command that installs it.

    Made of the names of the solver, of the package, and of the extra that brings it.
    """

    _message = "which is not installed; type: pip install 'cpgrl-opt[{2}]'"

    def __str__(self) -> str:
        """From the arguments alone, with which pickle makes the error anew in another process."""
        return f"solver {{0!r}} needs the package {{1}}, {self._message}".format(*self.args)


class UnusablePackageError(MissingPackageError):
    """A solver's package is installed, yet cannot be imported, e.g. for want of a system library.

    The third argument is the reason.
    """

    _message = "which is installed but cannot be imported: {2}"


def has_package(package: str) -> bool:
    """Whether `package` is there, found without importing it, so that nobody knows yet whether it can be."""
    return find_spec(package) is not None


def is_installed(solver: Any) -> bool:
    """Whether the packages behind a solver are there; True for a solver that names none. Imports nothing.

    Whether they can be imported too, `obstacle` finds out.
    """
    return all(map(has_package, facts_of(solver).packages))


def obstacle(solver: Any) -> str:
    """Why a solver cannot be used: "not installed" or "broken: …", where … says why; "" where it can.

    A package that is there may lack a system library, which only its import tells: it is imported here.
    """
    try:
        require_packages(solver)
    except MissingPackageError as error:
        return f"broken: {error.args[-1]}" if isinstance(error, UnusablePackageError) else "not installed"
    return ""


def is_usable(solver: Any) -> bool:
    """Whether the packages behind a solver are there and can be imported; imports them."""
    return not obstacle(solver)


def require_packages(solver: Any) -> None:
    """Imports what the solver stands on. Raises MissingPackageError, UnusablePackageError."""
    packages = facts_of(solver).packages
    for package in packages:
        name = getattr(solver, "name", packages[0])
        if not has_package(package):
            raise MissingPackageError(name, package, getattr(solver, "extra", "solvers"))
        try:
            import_module(package)
        except Exception as reason:  # whatever a third party raises as it is imported
            text = str(reason) if isinstance(reason, ImportError) else f"{type(reason).__name__}: {reason}"
            raise UnusablePackageError(name, package, text) from reason
