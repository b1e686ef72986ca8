"""Compiled kernels against `step`: the same rewards, the same distribution."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from envs.interface import ContinuousKernels, FiniteKernel, random_state

from ..channels import event_key, event_of
from .contract import require, require_reward

_EPISODES = 200  # of each side
_STEPS = 20  # of an episode at most: enough to see how one moves


def check_finite_kernel(kernel: FiniteKernel, transitions: Sequence[Any], z: float) -> None:
    """Rewards of each visited (s, a) exactly; how often s′ follows within z standard errors of its probability."""
    probabilities = np.diff(kernel.transition_cumulative, axis=2, prepend=0.0)
    counts = np.zeros(probabilities.shape)
    require(
        int(transitions[0].observation) == kernel.start,
        f"reset should lead to the kernel's start state {kernel.start}",
        transitions[0].observation,
    )
    for each in transitions:
        s, a = int(each.observation), int(each.action)
        counts[s, a, int(each.following)] += 1
        wanted = kernel.rewards[:, s, a]
        should = f"the reward in state {s} for action {a} should be the kernel's, {wanted}"
        require_reward(wanted, each.reward, should)
    visits = counts.sum(axis=2, keepdims=True)
    error = np.abs(counts - visits * probabilities)
    # 1 for what is rare: the count of an event of small probability is no Gaussian.
    allowed = z * np.sqrt(np.maximum(visits * probabilities * (1 - probabilities), 1.0)) * (visits > 0)
    impossible = (probabilities == 0) & (counts > 0)
    worst = np.unravel_index(np.argmax(np.where(impossible, np.inf, error - allowed)), counts.shape)
    s, a, following = (int(index) for index in worst)
    require(
        not impossible.any() and (error <= allowed).all(),
        f"from state {s} action {a} should lead to {following} with the kernel's probability "
        f"{probabilities[worst]:.3f}, {visits[s, a, 0] * probabilities[worst]:.0f} of {visits[s, a, 0]:.0f} times",
        f"{counts[worst]:.0f} times by step",
    )


def check_continuous_kernels(kernels: ContinuousKernels, env: Any, seed: int, z: float) -> None:
    """Means and mean squares of start, way, rewards, length and event, over episodes of random actions."""
    names = [
        *(f"start[{i}]" for i in range(kernels.state_size)),
        *(f"way from start to last state[{i}]" for i in range(kernels.state_size)),
        *(f"sum of reward channel {i}" for i in range(kernels.reward_channels)),
        "number of steps",
        *(f"share of episodes that end with {event}" for event in kernels.events),
    ]
    by_kernel, by_step = (
        np.array(list(make(kernels, env, source)))
        for make, source in zip((_kernel_episodes, _step_episodes), np.random.SeedSequence(seed).spawn(2), strict=True)
    )
    for power, what in ((1, "mean"), (2, "mean square")):
        means = [(sample**power).mean(axis=0) for sample in (by_kernel, by_step)]
        errors = np.sqrt(sum((sample**power).var(axis=0, ddof=1) / _EPISODES for sample in (by_kernel, by_step)))
        gap = np.abs(means[0] - means[1])
        # A share of 0 or 1 has no spread in a sample: one episode in _EPISODES is nothing to go by.
        allowed = z * np.maximum(errors, 1e-9 * (1 + np.abs(means[0])))
        allowed[len(names) - len(kernels.events) :] += 2 / _EPISODES
        worst = int(np.argmax(gap - allowed))
        require(
            (gap <= allowed).all(),
            f"the {what} of the {names[worst]} should be the same by kernels and by step, to {allowed[worst]:.3g}",
            f"{means[0][worst]:.6g} and {means[1][worst]:.6g}",
        )


def _kernel_episodes(kernels: ContinuousKernels, _: Any, source: np.random.SeedSequence) -> Iterator[np.ndarray]:
    state, reward = np.zeros(kernels.state_size), np.zeros(kernels.reward_channels)
    own, actions = source.spawn(2)
    stream = random_state(own)

    def begin() -> np.ndarray:
        kernels.reset(kernels.constants, stream, state)
        return state

    def step(action: np.ndarray) -> tuple[np.ndarray, np.ndarray, int, bool]:
        event = kernels.step(kernels.constants, state, action, stream, reward)
        return state, reward, event, event != 0

    return _episodes(kernels, np.random.default_rng(actions), begin, step)


def _step_episodes(kernels: ContinuousKernels, env: Any, source: np.random.SeedSequence) -> Iterator[np.ndarray]:
    rng, key = np.random.default_rng(source), event_key(env)

    def begin() -> np.ndarray:
        return np.array(env.reset(seed=int(rng.integers(2**31)))[0])

    def step(action: np.ndarray) -> tuple[np.ndarray, np.ndarray, int, bool]:
        state, reward, terminated, truncated, info = env.step(action)
        event = event_of(info, key, terminated=terminated)
        return state, reward, event, bool(event or truncated)

    return _episodes(kernels, rng, begin, step)


def _episodes(
    kernels: ContinuousKernels, rng: np.random.Generator, begin: Callable[[], np.ndarray], step: Callable[..., Any]
) -> Iterator[np.ndarray]:
    """Of each episode of random actions: start, way, sums of rewards, steps, and which event ended it."""
    for _ in range(_EPISODES):
        state = begin()
        start, total, event, steps, ended = state.copy(), np.zeros(kernels.reward_channels), 0, 0, False
        while not ended and steps < min(_STEPS, kernels.max_steps):
            state, reward, event, ended = step(rng.standard_normal(kernels.action_size))
            total += reward
            steps += 1
        ends = np.arange(1, len(kernels.events) + 1) == event
        yield np.concatenate([np.ravel(start), np.ravel(state - start), total, [steps], ends.astype(float)])
