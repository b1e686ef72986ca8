"""A Gaussian over actions whose mean is linear in features of the observation."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from cpgrl_opt.arrays import Float, Vector
from cpgrl_opt.validation import require_count, require_positive

from .interface import Features, at_parameters, feature_vector, first_parameters


@dataclass(frozen=True, init=False, eq=False)
class LinearGaussian:
    """u ~ N(Θᵀφ(x), σ²I);   ψ = φ(x) ⊗ (u − Θᵀφ(x)) / σ².

    features: φ(x), (k,), finite; Θ: (k, d), θ its rows one after the other; deviation σ > 0 in the unit of u.
    u is taken as drawn, and ψ is of that u: whatever rounds it to the action space's dtype or clips it to the bounds,
    as gymnasium.wrappers.ClipAction, does so behind the policy.
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
        for name, value in (
            ("features", features),
            ("size", int(size)),
            ("dimensions", int(dimensions)),
            ("deviation", float(deviation)),
            ("parameters", first_parameters(parameters, size * dimensions)),
        ):
            object.__setattr__(self, name, value)

    def mean(self, observation: Any) -> Float[np.ndarray, "d"]:
        """Θᵀφ(x), (d,)."""
        return self._of(self._features(observation))

    def sample(self, observation: Any, rng: np.random.Generator) -> Float[np.ndarray, "d"]:
        """An action, (d,)."""
        return self.mean(observation) + self.deviation * rng.standard_normal(self.dimensions)

    def score(self, observation: Any, action: ArrayLike) -> Vector:
        """ψ, (k·d,)."""
        phi = self._features(observation)
        surprise = (np.asarray(action, dtype=np.float64) - self._of(phi)) / self.deviation**2
        return np.outer(phi, surprise).reshape(-1)

    def with_parameters(self, parameters: ArrayLike) -> Self:
        """The policy at another θ, (k·d,)."""
        return at_parameters(self, parameters)

    def _features(self, observation: Any) -> Float[np.ndarray, "k"]:
        return feature_vector(self.features(observation), self.size)

    def _of(self, phi: Float[np.ndarray, "k"]) -> Float[np.ndarray, "d"]:
        mean: np.ndarray = phi @ self.parameters.reshape(self.size, self.dimensions)
        return mean
