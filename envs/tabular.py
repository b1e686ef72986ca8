"""Finite Markov decision processes with vector rewards, and their exact answers."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from .arrays import (
    AverageRewards,
    Chain,
    ChannelValues,
    Occupancy,
    PolicyTable,
    Rewards,
    StateDistribution,
    TableGradients,
    Thresholds,
    Transitions,
)
from .interface import FiniteKernel, register_code
from .markov_chain import stationary_distribution
from .validation import (
    finite_array,
    index_below,
    number_between,
    positive_integer,
    real_array,
    require_probabilities,
)

# Below this share of time a state counts as never visited: the linear programme's zeros are exact, its noise
# is 1e-16.
_VISITED = 1e-12


@dataclass(frozen=True, eq=False)
class ConstrainedOptimum:
    """The best average reward under thresholds, and how it is reached.

    Parameters
    ----------
    values
        (1 + m,), average rewards of `policy`, per step.
    policy
        (states, actions), uniform in states that it never visits.
    occupancy
        (states, actions), share of time spent in s doing a.
    multipliers
        (m,), ≥ 0, λᵢ = −∂ρ¹/∂Gⁱ where that derivative exists, one of the subgradients elsewhere.
    """

    values: ChannelValues
    policy: PolicyTable
    occupancy: Occupancy
    multipliers: Thresholds


@register_code
@dataclass(frozen=True, init=False, eq=False)
class TabularMDP:
    """T(s, a, s′) = Pr(s′ | s, a) and rewards rⁱ(s, a), channel 0 the intrinsic one.

    A policy is a table π(a | s), (states, actions); where a method takes one it also takes a stack of them,
    (…, states, actions), and answers with the same leading axes.

    Parameters
    ----------
    transitions
        (states, actions, states), rows sum to 1. Arrays are copied and made read-only.
    rewards
        (1 + m, states, actions).
    start
        First state of an episode.

    Raises
    ------
    ValueError
        For NaN, infinities, wrong shapes, what is no probability.
    """

    transitions: Transitions
    rewards: Rewards
    start: int

    def __init__(self, transitions: ArrayLike, rewards: ArrayLike, start: int = 0) -> None:
        T = finite_array("transitions", transitions)
        if T.ndim != 3 or T.shape[0] != T.shape[2] or T.size == 0:
            raise ValueError(f"transitions should have shape (states, actions, states); found {T.shape}")
        require_probabilities("transitions", T)
        r = finite_array("rewards", rewards)
        if r.ndim != 3 or r.shape[0] == 0 or r.shape[1:] != T.shape[:2]:
            raise ValueError(f"rewards should have shape (1 + m, {T.shape[0]}, {T.shape[1]}); found {r.shape}")
        object.__setattr__(self, "transitions", T)
        object.__setattr__(self, "rewards", r)
        object.__setattr__(self, "start", index_below("start", start, T.shape[0]))

    @property
    def states(self) -> int:
        """Number of states."""
        return int(self.transitions.shape[0])

    @property
    def actions(self) -> int:
        """Number of actions."""
        return int(self.transitions.shape[1])

    @property
    def reward_channels(self) -> int:
        """1 + m: the intrinsic reward and the extrinsic ones."""
        return int(self.rewards.shape[0])

    def chain(self, policy: ArrayLike) -> Chain:
        """P(s, s′) = Σₐ π(a|s) T(s, a, s′)."""
        return self._chain(self._policy(policy))

    def stationary_distribution(self, policy: ArrayLike) -> StateDistribution:
        """The d with dP = d, Σd = 1: the share of time spent in each state, whatever the start.

        Transient states and periodic chains are fine.

        Raises
        ------
        ValueError
            For a policy whose chain has more than one recurrent class: its shares depend on the start.
        """
        return stationary_distribution(self.chain(policy))

    def average_rewards(self, policy: ArrayLike) -> AverageRewards:
        """ρⁱ = Σₛ d(s) Σₐ π(a|s) rⁱ(s, a), per step: eq. 1 and 2. Raises as `stationary_distribution`."""
        table = self._policy(policy)
        return self._averages(stationary_distribution(self._chain(table)), table)

    def policy_gradients(self, policy: ArrayLike) -> TableGradients:
        """∂ρⁱ/∂θ(s, a) = d(s) π(a|s) (Qⁱ(s, a) − Vⁱ(s)) for the softmax parameters θ of π.

        Vⁱ solves the Poisson equation (I − P) Vⁱ = rⁱ_π − ρⁱ with dVⁱ = 0; Qⁱ = rⁱ − ρⁱ + T Vⁱ. Ascent
        gradients; they sum to 0 over the actions of a state. Raises as `stationary_distribution`.
        Source: policy gradient theorem for average reward, Sutton, McAllester, Singh & Mansour (2000),
        theorem 1.
        """
        return self.discounted_score_gradients(policy, 1.0)

    def discounted_score_gradients(
        self, policy: ArrayLike, trace_decay: float, convention: Literal["paper", "usual"] = "paper"
    ) -> TableGradients:
        """The limit of GPOMDP's estimate in a long run at trace decay β: Σₖ cₖ E[ψ_t r_{t+k}], stationary.

        "paper": cₖ = 1, 1, β, β², …, from r_{t+1}(z_{t+1} + ψ_{t+1}) with z_{t+1} = βz_t + ψ_t (eq. 3 as printed);
        "usual": cₖ = βᵏ (Baxter & Bartlett, 2001). For the softmax parameter θ(s, a)

            Σₖ cₖ E[ψ r_{t+k}] = d(s) π(a|s) (Q(s, a) − Σ_b π(b|s) Q(s, b)),   Q = r + c₁ T V,
            V = Σₖ βᵏ Pᵏ (r_π − ρ) = (I − βP + 1dᵀ)⁻¹ (r_π − ρ)

        The term 1dᵀ changes nothing, as d(r_π − ρ) = 0, and keeps the matrix regular up to β = 1, where both
        conventions are the exact gradient.

        Parameters
        ----------
        policy
            (…, states, actions).
        trace_decay
            β, in [0, 1].
        convention
            "paper" or "usual".

        Returns
        -------
        array
            (…, 1 + m, states, actions).

        Raises
        ------
        ValueError
            For another β or convention, and as `stationary_distribution`.
        """
        decay = number_between("trace_decay", trace_decay, 0.0, 1.0)
        if convention not in ("paper", "usual"):
            raise ValueError(f"convention should be 'paper' or 'usual'; found {convention!r}")
        table = self._policy(policy)
        P = self._chain(table)
        d = stationary_distribution(P)
        excess = np.einsum("...sa,csa->...sc", table, self.rewards) - self._averages(d, table)[..., None, :]
        V = np.linalg.solve(np.eye(self.states) - decay * P + d[..., None, :], excess)
        later = np.einsum("saj,...jc->...csa", self.transitions, V)
        Q = self.rewards + (1.0 if convention == "paper" else decay) * later
        weights = table[..., None, :, :]
        advantage = Q - (weights * Q).sum(axis=-1, keepdims=True)
        gradients: TableGradients = d[..., None, :, None] * weights * advantage
        return gradients

    def constrained_optimum(self, thresholds: ArrayLike) -> ConstrainedOptimum:
        """The policy with the largest ρ¹ s.t. ρⁱ ≥ Gⁱ among stationary ones: the occupancy-measure programme.

        Parameters
        ----------
        thresholds
            (m,), thresholds[0] = G²; −inf switches a constraint off.

        Raises
        ------
        ValueError
            With the least violation if no policy meets them (misses below 1e-10 of a channel's range, or 1e-14 of its
            size, count as met), and if the optimal shares of time are spread over several recurrent classes, which no
            single run can realise.
        """
        from .occupancy import best_occupancy

        bounds = real_array("thresholds", thresholds)
        if bounds.shape != (self.reward_channels - 1,) or (bounds == np.inf).any():
            raise ValueError(
                f"thresholds should have shape ({self.reward_channels - 1},) and be below +inf; found {bounds.tolist()}"
            )
        shares, multipliers = best_occupancy(self.transitions, self.rewards, bounds)
        visits = shares.sum(axis=1, keepdims=True)
        policy = np.full(shares.shape, 1 / self.actions)
        np.divide(shares, visits, out=policy, where=visits > _VISITED)
        d = self.stationary_distribution(policy)
        return ConstrainedOptimum(self._averages(d, policy), policy, d[:, None] * policy, multipliers)

    def finite_kernel(self) -> FiniteKernel:
        """The arrays for compiled code, as fresh copies."""
        cumulative = np.cumsum(self.transitions, axis=2)
        # From the last possible successor on exactly 1: neither a rounded sum nor a zero can then be drawn.
        last = self.states - 1 - np.argmax(self.transitions[:, :, ::-1] > 0, axis=2)
        cumulative[np.arange(self.states) >= last[:, :, None]] = 1.0
        return FiniteKernel(np.minimum(cumulative, 1.0), self.rewards.copy(), self.start)

    def _policy(self, policy: ArrayLike) -> PolicyTable:
        table = finite_array("policy", policy)
        if table.shape[-2:] != (self.states, self.actions):
            raise ValueError(f"policy should have shape (…, {self.states}, {self.actions}); found {table.shape}")
        require_probabilities("policy", table)
        return table

    def _chain(self, table: PolicyTable) -> Chain:
        product: Chain = (table[..., None, :] @ self.transitions)[..., 0, :]
        return product

    def _averages(self, distribution: StateDistribution, table: PolicyTable) -> AverageRewards:
        shares = (distribution[..., None] * table).reshape(*table.shape[:-2], -1)
        averages: AverageRewards = shares @ self.rewards.reshape(self.reward_channels, -1).T
        return averages


def random_mdp(rng: np.random.Generator, states: int, actions: int, channels: int) -> TabularMDP:
    """An ergodic MDP: each T(s, a, ·) uniform on the simplex, rewards standard normal; channels = 1 + m.

    All probabilities are positive, so every policy's chain is irreducible and aperiodic.

    Raises
    ------
    ValueError
        For what is no generator, and for numbers that are no integers ≥ 1.
    """
    if not isinstance(rng, np.random.Generator):
        raise ValueError(f"rng should be a numpy.random.Generator; found {rng!r}")
    shape = positive_integer("states", states), positive_integer("actions", actions)
    transitions = rng.dirichlet(np.ones(shape[0]), size=shape)
    return TabularMDP(transitions, rng.standard_normal((positive_integer("channels", channels), *shape)))
