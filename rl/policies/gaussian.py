"""What all Gaussian policies with a mean linear in features of the observation have in common."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cpgrl_opt.arrays import Float, Vector

from .interface import ParametricPolicy


class GaussianPolicy(ParametricPolicy):
    """u ~ N(Θᵀφ(x), σ²I);   ψ = φ(x) ⊗ (u − Θᵀφ(x)) / σ².

    A subclass has φ, d, σ and θ, the rows of Θ (k, d) one after the other. u is taken as drawn, and ψ is of that u:
    whatever rounds it to the action space's dtype or clips it to the bounds, as gymnasium.wrappers.ClipAction, does so
    behind the policy.
    """

    features: Callable[[Any], Float[np.ndarray, "k"]]
    dimensions: int
    deviation: float

    def mean(self, observation: Any) -> Float[np.ndarray, "d"]:
        """Θᵀφ(x), (d,)."""
        return self._mean_of(self._features(observation))

    def sample(self, observation: Any, rng: np.random.Generator) -> Float[np.ndarray, "d"]:
        """An action, (d,)."""
        return self.mean(observation) + self.deviation * rng.standard_normal(self.dimensions)

    def score(self, observation: Any, action: ArrayLike) -> Vector:
        """ψ of the action as drawn, (k·d,)."""
        phi = self._features(observation)
        surprise = (np.asarray(action, dtype=np.float64) - self._mean_of(phi)) / self.deviation**2
        return np.outer(phi, surprise).reshape(-1)

    def _features(self, observation: Any) -> Float[np.ndarray, "k"]:
        return self.features(observation)

    def _mean_of(self, phi: Float[np.ndarray, "k"]) -> Float[np.ndarray, "d"]:
        mean: np.ndarray = phi @ self.parameters.reshape(-1, self.dimensions)
        return mean
