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


def at_angle(theta, *, sign=-1.0, n=40, seed=0):
    """g and two rows, the second at θ from opposing the first (sign −1) or from parallel; lengths 5 and 3."""
    first, second, third = np.linalg.qr(np.random.default_rng(seed).standard_normal((n, 3)))[0].T
    rows = np.array([5.0 * first, 3.0 * (sign * np.cos(theta) * first + np.sin(theta) * second)])
    return first - 2.0 * second + 0.5 * third, rows


def near_span(epsilon, *, n=40, seed=0):
    """Three rows well apart, and g at ε of its length from their span."""
    *rows, outside = np.linalg.qr(np.random.default_rng(seed).standard_normal((n, 4)))[0].T
    rows = np.array([[2.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.1, 0.3, 1.5]]) @ rows
    g = np.array([1.0, -2.0, 0.5]) @ rows
    return g / np.linalg.norm(g) + epsilon * outside, rows


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


@pytest.mark.parametrize("rung", RUNGS)
def test_coordinates_and_weights_are_those_of_exact_rationals(rung):
    assert_exact(GENERIC[0], GENERIC[1:], rung)
    assert_exact(*at_angle(0.1), rung)
    assert_exact(GENERIC[0], GENERIC[1:2], rung)


@pytest.mark.parametrize("theta", [1e-3, 1e-5, 1e-7, 1e-8])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_in_pairs_small_angles_are_exact_too(theta, sign):
    assert_exact(*at_angle(theta, sign=sign), "pairs")


@pytest.mark.parametrize("epsilon", [1e-3, 1e-6, 1e-9, 1e-12])
def test_in_pairs_a_gradient_near_the_span_is_exact_too(epsilon):
    assert_exact(*near_span(epsilon), "pairs")


def test_rows_that_depend_exactly_share_coordinates_and_leave_weights_to_a_basis():
    rows = np.array([[1.0, 2.0, -1.0, 0.0], [0.0, 1.0, 3.0, -2.0], [-1.0, -3.0, -2.0, 2.0]]) @ np.eye(4, 30)
    g = np.arange(30.0)
    assert found(g, rows, "gramian") is None
    small = found(g, rows, "pairs")
    assert len(small.basis) == 2
    assert_exact(g, rows, "pairs")
    assert np.count_nonzero(small.weights(np.ones(4)).hi[1:]) == 2


def test_a_zero_gradient_and_zero_rows_have_no_coordinates():
    for rung in RUNGS:
        small = found(np.zeros(30), [np.zeros(30), np.ones(30)], rung)
        assert small.lengths.tolist() == [0.0, 0.0, np.sqrt(30.0)]
        assert not small.gradient.any()
        assert not small.jacobian[0].any()
        assert small.weights(np.array([2.0, 0.0, 0.0])).rounded() == pytest.approx([0.0, 0.0, 2.0 / np.sqrt(30.0)])


def test_refined_multipliers_have_the_digits_that_rounded_coordinates_lack():
    g, rows = at_angle(1e-6)
    small, bound = found(g, rows, "pairs"), np.array([0.3, -0.2])
    V = rational(np.vstack([g, rows]))
    K = (V @ V.T)[1:]
    w = exactly(small.refine(np.array([1.0, 1.0]), bound))  # from anywhere
    assert np.abs(K @ w - rational(bound)).max() <= 1e-18


def test_rows_that_are_off_are_not_looked_at():
    g, rows = at_angle(1e-9)
    assert rung_of(g, rows) == "rows"
    assert rung_of(g, rows, on=[True, False]) == "gramian"
    assert rung_of(g, np.vstack([rows[0], np.full(40, 1e-170)]), on=[True, False]) == "gramian"
    small = found(g, rows, "gramian", on=[False, True])
    assert small.lengths[1] == 0.0
    assert not small.jacobian[0].any()
    assert small.weights(np.ones(3)).hi[1] == 0.0


def test_without_rows_g_is_its_own_coordinate():
    g = np.arange(1.0, 31.0)
    for rung in RUNGS:
        small = found(g, np.zeros((0, 30)), rung)
        assert small.gradient == pytest.approx([np.linalg.norm(g)], rel=1e-15)
        assert small.weights(small.gradient).rounded().tolist() == [1.0]


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("theta", "rung"),
    [
        *((1e-1, "gramian"), (2e-2, "gramian"), (1e-2, "pairs"), (1e-3, "pairs"), (1e-5, "pairs"), (1e-7, "pairs")),
        *((1e-8, "pairs"), (1e-9, "rows"), (1e-10, "rows"), (1e-11, "rows"), (1e-12, "rows"), (1e-15, "pairs")),
    ],
)
def test_the_rung_of_two_rows_is_decided_by_their_angle(theta, rung, sign):
    """‖L⁻¹‖_F² = 1 + (1 + cos²)/sin² ≤ 1e4, or 1e18 in pairs; below 1e-13 rad they depend on each other."""
    g, rows = at_angle(theta, sign=sign)
    for order in ([0, 1], [1, 0]):
        assert rung_of(g, rows[order]) == rung
    if rung == "pairs":
        assert len(found(g, rows, rung).basis) == (2 if theta > 1e-13 else 1)


@pytest.mark.parametrize(
    ("epsilon", "rung"),
    [(1e-2, "gramian"), (1e-3, "gramian"), (2e-4, "gramian"), (5e-5, "pairs"), (1e-6, "pairs"), (1e-9, "pairs")],
)
def test_the_rung_of_a_gradient_is_decided_by_its_distance_from_the_span(epsilon, rung):
    """Its square over g·g is 1e-8 or more."""
    assert rung_of(*near_span(epsilon)) == rung


def test_a_gradient_in_the_span_has_nothing_outside():
    rows = np.round(1000.0 * near_span(0.0)[1])
    small = found(np.array([3.0, -2.0, 1.0]) @ rows, rows, "pairs")
    assert small.gradient[3] == 0.0
    assert small.weights(small.gradient).rounded() == pytest.approx([0.0, 3.0, -2.0, 1.0], rel=1e-15)


@pytest.mark.parametrize(("m", "rung"), [(8, "gramian"), (20, "pairs"), (50, "rows")])
def test_pivots_do_not_hide_that_kahan_rows_nearly_depend(m, rung):
    """With m = 50 the least pivot is 4e-8 in length squared, and the least singular value squared below 1e-18."""
    assert rung_of(*kahan(m)) == rung
    if rung != "rows":
        assert_exact(*kahan(m), rung)


@pytest.mark.parametrize("exponent", [-432, 432])
def test_lengths_of_any_safe_scale_leave_the_coordinates_alone(exponent):
    """K of 1e±260 is still of float64; each vector has a unit of its own, and powers of two do not even round."""
    exponents = np.array([[0], [exponent], [-exponent]])
    for rung in RUNGS:
        plain, scaled = (found(V[0], V[1:], rung) for V in (GENERIC[:3], np.ldexp(GENERIC[:3], exponents)))
        assert (scaled.jacobian == np.ldexp(plain.jacobian, exponents[1:])).all()
        x = np.array([1.0, -2.0, 3.0])
        assert (np.ldexp(scaled.weights(x).rounded(), exponents[:, 0]) == plain.weights(x).rounded()).all()


@pytest.mark.parametrize("unit", [1e-170, 1e-145, 1e145, 1e170])
@pytest.mark.parametrize("vector", [0, 1])
def test_squares_that_leave_float64_leave_the_ladder(unit, vector):
    V = GENERIC[:3].copy()
    V[vector] = unit * V[2] / np.linalg.norm(V[2])
    assert rung_of(V[0], V[1:]) == "rows"


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
