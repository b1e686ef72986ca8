"""What an estimator needs of a policy μ_θ(x, u)."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike, NDArray

from cpgrl_opt.arrays import Vector

Index = int | np.int64
Features = Callable[[Any], Float[np.ndarray, "k"]]


@runtime_checkable
class Policy(Protocol):
    """μ_θ(x, u), immutable: `with_parameters` gives the same policy at another θ."""

    @property
    def parameters(self) -> Vector:
        """θ, (n,), read-only."""

    def sample(self, observation: Any, rng: np.random.Generator) -> Any:
        """u ~ μ_θ(x, ·)."""

    def score(self, observation: Any, action: Any) -> Vector:
        """ψ = ∇_θ log μ_θ(x, u), (n,). Source: §2.2 of the paper."""

    def with_parameters(self, parameters: ArrayLike) -> "Policy":
        """The policy at another θ, (n,)."""


def parameter_vector(parameters: ArrayLike | None, n: int) -> NDArray[np.float64]:
    """A read-only copy of θ, (n,), zeros if None; ValueError unless it is finite and has n components."""
    theta = np.zeros(n) if parameters is None else np.array(parameters, dtype=np.float64)
    if theta.shape != (n,):
        raise ValueError(f"parameters should have shape ({n},); found {theta.shape}")
    if not np.isfinite(theta).all():
        raise ValueError(f"parameters should be finite; found {theta[~np.isfinite(theta)][0]}")
    theta.flags.writeable = False
    return theta


def feature_vector(features: Float[np.ndarray, "k"], size: int) -> Float[np.ndarray, "k"]:
    """φ(x) as it is; ValueError unless it has `size` components."""
    if np.shape(features) != (size,):
        raise ValueError(f"policy should have features of shape ({size},), as its size; found {np.shape(features)}")
    return features


def require_count(name: str, value: int, least: int = 1, most: int | None = None) -> None:
    """ValueError unless `value` is an integer ≥ least, and ≤ most if given."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} should be an integer ≥ {least}; found {value!r}")
    if most is not None and value > most:
        raise ValueError(f"{name} should be an integer ≤ {most}; found {value!r}")
