"""The exact answer of a small problem in a ball, by a search over active sets on the rational data.

    max gᵀd   s.t.   Jd ≥ b, = b on E,   dᵀMd ≤ radius²                            (of several optima the shortest)

Where the ball misses C = {Jd ≥ b}, or C is empty, d violates least on unit rows, and climbs best of what does (see
`faces` and `violation`). Nothing of the package's solvers and of its referee is in here.
"""

from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np

from ..arrays import Mask, Multipliers, Vector
from ..problem import DirectionProblem
from .faces import Found, Polyhedron, root
from .rational import RationalProblem, Rationals, Weights
from .violation import held_back, least_lack


@dataclass(frozen=True, eq=False)
class TrustRegionAnswer:
    """feasible: the verdict. direction: d, (n,); where infeasible, of least violation and best climb. multipliers: μ,
    or a proof y where infeasible, (m,); None where the ball only touches C, which leaves μ unbounded.
    radius_multiplier: κ; None where several, or none, would do; λ where the ball holds back from less violation.
    margin: 1 − ‖·‖²/radius² of the shortest point of C; where infeasible −‖r‖/max bᵢ on unit rows.
    room: 1 − ‖q‖²/radius², how far the ball reaches beyond the shortest point of the face; climb: ‖p‖/‖g‖ on it.
    face: the rows that hold with equality (or, where infeasible, are violated). exact: d in fractions, before rounding.
    """

    feasible: bool
    direction: Vector
    multipliers: Multipliers | None
    radius_multiplier: float | None
    margin: float
    room: float
    climb: float
    face: Mask
    exact: Rationals = field(repr=False)


def exact_trust_region(problem: DirectionProblem) -> TrustRegionAnswer:
    """The answer of a problem with a radius.

    Parameters
    ----------
    problem
        With m up to about 8: every active set is tried.

    Returns
    -------
    TrustRegionAnswer
    """
    return _Search(problem).answer()


def shortest_length(problem: DirectionProblem) -> float | None:
    """√(dᵀMd) of the shortest direction that meets the constraints.

    Parameters
    ----------
    problem
        Of which only J, b, E and M count.

    Returns
    -------
    float or None
        Rounded down; None where no direction meets them.
    """
    search = _Search(problem)
    shortest = None if search.impossible else search.constraints.shortest()
    return None if shortest is None else _float(root(shortest[1]))


class _Search:
    """Verdict and answer of a problem; zero rows are judged apart and left out of the search."""

    def __init__(self, problem: DirectionProblem) -> None:
        self.given, self.rational = problem, RationalProblem(problem)
        self.square = Fraction(float(problem.radius or 0.0)) ** 2
        rational = self.rational
        self.rows = [i for i in rational.rows if rational.gram[i, i] != 0]
        zeros = [i for i in rational.rows if rational.gram[i, i] == 0]
        self.impossible = [i for i in zeros if rational.b[i] > 0 or (rational.b[i] != 0 and i in rational.equality)]
        self.constraints = Polyhedron(rational, self.rows, rational.b, rational.equality)
        self.margin = Fraction(0)

    def answer(self) -> TrustRegionAnswer:
        """Of the rows that are not zero first; an impossible zero row then turns the verdict."""
        shortest = self.constraints.shortest()
        if shortest is None or shortest[1] > self.square:
            return self._least_violation(can_be_met=shortest is not None)
        self.margin = 1 - shortest[1] / self.square
        found = self.constraints.best_in_ball(self.square)
        found = found or _only_point(shortest[0])  # where the ball touches C
        if self.impossible:
            proof = {i: Fraction(1 if self.rational.b[i] > 0 else -1) for i in self.impossible}
            found = replace(found, multipliers=proof, kappa=Fraction(0))
        return self._rounded(not self.impossible, found)

    def _least_violation(self, *, can_be_met: bool) -> TrustRegionAnswer:
        rational = self.rational
        lack = {} if can_be_met else least_lack(self.constraints)
        if lack:
            held = {i: rational.b[i] - lack.get(i, Fraction(0)) for i in self.rows}
            nearest = Polyhedron(rational, self.rows, held, rational.equality | set(lack))
            shortest = nearest.shortest()
            assert shortest is not None
            if shortest[1] <= self.square:
                found = nearest.best_in_ball(self.square) or _only_point(shortest[0])
                proof = {i: value / rational.gram[i, i] for i, value in lack.items()}
                self._miss_by(proof)
                return self._rounded(False, replace(found, multipliers=proof, kappa=Fraction(0)), set(lack))
        y, weight = held_back(self.constraints, self.square)
        proof = {i: value * weight for i, value in y.items()}
        self._miss_by(proof)
        return self._rounded(False, replace(_only_point(y), multipliers=proof, kappa=weight), set(y))

    def _miss_by(self, proof: Weights) -> None:
        """The margin, of wᵢrᵢ: in units of what is asked, however large the ball."""
        gram, b = self.rational.gram, self.rational.b
        demands = (b[i] ** 2 / gram[i, i] for i in self.rows if b[i] > 0 or i in self.rational.equality)
        unit = max(demands)
        self.margin = -root(sum((value**2 * gram[i, i] for i, value in proof.items()), Fraction(0)) / unit)

    def _rounded(self, feasible: bool, found: Found, violated: set[int] | None = None) -> TrustRegionAnswer:
        rational = self.rational
        exact = rational.direction(found.weights, found.climb)
        face = np.zeros(self.given.m, np.bool_)
        for i in self.rows:
            slack = found.climb * rational.pull[i] + rational.along(i, found.weights) - rational.b[i]
            size = abs(rational.b[i]) + root(rational.gram[i, i] * self.square)
            face[i] = i in rational.equality or i in (violated or ()) or abs(slack) <= size / 2**100
        mu = None if found.multipliers is None else np.zeros(self.given.m)
        for i, value in (found.multipliers or {}).items():
            mu[i] = _float(value)  # type: ignore[index]
        return TrustRegionAnswer(
            feasible,
            np.array([float(value) for value in exact]),
            mu,
            None if found.kappa is None else _float(found.kappa),
            float(self.margin),
            float(found.room),
            float(found.slope) ** 0.5,
            face,
            exact,
        )


def _only_point(weights: Weights) -> Found:
    return Found(weights, Fraction(0), None, None, Fraction(0), Fraction(0))


def _float(value: Fraction) -> float:
    """Rounded once; infinite where float64 ends."""
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")
