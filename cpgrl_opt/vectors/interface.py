"""What a kind of vectors offers: v₀ = g, vᵢ = Jᵢ, inner products among them, and combinations of them.

    K = V Vᵀ,   d = Vᵀw        V = [g; J]

All that decides a direction is K and b; the vectors themselves are met again only when d is formed, and when it is
judged. Both K and d can be had with about 106 bits, for rows that nearly oppose each other: K alone squares their
angle. Sums in pairs of float64 are what this takes; the alternative, to orthogonalise the vectors (Cholesky-QR twice),
needs a copy of them and was measured to be slower and less exact.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..arrays import Float, Multipliers
from ..compensated import Pair

Sums = Float[np.ndarray, "sums"]  # [r·r, J d …, d·d]


@dataclass(frozen=True, eq=False)
class Certificate:
    """What the referee needs of a direction d: ‖κd − g − Jᵀμ‖, J d (m,) and ‖d‖; κ = 1 without a ball."""

    rest: float
    products: Float[np.ndarray, "m"]
    length: float


class Vectors:
    """g and the rows of J, of whatever kind: what every kind offers, and what follows from it.

    A kind brings `shape`, `are_finite`, `is_zero`, `find_gramian`, `gramian_in_pairs`, `form` and `measure`. Weights
    are of g first, then of each row.
    """

    gradient: Any  # as `DirectionProblem` takes it, and
    jacobian: Any = None  # None where the rows are in an object with g
    has_rows: ClassVar[bool] = False  # whether g and J can be put together as arrays of float64
    has_pairs: bool = True  # whether K and combinations can be had in pairs

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n)."""
        raise NotImplementedError

    def are_finite(self) -> bool:
        """No NaN and no infinity."""
        raise NotImplementedError

    def is_zero(self, index: int) -> bool:
        """Whether vᵢ = 0, and not only its square."""
        raise NotImplementedError

    def channels(self) -> Any:
        """g and the rows as a `Linearization` takes them."""
        return self.gradient

    def find_gramian(self) -> Float[np.ndarray, "channels channels"]:
        """K in float64."""
        raise NotImplementedError

    def gramian_in_pairs(self) -> Pair:
        """K, each entry to about 2⁻¹⁰⁰ ‖vᵢ‖‖vⱼ‖, where the kind has pairs."""
        raise NotImplementedError

    def form(self, weights: Pair, forces: Float[np.ndarray, "channels"]) -> tuple[Any, Sums]:
        """d = Vᵀw in this kind of vectors, in pairs where weights.lo has any ≠ 0; its sums with r = d − Vᵀforces."""
        raise NotImplementedError

    def measure(self, direction: Any, forces: Float[np.ndarray, "channels"]) -> Sums:
        """The sums of a d that somebody else made; ValueError for what is no such d."""
        raise NotImplementedError

    def require_finite(self) -> None:
        """ValueError for NaN and infinities."""
        if not self.are_finite():
            raise ValueError("gradient and jacobian should be finite, and their squares too; found NaN or infinity")

    def agree(self, work: Callable[..., Any], *arguments: Any) -> Any:
        """What work returns, arrays and None; where vectors lie in several processes, an error on one is one on all."""
        return work(*arguments)

    def attempt(self, work: Callable[..., Any], *arguments: Any) -> Any:
        """What work returns; an error is one on all processes when they look at their vectors next."""
        return work(*arguments)

    def row_of(self, direction: Any, name: str = "direction.value") -> Any:  # noqa: ARG002
        """d as one array of float64 where the kind has rows, else d."""
        return direction

    def from_row(self, row: Any) -> Any:
        """The other way."""
        return row

    def is_representable(self, direction: Any) -> bool:  # noqa: ARG002
        """Whether d is finite in the dtypes of its kind: float32 ends at 3e38."""
        return True

    def gramian(self) -> Float[np.ndarray, "channels channels"]:
        """K, each entry to about √n eps ‖vᵢ‖‖vⱼ‖; found once. Numbers beyond 1e±140 over- or underflow."""
        # Not by `cached_property`, which up to Python 3.11 holds one lock for all: threads would wait for each other.
        found: np.ndarray | None = vars(self).get("_gramian")
        if found is None:
            found = vars(self)["_gramian"] = self.find_gramian()
        return found

    def lengths(self) -> Float[np.ndarray, "channels"]:
        """Of g and of each row; over- or underflows with their squares."""
        return np.asarray(np.sqrt(self.gramian().diagonal()))

    def combine(self, weights: Pair, multipliers: Multipliers, kappa: float = 1.0) -> tuple[Any, Certificate]:
        """d = Vᵀw and its certificate with μ, which is of d before it is rounded to its dtype."""
        d, sums = self.form(weights, _forces(multipliers, kappa))
        return d, self._certificate(sums, multipliers, kappa)

    def combine_usually(self, weights: Float[np.ndarray, "channels"]) -> tuple[Any, Sums]:
        """d = Vᵀ(1, μ) and its sums."""
        return self.form(Pair(weights, np.zeros(len(weights))), weights)

    def certificate(self, direction: Any, multipliers: Multipliers, kappa: float = 1.0) -> Certificate:
        """Of a d that somebody else made."""
        return self._certificate(self.measure(direction, _forces(multipliers, kappa)), multipliers, kappa)

    def zero(self) -> Any:
        """d = 0."""
        weights = np.zeros(1 + self.shape[0])
        return self.form(Pair(weights, weights), weights)[0]

    def _certificate(self, sums: Sums, multipliers: Multipliers, kappa: float) -> Certificate:
        """Of κ times the rest d − (g + Jᵀμ)/κ; where κ = 0 the rest is g + Jᵀμ, which is formed."""
        if kappa == 0.0:
            rest = math.sqrt(self.combine_usually(np.append(1.0, multipliers))[1][-1])
        else:
            rest = abs(kappa) * math.sqrt(sums[0])
        return Certificate(rest, sums[1:-1], math.sqrt(sums[-1]))


def _forces(multipliers: Multipliers, kappa: float) -> Float[np.ndarray, "channels"]:
    return np.append(1.0, multipliers) / (kappa or 1.0)
