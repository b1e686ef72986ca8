"""What a kind of vectors offers: v₀ = g, vᵢ = Jᵢ, inner products among them, and combinations of them.

    K = V Vᵀ,   d = Vᵀw        V = [g; J]

All that decides a direction is K and b; the vectors themselves are met again only when d is formed, and when it is
judged. Both K and d can be had with about 106 bits, for rows that nearly oppose each other: K alone squares their
angle. Sums in pairs of float64 are what this takes; the alternative, to orthogonalise the vectors (Cholesky-QR twice),
needs a copy of them and was measured to be slower and less exact.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..arrays import Float
from ..compensated import Pair


@dataclass(frozen=True, eq=False)
class Certificate:
    """What the referee needs of a direction d: ‖κd − g − Jᵀμ‖, J d (m,) and ‖d‖; κ = 1 without a ball."""

    rest: float
    products: Float[np.ndarray, "m"]
    length: float


class Vectors(Protocol):
    """g and the rows of J, of whatever kind. Weights are of g first, then of each row."""

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n)."""
        ...

    def are_finite(self) -> bool:
        """No NaN and no infinity."""
        ...

    def lengths(self) -> Float[np.ndarray, "channels"]:
        """‖vᵢ‖; over- or underflows with its square."""
        ...

    def gramian(self) -> Float[np.ndarray, "channels channels"]:
        """K in float64. Entries of numbers beyond 1e±140 over- or underflow."""
        ...

    def gramian_in_pairs(self) -> Pair:
        """K, (1 + m, 1 + m), to 106 bits before cancellation."""
        ...

    def is_zero(self, index: int) -> bool:
        """Whether vᵢ = 0, and not only its square."""
        ...

    def combine(
        self, weights: Pair, multipliers: Float[np.ndarray, "m"], kappa: float = 1.0
    ) -> tuple[Any, Certificate]:
        """d = Σ wᵢvᵢ in this kind of vectors, and its certificate with μ; in pairs where weights.lo has any ≠ 0."""
        ...

    def certificate(self, direction: Any, multipliers: Float[np.ndarray, "m"], kappa: float = 1.0) -> Certificate:
        """Of a d that somebody else made."""
        ...
