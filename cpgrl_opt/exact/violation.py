"""The least violation of rows that cannot be met, in a ball or without one, in rational arithmetic.

    min Σ wᵢrᵢ²,   r = (b − Jd)₊ (signed on E),   wᵢ = 1/(JᵢM⁻¹Jᵢᵀ)   s.t.   dᵀMd ≤ radius²

Without the ball JᵀWr = 0, a regression on the rows that are violated. If the ball holds d back, JᵀWr = λMd with λ > 0:

    (K + λW⁻¹)y = b,   d = M⁻¹Jᵀy,   r = λW⁻¹y

on these rows, and ‖d(λ)‖ = radius is solved for λ to 60 digits, each d(λ) being exact; ‖d(λ)‖ falls with λ.
Source: Moré & Sorensen 1983 (the equation for λ); Nocedal & Wright, Numerical Optimization, §4.3.
"""

from collections.abc import Sequence
from fractions import Fraction

from .faces import DIGITS, Polyhedron, root
from .rational import Weights, solve, subsets, total

_FARTHER = 2**20  # from one trial λ to the next, until the radius is between two


def least_lack(constraints: Polyhedron) -> Weights:
    """r ≠ 0 of least Σ wᵢrᵢ² over all d: JᵀWr = 0, r ≥ 0 on I, and some d lacks just that."""
    problem = constraints.problem
    free = [i for i in constraints.rows if i not in constraints.equality]
    for chosen in subsets(free, len(free)):
        violated = sorted({*chosen, *(i for i in constraints.rows if i in constraints.equality)})
        lack = _regression(constraints, violated)
        if any(lack[i] < 0 for i in chosen):
            continue
        held = {i: constraints.b[i] - lack.get(i, Fraction(0)) for i in constraints.rows}
        if Polyhedron(problem, constraints.rows, held, {*violated}).shortest() is not None:
            return {i: value for i, value in lack.items() if value}
    raise AssertionError("the least violation should be attained; found no set of violated rows")


def _regression(constraints: Polyhedron, rows: Sequence[int]) -> Weights:
    """r = b − Jd of the weighted regression of b on the rows, each counting as if its length were 1."""
    problem, gram = constraints.problem, constraints.problem.gram
    basis = problem.independent(rows)
    normal = [[sum((gram[i, k] * gram[k, j] / gram[k, k] for k in rows), Fraction(0)) for j in basis] for i in basis]
    right = [sum((gram[i, k] * constraints.b[k] / gram[k, k] for k in rows), Fraction(0)) for i in basis]
    solution = solve(normal, right)
    assert solution is not None
    y = dict(zip(basis, solution, strict=True))
    return {k: constraints.b[k] - problem.along(k, y) for k in rows}


def held_back(constraints: Polyhedron, square: Fraction) -> tuple[Weights, Fraction]:
    """(y, λ) with d = M⁻¹Jᵀy, y = Wr/λ and ‖d‖ = radius, for the ball that misses the points of least violation."""
    low, high = Fraction(1), Fraction(1)
    face: tuple[int, ...] = ()
    while _size(constraints, low, face)[0] <= square:
        low /= _FARTHER
    while _size(constraints, high, face)[0] > square:
        high *= _FARTHER
    width = Fraction(1, 2**DIGITS)
    while high - low > width * low:
        middle = (low + high) / 2 if high < 2 * low else root(low * high)
        middle = _shortened(middle)
        if not low < middle < high:
            break
        size, y, face = _size(constraints, middle, face)
        guess = _newton(constraints, y, middle, square) if high < 2 * low else None
        for trial in (middle, *((guess * (1 - width), guess * (1 + width)) if guess is not None else ())):
            if low < trial < high:
                size, y, face = _size(constraints, trial, face)
                low, high = (trial, high) if size > square else (low, trial)
    _, y, _ = _size(constraints, low, face)
    return y, low


def _size(constraints: Polyhedron, weight: Fraction, guess: Sequence[int]) -> tuple[Fraction, Weights, tuple[int, ...]]:
    """(‖d(λ)‖², y, rows in force) of min ½Σ wᵢrᵢ² + ½λ‖d‖²; guess: a set of rows that is tried first."""
    equal = [i for i in constraints.rows if i in constraints.equality]
    free = [i for i in constraints.rows if i not in constraints.equality]
    for chosen in (tuple(guess), *subsets(free, len(free))):
        rows = sorted({*chosen, *equal})
        y = _softened(constraints, rows, weight)
        if all(y[i] >= 0 for i in chosen) and all(
            constraints.problem.along(i, y) >= constraints.b[i] for i in free if i not in chosen
        ):
            return total({i: constraints.problem.along(i, y) for i in rows}, y), y, chosen
    raise AssertionError("a strictly convex problem should have an answer; found no set of rows")


def _softened(constraints: Polyhedron, rows: Sequence[int], weight: Fraction) -> Weights:
    """y with (K + λW⁻¹)y = b on the rows."""
    return _solve_softened(constraints, rows, weight, [constraints.b[i] for i in rows])


def _solve_softened(constraints: Polyhedron, rows: Sequence[int], weight: Fraction, right: list[Fraction]) -> Weights:
    """y with (K + λW⁻¹)y = right, which is definite."""
    K = constraints.problem.matrix(rows, rows)
    for k, i in enumerate(rows):
        K[k][k] += weight * constraints.problem.gram[i, i]
    y = solve(K, right)
    assert y is not None
    return dict(zip(rows, y, strict=True))


def _newton(constraints: Polyhedron, y: Weights, weight: Fraction, square: Fraction) -> Fraction | None:
    """The root of ‖d(λ)‖² = radius² on the face of y, by Newton's method from λ; None where it does not get there."""
    rows, problem = list(y), constraints.problem
    for _ in range(12):
        y = _softened(constraints, rows, weight)
        pulled = {i: problem.along(i, y) for i in rows}
        change = _solve_softened(constraints, rows, weight, [problem.gram[i, i] * y[i] for i in rows])
        slope = -2 * total(pulled, change)
        if slope == 0:
            return None
        step = (total(pulled, y) - square) / slope
        if weight - step <= 0:
            return None
        weight = _shortened(weight - step)
        if abs(step) <= weight / 2 ** (DIGITS + 20):
            return weight
    return None


def _shortened(value: Fraction) -> Fraction:
    """The same to 90 digits: the numbers of an iteration do not grow."""
    shift = DIGITS * 3 // 2 - (value.numerator.bit_length() - value.denominator.bit_length())
    unit = Fraction(2) ** -shift
    return round(value / unit) * unit
