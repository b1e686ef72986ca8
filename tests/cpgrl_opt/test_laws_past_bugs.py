"""Problems that once broke a law, by the kit's own search: no installed solver may break it on them again."""

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, DirectionProblem, Status, farkas_residual
from cpgrl_opt.certify import least_violation_residual
from cpgrl_opt.solvers import is_installed
from cpgrl_opt.testing import check_claims_are_certified, check_non_finite_is_refused

INSTALLED = {name: solver for name, solver in SOLVERS.items() if is_installed(solver)}

# Inequalities 1e-12 rad from opposing: a certificate whose rounding differs from the referee's called it OPTIMAL.
ALMOST_OPPOSING = DirectionProblem(
    gradient=[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0],
    jacobian=[
        [0.0, 0.0, 0.0, 0.7071067811865475, -4.949747468305833, 0.0, 0.0, 0.0, 0.0],
        [3.111442253383356e-29, 0.0, 0.0, -0.424264068712642, 2.969848480983398, 0.0, 0.0, 0.0, 2.91214102869774e-12],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ],
)
# The same for equalities.
ALMOST_OPPOSING_EQUALITIES = DirectionProblem(
    gradient=[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    jacobian=[
        [-2.0412414523193156, 0.0, -2.041241452319315, 0.0, 4.08248290463863, 0.0, 0.0, 0.0, 0.0],
        [
            *(1.2247448713863465, 0.0, 1.2247448713913132, -6.622527313669953e-12, -2.449489742785938),
            *(0.0, 0.0, 0.0, -3.3112636568349767e-12),
        ],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    ],
    equality=True,
)
# Two equalities contradict each other; the inequalities beside them led scipy's nnls astray (scipy issue 25389).
CONTRADICTION = DirectionProblem(
    gradient=[7.0, -6.0, 0.0],
    jacobian=[[-7.0, 6.0, -1.0], [7.0, -6.0, 1.0], [-6.0, 5.0, -9.0], [7.0, -6.0, 0.0], [1.0, 2.0, -1.0]],
    bound=[37.0, -15.0, -41.0, -33.0, -26.0],
    equality=[True, True, False, False, False],
)
# −∞ · 0 warned in the referee.
SWITCHED_OFF_ZERO_ROW = DirectionProblem(
    gradient=[1.0, 0.0],
    jacobian=[[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0]],
    bound=[-np.inf, 1.0, 1.0],
)
PAST = {
    "almost opposing": ALMOST_OPPOSING,
    "almost opposing equalities": ALMOST_OPPOSING_EQUALITIES,
    "contradiction": CONTRADICTION,
    "switched-off zero row": SWITCHED_OFF_ZERO_ROW,
}


@pytest.mark.parametrize("problem", PAST.values(), ids=list(PAST))
@pytest.mark.parametrize("name", INSTALLED)
def test_every_claim_about_a_past_bug_is_certified(name, problem):
    check_claims_are_certified(INSTALLED[name], problem)


@pytest.mark.parametrize("name", INSTALLED)
def test_a_row_of_nan_and_zeros_is_no_zero_row(name):
    """max |Jᵢⱼ| forgot the NaN when a 0 came after it."""
    problem = DirectionProblem([0.0, 0.0], [[0.0, 0.0], [0.0, 0.0]], equality=name == "rosen")
    check_non_finite_is_refused(INSTALLED[name], problem, where="jacobian", value=float("nan"))


@pytest.mark.parametrize("name", [name for name in INSTALLED if not name.startswith("rosen")])
def test_the_contradiction_is_proven(name):
    """nnls ended at a point that was not optimal, and no proof was found."""
    answer = INSTALLED[name].solve(CONTRADICTION)
    assert answer.status == Status.INFEASIBLE
    assert farkas_residual(CONTRADICTION, answer.multipliers) <= 1e-12


def test_a_farkas_vector_on_harmless_zero_rows_proves_nothing():
    """0/0 in the referee."""
    harmless = DirectionProblem([0.0, 0.0], [[0.0, 0.0]], equality=True)
    assert farkas_residual(harmless, np.ones(1)) == np.inf


@pytest.mark.parametrize("name", [name for name in INSTALLED if not name.startswith("rosen")])
@pytest.mark.parametrize(
    ("column", "bound", "equality"),
    [
        ([0.0], [1.0], [False]),  # the kernel was called without a row, and its report read before it was written
        ([1.0, 2.0, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0], [False, False, True, False]),
        ([0.0, *[1.0] * 8], [1.0, *[0.0] * 6, -1.0, 0.0], [*[False] * 8, True]),
        ([0.0, *[1.0] * 11], [1.0, *[0.0] * 7, -1.0, 0.0, -1.0, 0.0], [*[False] * 11, True]),
    ],
)
def test_beside_a_zero_row_that_is_impossible_nothing_is_asked(name, column, bound, equality):
    """d = 0 came out as 1e-128, and the referee doubted that it violates least."""
    problem = DirectionProblem(np.zeros(3), np.outer(column, [1.0, 0.0, 0.0]), bound, equality)
    answer = INSTALLED[name].solve(problem)
    assert answer.status == Status.INFEASIBLE
    assert farkas_residual(problem, answer.multipliers) == 0.0
    np.testing.assert_array_equal(answer.value, np.zeros(3))


@pytest.mark.parametrize("name", [name for name in ("active-set", "nnls", "osqp", "piqp") if name in INSTALLED])
def test_what_is_called_infeasible_violates_least(name):
    """Rows 1e-7 … 1e-12 rad from opposing: a conflicting sub-answer was passed on, far from the least."""
    rng, judged = np.random.default_rng(7), 0
    for _ in range(60 if name == "active-set" else 15):
        m, n = int(rng.integers(2, 6)), int(rng.integers(2, 5))
        rows = rng.normal(size=(m, n))
        rows[1] = -rows[0] + 10.0 ** rng.integers(-12, -5) * rng.normal(size=n)
        problem = DirectionProblem(
            rng.normal(size=n), rows, rng.normal(size=m) * 10.0 ** rng.integers(-3, 4, size=m), rng.random(m) < 0.25
        )
        answer = INSTALLED[name].solve(problem)
        if answer.status == Status.INFEASIBLE:
            judged += 1
            assert least_violation_residual(problem, answer.value) <= 1e-6
    assert judged >= 1
