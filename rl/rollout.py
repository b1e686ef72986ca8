"""One episode of a policy in a Gymnasium environment with vector rewards."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from cpgrl_opt.arrays import Float, Vector
from cpgrl_opt.validation import is_finite

from ._spaces import hand_over, own_copy
from .channels import event_key, event_of, name_of, reward_channels
from .policies import Policy


class RolloutError(ValueError):
    """Something that an environment or a policy handed over; says what, and in which step, episode and run."""

    def __init__(self, what: str, environment: str = "", step: int | None = None, run: int | None = None) -> None:
        super().__init__(what, environment, step, run)
        self.what, self.environment, self.step, self.run = what, environment, step, run
        self.episode: int | None = None

    def at(self, environment: Any, step: int, run: int | None) -> Self:
        """The same error, where it happened."""
        return type(self)(self.what, name_of(environment), step, run)

    def __str__(self) -> str:
        numbers = (("step", self.step), ("episode", self.episode), ("run", self.run))
        places = [f"{name} {number}" for name, number in numbers if number is not None]
        return self.what + (f" ({', '.join(places)}, {self.environment})" if places else "")


class PolicyError(RolloutError):
    """A policy's action or score that is not finite, as where θ has grown without bound."""


@dataclass(frozen=True, eq=False, slots=True)
class Step:
    """x_t, u_t, r_t, the event, x_{t+1} and ψ_t.

    All are copies of what environment and policy handed out: neither can change them later.

    Parameters
    ----------
    observation, action
        x_t and u_t, as drawn.
    reward
        (1 + m,), what (x_t, u_t) yields.
    event
        The one that ended the episode, 0 for none.
    following
        x_{t+1}.
    score
        ψ_t, (n,).
    """

    observation: Any
    action: Any
    reward: Float[np.ndarray, "channels"]
    event: int
    following: Any
    score: Vector


def episode(
    environment: Any, policy: Policy, rng: np.random.Generator, limit: int, run: int | None = None
) -> Iterator[Step]:
    """Steps from a reset, seeded from `rng`, to the episode's end or to `limit` steps.

    At a termination the event is info[key] if that is an integer ≥ 1, else 1. The key is the environment's
    `event_key`, and "cpgrl_event" where it declares none.
    The environment gets its own copy of each action, in the dtype of its `action_space`; ψ is of the action as drawn.
    An action outside the space's bounds goes over as it is: clip it behind the policy, by `ClipAction` of
    gymnasium.wrappers or in the environment itself.

    Parameters
    ----------
    limit
        Steps, ≥ 1.
    run
        For the message of an error.

    Raises
    ------
    RolloutError
        A ValueError: for rewards, observations and actions that are NaN or infinite, rewards of another shape, and
        answers of `reset` and `step` that are not Gymnasium's.
    """
    channels, key = reward_channels(environment), event_key(environment)
    space = getattr(environment, "action_space", None)
    with locate_errors(environment, 0, run):
        observation = _begin(environment, int(rng.integers(2**31)))
    for step in range(limit):
        try:
            action, score = act(policy, observation, rng)
            following, reward, terminated, truncated, info = _check_answer(environment.step(hand_over(action, space)))
            rewards, following = _reward_vector(reward, channels), _own_observation("observation", following)
        except RolloutError as error:
            raise error.at(environment, step, run) from error.__cause__
        yield Step(observation, action, rewards, event_of(info, key, terminated=terminated), following, score)
        if terminated or truncated:
            return
        observation = following


@contextmanager
def locate_errors(environment: Any, step: int, run: int | None) -> Iterator[None]:
    """A RolloutError from inside learns where it happened."""
    try:
        yield
    except RolloutError as error:
        raise error.at(environment, step, run) from error.__cause__


def act(policy: Policy, observation: Any, rng: np.random.Generator) -> tuple[Any, Vector]:
    """u ~ μ_θ(x, ·) and its ψ, copies; RolloutError unless both are there and finite."""
    action = own_copy(policy.sample(observation, rng))
    if action is None:
        raise RolloutError(f"sample of {type(policy).__name__} should return an action; found None")
    _require_finite("action", action, policy)
    score, shape = np.asarray(policy.score(observation, action)), policy.parameters.shape
    if score.shape != shape or score.dtype.kind not in "fiu":
        raise RolloutError(
            f"score of {type(policy).__name__} should be numbers of shape {shape}, as θ; found {score.dtype}, "
            f"shape {score.shape}"
        )
    own = np.array(score, dtype=np.float64)
    _require_finite("score", own, policy)
    return action, own


def _require_finite(name: str, value: Any, policy: Policy) -> None:
    if (flaw := _flaw(value)) is not None:
        largest = np.abs(policy.parameters).max(initial=0.0)
        found = f"{flaw}, where max |θ| = {largest:.3g}"
        raise PolicyError(f"{name} of {type(policy).__name__} should be finite; found {found}")


def _begin(environment: Any, seed: int) -> Any:
    answer = environment.reset(seed=seed)
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise RolloutError(f"reset should return (observation, info), as in Gymnasium; found {type(answer).__name__}")
    return _own_observation("first observation", answer[0])


# What else is known to come out of `step`, by its length.
_OTHERS = {
    4: " as before Gymnasium: (observation, reward, done, info) needs a wrapper that tells terminated from truncated",
    6: " as in Safety-Gymnasium: (observation, reward, cost, terminated, truncated, info) needs a wrapper with "
    "np.array([reward, -cost]) in the reward's place and a reward_space of shape (2,)",
}


def _check_answer(answer: Any) -> tuple[Any, Any, bool, bool, Any]:
    if isinstance(answer, tuple) and len(answer) == 5:
        observation, reward, terminated, truncated, info = answer
        return observation, reward, bool(terminated), bool(truncated), info
    count = len(answer) if isinstance(answer, tuple) else None
    found = type(answer).__name__ if count is None else f"{count} values{_OTHERS.get(count, '')}"
    raise RolloutError(f"step should return (observation, reward, terminated, truncated, info); found {found}")


def _own_observation(name: str, observation: Any) -> Any:
    """A copy, since an environment may hand out its own buffer and go on writing to it."""
    own = own_copy(observation)
    if (flaw := _flaw(own)) is not None:
        raise RolloutError(f"{name} should be finite; found {flaw}")
    return own


def _flaw(value: Any, where: str = "") -> str | None:
    """The first NaN or infinity, and where it stands; None if there is none, or no number."""
    if type(value) is np.ndarray and value.dtype == np.float64 and is_finite(value):  # the usual case first
        return None
    if isinstance(value, (int, np.integer)):
        return None
    if isinstance(value, (float, np.floating, np.ndarray)):
        array = np.asarray(value)
        if array.dtype.kind not in "fc" or np.isfinite(array).all():
            return None
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        return f"{array[index]}{f' at {where}{list(index)}' if index or where else ''}"
    if isinstance(value, Mapping):
        parts = list(value.items())
    elif isinstance(value, (tuple, list)):
        parts = list(enumerate(value))
    else:
        return None
    return next((flaw for key, part in parts if (flaw := _flaw(part, f"{where}[{key!r}]")) is not None), None)


def _reward_vector(reward: Any, channels: int) -> Float[np.ndarray, "channels"]:
    try:
        given = np.asarray(reward)
        vector = np.array(given, dtype=np.float64) if given.dtype.kind in "biufO" else None
    except (TypeError, ValueError):
        vector = None
    if vector is None:
        raise RolloutError(f"rewards should be numbers, one for each channel; found {reward!r}")
    if vector.shape != (channels,):
        found = vector.shape if vector.ndim else "one number: a wrapper makes a vector of it, np.array([reward, -cost])"
        raise RolloutError(f"rewards should have shape ({channels},), as the environment declares; found {found}")
    if not is_finite(vector):
        channel = int(np.argmin(np.isfinite(vector)))
        raise RolloutError(f"reward of channel {channel} should be finite; found {vector[channel]}")
    return vector
