"""What an estimator needs of a policy μ_θ(x, u)."""

import copy
from collections.abc import Callable
from functools import cached_property
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpgrl_opt.arrays import Float, Vector
from cpgrl_opt.validation import real_values, require_count

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


_MOST_PARAMETERS = 10**12  # 8 TB


def set_fields(policy: Any, **values: Any) -> None:
    """Fills the fields of a frozen policy, in its constructor."""
    for name, value in values.items():
        object.__setattr__(policy, name, value)


def parameter_vector(parameters: ArrayLike, n: int) -> NDArray[np.float64]:
    """A read-only copy of θ, (n,); ValueError unless it is n finite real numbers."""
    if parameters is None or isinstance(parameters, np.ma.MaskedArray):
        raise ValueError(f"parameters should have shape ({n},), no entry masked; found {parameters!r}")
    theta = real_values("parameters", parameters).copy()
    if theta.shape != (n,):
        raise ValueError(f"parameters should have shape ({n},); found {theta.shape}")
    if not np.isfinite(theta).all():
        raise ValueError(f"parameters should be finite; found {theta[~np.isfinite(theta)][0]}")
    theta.flags.writeable = False
    return theta


def first_parameters(parameters: ArrayLike | None, n: int) -> NDArray[np.float64]:
    """θ of a policy's constructor: zeros, (n,), unless given; ValueError for more than memory may hold."""
    require_count("the number of parameters", n, 1, _MOST_PARAMETERS)
    return parameter_vector(np.zeros(n) if parameters is None else parameters, n)


class ParametricPolicy:
    """What policies with their θ in `parameters` have in common."""

    parameters: Vector

    def with_parameters(self, parameters: ArrayLike) -> Self:
        """The policy at another θ, (n,): a copy of the same class, so that a subclass keeps its `sample` and `score`.

        Cached properties are computed anew. A subclass that stores more of what depends on θ needs its own
        `with_parameters`. Raises ValueError for what is no θ of n finite numbers.
        """
        theta = parameter_vector(parameters, len(self.parameters))
        other = copy.copy(self)
        for name in [name for name in vars(other) if isinstance(getattr(type(other), name, None), cached_property)]:
            del vars(other)[name]
        set_fields(other, parameters=theta)
        return other


def feature_vector(features: Float[np.ndarray, "k"], size: int) -> Float[np.ndarray, "k"]:
    """φ(x) as it is; ValueError unless it has `size` components, real numbers. Rollouts see whether they are finite."""
    if np.shape(features) != (size,):
        raise ValueError(f"policy should have features of shape ({size},), as its size; found {np.shape(features)}")
    return features if isinstance(features, np.ndarray) and features.dtype == np.float64 else _real(features)


def _real(features: Any) -> Float[np.ndarray, "k"]:
    given: Any = np.asarray(features, np.float64) if np.asarray(features).dtype == np.bool_ else features  # indicators
    return real_values("what the policy's features return", given)
