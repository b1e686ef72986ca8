"""The compiled projection: exact on the hostile families, honest on infeasible ones, the same in batches."""

import itertools
from collections.abc import Callable
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest

from cpgrl_opt import DirectionProblem, Status, farkas_residual, kkt_residuals
from cpgrl_opt.solvers.exact_core import project

TOLERANCE = 1e-12  # of the optimality residuals; what the method promises
EXACT = 1e-13  # relative distance to an answer in rational arithmetic
ANGLES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-9)
Data = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def rng_for(*seed: int) -> np.random.Generator:
    return np.random.default_rng([20061119, *seed])


def rotation(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.linalg.qr(rng.normal(size=(n, n)))[0]


def solved(data: Data, *, tangent: bool = False, tolerance: float = TOLERANCE) -> SimpleNamespace:
    problem = DirectionProblem(*data)
    return SimpleNamespace(**vars(project(problem, tolerance, tangent=tangent)), problem=problem)


def inequalities(m: int) -> np.ndarray:
    return np.zeros(m, dtype=bool)


def touching(rng: np.random.Generator, J: np.ndarray) -> np.ndarray:
    """Bounds that a random point meets, about half of them exactly."""
    slack = np.abs(rng.normal(size=len(J))) * (rng.random(len(J)) < 0.5) * np.linalg.norm(J, axis=1)
    return J @ rng.normal(size=J.shape[1]) - slack


def gaussian(m: int, n: int, *, bounds: bool) -> Callable[[np.random.Generator], Data]:
    def draw(rng: np.random.Generator) -> Data:
        J = rng.normal(size=(m, n))
        return rng.normal(size=n), J, touching(rng, J) if bounds else np.zeros(m), inequalities(m)

    return draw


def angled(angle: float, side: float, *, bounds: bool, equality: bool = False) -> Callable[[np.random.Generator], Data]:
    """Two rows at an angle from parallel (side 1) or opposing (side −1), two more, rotated."""

    def draw(rng: np.random.Generator) -> Data:
        J = np.vstack([[1, 0, 0, 0, 0], [side * np.cos(angle), np.sin(angle), 0, 0, 0], rng.normal(size=(2, 5))])
        J = J @ rotation(rng, 5) * rng.choice([1.0, 3.7, 0.2], size=(4, 1))
        E = np.full(4, equality)
        b = touching(rng, J) if bounds and not equality else J @ rng.normal(size=5) * bounds
        return rng.normal(size=5), J, b, E

    return draw


def copies(rng: np.random.Generator) -> Data:
    """Copies of two rows, of either sign and any length, b = 0: implicit equalities."""
    J = rng.normal(size=(2, 5))[rng.integers(0, 2, size=6)] * rng.choice([1.0, -1.0, 1e3, -1e-5, np.pi], size=(6, 1))
    return rng.normal(size=5), J @ rotation(rng, 5), np.zeros(6), inequalities(6)


def sum_to_zero(rng: np.random.Generator) -> Data:
    J = rng.normal(size=(3, 6))
    J = np.vstack([J, -J.sum(axis=0), rng.normal(size=6)]) @ rotation(rng, 6)
    return rng.normal(size=6), J, np.zeros(5), inequalities(5)


def zero_rows(rng: np.random.Generator) -> Data:
    J = rng.normal(size=(4, 5)) * (rng.random((4, 1)) < 0.5)
    E = rng.random(4) < 0.3
    return rng.normal(size=5), J, np.where(E, 0.0, -rng.random(4)), E


def lengths_apart(rng: np.random.Generator) -> Data:
    g, J, b, E = gaussian(4, 9, bounds=True)(rng)
    length = 10.0 ** rng.choice([-12, -6, 0, 6, 12], size=4)
    return g, J * length[:, None], b * length, E


def only_the_origin(rng: np.random.Generator) -> Data:
    J = rng.normal(size=(4, 4))
    return rng.normal(size=4), np.vstack([J, -J.sum(axis=0), rng.normal(size=(2, 4))]), np.zeros(7), inequalities(7)


def integer_vertex(rng: np.random.Generator) -> Data:
    """Many integer rows through one integer point, some of them equalities."""
    J = rng.integers(-2, 3, size=(10, 3)).astype(float)
    b = J @ rng.integers(-3, 4, size=3)
    E = rng.random(10) < 0.2
    return rng.integers(-4, 5, size=3).astype(float), J, np.where(E, b, b - (rng.random(10) < 0.2)), E


def crowded_vertex(rng: np.random.Generator) -> Data:
    J, d = rng.normal(size=(30, 5)), rng.normal(size=5)
    return d - J.T @ np.abs(rng.normal(size=30)), J, J @ d, inequalities(30)


def mixed(rng: np.random.Generator) -> Data:
    J = rng.normal(size=(5, 6))
    J = np.vstack([J, 3.3 * J[0], -0.7 * J[2], J[0] - J[1]])
    b = J @ rng.normal(size=6)
    E = np.array([1, 1, 0, 0, 0, 1, 0, 1], dtype=bool)
    b[3:5] -= rng.random(2)
    return rng.normal(size=6), J, b, E


def far_slack(rng: np.random.Generator) -> Data:
    g, J, b, E = gaussian(5, 6, bounds=True)(rng)
    return g, J, np.where(rng.random(5) < 0.4, -(10.0 ** rng.uniform(3, 300, size=5)), b), E


def switched_off(rng: np.random.Generator) -> Data:
    g, J, b, E = gaussian(5, 6, bounds=True)(rng)
    return g, J, np.where(rng.random(5) < 0.5, -np.inf, b), E


def jointly_scaled(exponent: int, draw: Callable[[np.random.Generator], Data]) -> Callable[[np.random.Generator], Data]:
    def scaled(rng: np.random.Generator) -> Data:
        g, J, b, E = draw(rng)
        return g * 10.0**exponent, J * 10.0**exponent, b, E

    return scaled


FEASIBLE: dict[str, Callable[[np.random.Generator], Data]] = {
    **{
        f"gaussian {n} {m} {bounds}": gaussian(m, n, bounds=bounds)
        for (n, m), bounds in itertools.product(
            ((9, 3), (9, 5), (9, 8), (3, 5), (2, 6), (20, 10), (80, 2), (1000, 5)), (False, True)
        )
    },
    **{
        f"{'opposing' if side < 0 else 'parallel'} {angle:g} {bounds}": angled(angle, side, bounds=bounds)
        for angle, side, bounds in itertools.product(ANGLES, (1.0, -1.0), (False, True))
    },
    **{f"equalities {angle:g}": angled(angle, -1.0, bounds=True, equality=True) for angle in ANGLES},
    "copies": copies,
    "sum to zero": sum_to_zero,
    "zero rows": zero_rows,
    "lengths apart": lengths_apart,
    "only the origin": only_the_origin,
    "integer vertex": integer_vertex,
    "crowded vertex": crowded_vertex,
    "mixed": mixed,
    "far slack": far_slack,
    "switched off": switched_off,
    "one parameter": gaussian(4, 1, bounds=True),
    "no constraints": gaussian(0, 5, bounds=False),
    "no gradient": lambda rng: (np.zeros(6), *gaussian(4, 6, bounds=True)(rng)[1:]),
    "tiny gradient": lambda rng: (lambda g, J, b, E: (g * 1e-8, J, b * 1e-8, E))(*gaussian(4, 6, bounds=True)(rng)),
    **{
        f"times 1e{exponent} {name}": jointly_scaled(exponent, draw)
        for exponent in (170, -170)
        for name, draw in (
            ("gaussian", gaussian(4, 9, bounds=False)),
            ("opposing", angled(1e-6, -1.0, bounds=False)),
            ("only the origin", only_the_origin),
        )
    },
}


@pytest.mark.parametrize("family", FEASIBLE)
def test_every_feasible_problem_is_solved_to_the_referees_satisfaction(family: str) -> None:
    rng = rng_for(len(family))
    for _ in range(25):
        answer = solved(FEASIBLE[family](rng))
        assert answer.status == Status.OPTIMAL, answer
        assert kkt_residuals(answer.problem, answer).worst <= TOLERANCE, answer


@pytest.mark.slow
@pytest.mark.parametrize("family", FEASIBLE)
def test_a_thousand_problems_of_every_family_are_solved(family: str) -> None:
    rng = rng_for(1, len(family))
    for _ in range(1000):
        answer = solved(FEASIBLE[family](rng))
        assert answer.status == Status.OPTIMAL
        assert kkt_residuals(answer.problem, answer).worst <= TOLERANCE, answer


def rational_solution(A: list[list[Fraction]], b: list[Fraction]) -> list[Fraction] | None:
    """Gauss and Jordan; None if singular."""
    rows = [[*row, value] for row, value in zip(A, b, strict=True)]
    for i in range(len(rows)):
        pivot = next((k for k in range(i, len(rows)) if rows[k][i] != 0), None)
        if pivot is None:
            return None
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for k in range(len(rows)):
            if k != i:
                rows[k] = [x - rows[k][i] * y for x, y in zip(rows[k], rows[i], strict=True)]
    return [row[-1] for row in rows]


def rational_optimum(data: Data) -> np.ndarray:
    """The optimum of the problem as float64 states it, by trying every active set in exact arithmetic."""
    g, J, b = (np.vectorize(Fraction, otypes=[object])(array) for array in data[:3])
    E = data[3]
    for size in range(len(J) + 1):
        for chosen in itertools.combinations(range(len(J)), size):
            A = J[list(chosen)]
            mu = rational_solution((A @ A.T).tolist(), list(b[list(chosen)] - A @ g)) if size else []
            if mu is None or any(x < 0 and not E[i] for i, x in zip(chosen, mu, strict=True)):
                continue
            d = g + sum((x * J[i] for i, x in zip(chosen, mu, strict=True)), 0 * g)
            if (np.where(E, J @ d == b, J @ d >= b)).all():
                return d.astype(float)
    raise AssertionError("the problem should be feasible")


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("bounds", [False, True])
def test_nearly_opposing_rows_give_the_optimum_of_rational_arithmetic(angle: float, bounds: bool) -> None:
    rng = rng_for(2)
    for _ in range(4):
        data = angled(angle, -1.0, bounds=bounds)(rng)
        if bounds:  # away from the vertex, where rounding of b alone moves the optimum by eps/angle
            data = (data[0], data[1], np.minimum(data[2], 0.0) - 1e-3, data[3])
        exact = rational_optimum(data)
        assert np.linalg.norm(solved(data).value - exact) <= EXACT * max(1.0, np.linalg.norm(exact))


def test_integer_problems_give_the_optimum_of_rational_arithmetic() -> None:
    rng = rng_for(3)
    for _ in range(20):
        J = rng.integers(-2, 3, size=(5, 3)).astype(float)
        b = J @ rng.integers(-3, 4, size=3)
        data = rng.integers(-4, 5, size=3).astype(float), J, b, inequalities(5)
        exact = rational_optimum(data)
        assert np.linalg.norm(solved(data).value - exact) <= EXACT * max(1.0, np.linalg.norm(exact))


def opposing(violation: float) -> Callable[[np.random.Generator], Data]:
    """rᵀd ≥ b and −c·rᵀd ≥ −c·b + violation, other rows beside them."""

    def draw(rng: np.random.Generator) -> Data:
        J = rng.normal(size=(4, 5))
        J[1] = -3.0 * J[0]
        b = touching(rng, J)
        unit = max(1.0, np.abs(b).max() / np.linalg.norm(J, axis=1).min())
        b[1] = -3.0 * b[0] + 6.0 * violation * unit * np.linalg.norm(J[0])
        return rng.normal(size=5), J @ rotation(rng, 5), b, inequalities(4)

    return draw


def surrounded(rng: np.random.Generator) -> Data:
    J = rng.normal(size=(4, 4))
    J = np.vstack([J, -(rng.uniform(0.5, 2, size=4) @ J), rng.normal(size=4)])
    return rng.normal(size=4), J, np.append(J[:5] @ rng.normal(size=4) + rng.random(5), -50.0), inequalities(6)


def contradicting_equalities(rng: np.random.Generator) -> Data:
    J = rng.normal(size=(5, 3)) @ np.vstack([rng.normal(size=(2, 6)), np.zeros(6)])
    return rng.normal(size=6), J, rng.normal(size=5), np.ones(5, dtype=bool)


def walled_in(rng: np.random.Generator) -> Data:
    """Two rows 1e-8 from opposing leave room only beyond 1e8, and a third row closes it."""
    J = np.array([[1, 0, 0], [-np.cos(1e-8), np.sin(1e-8), 0], [0, -1, 0]]) @ rotation(rng, 3)
    return rng.normal(size=3), J, np.array([0.5 + rng.random(), 0.5 + rng.random(), -10.0]), inequalities(3)


INFEASIBLE: dict[str, Callable[[np.random.Generator], Data]] = {
    **{f"opposing by {violation:g}": opposing(violation) for violation in (1.0, 1e-4, 1e-8, 2e-9)},
    "surrounded": surrounded,
    "contradicting equalities": contradicting_equalities,
    "walled in": walled_in,
}


@pytest.mark.parametrize("family", INFEASIBLE)
def test_infeasible_problems_come_with_proof_and_the_least_violation(family: str) -> None:
    rng = rng_for(4, len(family))
    for _ in range(25):
        data = INFEASIBLE[family](rng)
        answer = solved(data)
        assert answer.status == Status.INFEASIBLE, answer
        assert farkas_residual(answer.problem, answer.multipliers) <= 1e-6
        _, J, b, E = data
        length = np.linalg.norm(J, axis=1)
        lack = (b - J @ answer.value) / length
        lack = np.where(E, lack, np.maximum(lack, 0.0))
        # the gradient of ½‖(b̂ − Ĵd)₊‖²
        assert np.linalg.norm((J / length[:, None]).T @ lack) <= 1e-12 * max(1.0, np.linalg.norm(answer.value))


def test_of_the_least_violating_directions_the_nearest_to_the_gradient_is_returned() -> None:
    rng = rng_for(5)
    for _ in range(25):
        g, J, b, E = opposing(0.3)(rng)
        answer = solved((g, J, b, E))
        lack = np.maximum(b - J @ answer.value, 0.0)
        nearest = solved((g, J, b - lack - 1e-9, E))
        assert np.linalg.norm(answer.value - nearest.value) <= 1e-6 * max(1.0, np.linalg.norm(g))


def test_a_zero_row_that_asks_for_something_is_the_proof() -> None:
    J = np.array([[1.0, 2.0], [0.0, 0.0]])
    answer = solved((np.array([-1.0, 0.0]), J, np.array([0.0, 1e-9]), inequalities(2)))
    assert answer.status == Status.INFEASIBLE
    np.testing.assert_array_equal(answer.multipliers, [0.0, 1.0])
    np.testing.assert_allclose(answer.value, [-0.8, 0.4])  # the projection under the rows that ask for the possible
