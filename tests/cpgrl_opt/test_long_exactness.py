"""Long vectors against exact rationals: what each rung of the ladder costs in digits."""

from fractions import Fraction

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, DirectionProblem, Status
from cpgrl_opt.vectors import _numpy as array_vectors

ACTIVE_SET = SOLVERS["active-set"]


@pytest.fixture(autouse=True)
def every_problem_is_long(monkeypatch):
    monkeypatch.setattr(array_vectors, "LEAST_PRODUCTS", 0)


def rational(array):
    return np.vectorize(Fraction, otypes=[object])(np.asarray(array, dtype=np.float64))


def exact_direction(problem, active):
    """g + Jᵀμ with J_A d = b_A, in rationals; rounded once."""
    g, J, b = (rational(each) for each in (problem.gradient, problem.jacobian[active], problem.bound[active]))
    A, rest = J @ J.T, b - J @ g
    for i in range(len(A)):
        for j in range(len(A)):
            if j != i:
                factor = A[j, i] / A[i, i]
                A[j], rest[j] = A[j] - factor * A[i], rest[j] - factor * rest[i]
    return (g + (rest / A.diagonal()) @ J).astype(np.float64) if len(A) else problem.gradient


def assert_exact(problem, answer, *, error):
    """d to `error` of its own length, on the face that the multipliers name."""
    exact = exact_direction(problem, np.flatnonzero(answer.multipliers))
    assert answer.status == Status.OPTIMAL
    assert np.linalg.norm(answer.value - exact) <= error * np.linalg.norm(exact)


def at_angle(theta, *, sign=-1.0, n=120):
    """Two rows that bind, the second at θ from opposing the first or from parallel; and a third."""
    first, second, third, fourth = np.linalg.qr(np.random.default_rng(5).standard_normal((n, 4)))[0].T
    rows = [5.0 * first, 3.0 * (sign * np.cos(theta) * first + np.sin(theta) * second), third - 0.4 * first]
    return fourth - 2.0 * second - third + 0.3 * sign * first, np.array(rows)


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
    assert_exact(problem, answer, error=2e-15 / (epsilon if answer.rung == "gramian" else 1.0))


@pytest.mark.parametrize("bound", [0.0, [0.3, -0.3, 0.1]])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("theta", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11])
def test_small_angles_between_rows_that_bind_cost_no_digits(theta, sign, bound):
    """Not even where b asks for d across the angle, of length 1/θ: what the coordinates round, K in pairs mends."""
    problem = DirectionProblem(*at_angle(theta, sign=sign), bound, True)
    answer = ACTIVE_SET.solve(problem)
    assert answer.rung == ("pairs" if theta > 3e-9 else "rows")
    assert_exact(problem, answer, error=max(1e-15, 1e-30 / theta**2))


def test_many_rows_that_nearly_depend_cost_no_digits():
    """Found by random search: 0.25 σ off, and OPTIMAL, when pivots of 1e-20 were taken for rows."""
    for seed, noise in enumerate((1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)):
        rng = np.random.default_rng(seed)
        J = rng.standard_normal((5, 2)) @ rng.standard_normal((2, 60)) + noise * rng.standard_normal((5, 60))
        problem = DirectionProblem(rng.standard_normal(60), J, J @ rng.standard_normal(60), True)
        answer = ACTIVE_SET.solve(problem)
        assert_exact(problem, answer, error=1e-13)
