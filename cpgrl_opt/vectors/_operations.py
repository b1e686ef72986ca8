"""Vectors of the caller's own kind: any object that forms inner products and combinations of its vectors."""

import math
from typing import Any, Protocol

import numpy as np

from ..arrays import ArrayLike, Float
from ..compensated import Pair
from ..validation import real_values, require_shape
from .interface import Sums, Vectors

# What rounding leaves between vᵢ·vⱼ and vⱼ·vᵢ, of ‖vᵢ‖‖vⱼ‖; a tenth of it in single precision would be refused.
_ASYMMETRY = 1e-6
_LARGE = 2.0**500  # times a vector whose square underflows, its square does not


class VectorOperations(Protocol):
    """g and the rows of J as one object of the caller's: v₀ = g, vᵢ = Jᵢ, i = 1 … m.

    The answer's d is what `lincomb` returns. Optional: `n`, the number of parameters, for `problem.n`; and both
    `gramian_in_pairs() -> (hi, lo)`, K to 106 bits, and `lincomb_in_pairs(hi, lo)`, the combination with such weights,
    rounded once. Without them rows that nearly depend, within 1e-2 rad or so of it, are UNCERTIFIED.
    """

    def gramian(self) -> ArrayLike:
        """K, (1 + m, 1 + m): the inner product of each two, in float64."""
        ...

    def lincomb(self, weights: Float[np.ndarray, "channels"]) -> Any:
        """Σ wᵢvᵢ, with the rounding of float64; where wᵢ = 0, vᵢ need not be read."""
        ...

    def extended(self, *vectors: Any) -> "VectorOperations":
        """The same object with combinations, as `lincomb` returns them, behind its own vectors."""
        ...


def has_operations(value: Any) -> bool:
    """Whether it is such an object."""
    return all(callable(getattr(value, name, None)) for name in ("gramian", "lincomb", "extended"))


class OperationVectors(Vectors):
    """Such an object, made to offer what all kinds do; what a d is worth is measured on d itself."""

    jacobian = None  # it is in the object

    def __init__(self, given: Any) -> None:
        self.gradient = given

    def __getstate__(self) -> dict[str, Any]:
        """Without what was found."""
        return {"gradient": self.gradient}

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n), n = 0 where the object does not say."""
        return len(self.gramian()) - 1, int(getattr(self.gradient, "n", 0))

    def channels(self) -> Any:
        """The object."""
        return self.gradient

    def are_finite(self) -> bool:
        """Seen in K: a square that overflows is refused too."""
        return math.isfinite(self.gramian().trace())

    def is_zero(self, index: int) -> bool:
        """Seen in a large multiple."""
        weights = np.zeros(len(self.gramian()))
        weights[index] = _LARGE
        large = self.gradient.lincomb(weights)
        return not _checked(self.gradient.extended(large).gramian())[-1, -1] > 0.0

    def find_gramian(self) -> Float[np.ndarray, "channels channels"]:
        """The object's own; ValueError for what is no table of inner products."""
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            return _checked(self.gradient.gramian())

    @property
    def has_pairs(self) -> bool:
        """Whether the object has."""
        return hasattr(self.gradient, "gramian_in_pairs") and hasattr(self.gradient, "lincomb_in_pairs")

    def gramian_in_pairs(self) -> Pair:
        """The object's own."""
        hi, lo = self.gradient.gramian_in_pairs()
        return Pair(_checked(hi), real_values("gramian_in_pairs()", lo).copy())

    def form(self, weights: Pair, forces: Float[np.ndarray, "channels"]) -> tuple[Any, Sums]:
        """By the object, which then measures what it formed."""
        in_pairs = self.has_pairs and weights.lo.any()
        d = self.gradient.lincomb_in_pairs(*weights) if in_pairs else self.gradient.lincomb(weights.rounded())
        return d, self.measure(d, forces)

    def measure(self, direction: Any, forces: Float[np.ndarray, "channels"]) -> Sums:
        """By K of the vectors, d and r."""
        rest = self.gradient.extended(direction).lincomb(np.append(-forces, 1.0))
        K = _checked(self.gradient.extended(direction, rest).gramian())
        return np.concatenate([[K[-1, -1]], K[-2, 1:-1]])


def _checked(gramian: Any) -> np.ndarray:
    """K, symmetric but for rounding."""
    K = real_values("gramian()", gramian).copy()
    require_shape("gramian()", K, (len(K),) * 2 if K.ndim else (1, 1))
    with np.errstate(all="ignore"):
        lengths = np.sqrt(np.abs(K.diagonal()))
        if (np.abs(K - K.T) > _ASYMMETRY * lengths * lengths[:, None]).any():
            raise ValueError(f"gramian() should be symmetric; found {K}")
        return 0.5 * K + 0.5 * K.T
