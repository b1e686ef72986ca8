"""One episode of a policy in a Gymnasium environment with vector rewards."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from .policies import Policy


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
    observation, _ = environment.reset(seed=int(rng.integers(2**31)))
    for _ in range(limit):
        action = policy.sample(observation, rng)
        following, reward, terminated, truncated, info = environment.step(action)
        event = int(info.get("event", 1)) if terminated else 0
        yield Step(observation, action, _vector(reward), event, following)
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


def _vector(reward: Any) -> Float[np.ndarray, "channels"]:
    vector = np.asarray(reward, dtype=np.float64)
    if vector.ndim != 1:
        raise ValueError(f"rewards should be vectors (1 + m,); found shape {vector.shape}")
    return vector
