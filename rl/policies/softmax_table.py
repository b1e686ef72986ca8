"""A lookup table with softmax distribution: the policy of the three-state MDP (§3.1)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cpgrl_opt.arrays import Float, Vector
from cpgrl_opt.validation import require_count

from .interface import Index, ParametricPolicy, first_parameters, set_fields


@dataclass(frozen=True, init=False, eq=False)
class SoftmaxTable(ParametricPolicy):
    """μ_θ(s, a) = exp θ_{s,a} / Σ_b exp θ_{s,b};   ψ_{s',b}(s, a) = 1[s' = s] (1[b = a] − μ_θ(s, b)).

    Parameters
    ----------
    states, actions
        S and A, ≥ 1.
    parameters
        θ, (S·A,), index s·A + a; zeros, the uniform policy, unless given.

    Raises
    ------
    ValueError
        For sizes below 1 and a θ that does not fit.

    Notes
    -----
    Source: §3.1 of the paper.
    """

    states: int
    actions: int
    parameters: Vector

    def __init__(self, states: int, actions: int, parameters: ArrayLike | None = None) -> None:
        require_count("states", states)
        require_count("actions", actions)
        theta = first_parameters(parameters, states * actions)
        set_fields(self, states=int(states), actions=int(actions), parameters=theta)

    def probabilities(self, parameters: Float[np.ndarray, "*runs n"] | None = None) -> Float[np.ndarray, "*runs S A"]:
        """μ_θ as a table (…, S, A), of the policy's own θ or of many, (…, S·A)."""
        theta = self.parameters if parameters is None else np.asarray(parameters, dtype=np.float64)
        return softmax(theta.reshape((*theta.shape[:-1], self.states, self.actions)))

    def sample(self, observation: Index, rng: np.random.Generator) -> int:
        """An action 0 … A − 1 in the state 0 … S − 1."""
        return draw_action(self._row(observation), rng)

    def score(self, observation: Index, action: Index) -> Vector:
        """ψ, (S·A,): zero but for the A entries of the state."""
        psi = np.zeros((self.states, self.actions))
        psi[observation] = -self._row(observation)
        psi[observation, action] += 1.0
        return psi.reshape(-1)

    def _row(self, state: Index) -> Float[np.ndarray, "A"]:
        return softmax(self.parameters[state * self.actions : (state + 1) * self.actions])


def softmax(preferences: Float[np.ndarray, "*rows A"]) -> Float[np.ndarray, "*rows A"]:
    """exp hᵢ / Σⱼ exp hⱼ over the last axis; shifted by max h, so that nothing overflows."""
    weights: np.ndarray = np.exp(preferences - preferences.max(axis=-1, keepdims=True))
    weights /= weights.sum(axis=-1, keepdims=True)
    return weights


def draw_action(probabilities: Float[np.ndarray, "A"], rng: np.random.Generator) -> int:
    """An action 0 … A − 1."""
    place = int(np.searchsorted(np.cumsum(probabilities), rng.random(), side="right"))
    return min(place, len(probabilities) - 1)  # rounding can leave the last sum below the draw
