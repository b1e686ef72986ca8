"""The exact answer of a small direction problem, in rational arithmetic on the float64 data: no rounding, no tolerance.

    for 𝒜 ⊆ {1 … m}:   J_𝒜 J_𝒜ᵀ μ = b_𝒜 − J_𝒜 g,   d = g + J_𝒜ᵀ μ

is the answer when μ ≥ 0 on I and Jd ≥ b (= on E): these conditions are sufficient, the problem being strictly convex,
and by Carathéodory's theorem some independent 𝒜 meets them wherever the problem is feasible. Where it is not, some
minimally dependent 𝒞 carries a Farkas vector: Jᵀy = 0, y ≥ 0 on I, bᵀy > 0.
Source: Nocedal & Wright, Numerical Optimization, Theorem 16.4; Rockafellar, Convex Analysis, §22 (elementary vectors).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations

import numpy as np

from ..arrays import Multipliers, Vector
from ..problem import DirectionProblem

MOST_EXACT_CONSTRAINTS = 8  # 2⁸ active sets
MOST_EXACT_PARAMETERS = 100  # exact products of rows of that length take milliseconds

Rationals = list[Fraction]


@dataclass(frozen=True, eq=False)
class ExactAnswer:
    """feasible: the verdict. direction: (n,), d* rounded once to float64, zeros where infeasible; multipliers: (m,),
    μ for that d*, or the Farkas vector where infeasible, rounded too.
    """

    feasible: bool
    direction: Vector
    multipliers: Multipliers


def is_small_enough(problem: DirectionProblem) -> bool:
    """Whether `exact_answer` takes the problem."""
    return problem.m <= MOST_EXACT_CONSTRAINTS and problem.n <= MOST_EXACT_PARAMETERS


def exact_answer(problem: DirectionProblem) -> ExactAnswer:
    """The optimum, or the proof that there is none. ValueError for more than 8 constraints or 100 parameters."""
    if not is_small_enough(problem):
        raise ValueError(
            f"problem should have m ≤ {MOST_EXACT_CONSTRAINTS} and n ≤ {MOST_EXACT_PARAMETERS}; "
            f"found m = {problem.m}, n = {problem.n}"
        )
    rational = _Rational(problem)
    for active in rational.candidates():
        multipliers = rational.multipliers(active)
        if multipliers is not None and rational.is_optimal(active, multipliers):
            weights = dict(zip(active, multipliers, strict=True))
            return ExactAnswer(True, _rounded(rational.direction(weights)), _spread(weights, problem.m))
    weights = rational.farkas()
    return ExactAnswer(False, np.zeros(problem.n), _spread(weights, problem.m))


class _Rational:
    """The problem in rationals: Gram matrix JJᵀ, lack b − Jg; rows that are switched off are left out."""

    def __init__(self, problem: DirectionProblem) -> None:
        self.n = problem.n
        self.rows = [i for i in range(problem.m) if problem.bound[i] > -np.inf]
        self.equality = {i for i in self.rows if problem.equality[i]}
        self.g = [Fraction(float(x)) for x in problem.gradient]
        self.J = {i: [Fraction(float(x)) for x in problem.jacobian[i]] for i in self.rows}
        self.b = {i: Fraction(float(problem.bound[i])) for i in self.rows}
        self.gram = {(i, j): _dot(self.J[i], self.J[j]) for i in self.rows for j in self.rows if j <= i}
        self.gram.update({(j, i): value for (i, j), value in list(self.gram.items())})
        self.lack = {i: self.b[i] - _dot(self.J[i], self.g) for i in self.rows}

    def candidates(self) -> Iterator[tuple[int, ...]]:
        """Every set of at most n rows, small ones first."""
        for size in range(min(self.n, len(self.rows)) + 1):
            yield from combinations(self.rows, size)

    def multipliers(self, active: Sequence[int]) -> Rationals | None:
        """μ on the active rows, None where they are dependent."""
        return _solved([[self.gram[i, j] for j in active] for i in active], [self.lack[i] for i in active])

    def is_optimal(self, active: Sequence[int], multipliers: Rationals) -> bool:
        """μ ≥ 0 on I, Jd ≥ b on I and Jd = b on E."""
        if any(value < 0 and i not in self.equality for i, value in zip(active, multipliers, strict=True)):
            return False
        for i in set(self.rows) - set(active):
            slack = sum((self.gram[i, j] * value for j, value in zip(active, multipliers, strict=True)), -self.lack[i])
            if slack < 0 or (slack > 0 and i in self.equality):
                return False
        return True

    def direction(self, weights: dict[int, Fraction]) -> Rationals:
        """g + Jᵀμ."""
        return [g + sum(w * self.J[i][k] for i, w in weights.items()) for k, g in enumerate(self.g)]

    def farkas(self) -> dict[int, Fraction]:
        """y on a minimally dependent set of rows; by Farkas' lemma there is one where no candidate was optimal."""
        for size in range(1, min(self.n + 1, len(self.rows)) + 1):
            for support in combinations(self.rows, size):
                y = self._elementary_vector(support)
                if y is not None:
                    return y
        raise AssertionError("Farkas' lemma fails: no active set is optimal, and none carries a proof")

    def _elementary_vector(self, support: Sequence[int]) -> dict[int, Fraction] | None:
        """y with J_𝒞ᵀy = 0, its last entry ±1, bᵀy > 0 and y ≥ 0 on I; None where there is none."""
        *others, last = support
        gram = [[self.gram[i, j] for j in others] for i in others]
        weights = _solved(gram, [-self.gram[i, last] for i in others])
        if weights is None:
            return None
        y = dict(zip(support, [*weights, Fraction(1)], strict=True))
        if any(sum(w * self.J[i][k] for i, w in y.items()) != 0 for k in range(self.n)):
            return None
        gain = sum(w * self.b[i] for i, w in y.items())
        y = {i: w if gain > 0 else -w for i, w in y.items()}
        proves = gain != 0 and all(w >= 0 or i in self.equality for i, w in y.items())
        return y if proves else None


def _dot(left: Rationals, right: Rationals) -> Fraction:
    return sum((x * y for x, y in zip(left, right, strict=True)), Fraction(0))


def _solved(matrix: list[Rationals], right: Rationals) -> Rationals | None:
    """x with matrix · x = right by Gauss–Jordan elimination; None where the matrix is singular."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for k in range(len(rows)):
        pivot = next((i for i in range(k, len(rows)) if rows[i][k] != 0), None)
        if pivot is None:
            return None
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(len(rows)):
            if i != k and rows[i][k] != 0:
                factor = rows[i][k]
                rows[i] = [value - factor * base for value, base in zip(rows[i], rows[k], strict=True)]
    return [row[-1] for row in rows]


def _rounded(values: Rationals) -> Vector:
    return np.array([float(value) for value in values])


def _spread(weights: dict[int, Fraction], m: int) -> Multipliers:
    spread = np.zeros(m)
    for i, value in weights.items():
        spread[i] = float(value)
    return spread
