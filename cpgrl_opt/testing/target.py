"""What `package.module:SOLVER` names: loaded, made a direction solver, and how a test would spell it."""

import sys
import traceback
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from inspect import signature
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from ..problem import DirectionProblem
from ..published.function_solver import FunctionSolver
from ..solvers import compile_kernels
from ..solvers.facts import tolerance_of
from ..solvers.interface import DirectionSolver


class TargetError(ValueError):
    """There is no solver to check; `traceback` is that of the user's own module, "" if it has no part in it."""

    def __init__(self, message: str, traceback: str = "") -> None:
        super().__init__(message, traceback)
        self.message, self.traceback = message, traceback

    def __str__(self) -> str:
        return self.message


@dataclass(frozen=True)
class Subject:
    """A solver; `imports` and `expression` are the source by which a test gets it."""

    solver: DirectionSolver
    imports: tuple[str, ...]
    expression: str


def checkable_solver(target: str) -> DirectionSolver:
    """The solver of a target that can be checked. Raises TargetError.

    A small problem shows whether a package is missing; whatever else it shows is for the laws.
    """
    solver = load_subject(target).solver
    try:
        tolerance_of(solver)
    except ValueError as error:
        raise TargetError(f"{target}: {error}") from error
    try:
        get_ready(solver)
    except ImportError as error:
        raise TargetError(f"{target} should have the packages that it needs; found {error}") from error
    except Exception:
        pass
    return solver


def get_ready(solver: DirectionSolver) -> None:
    """Does once what is not in the solver's time: compiles the oracle that the laws compare with; imports packages."""
    compile_kernels()
    solver.solve(DirectionProblem([1.0, 2.0], np.array([[1.0, 0.0]])))


def spelling_of(_: object, target: str) -> tuple[tuple[str, ...], str]:
    """Statements and the expression by which a test gets the solver of a target."""
    subject = load_subject(target)
    return subject.imports, subject.expression


def load_subject(target: str) -> Subject:
    """The solver of "package.module:SOLVER", an instance, a class or a function; the current folder is importable.

    Raises TargetError, which says what should be and what was found.
    """
    module_name, colon, path = target.partition(":")
    if not colon or not all(part.isidentifier() for part in (*module_name.split("."), *path.split("."))):
        raise TargetError(f"the target should be package.module:SOLVER; found {target!r}")
    found: Any = _import(module_name)
    for name in path.split("."):
        if not hasattr(found, name):
            near = get_close_matches(name, dir(found), n=3) or [each for each in dir(found) if not each.startswith("_")]
            listed = ", ".join(near[:8]) or "nothing"
            raise TargetError(f"{target} should name something in {module_name}; found no {name!r} but {listed}")
        found = getattr(found, name)
    return _subject(target, f"from {module_name} import {path.split('.')[0]}", path, found)


def _subject(target: str, statement: str, expression: str, found: Any) -> Subject:
    if isinstance(found, type):
        expression += "()"
        try:
            found = found()
        except Exception as error:
            raise TargetError(
                f"the class {target} should be constructible without arguments; found {_describe(error)}",
                "" if isinstance(error, TypeError) else _own_part(error),
            ) from error
    if callable(getattr(found, "solve", None)):
        _require_one_argument(target, found)
        return Subject(found, (statement,), expression)
    if not callable(found):
        raise TargetError(
            f"{target} should be a solver (an object with solve(problem)), a class of solvers, or a function "
            f"(g, J, b) → d; found {_shorten(repr(found))}, without a method solve"
        )
    try:
        solver = FunctionSolver(found)
    except ValueError as error:
        raise TargetError(f"{target}: {error}") from error
    return Subject(solver, ("from cpgrl_opt.testing import FunctionSolver", statement), f"FunctionSolver({expression})")


def _require_one_argument(target: str, solver: Any) -> None:
    try:
        parameters = signature(solver.solve)
    except ValueError:  # compiled functions may tell nothing
        return
    try:
        parameters.bind(object())
    except TypeError:
        raise TargetError(
            f"{target}.solve should take one argument, the problem; found the arguments {parameters}"
        ) from None


def _import(name: str) -> Any:
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and (name == error.name or name.startswith(f"{error.name}.")):
            raise TargetError(
                f"{name} should be a module in the current folder or installed; found no module {error.name!r}"
            ) from error
        raise _not_imported(name, error) from error
    except (Exception, SystemExit) as error:
        raise _not_imported(name, error) from error


def _not_imported(name: str, error: BaseException) -> TargetError:
    return TargetError(f"{name} should be importable; found {_describe(error)}", _own_part(error))


def _own_part(error: BaseException) -> str:
    """The traceback from the first frame that is the user's."""
    frame: TracebackType | None = error.__traceback__
    while frame is not None and _is_ours(frame.tb_frame.f_code.co_filename):
        frame = frame.tb_next
    return "".join(traceback.format_exception(type(error), error, frame, chain=False))


def _is_ours(filename: str) -> bool:
    return filename == __file__ or filename.startswith("<frozen importlib") or "importlib" in Path(filename).parts


def _describe(error: BaseException) -> str:
    return _shorten(f"{type(error).__name__}: {error}")


def _shorten(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= 200 else f"{line[:199]}…"
