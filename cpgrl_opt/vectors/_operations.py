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

    def __init__(self, given: Any) -> None:
        self.gradient = given
        self.has_pairs = hasattr(given, "gramian_in_pairs") and hasattr(given, "lincomb_in_pairs")

    def __getstate__(self) -> dict[str, Any]:
        """Without what was found."""
        return {"gradient": self.gradient, "has_pairs": self.has_pairs}

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n), n = 0 where the object does not say."""
        return len(self.gramian()) - 1, int(getattr(self.gradient, "n", 0))

    def are_finite(self) -> bool:
        """Seen in K: a square that overflows is refused too."""
        return math.isfinite(self.gramian().trace())

    def is_zero(self, index: int) -> bool:
        """Seen in a large multiple."""
        weights = np.zeros(len(self.gramian()))
        weights[index] = _LARGE
        large = _lincomb(self.gradient, weights)
        return not self._gramian_with(large)[-1, -1] > 0.0

    def find_gramian(self) -> Float[np.ndarray, "channels channels"]:
        """The object's own; ValueError for what is no table of inner products."""
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            return _check_gramian("gramian()", self.gradient.gramian())

    def gramian_in_pairs(self) -> Pair:
        """The object's own."""
        name, count = "gramian_in_pairs()", len(self.gramian())
        pair = real_values(name, self.gradient.gramian_in_pairs())
        require_shape(name, pair, (2, count, count))
        return Pair(_check_gramian(name, pair[0]), pair[1].copy())

    def form(self, weights: Pair, forces: Float[np.ndarray, "channels"]) -> tuple[Any, Sums]:
        """By the object, which then measures what it formed."""
        in_pairs = self.has_pairs and weights.lo.any()
        d = _lincomb(self.gradient, *weights) if in_pairs else _lincomb(self.gradient, weights.rounded())
        return d, self.measure(d, forces)

    def measure(self, direction: Any, forces: Float[np.ndarray, "channels"]) -> Sums:
        """By K of the vectors, d and r."""
        rest = _lincomb(_extend(self.gradient, direction), np.append(-forces, 1.0))
        K = self._gramian_with(direction, rest)
        return np.concatenate([[K[-1, -1]], K[-2, 1:-1]])

    def _gramian_with(self, *vectors: Any) -> np.ndarray:
        """K of the vectors and these."""
        count = len(self.gramian()) + len(vectors)
        return _check_gramian("gramian() of what extended() returns", _extend(self.gradient, *vectors).gramian(), count)


def _lincomb(given: Any, *weights: np.ndarray) -> Any:
    """Σ wᵢvᵢ, in pairs with weights in pairs."""
    name = "lincomb" if len(weights) == 1 else "lincomb_in_pairs"
    return _ask(given, name, f"{len(weights[0])} weights", *weights)


def _extend(given: Any, *vectors: Any) -> Any:
    """The object with vectors behind its own."""
    more = _ask(given, "extended", "what lincomb() returns", *vectors)
    if not has_operations(more):
        raise ValueError(f"extended() should return an object with gramian, lincomb and extended; found {more!r}")
    return more


def _ask(given: Any, name: str, what: str, *arguments: Any) -> Any:
    """What the method returns; ValueError where that is nothing, or it does not take what it should."""
    try:
        found = getattr(given, name)(*arguments)
    except (TypeError, ValueError, AttributeError, IndexError) as error:
        kinds = ", ".join(type(argument).__name__ for argument in arguments)
        raise ValueError(f"{name}() should take {what}; found that {kinds} is an error: {error}") from error
    if found is None:
        raise ValueError(f"{name}() should return something; found None")
    return found


def _check_gramian(name: str, gramian: Any, count: int | None = None) -> np.ndarray:
    """K of so many vectors, symmetric but for rounding."""
    K = real_values(name, gramian).copy()
    require_shape(name, K, (count or (len(K) if K.ndim else 1),) * 2)
    with np.errstate(all="ignore"):
        lengths = np.sqrt(np.abs(K.diagonal()))
        if (np.abs(K - K.T) > _ASYMMETRY * lengths * lengths[:, None]).any():
            raise ValueError(f"{name} should be symmetric; found {K}")
        return 0.5 * K + 0.5 * K.T
