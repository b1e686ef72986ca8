"""Training: many runs of one learner in lockstep by episode, as a generator of records."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cpgrl_opt import ConstrainedStep, Linearization
from cpgrl_opt.arrays import Float, Vector
from cpgrl_opt.step import Observer
from cpgrl_opt.validation import is_finite, require_count

from .channels import name_of
from .estimators import Estimate, Estimation, GradientEstimator
from .estimators.learned_episodes import LearnedEpisodes, LearningEstimation
from .learners import CPGRL, Learner, LearnerUpdate
from .policies import Policy
from .policies.interface import parameter_vector
from .rollout import PolicyError, RolloutError
from .streams import run_indices, run_streams

_ADVICE = "Lower the rates, or set the step's ridge or max_restoration"

Initial = Callable[[np.random.Generator], Vector]


class DivergenceError(FloatingPointError):
    """An estimate or θ is not finite: the run cannot go on."""


@dataclass(frozen=True, eq=False, slots=True)
class TrainingRecord:
    """B runs after an episode and the update that followed it.

    episode: from 1; parameters: (B, n), θ *after* the update; estimate: at the θ before it; update: the change.
    The arrays are made anew each episode and never written again: keep them without copying, do not write to them. A
    record itself may hold on to the episodes beside it, a few megabytes.
    """

    episode: int
    parameters: Float[np.ndarray, "B n"]
    estimate: Estimate
    update: LearnerUpdate

    @property
    def linearization(self) -> Linearization:
        """ρ (B, 1 + m) and Δ (B, 1 + m, n) that the update was made from."""
        return self.estimate.linearization


class _LearnedRecord(TrainingRecord):
    """A record whose parts are made when somebody looks at them."""

    __slots__ = ("_index", "_learned")

    def __new__(cls, *parts: Any, **named: Any) -> Any:
        """A plain record, for `dataclasses.replace`."""
        return TrainingRecord(*parts, **named)

    @classmethod
    def of(cls, episode: int, learned: LearnedEpisodes, index: int) -> "_LearnedRecord":
        """The record of one of the episodes."""
        record: _LearnedRecord = object.__new__(cls)
        for name, value in (("episode", episode), ("_learned", learned), ("_index", index)):
            object.__setattr__(record, name, value)
        return record

    parameters = property(lambda self: self._learned.parameters[self._index + 1].copy())
    estimate = property(lambda self: self._learned.estimate(self._index))
    update = property(lambda self: self._learned.update(self._index))

    def __reduce__(self) -> tuple[type[TrainingRecord], tuple[Any, ...]]:
        return TrainingRecord, (self.episode, self.parameters, self.estimate, self.update)


def train(
    environment: Any,
    policy: Policy,
    estimator: GradientEstimator,
    learner: Learner,
    *,
    episodes: int,
    runs: int | Sequence[int] = 20,
    seed: int = 0,
    initial: Initial | None = None,
    observe: Observer | None = None,
    stop_when_stationary: bool = False,
    max_change: float = np.inf,
) -> Iterator[TrainingRecord]:
    """while k < N_K: estimate ρ and Δ over an episode; update θ (§2.1). One record per episode.

    episodes: N_K; runs: how many, or which: run i of a seed is the same, bit for bit, whatever else runs beside it.
    initial: draws a run's first θ, (n,), from the run's own stream; the policy's θ for every run if not given.
    observe: sees every direction problem of the learner with its answer.
    stop_when_stationary: end after the update in which every run was stationary (the paper's termination).
    max_change: the most by which an update may move a component of θ, in its unit. A diverging update need not reach
    infinity: on the arm the paper's own throws θ so far that the policy never acts otherwise again.
    Compiled episodes that nobody observes are simulated some milliseconds ahead of their records.
    Raises ValueError for bad input at once; RolloutError, a ValueError, for an environment's NaN or infinity, with the
    step, episode and run; DivergenceError when an estimate, an action or θ is not finite or θ moves further.
    """
    require_count("episodes", episodes, 0)
    _require_types(initial, max_change)
    indices = run_indices(runs)
    streams = [run_streams(seed, run) for run in indices]
    parameters = _first_parameters(policy, initial, [np.random.default_rng(stream.initial) for stream in streams])
    estimation = estimator.start(environment, policy, [stream.episodes for stream in streams])
    if not isinstance(estimation, Estimation):
        raise ValueError(f"the estimator's start should return an Estimation (episode); found {estimation!r}")
    course = _Course(name_of(environment), indices, episodes, observe, stop_when_stationary, max_change)
    return _records(estimation, learner, parameters, course)


def _require_types(initial: object, max_change: object) -> None:
    if not isinstance(max_change, (int, float, np.integer, np.floating)) or not max_change > 0:
        raise ValueError(f"max_change should be a number > 0; found {max_change!r}")
    if initial is not None and not callable(initial):
        raise ValueError(f"initial should be a function of a random generator, or None; found {initial!r}")


@dataclass(frozen=True)
class _Course:
    environment: str
    runs: tuple[int, ...]
    episodes: int
    observe: Observer | None
    stop_when_stationary: bool
    max_change: float


def _records(
    estimation: Estimation, learner: Learner, parameters: Float[np.ndarray, "B n"], course: _Course
) -> Iterator[TrainingRecord]:
    memory: Any = None
    learning, step = _compiled(estimation, learner, parameters, course)
    episode = 0
    while episode < course.episodes:
        estimate = None
        learned = learning.learned_episodes(parameters, step, course.episodes - episode) if learning else None
        if learned is not None:
            for k in range(learned.made):
                yield _LearnedRecord.of(episode + k + 1, learned, k)
            episode, parameters = episode + learned.made, learned.parameters[learned.made]
            if learned.made == len(learned.change):
                continue
            estimate = learned.estimate(learned.made)
        episode += 1
        estimate = estimate or _estimated(estimation, parameters, course, episode)
        parameters, update = _updated(estimate, learner, parameters, memory, course, episode)
        memory = update.memory
        yield TrainingRecord(episode, parameters, estimate, update)
        if course.stop_when_stationary and update.stationary.all():
            return


def _compiled(
    estimation: Estimation, learner: Learner, parameters: Float[np.ndarray, "B n"], course: _Course
) -> tuple[LearningEstimation | None, tuple[Any, ...]]:
    """Who makes usual updates without Python, and what it takes of the learner; None where nobody can.

    An observer sees every direction problem. Subclasses, and wrappers that hand attributes on, may do anything in code
    of their own. No update depends on the last one's 𝒜.
    """
    if course.observe is not None or type(learner) is not CPGRL or type(learner.step) is not ConstrainedStep:
        return None, ()
    way = learner.step.usual_way(len(learner.thresholds), parameters.shape[1])
    speaks_for_itself = {"episode", "learned_episodes"} <= vars(type(estimation)).keys()
    if way is not None and speaks_for_itself and isinstance(estimation, LearningEstimation):
        return estimation, (learner.thresholds.copy(), way, float(course.max_change))
    return None, ()


def _estimated(estimation: Estimation, parameters: Float[np.ndarray, "B n"], course: _Course, episode: int) -> Estimate:
    """One episode; what is wrong with environment or policy is told with the run's own number."""
    try:
        estimate = estimation.episode(parameters)
    except RolloutError as error:
        error.episode, error.run = episode, None if error.run is None else course.runs[error.run]
        if isinstance(error, PolicyError):
            raise DivergenceError(f"{error}. If that is large: {_ADVICE[0].lower()}{_ADVICE[1:]}") from error
        raise
    if not all(hasattr(estimate, name) for name in ("values", "gradients", "rewards")):
        raise ValueError(f"the estimator's episode should return an Estimate; found {estimate!r}")
    return estimate


def _updated(
    estimate: Estimate,
    learner: Learner,
    parameters: Float[np.ndarray, "B n"],
    memory: Any,
    course: _Course,
    episode: int,
) -> tuple[Float[np.ndarray, "B n"], LearnerUpdate]:
    """The learner's update and θ after it, or what is wrong with either."""
    linearization = _finite(estimate, parameters, course, episode)
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is found by _require_finite
        try:
            update = learner.update(linearization, memory, course.observe)
        except FloatingPointError as error:
            raise DivergenceError(f"after episode {episode} {error}. {_ADVICE}") from error
        _require_update(update, parameters)
        parameters = parameters + update.change
    _require_finite(parameters, course.runs, episode)
    _require_small(update.change, course, episode)
    return parameters, update


def _finite(estimate: Estimate, parameters: Float[np.ndarray, "B n"], course: _Course, episode: int) -> Linearization:
    """The linearization, or which run and channel diverged."""
    if not is_finite(estimate.rewards):
        run, channel = np.argwhere(~np.isfinite(estimate.rewards))[0]
        raise RolloutError(
            f"rewards of channel {channel} should be finite; found a sum of {estimate.rewards[run, channel]}, where "
            f"max |θ| = {np.abs(parameters[run]).max():.3g} (episode {episode}, run {course.runs[run]}, "
            f"{course.environment})"
        )
    try:
        return estimate.linearization
    except ValueError as error:
        finite = np.isfinite(estimate.values) & np.isfinite(estimate.gradients).all(axis=2)
        if finite.all():
            raise
        run, channel = np.argwhere(~finite)[0]
        raise DivergenceError(
            f"the estimate of channel {channel} in run {course.runs[run]}, episode {episode}, should be finite; found "
            f"ρ = {estimate.values[run, channel]}, max |Δ| = {np.abs(estimate.gradients[run, channel]).max()}. "
            f"{_ADVICE}"
        ) from error


def _require_update(update: Any, parameters: Float[np.ndarray, "B n"]) -> None:
    """ValueError unless a learner's answer holds a change for each θ: another shape would spread over the runs."""
    if not hasattr(update, "change"):
        raise ValueError(f"the learner's update should return a LearnerUpdate; found {update!r}")
    change = np.asarray(update.change)
    if change.shape != parameters.shape or change.dtype.kind not in "fiu":
        raise ValueError(
            f"the learner's change should be numbers of shape {parameters.shape}; found {change.dtype}, {change.shape}"
        )


def _require_finite(parameters: Float[np.ndarray, "B n"], runs: tuple[int, ...], episode: int) -> None:
    if not is_finite(parameters):
        run, index = np.argwhere(~np.isfinite(parameters))[0]
        raise DivergenceError(
            f"θ[{index}] in run {runs[run]} should be finite after episode {episode}; found {parameters[run, index]}. "
            f"{_ADVICE}"
        )


def _require_small(change: Float[np.ndarray, "B n"], course: _Course, episode: int) -> None:
    if course.max_change < np.inf and (found := np.abs(change)).max() > course.max_change:
        run, index = np.unravel_index(found.argmax(), found.shape)
        raise DivergenceError(
            f"θ[{index}] in run {course.runs[run]} should move by at most max_change = {course.max_change:g} in the "
            f"update after episode {episode}; found {change[run, index]:g}. {_ADVICE}"
        )


def uniform_parameters(n: int, low: float = 0.0, high: float = 1.0) -> Initial:
    """θ₀ ~ U[low, high]ⁿ; the paper's §3.1 has U[0, 1]⁹."""
    require_count("n", n)
    if not -np.inf < low <= high < np.inf:
        raise ValueError(f"low and high should be finite, low ≤ high; found {low!r}, {high!r}")
    return lambda rng: rng.uniform(low, high, n)


def _first_parameters(
    policy: Policy, initial: Initial | None, rngs: Sequence[np.random.Generator]
) -> Float[np.ndarray, "B n"]:
    if initial is None:
        return np.array([parameter_vector(policy.parameters, np.size(policy.parameters)) for _ in rngs])
    return np.array([policy.with_parameters(_drawn(initial, rng, len(policy.parameters))).parameters for rng in rngs])


def _drawn(initial: Initial, rng: np.random.Generator, n: int) -> Vector:
    try:
        return parameter_vector(initial(rng), n)
    except ValueError as error:
        raise ValueError(f"initial should return θ of shape ({n},), finite numbers: {error}") from error
