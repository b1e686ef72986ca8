"""`check_constrained_env`: does an environment keep what training relies on?"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from envs.interface import ContinuousEnvironment, FiniteEnvironment

from .contract import require
from .kernels import check_continuous_kernels, check_finite_kernel

# (observation, action, next observation) → what each channel should yield, (1 + m,)
ExpectedReward = Callable[[Any, Any, Any], Any]


@dataclass(frozen=True, eq=False)
class Transition:
    """One step; reward is a copy, given the environment's own array."""

    observation: Any
    action: Any
    following: Any
    reward: np.ndarray
    given: np.ndarray
    ended: tuple[bool, bool]


def check_constrained_env(
    env: Any, *, steps: int = 400, seed: int = 0, expected_reward: ExpectedReward | None = None, z: float = 6.0
) -> None:
    """Random actions for `steps` steps; ContractBroken at the first thing that is not as it should be.

    Checked: observation, action and reward spaces, all there; `reset` and `step` return what Gymnasium asks for, info
    a dict; every reward is an array (1 + m,) of floats, finite, inside `reward_space`, and stays as it was when the
    next one comes; the same seed and actions give the same episode, whatever NumPy's global generator is at.
    expected_reward: what each channel should yield, to check that channel 0 is the objective and the constraints
    stand in their order; without it the order is checked against compiled kernels, where `env` offers them
    (`envs.interface`), and cannot be checked otherwise. Kernels are compared with `step`: a finite MDP's rewards
    exactly; its transitions, and everything of continuous kernels, in distribution, within `z` standard errors, so
    that a right environment fails with a chance of about 2e-9 a number compared (z = 6).
    Not seen: a seed that is ignored by an environment that draws nothing, bias below the standard errors, and what
    random actions do not reach.
    """
    inner = getattr(env, "unwrapped", env)
    channels = _check_spaces(env, inner)
    first = _rollout(env, steps, seed)
    _check_rewards(first, inner.reward_space, channels)
    again = _rollout(env, steps, seed, disturb=True)
    for t, (one, other) in enumerate(zip(first, again, strict=False)):
        for name in ("observation", "reward", "following", "ended"):
            require(
                np.array_equal(getattr(one, name), getattr(other, name)),
                f"{name} of step {t} should be the same after reset(seed={seed}) and the same actions",
                f"{getattr(one, name)} and {getattr(other, name)}: all randomness should come from self.np_random",
            )
    require(
        len(first) == len(again), "an episode should be as long again after the same seed", (len(first), len(again))
    )
    if expected_reward is not None:
        _check_order(first, expected_reward)
    if isinstance(inner, FiniteEnvironment):
        check_finite_kernel(inner.finite_kernel(), first, z)
    if isinstance(inner, ContinuousEnvironment):
        check_continuous_kernels(inner.continuous_kernels(), env, seed, z)


def _check_spaces(env: Any, inner: Any) -> int:
    for name in ("reset", "step"):
        require(callable(getattr(env, name, None)), f"env should have a method {name}", type(env).__name__)
    for name in ("observation_space", "action_space"):
        space = getattr(env, name, None)
        require(isinstance(space, gymnasium.Space), f"{name} should be a Gymnasium space", repr(space))
    space = getattr(inner, "reward_space", None)
    require(
        isinstance(space, gymnasium.spaces.Box) and len(space.shape) == 1 and space.shape[0] >= 1,
        "env.unwrapped.reward_space should be a Box of shape (1 + m,), channel 0 the objective",
        repr(space),
    )
    channels = int(inner.reward_space.shape[0])
    for name in ("reward_dim", "reward_channels"):
        stated = getattr(inner, name, channels)
        require(stated == channels, f"{name} should be {channels}, as reward_space has it", stated)
    return channels


def _rollout(env: Any, steps: int, seed: int, *, disturb: bool = False) -> list[Transition]:
    """Random actions from a generator of its own; episodes after the first start without a seed."""
    rng = np.random.default_rng(seed)
    env.action_space.seed(int(rng.integers(2**31)))
    if disturb:  # whoever draws from the global generator is found out; its state is put back
        kept = np.random.get_state()  # noqa: NPY002
        np.random.random(7)  # noqa: NPY002
    observation = _reset(env, seed)
    found = []
    for _ in range(steps):
        action = env.action_space.sample()
        answer = env.step(action)
        require(
            isinstance(answer, tuple) and len(answer) == 5,
            "step should return (observation, reward, terminated, truncated, info)",
            repr(answer),
        )
        following, reward, terminated, truncated, info = answer
        require(isinstance(info, dict), "info should be a dict", repr(info))
        for name, flag in (("terminated", terminated), ("truncated", truncated)):
            require(isinstance(flag, (bool, np.bool_)), f"{name} should be a truth value", repr(flag))
        _require_in("observation", following, env.observation_space)
        require(
            isinstance(reward, np.ndarray) and reward.dtype.kind == "f",
            "reward should be an array of floats, one for each channel",
            repr(reward),
        )
        ended = bool(terminated), bool(truncated)
        found.append(Transition(_copy(observation), _copy(action), _copy(following), reward.copy(), reward, ended))
        observation = _reset(env, None) if any(ended) else following
    if disturb:
        np.random.set_state(kept)  # noqa: NPY002
    return found


def _reset(env: Any, seed: int | None) -> Any:
    answer = env.reset(seed=seed)
    require(isinstance(answer, tuple) and len(answer) == 2, "reset should return (observation, info)", repr(answer))
    require(isinstance(answer[1], dict), "info should be a dict", repr(answer[1]))
    _require_in("observation", answer[0], env.observation_space)
    return answer[0]


def _require_in(name: str, value: Any, space: Any) -> None:
    require(space.contains(value), f"{name} should lie in {space}", repr(value))


def _copy(value: Any) -> Any:
    return value.copy() if isinstance(value, np.ndarray) else value


def _check_rewards(transitions: list[Transition], space: Any, channels: int) -> None:
    for t, transition in enumerate(transitions):
        reward = transition.reward
        require(reward.shape == (channels,), f"the reward of step {t} should have shape ({channels},)", reward.shape)
        require(np.isfinite(reward).all(), f"the reward of step {t} should be finite", reward)
        require(
            (reward >= space.low).all() and (reward <= space.high).all(),
            f"the reward of step {t} should lie in reward_space, [{space.low}, {space.high}]",
            reward,
        )
        require(
            np.array_equal(transition.given, reward),
            f"the reward of step {t} should stay as it was, an array of its own",
            f"{reward}, later {transition.given}",
        )


def _check_order(transitions: list[Transition], expected_reward: ExpectedReward) -> None:
    for t, each in enumerate(transitions):
        wanted = np.asarray(expected_reward(each.observation, each.action, each.following), dtype=np.float64)
        require(
            wanted.shape == each.reward.shape and np.allclose(wanted, each.reward, rtol=1e-6, atol=1e-9),
            f"the reward of step {t} should be {wanted}, channel by channel",
            f"{each.reward}{_swapped(wanted, each.reward)}",
        )


def _swapped(wanted: np.ndarray, found: np.ndarray) -> str:
    same = wanted.shape == found.shape and np.allclose(np.sort(wanted), np.sort(found))
    return ": the same numbers in another order of channels" if same else ""
