"""What a solver says of itself, read in one place: ours in class variables, a third party's in whatever it has."""

from inspect import signature
from typing import Any

import numpy as np

from ..problem import DirectionProblem
from ..settings import require_tolerance

DEFAULT_TOLERANCE = 1e-6  # of a third party's solver that states none
_LEAST_IN_SINGLE = 4 * 2.0**-23  # rounding d to float32 leaves half an eps of each number, and as much in a product


class Facts:
    """The facts of one solver; what it does not declare has the value that a plain cone solver would give.

    is_single: whether it computes in float32, dtype = "float32"; takes_geometry: whether it takes problems with a
    metric or a radius; finds_infeasible: whether it calls INFEASIBLE what is; has_batch: whether it has a `solve_batch`
    of its own; declines_by_itself: whether that calls UNSUPPORTED what `supports` does not take; packages: its
    `package` and what else it stands on in `also_needs`, nothing for a solver that names none.
    """

    def __init__(self, solver: Any) -> None:
        self.solver = solver
        self.is_single = is_single(getattr(solver, "dtype", None))
        self.takes_geometry = bool(getattr(solver, "takes_geometry", False))
        self.finds_infeasible = bool(getattr(solver, "finds_infeasible", True))
        self.has_batch = getattr(solver, "solve_batch", None) is not None
        self.declines_by_itself = self.has_batch and bool(getattr(solver, "declines_by_itself", False))
        named = (getattr(solver, "package", None), *getattr(solver, "also_needs", ()))
        self.packages = named if named[0] is not None else ()

    @property
    def has_warm_start(self) -> bool:
        """Whether it has a `session` with a setting warm_start."""
        session = getattr(self.solver, "session", None)
        return session is not None and "warm_start" in signature(session).parameters

    def supports(self, problem: DirectionProblem) -> bool:
        """Whether it takes this problem; one that declares nothing takes equalities, the cone and bounds.

        A metric or a radius only where it has `takes_geometry = True`: a `supports` that was written without a thought
        of them takes them for nothing.
        """
        if (problem.metric is not None or problem.radius is not None) and not self.takes_geometry:
            return False
        declared = getattr(self.solver, "supports", None)
        found = True if declared is None else declared(problem)
        if not isinstance(found, bool | np.bool_):
            raise ValueError(f"supports should return True or False; found {found!r}, from {self.solver!r}")
        return bool(found)


def facts_of(solver: Any) -> Facts:
    """What the solver says of itself."""
    return Facts(solver)


def tolerance_of(solver: Any) -> float:
    """The worst KKT residual that the solver allows an OPTIMAL answer; ValueError unless in (0, 1e-3].

    At least 4 eps of float32 where the solver says that it computes in it.
    """
    declared = getattr(solver, "tolerance", DEFAULT_TOLERANCE)
    require_tolerance(declared)
    return max(float(declared), _LEAST_IN_SINGLE if is_single(getattr(solver, "dtype", None)) else 0.0)


def supports(solver: Any, problem: DirectionProblem) -> bool:
    """`facts_of(solver).supports(problem)`."""
    return Facts(solver).supports(problem)


def is_single(dtype: Any) -> bool:
    """Whether it is float32: a name, or NumPy's, PyTorch's or JAX's."""
    return str(dtype).rpartition(".")[2].strip("'<>") == "float32"
