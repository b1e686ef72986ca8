"""A Gaussian over actions whose mean is linear in features of the observation."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cpgrl_opt.arrays import Float, Vector
from cpgrl_opt.validation import require_count, require_positive

from .gaussian import GaussianPolicy
from .interface import Features, feature_vector, first_parameters, set_fields


@dataclass(frozen=True, init=False, eq=False)
class LinearGaussian(GaussianPolicy):
    """u ~ N(Θᵀφ(x), σ²I);   ψ = φ(x) ⊗ (u − Θᵀφ(x)) / σ².   u is taken as drawn: see `GaussianPolicy`.

    Parameters
    ----------
    features
        φ(x), (k,), finite numbers.
    size, dimensions
        k of the features and d of the action.
    deviation
        σ > 0, in the unit of u.
    parameters
        θ, (k·d,), the rows of Θ (k, d) one after the other; zeros unless given.

    Raises
    ------
    ValueError
        For sizes below 1, another deviation, a θ that does not fit; where it acts, features of another size.

    Notes
    -----
    Source: Williams (1992), §6; the shape of the paper's §4.1 policy.
    """

    features: Features
    size: int  # k
    dimensions: int  # d
    deviation: float
    parameters: Vector

    def __init__(
        self,
        features: Features,
        size: int,
        dimensions: int,
        *,
        deviation: float = 1.0,
        parameters: ArrayLike | None = None,
    ) -> None:
        require_count("size", size)
        require_count("dimensions", dimensions)
        require_positive("deviation", deviation)
        set_fields(
            self, features=features, size=int(size), dimensions=int(dimensions), deviation=float(deviation),
            parameters=first_parameters(parameters, size * dimensions),
        )  # fmt: skip

    def _features(self, observation: Any) -> Float[np.ndarray, "k"]:
        return feature_vector(self.features(observation), self.size)
