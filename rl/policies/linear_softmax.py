"""A softmax over actions whose preferences are linear in features of the observation."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from cpgrl_opt.arrays import Float, Vector
from cpgrl_opt.validation import require_count

from .interface import Features, Index, at_parameters, feature_vector, first_parameters
from .softmax_table import softmax


@dataclass(frozen=True, init=False, eq=False)
class LinearSoftmax:
    """μ_θ(x, a) ∝ exp (Θᵀφ(x))_a;   ψ = φ(x) ⊗ (1[· = a] − μ_θ(x, ·)).

    features: φ(x), (k,), finite; Θ: (k, A), θ its rows one after the other. One-hot features make it `SoftmaxTable`.
    Source: Sutton & Barto, Reinforcement Learning, 2nd ed., §13.1.
    """

    features: Features
    size: int  # k
    actions: int
    parameters: Vector

    def __init__(self, features: Features, size: int, actions: int, parameters: ArrayLike | None = None) -> None:
        require_count("size", size)
        require_count("actions", actions)
        for name, value in (
            ("features", features),
            ("size", int(size)),
            ("actions", int(actions)),
            ("parameters", first_parameters(parameters, size * actions)),
        ):
            object.__setattr__(self, name, value)

    def probabilities(self, observation: Any) -> Float[np.ndarray, "A"]:
        """μ_θ(x, ·), (A,)."""
        return self._of(self._features(observation))

    def sample(self, observation: Any, rng: np.random.Generator) -> int:
        """An action 0 … A − 1."""
        cumulative = np.cumsum(self.probabilities(observation))
        return min(int(np.searchsorted(cumulative, rng.random(), side="right")), self.actions - 1)

    def score(self, observation: Any, action: Index) -> Vector:
        """ψ, (k·A,)."""
        phi = self._features(observation)
        surprise = -self._of(phi)
        surprise[action] += 1.0
        return np.outer(phi, surprise).reshape(-1)

    def with_parameters(self, parameters: ArrayLike) -> Self:
        """The policy at another θ, (k·A,)."""
        return at_parameters(self, parameters)

    def _features(self, observation: Any) -> Float[np.ndarray, "k"]:
        return feature_vector(self.features(observation), self.size)

    def _of(self, phi: Float[np.ndarray, "k"]) -> Float[np.ndarray, "A"]:
        return softmax(phi @ self.parameters.reshape(self.size, self.actions))
