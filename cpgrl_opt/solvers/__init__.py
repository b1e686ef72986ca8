"""Direction solvers: one file per method, one line each in SOLVERS.

A new solver is a frozen dataclass of settings with a core, `solve_small(small) -> SmallAnswer`, on the base
`SmallSolver`, in a file here, and one line below.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any
from warnings import warn

from ..direction import Direction, DirectionBatch
from ..problem import DirectionProblem, ProblemBatch, require_problem
from ..validation import not_a_member
from .active_set import ActiveSet
from .enumeration import Enumeration
from .exact_core import compile_kernels
from .facts import DEFAULT_TOLERANCE, facts_of, supports, tolerance_of
from .interface import TRUSTED, DirectionSolver, referee, solve_stacked
from .nnls import NNLS
from .osqp import OSQP
from .packages import MissingPackageError, UnusablePackageError, has_package, is_installed, is_usable, obstacle
from .rosen import Rosen
from .rosen_drop import RosenDrop
from .through_cvxpy import CVXPY
from .through_qpsolvers import BACK_ENDS, QPSolversBackend
from .with_geometry import WithGeometry, ask_and_certify

SOLVERS: Mapping[str, DirectionSolver] = MappingProxyType(
    {
        "rosen": Rosen(),
        "rosen-drop": RosenDrop(),
        "active-set": ActiveSet(),
        "nnls": NNLS(),
        "enumeration": Enumeration(),
        "osqp": OSQP(),
        **{name: QPSolversBackend(name) for name in BACK_ENDS},
        "cvxpy": CVXPY(),
    }
)

# They, not their subclasses, certify what they claim themselves; anybody else's claims are put before the referee where
# they are used, on arrays that it never got hold of (see `interface`).
TRUSTED.update({type(solver) for solver in SOLVERS.values()}, {WithGeometry})


if not TYPE_CHECKING:  # which would believe in any attribute

    def __getattr__(name: str) -> Any:
        if name != "refereed":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        warn("cpgrl_opt.solvers.refereed is now cpgrl_opt.solvers.referee", DeprecationWarning, stacklevel=2)
        return referee


def solver_named(name: str) -> DirectionSolver:
    """SOLVERS[name], or a ValueError that lists the right names."""
    if name not in SOLVERS:
        raise not_a_member("solver", name, SOLVERS)
    return SOLVERS[name]


def solve(problem: DirectionProblem, solver: DirectionSolver | str = "active-set") -> Direction:
    """The direction of a problem by a solver or the name of one.

    Parameters
    ----------
    problem : DirectionProblem
    solver : one of SOLVERS' names, or an object with `solve`. What one that is not of SOLVERS claims is put before the
        referee; a problem that it does not take is UNSUPPORTED.

    Returns
    -------
    Direction : d, its multipliers, and a status that stands.
    """
    require_problem(problem)
    solver = problem.vectors.attempt(find_solver, solver) if problem.is_tree else find_solver(solver)
    return solver.solve(problem) if type(solver) in TRUSTED else ask_and_certify(solver, problem)


def solve_batch(
    solver: DirectionSolver | str, problems: ProblemBatch | Sequence[DirectionProblem], *, threads: int = 1
) -> DirectionBatch:
    """B problems of one shape by a solver or the name of one, by its own `solve_batch` where it has one.

    Parameters
    ----------
    solver, problems : as for `solve`; what a solver that is not of SOLVERS claims is put before the referee, and a
        problem that it does not take is UNSUPPORTED, unasked.
    threads : parts of the batch solved side by side, to the same bits; worth it where solving lets other threads run,
        as the compiled `active-set` and `rosen` do.

    Returns
    -------
    DirectionBatch : one direction a problem, rows of float64 whatever the gradients were. ValueError where the solver
        writes to the problems, or returns none.
    """
    solver = find_solver(solver)
    answers = solve_stacked(solver, problems, threads=threads)
    return answers if type(solver) in TRUSTED else referee(problems, answers, tolerance_of(solver))


def find_solver(solver: DirectionSolver | str) -> DirectionSolver:
    """The solver, or that of a name; ValueError for what is none."""
    if isinstance(solver, str):
        return solver_named(solver)
    if isinstance(solver, type) or not callable(getattr(solver, "solve", None)):
        raise ValueError(f"solver should be a name or have a method solve(problem); found {solver!r}")
    return solver


__all__ = [
    "CVXPY", "DEFAULT_TOLERANCE", "NNLS", "OSQP", "SOLVERS", "ActiveSet", "DirectionSolver", "Enumeration",
    "MissingPackageError", "QPSolversBackend", "Rosen", "RosenDrop", "UnusablePackageError", "WithGeometry",
    "compile_kernels", "facts_of", "find_solver", "has_package", "is_installed", "is_usable", "obstacle", "referee",
    "solve", "solve_batch", "solver_named", "supports", "tolerance_of",
]  # fmt: skip
