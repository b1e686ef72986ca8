"""A second opinion on metric and radius: the problem as CVXPY states it, solved by an interior-point method.

    maximize gᵀd  subject to  Jd ≥ b, = on E,  ‖Lᵀd‖ ≤ radius,  M = LLᵀ                     a second-order cone program
    minimize ½‖Lᵀd‖² − gᵀd  subject to  Jd ≥ b, = on E                                      without a radius

With κ = λ/radius, λ the ball's multiplier. Where the ball misses the constraints, or they contradict each other:

    minimize ‖v‖²  subject to  Ĵd + v ≥ b̂, = on E,  ‖Lᵀd‖ ≤ radius                          rows of unit length in M⁻¹

Nothing is whitened, reduced or polished. Source: Boyd & Vandenberghe, Convex Optimization, §4.4.2.
"""

import warnings

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, DirectionProblem, Status
from cpgrl_opt.solvers import obstacle

if why := obstacle(SOLVERS["cvxpy"]):
    pytest.skip(f"cvxpy is {why}", allow_module_level=True)
import cvxpy

ACTIVE_SET = SOLVERS["active-set"]
# CLARABEL stops at relative gaps of 1e-8, and on the sphere d is off by the square root of twice that.
ACCURACY = 3e-4


def draw(seed: int, radius: float | None, kind: str) -> DirectionProblem:
    """Gaussian data; of every four problems one with equalities and one with rows that contradict each other."""
    rng = np.random.default_rng([seed, 77])
    n, m = int(rng.integers(2, 9)), int(rng.integers(1, 6))
    J, b, E = rng.standard_normal((m, n)), 0.5 * rng.standard_normal(m), np.zeros(m, np.bool_)
    if seed % 4 == 1:
        E[: min(m, n) - 1] = True
    if seed % 4 == 2 and m > 1:
        J[-1], b[-1] = -2.0 * J[0], 0.3 - 2.0 * b[0]
    root = rng.standard_normal((n, n))
    metrics = {"none": None, "diagonal": 10.0 ** rng.uniform(-1, 1, n), "full": root @ root.T + 0.1 * np.eye(n)}
    return DirectionProblem(rng.standard_normal(n), J, b, E, metrics[kind], radius)


def matrix(problem: DirectionProblem) -> np.ndarray:
    M = np.ones(problem.n) if problem.metric is None else problem.metric
    return np.diag(M) if M.ndim == 1 else M


class Statement:
    """d, its length, and the constraints `rows` (d) ≥ b, = on E, with what each is a row of."""

    def __init__(self, problem: DirectionProblem) -> None:
        self.problem = problem
        self.d = cvxpy.Variable(problem.n)
        self.length = cvxpy.norm(np.linalg.cholesky(matrix(problem)).T @ self.d)
        self.ball = [] if problem.radius is None else [self.length <= problem.radius]

    def optimum(self) -> tuple[str, np.ndarray, float]:
        """(status, d, κ)."""
        p, climb = self.problem, self.problem.gradient @ self.d
        rows = signed(p, p.jacobian @ self.d, p.bound)
        goal = cvxpy.Maximize(climb) if self.ball else cvxpy.Minimize(0.5 * self.length**2 - climb)
        status = self.solve(goal, rows)
        kappa = float(self.ball[0].dual_value) / p.radius if self.ball and status == "optimal" else 0.0
        return status, self.d.value, kappa

    def least_violation(self) -> tuple[float, np.ndarray]:
        """(‖v‖, d)."""
        p = self.problem
        sizes = np.sqrt(np.einsum("ij,ij->i", p.jacobian, np.linalg.solve(matrix(p), p.jacobian.T).T))
        v = cvxpy.Variable(p.m)
        reached = (p.jacobian @ self.d) / sizes + v
        rows = signed(p, reached, p.bound / sizes)
        assert self.solve(cvxpy.Minimize(cvxpy.norm(v)), rows) == "optimal"
        return float(np.linalg.norm(v.value)), self.d.value

    def solve(self, goal: "cvxpy.problems.objective.Objective", rows: list) -> str:
        program = cvxpy.Problem(goal, [*rows, *self.ball])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its warning of what it calls inaccurate
            program.solve(solver=cvxpy.CLARABEL)
        return str(program.status)


def signed(problem: DirectionProblem, left: "cvxpy.Expression", right: np.ndarray) -> list:
    """left ≥ right on I, left = right on E, where there are such rows."""
    E = problem.equality
    return [left[~E] >= right[~E]] * bool((~E).any()) + [left[E] == right[E]] * bool(E.any())


def lack(problem: DirectionProblem, d: np.ndarray) -> float:
    """‖v‖ of a direction."""
    sizes = np.sqrt(np.einsum("ij,ij->i", problem.jacobian, np.linalg.solve(matrix(problem), problem.jacobian.T).T))
    missed = (problem.bound - problem.jacobian @ d) / sizes
    return float(np.linalg.norm(np.where(problem.equality, missed, np.maximum(missed, 0.0))))


@pytest.mark.parametrize("kind", ["none", "diagonal", "full"])
@pytest.mark.parametrize("radius", [None, 0.2, 1.0, 50.0])
def test_an_interior_point_method_finds_the_same_direction(radius: float | None, kind: str) -> None:
    met, unsure = set(), 0
    for seed in range(8):
        problem = draw(seed, radius, kind)
        answer, M = ACTIVE_SET.solve(problem), matrix(problem)
        status, d, kappa = Statement(problem).optimum()
        if status.endswith("inaccurate"):  # no opinion
            unsure += 1
            continue
        met.add(answer.status)
        assert (answer.status == Status.INFEASIBLE) == (status == "infeasible"), (seed, answer.status, status)
        if answer.status == Status.INFEASIBLE:
            least, _ = Statement(problem).least_violation()
            assert lack(problem, answer.value) == pytest.approx(least, rel=ACCURACY), seed
            if radius is not None:
                assert np.sqrt(answer.value @ M @ answer.value) <= radius * (1 + 1e-12)
            continue
        assert answer.status == Status.OPTIMAL
        unit = max(1e-3, float(np.sqrt(d @ M @ d)))
        assert problem.gradient @ answer.value == pytest.approx(problem.gradient @ d, rel=ACCURACY, abs=1e-6)
        assert np.sqrt((answer.value - d) @ M @ (answer.value - d)) <= ACCURACY * unit, seed
        assert answer.radius_multiplier == pytest.approx(kappa, rel=1e-3, abs=1e-5), seed
    assert unsure <= 1
    assert Status.OPTIMAL in met or radius == 0.2
    assert Status.INFEASIBLE in met


@pytest.mark.parametrize("kind", ["none", "full"])
def test_where_the_ball_is_slack_nothing_climbs_farther_and_nothing_as_far_is_shorter(kind: str) -> None:
    """max gᵀd s.t. gᵀd ≤ c and more: an interior-point method ends amid the best, `active-set` at the shortest."""
    for seed in range(4):
        problem = draw(4 * seed, 100.0, kind)
        wall = DirectionProblem(
            problem.gradient,
            np.vstack([problem.jacobian, -problem.gradient]),
            np.append(problem.bound - 1.0, -1.0),
            metric=problem.metric,
            radius=problem.radius,
        )
        answer, M = ACTIVE_SET.solve(wall), matrix(wall)
        status, d, _ = Statement(wall).optimum()
        assert (answer.status, status, answer.radius_multiplier) == (Status.OPTIMAL, "optimal", 0.0)
        assert wall.gradient @ answer.value == pytest.approx(wall.gradient @ d, rel=ACCURACY)
        shortest = Statement(
            DirectionProblem(np.zeros(wall.n), wall.jacobian, wall.bound, np.arange(wall.m) == wall.m - 1, wall.metric)
        )
        _, d, _ = shortest.optimum()
        assert np.sqrt((answer.value - d) @ M @ (answer.value - d)) <= ACCURACY * float(np.sqrt(d @ M @ d))
