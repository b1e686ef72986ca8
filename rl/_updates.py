"""One episode and the update after it, and what may be wrong with either, told with the run's own number."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cpgrl_opt import Linearization
from cpgrl_opt.arrays import Float
from cpgrl_opt.step import Observer
from cpgrl_opt.validation import is_finite

from .estimators import Estimate, Estimation
from .learners import Learner, LearnerUpdate
from .rollout import PolicyError, RolloutError

_ADVICE = "Lower the rates, or set the step's ridge or max_restoration"


class DivergenceError(FloatingPointError):
    """An estimate or θ is not finite: the run cannot go on."""


@dataclass(frozen=True)
class TrainingCourse:
    """Where a training is and how far it goes."""

    environment: str
    runs: tuple[int, ...]
    episodes: int
    observe: Observer | None
    stop_when_stationary: bool
    max_change: float


def estimate_episode(
    estimation: Estimation, parameters: Float[np.ndarray, "B n"], course: TrainingCourse, episode: int
) -> Estimate:
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


def update_parameters(
    estimate: Estimate,
    learner: Learner,
    parameters: Float[np.ndarray, "B n"],
    memory: Any,
    course: TrainingCourse,
    episode: int,
) -> tuple[Float[np.ndarray, "B n"], LearnerUpdate]:
    """The learner's update and θ after it, or what is wrong with either."""
    linearization = _linearize(estimate, parameters, course, episode)
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


def _linearize(
    estimate: Estimate, parameters: Float[np.ndarray, "B n"], course: TrainingCourse, episode: int
) -> Linearization:
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


def _require_small(change: Float[np.ndarray, "B n"], course: TrainingCourse, episode: int) -> None:
    if course.max_change < np.inf and (found := np.abs(change)).max() > course.max_change:
        run, index = np.unravel_index(found.argmax(), found.shape)
        raise DivergenceError(
            f"θ[{index}] in run {course.runs[run]} should move by at most max_change = {course.max_change:g} in the "
            f"update after episode {episode}; found {change[run, index]:g}. {_ADVICE}"
        )
