"""Direction problems in rational arithmetic: the float64 data as fractions, inner products, linear equations.

    K = JM⁻¹Jᵀ,   c = JM⁻¹g,   gᵀM⁻¹g;      d = M⁻¹(αg + Jᵀy):   Jd = αc + Ky,   dᵀMd = α²gᵀM⁻¹g + 2αcᵀy + yᵀKy

are all that a search over active sets needs to know: whatever the metric, it runs in the coordinates (α, y).
"""

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import combinations

import numpy as np

from ..problem import DirectionProblem

Rationals = list[Fraction]
Weights = dict[int, Fraction]  # of rows


class RationalProblem:
    """K, c, gᵀM⁻¹g and b of the module's head, as dictionaries by rows; rows that are switched off are left out."""

    def __init__(self, problem: DirectionProblem) -> None:
        self.n = problem.n
        self.m = problem.m
        self.rows = [i for i in range(problem.m) if problem.bound[i] > -np.inf]
        self.equality = {i for i in self.rows if problem.equality[i]}
        g, J = fractions_of(problem.gradient), {i: fractions_of(problem.jacobian[i]) for i in self.rows}
        lifted = _divided_by_metric(problem, [g, *J.values()])
        self.lifted_g, self.lifted = lifted[0], dict(zip(self.rows, lifted[1:], strict=True))
        self.b = {i: Fraction(float(problem.bound[i])) for i in self.rows}
        self.gram = {(i, j): dot(J[i], self.lifted[j]) for i in self.rows for j in self.rows if j <= i}
        self.gram.update({(j, i): value for (i, j), value in list(self.gram.items())})
        self.pull = {i: dot(self.lifted[i], g) for i in self.rows}
        self.strength = dot(self.lifted_g, g)

    def direction(self, weights: Weights, climb: Fraction) -> Rationals:
        """M⁻¹(αg + Jᵀy)."""
        terms = [(y, self.lifted[i]) for i, y in weights.items() if y]
        return [climb * g + sum(y * row[k] for y, row in terms) for k, g in enumerate(self.lifted_g)]

    def matrix(self, rows: Sequence[int], columns: Sequence[int]) -> list[Rationals]:
        """A block of K."""
        return [[self.gram[i, j] for j in columns] for i in rows]

    def along(self, i: int, weights: Weights) -> Fraction:
        """(Ky)ᵢ."""
        return sum((self.gram[i, j] * y for j, y in weights.items()), Fraction(0))

    def solve_on(self, rows: Sequence[int], right: Mapping[int, Fraction]) -> Weights | None:
        """y with Ky = right on these rows; None where they are dependent."""
        y = solve(self.matrix(rows, rows), [right[i] for i in rows])
        return None if y is None else dict(zip(rows, y, strict=True))

    def independent(self, rows: Sequence[int]) -> list[int]:
        """The first independent ones."""
        basis = list[int]()
        for i in rows:
            if self.solve_on([*basis, i], self.b) is not None:
                basis.append(i)
        return basis


def total(numbers: Mapping[int, Fraction], weights: Weights) -> Fraction:
    """Σ numbersᵢ yᵢ."""
    return sum((numbers[i] * y for i, y in weights.items()), Fraction(0))


def subsets(rows: Sequence[int], most: int) -> Iterator[tuple[int, ...]]:
    """Every set of at most that many rows, small ones first."""
    for size in range(min(most, len(rows)) + 1):
        yield from combinations(rows, size)


def fractions_of(values: np.ndarray) -> Rationals:
    """The float64 numbers as they are, without rounding."""
    return [Fraction(float(value)) for value in values]


def dot(left: Rationals, right: Rationals) -> Fraction:
    """Σ xᵢyᵢ."""
    return sum((x * y for x, y in zip(left, right, strict=True)), Fraction(0))


def solve(matrix: list[Rationals], right: Rationals) -> Rationals | None:
    """x with matrix · x = right; None where the matrix is singular."""
    solution = solve_all(matrix, [right])
    return None if solution is None else solution[0]


def solve_all(matrix: list[Rationals], rights: list[Rationals]) -> list[Rationals] | None:
    """The x with matrix · x = right for each of several, by Gauss–Jordan elimination; None where it is singular."""
    rows = [[*row, *(right[k] for right in rights)] for k, row in enumerate(matrix)]
    count = len(rows)
    for k in range(count):
        pivot = next((i for i in range(k, count) if rows[i][k] != 0), None)
        if pivot is None:
            return None
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(count):
            if i != k and rows[i][k] != 0:
                factor = rows[i][k]
                rows[i] = [value - factor * base for value, base in zip(rows[i], rows[k], strict=True)]
    return [[row[count + j] for row in rows] for j in range(len(rights))]


def _divided_by_metric(problem: DirectionProblem, vectors: list[Rationals]) -> list[Rationals]:
    """M⁻¹v of each."""
    metric = problem.metric
    if metric is None:
        return vectors
    if metric.ndim == 1:
        diagonal = fractions_of(metric)
        return [[x / weight for x, weight in zip(vector, diagonal, strict=True)] for vector in vectors]
    solutions = solve_all([fractions_of(row) for row in metric], vectors)
    if solutions is None:
        raise ValueError("metric should be positive definite; found a singular matrix")
    return solutions
