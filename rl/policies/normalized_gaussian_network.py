"""The normalised Gaussian network: the policy of the two-link arm (§4.1)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpgrl_opt.arrays import Vector
from cpgrl_opt.validation import is_number, real_values, require_count, require_positive

from .gaussian import GaussianPolicy
from .interface import first_parameters, set_fields

_ONE = np.ones(1)
_NARROWEST = 0.1  # of the spacing: at 0.1 a neighbour's weight is e⁻⁵⁰; compiled, e^(½ width⁻²) is ∞ below 0.027


@dataclass(frozen=True, init=False, eq=False)
class NormalizedGaussianNetwork(GaussianPolicy):
    """u ~ N(Θᵀn(x), σ²I),   nⱼ(x) = gⱼ(x)/Σₖ gₖ(x),   gⱼ(x) = exp(−½ Σ_d ((x_d − c_{j,d})/w_d)²).

        ψ = n(x) ⊗ (u − Θᵀn(x))/σ²,     μ_θ(x, u) ∝ exp(−‖u − Θᵀn(x)‖²/(2σ²))

    The exponent holds the *squared* norm: the paper prints ‖·‖ where a Gaussian has ‖·‖² (docs/reproduction.md,
    slip 5); its η₂ is 1/(2σ²). u is taken as drawn: an environment that clips it does so behind the policy.

    Parameters
    ----------
    low, high
        (D,), the corners of the grid of centres, in the unit of x, both ends included.
    counts
        (D,), centres along each axis, ≥ 2. For the arm the three are `*TwoLinkArm().stops, (5, 8)`.
    dimensions
        d of the action.
    deviation
        σ > 0, in the unit of u.
    width
        w_d by the spacing along axis d, ≥ 0.1.
    parameters
        θ, (K·d,), Θ (K, d) by rows, K = Π counts; basis function j counts the grid with its last axis fastest,
        so that with counts (5, 8) θ[2(8a + b) + c] is what centre (a, b) adds to
        component c of the mean. Zeros unless given.

    Raises
    ------
    ValueError
        For other bounds, counts, numbers.

    Notes
    -----
    Source: §4.1 of the paper; Moody & Darken (1989), eq. 4.
    """

    low: Vector
    high: Vector
    counts: tuple[int, ...]
    dimensions: int
    deviation: float
    width: float
    parameters: Vector

    def __init__(
        self,
        low: ArrayLike,
        high: ArrayLike,
        counts: Sequence[int],
        dimensions: int,
        *,
        deviation: float = 1.0,
        width: float = 1.0,
        parameters: ArrayLike | None = None,
    ) -> None:
        if not isinstance(counts, Sequence):
            raise ValueError(f"counts should be a number of units for each axis; found {counts!r}")
        for count in counts:
            require_count("counts", count, 2)
        require_count("dimensions", dimensions)
        require_positive("deviation", deviation)
        if not is_number(width) or not _NARROWEST <= width < np.inf:
            raise ValueError(f"width should be a finite number ≥ {_NARROWEST}; found {width!r}")
        corners = _corners(low, high, len(counts))
        set_fields(
            self, low=corners[0], high=corners[1], counts=tuple(map(int, counts)), dimensions=int(dimensions),
            deviation=float(deviation), width=float(width),
            parameters=first_parameters(parameters, int(np.prod(counts)) * dimensions),
        )  # fmt: skip

    @property
    def size(self) -> int:
        """K, the number of basis functions."""
        return len(self.parameters) // self.dimensions

    @property
    def spacing(self) -> Vector:
        """(D,), between neighbouring centres, in the unit of x."""
        spacing: Vector = (self.high - self.low) / (np.array(self.counts) - 1)
        return spacing

    def features(self, observation: ArrayLike) -> Vector:
        """n(x), (K,): positive or underflown to 0, summing to 1.

        Gaussians of a grid are products over its axes, and so are the normalised ones: one vector for each axis.
        """
        product = _ONE
        for x, (low, spacing, centres) in zip(np.asarray(observation, dtype=np.float64), self._axes, strict=True):
            place = (x - low) / spacing
            nearest = min(max(np.rint(place), 0.0), centres[-1])
            # ½(place − nearest)² − ½(place − centre)²: the nearest one has weight 1, however far from the grid
            weights = np.exp((centres - nearest) * (place - 0.5 * (centres + nearest)) / self.width**2)
            product = np.multiply.outer(product, weights / weights.sum()).reshape(-1)
        return product

    @cached_property
    def _axes(self) -> list[tuple[float, float, Vector]]:
        """Lowest centre, spacing, and the centres' places 0, 1, … along each axis."""
        places = [np.arange(count, dtype=np.float64) for count in self.counts]
        return list(zip(self.low.tolist(), self.spacing.tolist(), places, strict=True))


def _corners(low: ArrayLike, high: ArrayLike, axes: int) -> NDArray[np.float64]:
    """Read-only copies of both corners, (2, D)."""
    if axes == 0:
        raise ValueError("counts should hold a number for each axis of the state; found none")
    given = {"low": real_values("low", low), "high": real_values("high", high)}
    for name, corner in given.items():
        if corner.shape != (axes,):
            raise ValueError(f"{name} should have shape ({axes},), as counts; found {corner.shape}")
    corners = np.array(list(given.values()))
    if not (np.isfinite(corners).all() and (corners[0] < corners[1]).all()):
        raise ValueError(f"low and high should be finite, low < high; found {corners[0]}, {corners[1]}")
    corners.flags.writeable = False
    return corners
