"""The point of the unit ball that violates constraints least, where the ball does not meet them.

    x = argmin ½‖v‖²  s.t.  Jx + v ≥ b (= on E),  ‖x‖ ≤ 1,      so  Jᵀv = λx  with  λ = ‖Jᵀv‖

and v proves that the ball misses {Jx ≥ b}: bᵀv = ‖v‖² + vᵀJx = ‖v‖² + ‖Jᵀv‖ > ‖Jᵀv‖. For a given λ the point is a
projection of 0 onto a cone that is never empty,

    (x, w) = argmin ½‖x‖² + ½‖w‖²  s.t.  Jx + √λ w ≥ b (= on E),        v = √λ w

and ‖x‖ falls with λ. On the face where v ≠ 0, with J_𝒜 = U diag(s) Vᵀ, x = V diag(s/(s² + λ)) Uᵀb_𝒜, and ‖x‖ = 1 is
solved for λ by Newton's method on 1/‖x‖. Source: Farkas' lemma; Hebden 1973, Moré & Sorensen 1983 (the equation).
"""

import numpy as np

from ..arrays import Bool, Float
from ..direction import Status
from ..problem import DirectionProblem
from ..scaling import lengths
from .exact_core import project

_CERTIFIED = 1e-9
_EXACT = 1e-13
_MOST_STEPS = 60
_MOST_NEWTON_STEPS = 100
_FARTHER = 16.0

Vector = Float[np.ndarray, "n"]
Values = Float[np.ndarray, "m"]


def least_violation_in_ball(
    rows: Float[np.ndarray, "m n"], bound: Values, equality: Bool[np.ndarray, "m"]
) -> tuple[Vector, Values]:
    """(x, v) of the module's head for unit rows, zero rows being switched off; v = 0 where none is found."""
    on = bound > -np.inf
    J, b, E = rows[on], bound[on], equality[on]
    low, high, weight = 0.0, np.inf, max(1.0, float(np.abs(b[E | (b > 0)]).max(initial=0.0)))
    best, least = (np.zeros(rows.shape[1]), np.zeros(len(b))), np.inf
    for _ in range(_MOST_STEPS):
        solution = _regularized(J, b, E, weight)
        if solution is None:
            break
        x, face = solution
        root, point = _on_sphere(J[face], b[face])
        for candidate in (x / max(float(lengths(x)), 1e-300), point):
            violation = _violation(J, b, E, candidate)
            error = _error(J, candidate, violation)
            if error < least:
                best, least = (candidate, violation), error
        if least <= _EXACT:
            break
        low, high = (weight, high) if lengths(x) > 1.0 else (low, weight)
        weight = root if low < root < high else _middle(low, high)
        if high - low <= 1e-15 * low:
            break
    violation = np.zeros(len(bound))
    violation[on] = best[1]
    return best[0], violation


def _regularized(
    J: Float[np.ndarray, "p n"], b: Values, E: Bool[np.ndarray, "p"], weight: float
) -> tuple[Vector, Bool[np.ndarray, "p"]] | None:
    """x for λ = weight, and the face where v ≠ 0; None if it is not certified."""
    count, n = J.shape
    softened = np.hstack([J, np.sqrt(weight) * np.eye(count)])
    problem = DirectionProblem.trusted(np.zeros(n + count), softened, np.ascontiguousarray(b), np.ascontiguousarray(E))
    answer = project(problem, _CERTIFIED)
    if answer.status != Status.OPTIMAL:
        return None
    return answer.value[:n], E | (answer.multipliers > 0.0)


def _on_sphere(J: Float[np.ndarray, "a n"], b: Float[np.ndarray, "a"]) -> tuple[float, Vector]:
    """λ and x with ‖x‖ = 1 on a face; (0, the shortest x) where even that is inside the ball."""
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    c = U.T @ b
    weight = 0.0
    for _ in range(_MOST_NEWTON_STEPS):
        denominator = s * s + weight
        parts = np.where(s > 1e-14, s * c / np.where(denominator > 0.0, denominator, 1.0), 0.0)
        size = float(lengths(parts))
        if size <= 1.0 + 1e-16:
            break
        slope = float(np.sum(parts * parts / np.where(denominator > 0.0, denominator, np.inf))) / size  # −d‖x‖/dλ
        step = (1.0 - 1.0 / size) * size * size / slope
        if step <= 1e-16 * weight:
            break
        weight += step
    return weight, parts @ Vt / (size if weight > 0.0 else 1.0)


def _violation(J: Float[np.ndarray, "p n"], b: Values, E: Bool[np.ndarray, "p"], x: Vector) -> Values:
    lack = b - J @ x
    violation: Values = np.where(E, lack, np.maximum(lack, 0.0))
    return violation


def _error(J: Float[np.ndarray, "p n"], x: Vector, violation: Values) -> float:
    """‖Jᵀv − ‖Jᵀv‖x‖ / ‖v‖: 0 at the optimum on the sphere."""
    force = J.T @ violation
    size = float(lengths(violation))
    return float(lengths(force - float(lengths(force)) * x)) / size if size > 0.0 else 0.0


def _middle(low: float, high: float) -> float:
    if high == np.inf:
        return _FARTHER * max(low, 1.0)
    if low < high / _FARTHER:
        return float(np.sqrt(low * high)) if low > 0.0 else high / _FARTHER
    return 0.5 * (low + high)
