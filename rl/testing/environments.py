"""`check_constrained_env`: does an environment keep what training relies on?"""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np

from envs.interface import continuous_kernels_of, finite_kernel_of

from ..channels import event_key, find_declaration, layers
from .contract import allow_limits, require, require_reward
from .kernels import check_continuous_kernels, check_finite_kernel

# (observation, action, next observation) → what each channel should yield, (1 + m,)
ExpectedReward = Callable[[Any, Any, Any], Any]


@dataclass(frozen=True, eq=False)
class Transition:
    """One step, of copies; given: by name, the objects that environment and check handed each other."""

    observation: Any
    action: Any
    following: Any
    reward: np.ndarray
    ended: tuple[bool, bool]
    given: dict[str, Any] = field(default_factory=dict)


@allow_limits
def check_constrained_env(
    env: Any, *, steps: int = 400, seed: int = 0, expected_reward: ExpectedReward | None = None, z: float = 6.0
) -> None:
    """Random actions for `steps` steps; ContractBroken at the first thing that is not as it should be.

    Checked: observation, action and reward spaces, all there; `reset` and `step` return what Gymnasium asks for, info
    a dict; every reward is an array (1 + m,) of floats, finite, inside the outermost `reward_space`; observations and
    rewards stay as they were when the next ones come, and actions are not written to: training copies them all, but
    others who keep them are misled; an event number at a termination is an integer ≥ 1 (`envs.interface`); the same
    seed and actions give the same episode, whatever NumPy's global generator is at.

    Parameters
    ----------
    expected_reward
        What each channel should yield, to check that channel 0 is the objective and the constraints stand in their
        order; without it the order is checked against compiled kernels, where the environment within its wrappers
        offers them (`envs.interface.finite_kernel_of`), and cannot be checked otherwise.
    z
        Kernels are compared with that environment's `step`: a finite MDP's rewards exactly; its transitions, and
        everything of continuous kernels, in distribution, within z standard errors, so that a right environment fails
        with a chance of about 2e-9 a number compared (z = 6).
    time_limit, memory_limit
        Where either is given, as seconds and bytes, the check runs in a process of its own, and what hangs or crashes
        there is ContractBroken too.

    Notes
    -----
    Not seen: a seed that is ignored by an environment that draws nothing, bias below the standard errors, and what
    random actions do not reach.
    """
    inner = getattr(env, "unwrapped", env)
    space = _check_spaces(env)
    first = _roll_out(env, steps, seed)
    _check_rewards(first, space)
    _check_ownership(first)
    again = _roll_out(env, steps, seed, disturb=True)
    for t, (one, other) in enumerate(zip(first, again, strict=False)):
        for name in ("observation", "reward", "following", "ended"):
            require(
                _same(getattr(one, name), getattr(other, name)),
                f"{name} of step {t} should be the same after reset(seed={seed}) and the same actions",
                f"{getattr(one, name)} and {getattr(other, name)}: all randomness should come from self.np_random",
            )
    require(
        len(first) == len(again), "an episode should be as long again after the same seed", (len(first), len(again))
    )
    if expected_reward is not None:
        _check_order(first, expected_reward)
    if (kernel := finite_kernel_of(inner)) is not None:
        check_finite_kernel(kernel, first if inner is env else _roll_out(inner, steps, seed), z)
    if (kernels := continuous_kernels_of(inner)) is not None:
        check_continuous_kernels(kernels, inner, seed, z)


def _check_spaces(env: Any) -> gymnasium.spaces.Box:
    """The reward space, the outermost one."""
    for name in ("reset", "step"):
        require(callable(getattr(env, name, None)), f"env should have a method {name}", type(env).__name__)
    for name in ("observation_space", "action_space"):
        found = getattr(env, name, None)
        require(isinstance(found, gymnasium.Space), f"{name} should be a Gymnasium space", repr(found))
    space: Any = find_declaration(env, "reward_space")
    require(
        isinstance(space, gymnasium.spaces.Box) and len(space.shape) == 1 and space.shape[0] >= 1,
        "reward_space should be a Box of shape (1 + m,), channel 0 the objective",
        repr(space),
    )
    box: gymnasium.spaces.Box = space
    channels = box.shape[0]
    for layer in layers(env):
        if getattr(layer, "reward_space", None) is box:
            for name in ("reward_dim", "reward_channels"):
                stated = getattr(layer, name, channels)
                require(stated == channels, f"{name} should be {channels}, as reward_space has it", stated)
    return box


def _roll_out(env: Any, steps: int, seed: int, *, disturb: bool = False) -> list[Transition]:
    """Random actions from a generator of its own; episodes after the first start without a seed."""
    rng = np.random.default_rng(seed)
    env.action_space.seed(int(rng.integers(2**31)))
    if disturb:  # whoever draws from the global generator is found out; its state is put back
        kept = np.random.get_state()  # noqa: NPY002
        np.random.random(7)  # noqa: NPY002
    key, found = event_key(env), []
    given = _reset(env, seed)
    observation = copy.deepcopy(given)
    for _ in range(steps):
        action = env.action_space.sample()
        drawn = copy.deepcopy(action)
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
        if terminated and (event := info.get(key)) is not None:
            whole = isinstance(event, (int, np.integer)) and not isinstance(event, bool) and event >= 1
            require(whole, f"info[{key!r}] at a termination should be an integer ≥ 1, or missing", repr(event))
        ended = bool(terminated), bool(truncated)
        objects = {"observation": given, "action": action, "following": following, "reward": reward}
        found.append(Transition(observation, drawn, copy.deepcopy(following), reward.copy(), ended, objects))
        given = _reset(env, None) if any(ended) else following
        observation = copy.deepcopy(given)
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


def _same(one: Any, other: Any) -> bool:
    """The same numbers in the same places, through dictionaries, tuples and lists."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, (tuple, list)) and isinstance(other, (tuple, list)):
        return len(one) == len(other) and all(map(_same, one, other))
    return bool(np.array_equal(one, other))


def _check_rewards(transitions: list[Transition], space: gymnasium.spaces.Box) -> None:
    for t, transition in enumerate(transitions):
        reward = transition.reward
        require(reward.shape == space.shape, f"the reward of step {t} should have shape {space.shape}", reward.shape)
        require(np.isfinite(reward).all(), f"the reward of step {t} should be finite", reward)
        require(
            (reward >= space.low).all() and (reward <= space.high).all(),
            f"the reward of step {t} should lie in reward_space, [{space.low}, {space.high}]",
            reward,
        )


_OWN = {
    "reward": "should stay as it was, an array of its own",
    "observation": "should stay as it was, an array of its own",
    "following": "should stay as it was, an array of its own",
    "action": "should not be written to",
}


def _check_ownership(transitions: list[Transition]) -> None:
    """What was handed over during the rollout, compared with copies taken before, after all of it is over."""
    for t, each in enumerate(transitions):
        for name, should in _OWN.items():
            copied, now = getattr(each, name), each.given[name]
            what = "next observation" if name == "following" else name
            require(_same(copied, now), f"the {what} of step {t} {should}", f"{copied}, later {now}")


def _check_order(transitions: list[Transition], expected_reward: ExpectedReward) -> None:
    for t, each in enumerate(transitions):
        wanted = np.asarray(expected_reward(each.observation, each.action, each.following), dtype=np.float64)
        require_reward(wanted, each.reward, f"the reward of step {t} should be {wanted}, channel by channel")
