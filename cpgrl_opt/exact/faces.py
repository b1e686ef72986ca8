"""The faces of {Jd ≥ b, = on E}: its shortest point, and its best climb in a ball, in rational arithmetic.

On the face J_𝒜 d = b_𝒜 of independent rows, with u = K⁻¹b_𝒜, w = K⁻¹c_𝒜, K = J_𝒜M⁻¹J_𝒜ᵀ, c_𝒜 = J_𝒜M⁻¹g:

    q = M⁻¹J_𝒜ᵀu its shortest point,   p = M⁻¹(g − J_𝒜ᵀw) the part of g along it,
    d = q + sp,   s² = (radius² − ‖q‖²)/‖p‖²

is the best climb where Jd ≥ b and μ = κ(u − sw) ≥ 0 on I, κ = 1/s. Where some points in the ball climb as far as any
outside it, κ = 0 and the shortest of them is taken. The numbers are x + ys with rational x, y and s²: their signs are
decided by squares. Source: Nocedal & Wright, Numerical Optimization, Theorem 12.1; Rockafellar, Convex Analysis, §28.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import isqrt

from .rational import RationalProblem, Weights, subsets, total

DIGITS = 200  # bits of a square root: more than any float64 comparison sees


@dataclass(frozen=True)
class Found:
    """d = M⁻¹(αg + Jᵀy) and what is known of it, still rational: climb α, weights y, and μ, κ as they are."""

    weights: Weights
    climb: Fraction
    multipliers: Weights | None
    kappa: Fraction | None
    room: Fraction
    slope: Fraction  # ‖p‖²/‖g‖²


class Polyhedron:
    """{Jᵢd ≥ bᵢ, = on E} for rows of a problem, with bounds and equalities of its own."""

    def __init__(self, problem: RationalProblem, rows: Sequence[int], b: Weights, equality: set[int]) -> None:
        self.problem, self.rows, self.b, self.equality = problem, list(rows), b, equality

    def shortest(self) -> tuple[Weights, Fraction] | None:
        """(y, ‖d‖²) of its shortest point d = M⁻¹Jᵀy; None where it is empty."""
        for face in subsets(self.rows, self.problem.n):
            y = self.problem.solve_on(face, self.b)
            if y is not None and self._signs(y) and self._holds_at(y):
                return y, total(self.b, y)
        return None

    def best_in_ball(self, square: Fraction) -> Found | None:
        """The shortest best climb in the ball of radius² = square, which should meet it; None where it only touches."""
        return self._where_the_ball_is_slack(square) or self._on_the_sphere(square)

    def _where_the_ball_is_slack(self, square: Fraction) -> Found | None:
        """κ = 0: g + J_𝒜ᵀμ = 0 with μ ≥ 0; all optima hold these rows, and the shortest of them is wanted."""
        problem = self.problem
        for face in subsets(self.rows, problem.n):
            w = problem.solve_on(face, problem.pull)
            if w is None or problem.strength != total(problem.pull, w):
                continue
            mu = {i: -x for i, x in w.items() if x}
            if not self._signs(mu):
                continue
            shortest = Polyhedron(problem, self.rows, self.b, self.equality | set(mu)).shortest()
            if shortest is None:
                continue
            y, length = shortest
            if length > square:
                return None
            kappa = None if length == square else Fraction(0)  # on the sphere others may do as well
            return Found(y, Fraction(0), mu, kappa, 1 - length / square, Fraction(0))
        return None

    def _on_the_sphere(self, square: Fraction) -> Found | None:
        problem = self.problem
        for face in subsets(self.rows, problem.n):
            y, z = problem.solve_on(face, self.b), problem.solve_on(face, problem.pull)
            if y is None or z is None:
                continue
            room, slope = square - total(self.b, y), problem.strength - total(problem.pull, z)
            if room > 0 and slope > 0:
                found = self._along(y, z, room, slope)
            elif room == 0 and slope == 0:
                found = self._at_a_vertex(y, z)
            else:
                continue
            if found is not None:
                return Found(*found, room / square, slope / problem.strength)
        return None

    def _along(
        self, y: Weights, z: Weights, room: Fraction, slope: Fraction
    ) -> tuple[Weights, Fraction, Weights, Fraction | None] | None:
        """q + sp with its multipliers, where it is the answer."""
        problem, square = self.problem, room / slope
        free = [i for i in y if i not in self.equality]
        if any(_sign(y[i], -z[i], square) < 0 for i in free):
            return None
        start = {i: problem.along(i, y) for i in self.rows}
        ahead = {i: problem.pull[i] - problem.along(i, z) for i in self.rows}
        if not self._holds(start, ahead, square):
            return None
        s = root(square)
        tight = [i for i in self.rows if _sign(start[i] - self.b[i], ahead[i], square) == 0]
        unique = self._leaves_some_of_g(tight)
        return {i: y[i] - s * z[i] for i in y}, s, {i: y[i] / s - z[i] for i in y}, 1 / s if unique else None

    def _at_a_vertex(self, y: Weights, z: Weights) -> tuple[Weights, Fraction, Weights, None] | None:
        """q on the sphere where no part of g is left: any κ with κu ≥ w on I proves it."""
        if not self._holds_at(y):
            return None
        free = [i for i in y if i not in self.equality]
        if any(y[i] == 0 and z[i] > 0 for i in free):
            return None
        kappa = max([z[i] / y[i] for i in free if y[i] > 0], default=Fraction(0))
        kappa = max(kappa, Fraction(0))
        if any(y[i] < 0 and kappa > z[i] / y[i] for i in free):
            return None
        return y, Fraction(0), {i: kappa * y[i] - z[i] for i in y}, None

    def _leaves_some_of_g(self, tight: Sequence[int]) -> bool:
        """Whether g is outside the span of the rows: κ is then its part outside over d's, and there is only one."""
        problem = self.problem
        w = problem.solve_on(problem.independent(tight), problem.pull) or {}
        return problem.strength != total(problem.pull, w)

    def _signs(self, mu: Weights) -> bool:
        return all(value >= 0 or i in self.equality for i, value in mu.items())

    def _holds_at(self, y: Weights) -> bool:
        """Whether M⁻¹Jᵀy is in it."""
        return self._holds({i: self.problem.along(i, y) for i in self.rows}, {}, Fraction(0))

    def _holds(self, start: Weights, ahead: Weights, square: Fraction) -> bool:
        """Jd ≥ b, = b on E, where Jd = start + s·ahead."""
        signs = ((_sign(start[i] - self.b[i], ahead.get(i, Fraction(0)), square), i) for i in self.rows)
        return all(sign == 0 or (sign > 0 and i not in self.equality) for sign, i in signs)


def _sign(x: Fraction, y: Fraction, square: Fraction) -> int:
    """The sign of x + y√square."""
    if x >= 0 and y >= 0:
        return int(x > 0 or (y > 0 and square > 0))
    if x <= 0 and y <= 0:
        return -int(x < 0 or (y < 0 and square > 0))
    difference = x * x - y * y * square
    leading = 1 if x > 0 else -1
    return leading * ((difference > 0) - (difference < 0))


def root(square: Fraction) -> Fraction:
    """√square to 60 digits, never above it."""
    if square == 0:
        return Fraction(0)
    shift = max(0, DIGITS - (square.numerator.bit_length() - square.denominator.bit_length()) // 2 + 1)
    return Fraction(isqrt((square.numerator << 2 * shift) // square.denominator), 1 << shift)
