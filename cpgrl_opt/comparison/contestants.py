"""Who is compared: solvers of SOLVERS and people's own, behind our preparation and as the library alone."""

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from ..problem import DirectionProblem
from ..solvers import SOLVERS, is_installed, obstacle, supports
from ..validation import not_a_member
from .raw import RAW

DEFAULT_SOLVER = "active-set"  # whose time is 1


def solver_of(name: str) -> Any:
    """SOLVERS[name], or NAME of `package.module:NAME`, the current folder being importable.

    ValueError that lists the right names; whatever else the module raises on import is the module's.
    """
    if name in SOLVERS:
        return SOLVERS[name]
    module, colon, attribute = name.partition(":")
    if not colon:
        raise not_a_member("solver", name, SOLVERS, ", or package.module:SOLVER")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        home = import_module(module)
    except ModuleNotFoundError as error:
        if not f"{module}.".startswith(f"{error.name}."):  # another, which the module imports
            raise
        raise ValueError(f"solver should be package.module:SOLVER; found {name!r}: {error}") from error
    if not hasattr(home, attribute):
        raise ValueError(f"solver should be package.module:SOLVER; found no {attribute!r} in {module}")
    found = getattr(home, attribute)
    found = found() if isinstance(found, type) else found
    if not callable(getattr(found, "solve", None)):
        raise ValueError(f"{name} should have a method solve(problem); found {found!r}")
    return found


def installed(names: Iterable[str] | None) -> tuple[tuple[str, ...], Mapping[str, str]]:
    """(who is compared, {who is not: why not}); ValueError for a wrong name.

    None: all of SOLVERS that can be used. A solver that is asked for by name is left out only if it is not installed:
    where its package is broken, that is for the comparison to raise.
    """
    solvers = {name: solver_of(name) for name in (SOLVERS if names is None else names)}
    absent = {
        name: why
        for name, solver in solvers.items()
        if (why := obstacle(solver) if names is None or not is_installed(solver) else "")
    }
    return tuple(name for name in solvers if name not in absent), absent


def variants_of(name: str) -> Sequence[str]:
    """`prepared` for all, `raw` for what stands on a library that can be called without us."""
    return ("prepared", "raw") if name in RAW else ("prepared",)


def _is_quadratic_program(problem: DirectionProblem) -> bool:
    """What raw back ends are told: neither a ball, which is none, nor a metric, which they take only as a matrix."""
    return problem.metric is None and problem.radius is None


@dataclass(frozen=True)
class Contestant:
    """solve: what is called and timed, with nothing of ours around it; supports: whether it takes a problem."""

    solve: Callable[[DirectionProblem], Any]
    supports: Callable[[DirectionProblem], bool]


def contestant(name: str, variant: str) -> Contestant:
    """Solver `name` in a variant."""
    if variant == "raw":
        return Contestant(RAW[name], _is_quadratic_program)
    solver = solver_of(name)
    return Contestant(solver.solve, partial(supports, solver))
