"""A softmax over actions whose preferences are linear in features of the observation."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cpgrl_opt.arrays import Float, Vector
from cpgrl_opt.validation import require_count

from .interface import Features, Index, ParametricPolicy, feature_vector, first_parameters, set_fields
from .softmax_table import draw_action, softmax


@dataclass(frozen=True, init=False, eq=False)
class LinearSoftmax(ParametricPolicy):
    """μ_θ(x, a) ∝ exp (Θᵀφ(x))_a;   ψ = φ(x) ⊗ (1[· = a] − μ_θ(x, ·)).

    One-hot features make it `SoftmaxTable`.

    Parameters
    ----------
    features
        φ(x), (k,), finite numbers.
    size, actions
        k of the features and A.
    parameters
        θ, (k·A,), the rows of Θ (k, A) one after the other; zeros unless given.

    Raises
    ------
    ValueError
        For sizes below 1 and a θ that does not fit; where it acts, for features of another size.

    Notes
    -----
    Source: Sutton & Barto, Reinforcement Learning, 2nd ed., §13.1.
    """

    features: Features
    size: int  # k
    actions: int
    parameters: Vector

    def __init__(self, features: Features, size: int, actions: int, parameters: ArrayLike | None = None) -> None:
        require_count("size", size)
        require_count("actions", actions)
        theta = first_parameters(parameters, size * actions)
        set_fields(self, features=features, size=int(size), actions=int(actions), parameters=theta)

    def probabilities(self, observation: Any) -> Float[np.ndarray, "A"]:
        """μ_θ(x, ·), (A,)."""
        return self._of(self._features(observation))

    def sample(self, observation: Any, rng: np.random.Generator) -> int:
        """An action 0 … A − 1."""
        return draw_action(self.probabilities(observation), rng)

    def score(self, observation: Any, action: Index) -> Vector:
        """ψ, (k·A,)."""
        phi = self._features(observation)
        surprise = -self._of(phi)
        surprise[action] += 1.0
        return np.outer(phi, surprise).reshape(-1)

    def _features(self, observation: Any) -> Float[np.ndarray, "k"]:
        return feature_vector(self.features(observation), self.size)

    def _of(self, phi: Float[np.ndarray, "k"]) -> Float[np.ndarray, "A"]:
        return softmax(phi @ self.parameters.reshape(self.size, self.actions))
