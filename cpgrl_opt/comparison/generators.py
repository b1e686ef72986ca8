"""How the families' problems are made: one function of a generator each.

Feasible problems are built from a feasible point (b = Jd₀ − s, s > 0, or b = 0, which d = 0 meets), infeasible ones
from a Farkas vector (y ≥ 0 on I, Jᵀy = 0, bᵀy > 0), so that nothing is filtered and the right verdict is known.
"""

import numpy as np

from ..arrays import Jacobian, Multipliers
from ..problem import DirectionProblem

N, M = 9, 3  # the usual small case
_EXACT_STEP = 2.0**-20  # multiples of it of size ≤ 2³² add up without rounding


def well_conditioned(
    rng: np.random.Generator, n: int = N, m: int = M, *, bounds: bool = False, equality: bool = False
) -> DirectionProblem:
    """Gaussian rows and gradient."""
    J = rng.normal(size=(m, n))
    return _problem(rng, J, bounds=bounds, equality=equality)


def mixed(rng: np.random.Generator) -> DirectionProblem:
    """Two equalities among five Gaussian rows, with bounds."""
    return _problem(rng, rng.normal(size=(5, N)), bounds=True, equality=rng.permutation(5) < 2)


def angled(
    rng: np.random.Generator, angle: float, *, opposing: bool, bounds: bool = False, equality: bool = False
) -> DirectionProblem:
    """J₁ and J₂ at `angle` (rad) from parallel or from opposing, and a Gaussian row beside them."""
    basis = _rotation(rng, N)
    sign = -1.0 if opposing else 1.0
    J = np.stack([basis[0], sign * np.cos(angle) * basis[0] + np.sin(angle) * basis[1], rng.normal(size=N)])
    return _problem(rng, J * rng.uniform(0.5, 2.0, size=(3, 1)), bounds=bounds, equality=equality)


def duplicate(rng: np.random.Generator, *, bounds: bool = False, equality: bool = False) -> DirectionProblem:
    """Two rows, each twice, in lengths that differ by powers of two, so that they depend exactly."""
    J = _exact_rows(rng, 2, N)[[0, 1, 0, 1]] * 2.0 ** rng.integers(-3, 4, size=(4, 1))
    return _problem(rng, J, bounds=bounds, equality=equality)


def sum_to_zero(rng: np.random.Generator, *, bounds: bool = False, equality: bool = False) -> DirectionProblem:
    """J₁ + J₂ + J₃ = 0 exactly."""
    pair = _exact_rows(rng, 2, N)
    return _problem(rng, np.vstack([pair, -pair.sum(axis=0)]), bounds=bounds, equality=equality)


def zero_rows(rng: np.random.Generator, *, equality: bool = False) -> DirectionProblem:
    """A zero row that asks for nothing among three Gaussian ones."""
    J = rng.normal(size=(4, N))
    J[rng.integers(4)] = 0.0
    return _problem(rng, J, bounds=False, equality=equality)


def row_scales(rng: np.random.Generator, decades: int, *, bounds: bool = False) -> DirectionProblem:
    """Gaussian rows times 10^−decades, 1, 10^decades, in any order."""
    scales = 10.0 ** (decades * rng.permutation([-1.0, 0.0, 1.0]))
    return _problem(rng, rng.normal(size=(3, N)) * scales[:, None], bounds=bounds, equality=False)


def gradient_scale(rng: np.random.Generator, scale: float, *, bounds: bool = False) -> DirectionProblem:
    """(c g, c J, c² b) with Gaussian g and J: the direction is c times as long."""
    base = well_conditioned(rng, bounds=bounds)
    return DirectionProblem(base.gradient * scale, base.jacobian * scale, base.bound * scale * scale)


def degenerate_vertex(rng: np.random.Generator) -> DirectionProblem:
    """Eight small-integer rows through one integer point of ℝ³: every active set but few is degenerate."""
    J = rng.integers(-2, 3, size=(8, 3)).astype(np.float64)
    J[(J == 0).all(axis=1), 0] = 1.0
    vertex = rng.integers(-3, 4, size=3).astype(np.float64)
    return DirectionProblem(vertex - J.T @ rng.integers(0, 3, size=8), J, J @ vertex)


def cone_of_zero(rng: np.random.Generator, n: int = 4) -> DirectionProblem:
    """n + 1 rows that span ℝⁿ positively (Σ yᵢJᵢ = 0, y > 0), and one more: {d : Jd ≥ 0} = {0}."""
    J, _ = _positively_dependent(rng, n + 1, n)
    return DirectionProblem(rng.normal(size=n), np.vstack([J, rng.normal(size=n)])[rng.permutation(n + 2)])


def feasible_gradient(rng: np.random.Generator) -> DirectionProblem:
    """b = Jg − s, s > 0: nothing is to be done."""
    g, J = rng.normal(size=N), rng.normal(size=(M, N))
    return DirectionProblem(g, J, J @ g - _slack(rng, J))


def switched_off(rng: np.random.Generator) -> DirectionProblem:
    """Half of six rows have b = −∞, as in a batch of active sets."""
    base = well_conditioned(rng, m=6, bounds=True)
    off = rng.permutation(6) < 3
    return DirectionProblem(base.gradient, base.jacobian, np.where(off, -np.inf, base.bound))


def far_bounds(rng: np.random.Generator) -> DirectionProblem:
    """Half of six rows have b between −10³ and −10¹²: they never bind, but they spoil an absolute scale."""
    base = well_conditioned(rng, m=6, bounds=True)
    far = rng.permutation(6) < 3
    return DirectionProblem(
        base.gradient, base.jacobian, np.where(far, -(10.0 ** rng.uniform(3, 12, size=6)), base.bound)
    )


def infeasible(
    rng: np.random.Generator, support: int, gap: float, *, equality: bool = False, n: int = N
) -> DirectionProblem:
    """Σ yᵢĴᵢ = 0 over `support` rows, y > 0, and b̂ᵀy = gap · Σyᵢ: no d gives them all; a Gaussian row beside them.

    From d₀ outward: b = Jd₀ is the border, and every row of the support then asks for gap more (in units of ‖g‖).
    """
    J, _ = _positively_dependent(rng, support, n)
    J = np.vstack([J, rng.normal(size=n)])
    length = np.sqrt((J * J).sum(axis=1))
    # Jd₀ from d₀ on a coarse grid is exact on exact rows, so that the border is met to the last digit.
    point = np.round(rng.normal(size=n) * 8) / 8
    g = rng.normal(size=n)
    ask = np.where(np.arange(support + 1) < support, gap, -rng.uniform(0.1, 1.0)) * float(np.sqrt(g @ g)) * length
    order = rng.permutation(support + 1)
    return DirectionProblem(g, J[order], (J @ point + ask)[order], (np.arange(support + 1) < support)[order] & equality)


def infeasible_zero_row(rng: np.random.Generator) -> DirectionProblem:
    """0ᵀd ≥ b > 0."""
    base = well_conditioned(rng, m=4, bounds=True)
    J, b, row = base.jacobian.copy(), base.bound.copy(), int(rng.integers(4))
    J[row], b[row] = 0.0, 10.0 ** rng.uniform(-6, 1)
    return DirectionProblem(base.gradient, J, b)


def _problem(rng: np.random.Generator, J: Jacobian, *, bounds: bool, equality: bool | np.ndarray) -> DirectionProblem:
    """Rows in any order with a Gaussian gradient; b = 0, or b = Jd₀ on E and b = Jd₀ − s, s > 0, on I."""
    m, n = J.shape
    is_equality = np.full(m, equality) if np.ndim(equality) == 0 else np.asarray(equality)
    point = np.round(rng.normal(size=n) * 8) / 8
    b = J @ point - np.where(is_equality, 0.0, _slack(rng, J)) if bounds else np.zeros(m)
    order = rng.permutation(m)
    return DirectionProblem(rng.normal(size=n), J[order], b[order], is_equality[order])


def _slack(rng: np.random.Generator, J: Jacobian) -> Multipliers:
    """Positive, in units of each row's length."""
    slack: np.ndarray = rng.uniform(0.05, 1.0, size=len(J)) * np.sqrt((J * J).sum(axis=1))
    return slack


def _exact_rows(rng: np.random.Generator, m: int, n: int) -> Jacobian:
    """Gaussian rows on a grid fine enough to look Gaussian, coarse enough that small sums of them are exact."""
    rows: np.ndarray = np.round(rng.normal(size=(m, n)) / _EXACT_STEP) * _EXACT_STEP
    return rows


def _positively_dependent(rng: np.random.Generator, count: int, n: int) -> tuple[Jacobian, Multipliers]:
    """Rows J and weights y > 0 with Σ yᵢJᵢ = 0 exactly: y₁ … are powers of two, the last row closes the sum."""
    J = _exact_rows(rng, count - 1, n)
    y = np.append(2.0 ** rng.integers(-1, 2, size=count - 1), 1.0)
    return np.vstack([J, -(y[:-1] @ J)]), y


def _rotation(rng: np.random.Generator, n: int) -> Jacobian:
    Q, R = np.linalg.qr(rng.normal(size=(n, n)))
    return np.asarray(Q * np.sign(np.diag(R)))
