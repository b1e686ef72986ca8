"""QP back ends, each with its own names for limits and tolerances; see `library_calls` for how they are called.

min ½xᵀx − cᵀx   s.t.   −A_I x ≤ −b_I,   A_E x = b_E
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any, ClassVar

from .base import SmallSolver
from .library_calls import call_clarabel, call_highs, call_quadprog, call_scs, call_through_qpsolvers
from .small_problem import Core, SmallAnswer, SmallProblem


@dataclass(frozen=True)
class BackEnd:
    """Where one back end comes from, and which of its options keep it in bounds.

    accuracy: its tolerances in units of ours, none of them below `least`; limits: its names for the limits of
    iterations and of seconds, as far as it has them; others: options that never change; iterations: their usual limit;
    call: what asks the library.
    """

    package: str
    source: str
    guarantee: str
    accuracy: Mapping[str, float]
    limits: tuple[str, ...]
    others: Mapping[str, Any]
    iterations: int
    call: Callable[[dict[str, Any], SmallProblem], SmallAnswer]
    least: float = 0.0
    extra: str = "solvers"

    def options(self, settings: Any) -> dict[str, Any]:
        """Keyword arguments of its solve function."""
        limit = self.iterations if settings.iteration_limit is None else settings.iteration_limit
        accuracy = {name: max(self.least, factor * settings.tolerance) for name, factor in self.accuracy.items()}
        return {**accuracy, **dict(zip(self.limits, (limit, settings.time_limit), strict=False)), **self.others}


_DUAL, _INTERIOR = "dual active set, certified or UNCERTIFIED", "interior point, polished"

BACK_ENDS: Mapping[str, BackEnd] = MappingProxyType(
    {
        "quadprog": BackEnd("quadprog", "Goldfarb & Idnani 1983", _DUAL, {}, (), {}, 0, call_quadprog, extra="gpl"),
        "daqp": BackEnd(
            "daqp", "Arnström et al. 2022", _DUAL,
            {"primal_tol": 1e-3, "dual_tol": 1e-3}, ("iter_limit", "time_limit"),
            # rows 1e-9 rad apart are two rows; the default of sing_tol joins what is closer than 1e-5
            {"sing_tol": 1e-20, "zero_tol": 1e-14}, 1000, partial(call_through_qpsolvers, "daqp"),
        ),
        "piqp": BackEnd(
            "piqp", "Schwan et al. 2023", _INTERIOR,
            {"eps_abs": 1e-2, "eps_duality_gap_abs": 1e-2}, ("max_iter",),
            {"eps_rel": 0.0, "eps_duality_gap_rel": 0.0}, 250, partial(call_through_qpsolvers, "piqp"),
        ),
        "proxqp": BackEnd(
            "proxsuite", "Bambade et al. 2022", "augmented Lagrangian, polished",
            {"eps_abs": 1e-1}, ("max_iter",), {"eps_rel": 0.0}, 200, partial(call_through_qpsolvers, "proxqp"),
        ),
        "clarabel": BackEnd(
            "clarabel", "Goulart & Chen 2024", _INTERIOR,
            {"tol_feas": 1e-2, "tol_gap_abs": 1e-2, "tol_gap_rel": 1e-2}, ("max_iter", "time_limit"),
            {"max_threads": 1}, 200, call_clarabel,
        ),
        "highs": BackEnd(
            "highspy", "Huangfu & Hall 2018", "primal active set, polished",
            {"primal_feasibility_tolerance": 1e-2, "dual_feasibility_tolerance": 1e-2},
            ("qp_iteration_limit", "time_limit"),
            {"qp_regularization_value": 0.0, "threads": 1}, 1000, call_highs, least=1e-10,  # it takes no less
        ),
        # Where τ of its embedding sinks to 0 in a long run, SCS prints "ERROR: could not determine problem status",
        # and no option forbids it. With one metric throughout and no extrapolation the iteration is nonexpansive and
        # τ stays; the rows have length 1, for which 10 converges about as fast as the scale that SCS would adapt.
        "scs": BackEnd(
            "scs", "O'Donoghue 2021", "first order (ADMM), polished",
            {"eps_abs": 1e-1}, ("max_iters", "time_limit_secs"),
            {"eps_rel": 0.0, "eps_infeas": 1e-9, "adaptive_scale": False, "acceleration_lookback": 0, "scale": 10.0},
            20000, call_scs,
        ),
    }
)  # fmt: skip


@dataclass(frozen=True)
class QPSolversBackend(SmallSolver):
    """One of qpsolvers' back ends on the small problem.

    name: a key of BACK_ENDS. tolerance: the worst KKT residual of an OPTIMAL answer; polish: project once more onto
    the face found. iteration_limit: of the back end, its own kind of iteration (None: the back end's in BACK_ENDS);
    time_limit: s. PIQP and ProxQP have none, so that only iteration_limit ends them; quadprog has neither, and nothing
    but its own finite method ends it. options: further keyword arguments for the back end, which win.
    """

    name: str
    tolerance: float = field(default=1e-8, kw_only=True)
    polish: bool = field(default=True, kw_only=True)
    iteration_limit: int | None = field(default=None, kw_only=True)
    time_limit: float = field(default=2.0, kw_only=True)
    options: Mapping[str, Any] = field(default_factory=dict, kw_only=True, hash=False)

    also_needs: ClassVar[tuple[str, ...]] = ("qpsolvers",)

    def __post_init__(self) -> None:
        """A wrong name is refused here, not at the first problem."""
        super().__post_init__()
        if self.name not in BACK_ENDS:
            raise ValueError(f"name should be one of {', '.join(BACK_ENDS)}; found {self.name!r}")

    package = property(lambda self: BACK_ENDS[self.name].package, doc="The package to import.")
    source = property(lambda self: BACK_ENDS[self.name].source, doc="Where the method comes from.")
    guarantee = property(lambda self: BACK_ENDS[self.name].guarantee, doc="What the method promises.")
    extra = property(lambda self: BACK_ENDS[self.name].extra, doc="The extra of ours that installs the package.")

    @cached_property
    def _call(self) -> Core:
        """The library's function with all options."""
        back_end = BACK_ENDS[self.name]
        return partial(back_end.call, {**back_end.options(self), **self.options})

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """The back end's x and μ."""
        return self._call(small)
