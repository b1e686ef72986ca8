"""The exact answer of a small direction problem, in rational arithmetic on the float64 data: no rounding, no tolerance.

    for 𝒜 ⊆ {1 … m}:   J_𝒜M⁻¹J_𝒜ᵀ μ = b_𝒜 − J_𝒜M⁻¹g,   d = M⁻¹(g + J_𝒜ᵀμ)

is the answer when μ ≥ 0 on I and Jd ≥ b (= on E): these conditions are sufficient, the problem being strictly convex,
and by Carathéodory's theorem some independent 𝒜 meets them wherever the problem is feasible. It is M⁻¹g and the
shortest point of {Jx ≥ b − JM⁻¹g}, see `faces`. Where there is none, some minimally dependent 𝒞 carries a Farkas
vector: Jᵀy = 0, y ≥ 0 on I, bᵀy > 0. In a ball: see `trust_region`.
Source: Nocedal & Wright, Numerical Optimization, Theorem 16.4; Rockafellar, Convex Analysis, §22 (elementary vectors).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from ..arrays import Multipliers, Vector
from ..problem import DirectionProblem
from .faces import Polyhedron
from .rational import RationalProblem, Weights, subsets, total
from .trust_region import exact_trust_region

MOST_EXACT_CONSTRAINTS = 8  # 2⁸ active sets
MOST_EXACT_PARAMETERS = 100  # exact products of rows of that length take milliseconds
MOST_EXACT_IN_FULL_METRIC = 20  # elimination of M in fractions that grow as it goes


@dataclass(frozen=True, eq=False)
class ExactAnswer:
    """feasible: the verdict. direction: (n,), d* rounded once to float64, zeros where infeasible; multipliers: (m,),
    μ for that d*, or the Farkas vector where infeasible, rounded too; zeros where a ball only touches, which leaves μ
    unbounded.
    """

    feasible: bool
    direction: Vector
    multipliers: Multipliers


def is_small_enough(problem: DirectionProblem) -> bool:
    """Whether `exact_answer` takes the problem."""
    is_full = problem.metric is not None and problem.metric.ndim == 2
    most = MOST_EXACT_IN_FULL_METRIC if is_full else MOST_EXACT_PARAMETERS
    return problem.m <= MOST_EXACT_CONSTRAINTS and problem.n <= most


def exact_answer(problem: DirectionProblem) -> ExactAnswer:
    """The optimum, or the proof that there is none.

    Parameters
    ----------
    problem
        At most 8 constraints and 100 parameters; 20 in a full metric, which has to be inverted.

    Returns
    -------
    ExactAnswer
        d* and μ, rounded once, at the end.

    Raises
    ------
    ValueError
        For a larger problem.
    """
    if not is_small_enough(problem):
        raise ValueError(
            f"problem should have m ≤ {MOST_EXACT_CONSTRAINTS} and n ≤ {MOST_EXACT_PARAMETERS}, or "
            f"{MOST_EXACT_IN_FULL_METRIC} in a full metric; found m = {problem.m}, n = {problem.n}"
        )
    if problem.radius is not None:
        found = exact_trust_region(problem)
        multipliers = np.zeros(problem.m) if found.multipliers is None else found.multipliers
        return ExactAnswer(found.feasible, found.direction if found.feasible else np.zeros(problem.n), multipliers)
    rational = RationalProblem(problem)
    rows, equality = rational.rows, rational.equality
    lack = {i: rational.b[i] - rational.pull[i] for i in rows}
    nearest = Polyhedron(rational, rows, lack, equality).shortest()  # of all d − M⁻¹g
    if nearest is None:
        return ExactAnswer(False, np.zeros(problem.n), _spread(_farkas(rational), problem.m))
    mu, _ = nearest
    direction = np.array([float(value) for value in rational.direction(mu, Fraction(1))])
    return ExactAnswer(True, direction, _spread(mu, problem.m))


def _farkas(rational: RationalProblem) -> Weights:
    """y on a minimally dependent set of rows; by Farkas' lemma there is one where no active set was optimal."""
    for support in subsets(rational.rows, rational.n + 1):
        y = _elementary_vector(rational, support) if support else None
        if y is not None:
            return y
    raise AssertionError("Farkas' lemma fails: no active set is optimal, and none carries a proof")


def _elementary_vector(rational: RationalProblem, support: Sequence[int]) -> Weights | None:
    """y with J_𝒞ᵀy = 0, its last entry ±1, bᵀy > 0 and y ≥ 0 on I; None where there is none."""
    *others, last = support
    weights = rational.solve_on(others, {i: -rational.gram[i, last] for i in others})
    if weights is None:
        return None
    y = weights | {last: Fraction(1)}
    if any(rational.along(i, y) != 0 for i in support):  # Ky = 0 is Jᵀy = 0, since yᵀKy is its square
        return None
    gain = total(rational.b, y)
    y = {i: w if gain > 0 else -w for i, w in y.items()}
    proves = gain != 0 and all(w >= 0 or i in rational.equality for i, w in y.items())
    return y if proves else None


def _spread(weights: Weights, m: int) -> Multipliers:
    spread = np.zeros(m)
    for i, value in weights.items():
        spread[i] = float(value)
    return spread
