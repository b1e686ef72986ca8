"""Coordinates, weights and sums in pairs against exact rationals; and which gate of the ladder opens where."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cpgrl_opt.compensated import Pair
from cpgrl_opt.reduction import RUNGS, coordinates
from cpgrl_opt.vectors import ArrayVectors, Certificate

from .long import rational

# What one rounding leaves of L and w, in units of the vectors' lengths; K in pairs has 2⁻¹⁰⁰ at the most.
ROUNDED = {"gramian": 1e-14, "pairs": 2.0**-98}


def exactly(pair):
    return rational(pair.hi) + rational(pair.lo)


def kahan(m, c=0.54):
    """Rows whose triangle has pivots sⁱ, and a least singular value far below all of them. Kahan 1966.

    Each a little shorter than the one before, so that pivoting takes them in this order.
    """
    n = 4 * (1 + m) + 1
    basis = np.linalg.qr(np.random.default_rng(m).standard_normal((n, 1 + m)))[0].T
    triangle = np.diag(np.sqrt(1 - c * c) ** np.arange(m)) @ (np.eye(m) - c * np.triu(np.ones((m, m)), 1))
    return basis.sum(axis=0), np.linspace(0.99, 0.9, m)[:, None] * (triangle.T @ basis[:m])


def found(g, rows, rung, on=None):
    on = np.ones(len(rows), dtype=np.bool_) if on is None else np.asarray(on, dtype=np.bool_)
    return coordinates(ArrayVectors(np.asarray(g), np.asarray(rows)), on, rung)


def rung_of(g, rows, on=None):
    """The first that opens; "rows" where none does."""
    return next((rung for rung in RUNGS if found(g, rows, rung, on) is not None), "rows")


def assert_exact(g, rows, rung):
    """LLᵀ = K, and K w = L x for the weights of any x: then a g + Jᵀw is Qᵀx, whatever Q."""
    small = found(g, rows, rung)
    V = rational(np.vstack([g, rows]))
    scaled = exactly(small.factor)
    K, units = V @ V.T, rational(small.scales)
    lengths = rational(np.where(small.lengths > 0.0, small.lengths, 1.0))
    L = units[:, None] * scaled
    assert np.abs((L @ L.T - K) / np.outer(lengths, lengths)).max() <= ROUNDED[rung]
    x = np.random.default_rng(3).standard_normal(len(small.gradient))
    x[len(small.basis) + (small.gradient[len(small.basis)] != 0.0) :] = 0.0  # columns that nothing fills
    w = exactly(small.weights(x))
    rest, weight = np.abs((K @ w - L @ rational(x)) / lengths).max(), np.abs(w * lengths).max()
    assert rest <= 1e-14 * np.linalg.norm(x) + (ROUNDED[rung] * weight if rung == "pairs" else 0.0)


GENERIC = np.random.default_rng(7).standard_normal((4, 30)) * np.array([[1.0], [1e3], [1e-5], [7.0]])


@pytest.mark.parametrize(("m", "rung"), [(8, "gramian"), (20, "pairs"), (50, "rows")])
def test_pivots_do_not_hide_that_kahan_rows_nearly_depend(m, rung):
    """With m = 50 the least pivot is 4e-8 in length squared, and the least singular value squared below 1e-18."""
    assert rung_of(*kahan(m)) == rung
    if rung != "rows":
        assert_exact(*kahan(m), rung)


def test_what_coordinates_prove_of_a_direction_they_have_to_share():
    """J d and ‖d‖ of the vectors' own d: to 1e-12 of the unit."""
    small = found(GENERIC[0], GENERIC[1:], "gramian")
    x, lengths = np.array([1.0, 2.0, 3.0, 4.0]), small.lengths[1:]
    own = Certificate(0.0, small.jacobian @ x, float(np.linalg.norm(x)))
    assert small.holds(x, own, 1.0)
    for row in range(3):
        apart = own.products + 3e-12 * lengths * (np.arange(3) == row)
        assert not small.holds(x, Certificate(0.0, apart, own.length), 1.0)
        assert small.holds(x, Certificate(0.0, apart, own.length), 10.0)
    assert not small.holds(x, Certificate(0.0, own.products, own.length + 3e-12), 1.0)


# Pairs: hi, and lo of at most half a unit in hi's last place.
SIZES = st.floats(-1e3, 1e3).filter(lambda x: x == 0.0 or abs(x) > 1e-3)
NONZERO = SIZES.filter(lambda x: x != 0.0)
RESTS = st.floats(-0.5, 0.5)


def pair(hi, rest):
    return Pair(np.array([hi]), np.array([hi * rest * 2.0**-53]))


@given(NONZERO, RESTS, NONZERO, RESTS)
def test_products_and_quotients_of_pairs_have_100_bits(a, a_rest, b, b_rest):
    x, y = pair(a, a_rest), pair(b, b_rest)
    exact_x, exact_y = exactly(x)[0], exactly(y)[0]
    for answer, exact in ((x.times_pair(y), exact_x * exact_y), (x.over(y), exact_x / exact_y)):
        assert abs(exactly(answer)[0] / exact - 1) <= Fraction(2) ** -100
        assert abs(answer.lo[0]) <= 2.0**-52 * abs(answer.hi[0])
    assert abs(exactly(x.times(b))[0] / (exact_x * Fraction(b)) - 1) <= Fraction(2) ** -100


@given(NONZERO.map(abs), RESTS)
def test_roots_of_pairs_have_100_bits(a, rest):
    x = pair(a, rest)
    root = x.root()
    assert abs(exactly(root)[0] ** 2 / exactly(x)[0] - 1) <= Fraction(2) ** -99


@given(SIZES, RESTS, SIZES, RESTS)
def test_sums_of_pairs_lose_nothing_of_their_terms(a, a_rest, b, b_rest):
    x, y = pair(a, a_rest), pair(b, b_rest)
    for each in (y, Pair(-x.hi, y.lo)):  # the second cancels
        exact = exactly(x)[0] + exactly(each)[0]
        assert abs(exactly(x.plus(each))[0] - exact) <= Fraction(2) ** -104 * (abs(Fraction(a)) + abs(Fraction(b)))


@given(st.lists(st.tuples(SIZES, RESTS), min_size=1, max_size=9))
def test_sums_along_a_row_of_pairs_lose_nothing_of_their_terms(terms):
    hi = np.array([[a for a, _ in terms], [-a for a, _ in terms]])
    lo = hi * np.array([rest for _, rest in terms]) * 2.0**-53
    total = Pair(hi, lo).sums()
    exact, size = exactly(Pair(hi, lo)).sum(axis=1), Fraction(float(np.abs(hi[0]).sum()))
    assert (np.abs(exactly(total) - exact) <= Fraction(2) ** -100 * size).all()
