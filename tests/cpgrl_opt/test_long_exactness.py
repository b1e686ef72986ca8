"""Long vectors against exact rationals, rung by rung; and the referee in passes against the referee on the rows."""

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.vectors import is_long

from .long import at_angle, drawn_problem, on_rows, rational, solve_exactly

pytestmark = pytest.mark.usefixtures("every_problem_is_long")
ACTIVE_SET = SOLVERS["active-set"]
WIDE = np.random.default_rng(3).standard_normal((8, 300))


def require_exact(problem, answer, *, error):
    """d to `error` of its own length, on the face that the multipliers name: g + Jᵀμ with J_A d = b_A, in rationals."""
    active = np.flatnonzero(answer.multipliers)
    g, J, b = (rational(each) for each in (problem.gradient, problem.jacobian[active], problem.bound[active]))
    exact = (g + solve_exactly(J @ J.T, b - J @ g) @ J).astype(np.float64) if len(active) else problem.gradient
    assert answer.status == Status.OPTIMAL
    assert np.linalg.norm(answer.value - exact) <= error * np.linalg.norm(exact)


@pytest.mark.parametrize(("epsilon", "rung"), [(10.0**-k, "gramian" if k < 4 else "pairs") for k in range(1, 13)])
def test_a_direction_much_shorter_than_the_gradient_is_exact(epsilon, rung):
    """‖d‖ = ε‖g‖: rung 1 is exact to rounding of g, the second to rounding of d."""
    rng = np.random.default_rng(1)
    J = rng.standard_normal((3, 100))
    outside = rng.standard_normal(100)
    outside -= np.linalg.pinv(J) @ (J @ outside)
    g = -np.array([1.0, 2.0, 1.0]) @ J
    problem = DirectionProblem(g + epsilon * np.linalg.norm(g) / np.linalg.norm(outside) * outside, J)
    answer = ACTIVE_SET.solve(problem)
    assert answer.rung == rung or epsilon == 1e-4
    assert np.linalg.norm(answer.value) == pytest.approx(epsilon * np.linalg.norm(g), rel=1e-3)
    require_exact(problem, answer, error=2e-15 / (epsilon if answer.rung == "gramian" else 1.0))


@pytest.mark.parametrize("bound", [0.0, [0.3, -0.3, 0.1]])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("theta", 10.0 ** -np.arange(2, 12))
def test_small_angles_between_rows_that_bind_cost_no_digits(theta, sign, bound):
    """Not even where b asks for d across the angle, of length 1/θ: what the coordinates round, K in pairs mends."""
    problem = DirectionProblem(*at_angle(theta, sign=sign), bound, True)
    answer = ACTIVE_SET.solve(problem)
    assert answer.rung == ("pairs" if theta > 3e-9 else "rows")
    require_exact(problem, answer, error=max(1e-15, 1e-30 / theta**2))


@pytest.mark.parametrize("noise", [1e-6, 1e-8, 1e-9, 1e-11])
def test_many_rows_that_nearly_depend_cost_no_digits(noise):
    """Found by random search: 0.25 σ off, and OPTIMAL, when pivots of 1e-20 were taken for rows."""
    rng = np.random.default_rng(round(-np.log10(noise)) - 6)
    J = rng.standard_normal((5, 2)) @ rng.standard_normal((2, 60)) + noise * rng.standard_normal((5, 60))
    problem = DirectionProblem(rng.standard_normal(60), J, J @ rng.standard_normal(60), True)
    require_exact(problem, ACTIVE_SET.solve(problem), error=1e-13)


def some_answers(problem):
    """Right, wrong in each way, with multipliers that all but cancel, and not finite."""
    right = ACTIVE_SET.solve(problem)
    d, mu = right.value, right.multipliers
    yield from ((d, mu), (d + 1e-6 * problem.gradient, mu), (d, mu + 1e-6), (d, -mu - 1.0))
    yield from ((d, mu - (np.arange(len(mu)) == 1)), (np.zeros_like(d), np.zeros_like(mu)), (1e160 * d, mu))
    for size in (1e3, 1e9, 1e11, 1e15):
        yield d, mu + size * (np.arange(len(mu)) == 0)
        yield d + size * problem.jacobian[0] + problem.gradient, mu + size * (np.arange(len(mu)) == 0)
    for bad in (np.nan, np.inf):
        yield np.where(np.arange(len(d)) == 5, bad, d), mu
        yield d, np.where(np.arange(len(mu)) == 1, bad, mu)


def scaled(*sizes):
    return WIDE[1:4] * np.array(sizes)[:, None]


PROBLEMS_TO_JUDGE = {
    "generic": lambda: drawn_problem(0, equality=[True, False, False, False]),
    "off": lambda: DirectionProblem(WIDE[0], WIDE[1:4], [0.3, -np.inf, -1.0]),
    "zero rows": lambda: DirectionProblem(WIDE[0], scaled(1.0, 0.0, 1.0), [0.3, -1.0, 0.0]),
    "zero row that asks": lambda: DirectionProblem(WIDE[0], scaled(1.0, 0.0, 1.0), [0.3, 1.0, 0.0]),
    "zero gradient": lambda: DirectionProblem(0 * WIDE[0], WIDE[1:4]),
    "row scales": lambda: DirectionProblem(WIDE[0], scaled(1e100, 1e-100, 1.0), [1e100, 0.0, -1.0]),
    "beyond squares": lambda: DirectionProblem(WIDE[0], scaled(1e170, 1e-170, 1.0), [1e170, 0.0, -1.0]),
}


@pytest.mark.parametrize("name", PROBLEMS_TO_JUDGE)
def test_the_referee_says_the_same_of_long_problems_as_on_the_rows(name):
    problem = PROBLEMS_TO_JUDGE[name]()
    assert is_long(problem.m, problem.n)
    for d, mu in some_answers(problem):
        answer = Direction(d, mu, Status.OPTIMAL)
        found = kkt_residuals(problem, answer)
        with on_rows():
            on_the_rows = DirectionProblem(problem.gradient, problem.jacobian, problem.bound, problem.equality)
            expected = kkt_residuals(on_the_rows, answer)
        for part in ("stationarity", "primal", "dual", "complementarity"):
            assert getattr(found, part) == pytest.approx(getattr(expected, part), rel=1e-6, abs=2e-14), (part, mu)


@pytest.mark.parametrize(
    ("gradient_size", "row_size", "bound", "d", "residual"),
    [
        (1.0, 1e-200, 1e-200, -1.0, 1.0),
        (1e-200, 1.0, -1.0, 1e-200, 2.0),
        (1e-200, 1.0, -1.0, 0.0, 1.0),
        (1e130, 0.0, 1e-200, -1e130, np.inf),  # 0 · ∞ made NaN of the residual, which a maximum hides
    ],
)
def test_squares_that_underflow_hide_no_error(gradient_size, row_size, bound, d, residual):
    first, second = np.eye(2, 20)
    problem = DirectionProblem(-gradient_size * second, row_size * first[None], bound)
    assert kkt_residuals(problem, Direction(d * second, np.zeros(1), Status.OPTIMAL)).worst == residual
