"""A conformance kit for direction solvers: Hypothesis strategies, laws as plain functions, and a verdict.

    >>> from cpgrl_opt import SOLVERS
    >>> from cpgrl_opt.testing import check_direction_solver
    >>> check_direction_solver(SOLVERS["enumeration"], max_examples=5).passed
    True

In a test suite, one item for each solver and law:

    from cpgrl_opt.testing import parametrize_with_checks

    @parametrize_with_checks({"mine": MySolver()}, expected_failures={"mine": {"check_silence": "prints a banner"}})
    def test_laws(solver, check):
        check(solver)

or by hand, on any problem: `check_stationarity(solver, problem)` and its siblings raise `LawError`.
"""

from typing import TYPE_CHECKING, Any

try:
    import hypothesis  # noqa: F401 - so that its absence is told here, with what to type
except ModuleNotFoundError as error:
    raise ImportError(
        "cpgrl_opt.testing needs the package hypothesis, which is not installed; type: pip install 'cpgrl-opt[testing]'"
    ) from error

from ..problems import FAMILIES, Case, Family
from ..published.function_solver import FunctionSolver
from .claims import (
    check_claims_are_certified,
    check_feasible_is_not_called_infeasible,
    check_infeasible_is_called_infeasible,
    check_least_violation,
)
from .domain import supported_cases
from .invariance import (
    check_duplicate_row,
    check_inactive_row,
    check_permutation,
    check_rotation,
    check_row_scaling,
    check_scaling,
)
from .law import LawError, Outcome
from .laws import LAWS, Law
from .optimality import (
    check_agreement_with_enumeration,
    check_complementarity,
    check_dual_feasibility,
    check_gradient_kept_when_feasible,
    check_primal_feasibility,
    check_stationarity,
    check_zero_only_when_optimal,
)
from .projections import (
    check_firm_non_expansiveness,
    check_idempotence,
    check_non_expansiveness,
    check_restoration_is_normal,
    check_symmetry,
)
from .pytest_items import parametrize_with_checks
from .sensitivity import distance_bound, hoffman_constant
from .sequences import check_batch_is_loop, check_neighbours_change_nothing, check_warm_start_is_cold_start
from .shared_state import check_answers_stay, check_global_state_is_unchanged, check_threads_do_not_meet
from .side_effects import (
    check_answers_repeat,
    check_input_is_unchanged,
    check_non_finite_is_refused,
    check_silence,
)
from .strategies import (
    direction_problems,
    hostile_problems,
    infeasible_problems,
    problems_in_geometry,
    problems_of,
    problems_out_of_reach,
    well_posed_problems,
)
from .timing import check_time_is_in_proportion
from .verdict import CheckResult, Verdict, check_direction_solver

__all__ = [
    "FAMILIES",
    "LAWS",
    "Case",
    "CheckResult",
    "Family",
    "FunctionSolver",
    "Law",
    "LawError",
    "Outcome",
    "Verdict",
    "check_agreement_with_enumeration",
    "check_answers_repeat",
    "check_answers_stay",
    "check_batch_is_loop",
    "check_claims_are_certified",
    "check_complementarity",
    "check_direction_solver",
    "check_dual_feasibility",
    "check_duplicate_row",
    "check_feasible_is_not_called_infeasible",
    "check_firm_non_expansiveness",
    "check_global_state_is_unchanged",
    "check_gradient_kept_when_feasible",
    "check_idempotence",
    "check_inactive_row",
    "check_infeasible_is_called_infeasible",
    "check_input_is_unchanged",
    "check_least_violation",
    "check_neighbours_change_nothing",
    "check_non_expansiveness",
    "check_non_finite_is_refused",
    "check_permutation",
    "check_primal_feasibility",
    "check_restoration_is_normal",
    "check_rotation",
    "check_row_scaling",
    "check_scaling",
    "check_silence",
    "check_stationarity",
    "check_symmetry",
    "check_threads_do_not_meet",
    "check_time_is_in_proportion",
    "check_warm_start_is_cold_start",
    "check_zero_only_when_optimal",
    "direction_problems",
    "distance_bound",
    "hoffman_constant",
    "hostile_problems",
    "infeasible_problems",
    "parametrize_with_checks",
    "problems_in_geometry",
    "problems_of",
    "problems_out_of_reach",
    "supported_cases",
    "well_posed_problems",
]  # fmt: skip

if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        from warnings import warn

        if name != "LawBroken":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        warn("cpgrl_opt.testing.LawBroken is now LawError", DeprecationWarning, stacklevel=2)
        return LawError
