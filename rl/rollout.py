"""One episode of a policy in a Gymnasium environment with vector rewards."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from .policies import LinearGaussian, LinearSoftmax, NormalizedGaussianNetwork, Policy, SoftmaxTable


@dataclass(frozen=True, eq=False, slots=True)
class Step:
    """x_t, u_t, the rewards that (x_t, u_t) yields, (1 + m,), the event that ended the episode, 0 for none, x_{t+1}."""

    observation: Any
    action: Any
    reward: Float[np.ndarray, "channels"]
    event: int
    following: Any


def episode(environment: Any, policy: Policy, rng: np.random.Generator, limit: int) -> Iterator[Step]:
    """Steps from a reset, seeded from `rng`, to the episode's end or to `limit` steps.

    A terminated episode's last event is info["event"] if the environment counts events, else 1.
    """
    channels = reward_channels(environment)
    observation, _ = environment.reset(seed=int(rng.integers(2**31)))
    for _ in range(limit):
        action = policy.sample(observation, rng)
        following, reward, terminated, truncated, info = environment.step(action)
        event = int(info.get("event", 1)) if terminated else 0
        yield Step(observation, action, _vector(reward, channels), event, following)
        if terminated or truncated:
            return
        observation = following


def reward_channels(environment: Any) -> int:
    """1 + m of a Gymnasium environment with a vector reward; ValueError for anything else.

    Read from `reward_channels` (envs.interface) or from the shape of `reward_space` (MO-Gymnasium).
    """
    if not (callable(getattr(environment, "reset", None)) and callable(getattr(environment, "step", None))):
        raise ValueError(
            "environment should be a Gymnasium environment (reset, step), or a finite MDP (finite_kernel) with a "
            f"SoftmaxTable; found {type(environment).__name__}"
        )
    inner = getattr(environment, "unwrapped", environment)
    if hasattr(inner, "reward_channels"):
        return int(inner.reward_channels)
    shape = getattr(getattr(inner, "reward_space", None), "shape", None)
    if shape is None or len(shape) != 1:
        raise ValueError(
            "environment should have a reward_space of shape (1 + m,), as in MO-Gymnasium; found "
            f"{shape or 'none'} in {type(inner).__name__}"
        )
    return int(shape[0])


def require_fitting(environment: Any, policy: Policy) -> None:
    """ValueError unless a policy of ours fits the environment's spaces; whatever says no size is let through."""
    from gymnasium.spaces import Box, Discrete

    states, actions = (getattr(environment, f"{name}_space", None) for name in ("observation", "action"))
    if isinstance(policy, SoftmaxTable):
        _require_kind("observation", Discrete, states, policy)
        _require_size("states", policy.states, _count(states), states)
    if isinstance(policy, (SoftmaxTable, LinearSoftmax)):
        _require_kind("action", Discrete, actions, policy)
        _require_size("actions", policy.actions, _count(actions), actions)
    if isinstance(policy, NormalizedGaussianNetwork):
        _require_kind("observation", Box, states, policy)
        _require_size("components of an observation", len(policy.counts), _shape(states), states)
    if isinstance(policy, (LinearGaussian, NormalizedGaussianNetwork)):
        _require_kind("action", Box, actions, policy)
        _require_size("components of an action", policy.dimensions, _shape(actions), actions)


def _require_kind(name: str, kind: type, space: Any, policy: Policy) -> None:
    if space is not None and not isinstance(space, kind):
        raise ValueError(
            f"policy should have {name}s from {space}; found {type(policy).__name__}, which has them from a "
            f"{kind.__name__}"
        )


def _require_size(name: str, found: int, wanted: int | str | None, space: Any) -> None:
    if wanted is not None and found != wanted:
        raise ValueError(f"policy should have {wanted} {name}, as the environment's {space}; found {found}")


def _count(space: Any) -> int | str | None:
    """How many elements 0, 1, … a Discrete space has."""
    if space is None:
        return None
    return int(space.n) if space.start == 0 else f"{space.n} (from {space.start}, where a policy counts from 0)"


def _shape(space: Any) -> int | str | None:
    """How many components a Box has, if it is a box of vectors; else its shape, which no number equals."""
    if space is None:
        return None
    return int(space.shape[0]) if len(space.shape) == 1 else str(space.shape)


def _vector(reward: Any, channels: int) -> Float[np.ndarray, "channels"]:
    vector = np.asarray(reward, dtype=np.float64)
    if vector.shape != (channels,):
        raise ValueError(f"rewards should have shape ({channels},), as the environment declares; found {vector.shape}")
    return vector
