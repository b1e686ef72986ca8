"""Environments and policies that say what a test has them say."""

# ruff: noqa: ARG002 - stand-ins take what they ignore

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete

from rl import LinearGaussian, LinearSoftmax, WeightedSum, train
from rl.streams import run_streams


def streams(runs: int = 1, seed: int = 0) -> list[np.random.SeedSequence]:
    return [run_streams(seed, run).episodes for run in range(runs)]


def one(observation: Any) -> np.ndarray:
    """φ(x) = 1."""
    return np.ones(1)


ONE_OF_TWO = LinearSoftmax(one, 1, 2)


def estimate_of(environment: Any, estimator: Any, policy: Any) -> Any:
    """An estimation of one run, and its first estimate."""
    estimation = estimator.start(environment, policy, streams())
    return estimation, estimation.episode(np.array([policy.parameters]))


def learn(environment: Any, policy: Any, estimator: Any, **settings: Any) -> list[Any]:
    """The records of a training by SUM."""
    return list(train(environment, policy, estimator, WeightedSum(), **{"episodes": 1, "runs": 1, **settings}))


class Foreign(gymnasium.Env):  # type: ignore[type-arg]
    """One state, two actions, a reward of 1 in two channels; `begin(right)` and `answer(self, action, right)` say else.

    attributes: of the instance, as another action_space.
    """

    observation_space, action_space = Box(-np.inf, np.inf, (1,)), Discrete(2)
    reward_space = Box(-np.inf, np.inf, (2,))

    def __init__(self, answer: Callable[..., Any] | None = None, begin: Any = None, **attributes: Any) -> None:
        vars(self).update(attributes)
        self.answer, self.begin, self.episodes = answer, begin, 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.time, self.episodes = 0, self.episodes + 1
        right: Any = np.zeros(1), {}
        return right if self.begin is None else self.begin(right)

    def step(self, action: Any) -> Any:
        self.time += 1
        right = np.zeros(1), np.ones(2), False, False, {}
        return right if self.answer is None else self.answer(self, action, right)


def bandit(*lengths: int) -> Foreign:
    """Episodes of so many steps in turn, the last number over and over; a reward of 1 for action 1."""

    def answer(own: Any, action: Any, right: Any) -> Any:
        over = own.time == lengths[min(own.episodes, len(lengths)) - 1]
        return 0, np.array([float(action)]), over, False, {}

    return Foreign(answer, lambda _: (0, {}), observation_space=Discrete(1), reward_space=Box(0, 1, (1,)))


def two_or_eight() -> Foreign:
    """At first action 0 leads to an episode of 2 steps with return 1, action 1 to one of 8 with return 2.

    The return is paid at the last step; channel 1 is −1 a step. With Pr(action 1) = p: E[R] = 1 + p, E[T] = 2 + 6p.
    """

    def answer(own: Any, action: Any, right: Any) -> Any:
        if own.time == 1:
            own.length = 8 if action == 1 else 2
        over = own.time == own.length
        return 1, np.array([(2.0 if own.length == 8 else 1.0) * over, -1.0]), over, False, {}

    return Foreign(answer, lambda _: (0, {}), observation_space=Discrete(2))


class Given:
    """A policy of one parameter that draws and scores by what it is given; u ~ N(0, 1) without."""

    def __init__(self, sample: Any = None, score: Any = None) -> None:
        inner = LinearGaussian(one, 1, 1)
        self.parameters = inner.parameters
        self.draw, self.rate = sample or inner.sample, score or inner.score

    def with_parameters(self, parameters: Any) -> Any:
        return self

    def sample(self, observation: Any, rng: Any) -> Any:
        return self.draw(observation, rng)

    def score(self, observation: Any, action: Any) -> Any:
        return self.rate(observation, action)
