"""Training: many runs of one learner in lockstep by episode, as a generator of records."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt import ConstrainedStep, Linearization
from cpgrl_opt.arrays import Float, Vector
from cpgrl_opt.step import Observer
from cpgrl_opt.validation import is_number, require_count

from ._carried import put_back, require_like, state_of
from ._updates import DivergenceError, TrainingCourse, estimate_episode, update_parameters
from .channels import name_of
from .description import describe, describe_environment, describe_policy, first_difference
from .estimators import Estimate, Estimation, GradientEstimator
from .estimators.learned_episodes import LearnedEpisodes, LearningEstimation
from .learners import CPGRL, Learner, LearnerUpdate
from .policies import Policy
from .policies.interface import parameter_vector
from .saved_state import read_state, write_state
from .streams import MOST_COUNTED, run_indices, run_streams

__all__ = ["DivergenceError", "Initial", "Training", "TrainingRecord", "train", "uniform_parameters"]

_KIND = "saved training"
_PARTS = ("settings", "episode", "stationary", "parameters", "memory", "estimation")

Initial = Callable[[np.random.Generator], Vector]


@dataclass(frozen=True, eq=False, slots=True)
class TrainingRecord:
    """B runs after an episode and the update that followed it.

    Parameters
    ----------
    episode
        From 1.
    parameters
        (B, n), θ *after* the update.
    estimate
        At the θ before it.
    update
        The change.

    Notes
    -----
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


class Training:
    """A training that can be stopped: iterate for its records, `save` between two of them, `load` and iterate on.

    >>> training = Training(environment, policy, estimator, learner, episodes=10_000)      # doctest: +SKIP
    >>> for record in training:                                                            # doctest: +SKIP
    ...     if record.episode % 1000 == 0:
    ...         training.save("training.npz")

    `load` of the file into a `Training` made with the same arguments, in another process too, goes on bit for bit as
    if there had been no stop. What is saved: θ, and whatever goes from episode to episode: averages, critics, random
    streams, the learner's memory. Traces restart with each episode, so between two there are none. Arguments: as
    `train` says. An environment begins each episode with `reset(seed=…)`; memory of its own beyond that is not saved.
    """

    def __init__(
        self,
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
    ) -> None:
        require_count("episodes", episodes, 0, MOST_COUNTED)
        _require_types(policy, estimator, learner, initial, max_change)
        indices = run_indices(runs)
        streams = [run_streams(seed, run) for run in indices]
        self._theta = _first_parameters(policy, initial, [np.random.default_rng(stream.initial) for stream in streams])
        self._estimation = estimator.start(environment, policy, [stream.episodes for stream in streams])
        if not isinstance(self._estimation, Estimation):
            raise ValueError(f"the estimator's start should return an Estimation (episode); found {self._estimation!r}")
        self._learner, self._memory = learner, None
        self._course = TrainingCourse(
            name_of(environment), indices, episodes, observe, stop_when_stationary, max_change
        )
        self._learning, self._step = _compiled_learning(self._estimation, learner, self._theta, self._course)
        self._environment = environment
        self._made_with = {  # before anybody counts anything in them
            **describe_policy(policy),
            **describe("estimator", estimator),
            **describe("learner", learner),
            "runs": str(list(indices)),
            "seed": str(int(seed)),
        }
        self._episode = 0
        self._is_stationary = False  # after the last update, in every run
        self._is_whole = True  # no episode has been begun that has no record yet
        self._ahead: _Ahead | None = None

    @property
    def episode(self) -> int:
        """How many are done."""
        return self._episode

    @property
    def parameters(self) -> Float[np.ndarray, "B n"]:
        """θ after them, a fresh array."""
        ahead = self._ahead
        return (self._theta if ahead is None else ahead.learned.parameters[ahead.shown]).copy()

    def __iter__(self) -> Iterator[TrainingRecord]:
        """The records of the episodes that are left."""
        while self._episode < self._course.episodes and not (self._is_stationary and self._course.stop_when_stationary):
            self._require_whole("go on")
            self._is_whole = False
            record = self._next()
            self._is_whole = True
            yield record

    def save(self, path: Path | str) -> None:
        """Writes what is needed to go on after the last record; the file is there whole, or not at all.

        It is a zip file of JSON and arrays, as `numpy.load` reads; nothing is pickled.

        Raises
        ------
        ValueError
            Where an error has ended an episode halfway, for a learner's memory that is more than numbers, strings and
            arrays of them in lists, tuples and dicts, and for an estimation that does not say what it carries
            (`Estimation`).
        """
        write_state(path, _KIND, self.state())

    def load(self, path: Path | str) -> None:
        """Goes on from a file of `save`: the same records, bit for bit, as those that followed it.

        `episodes`, `observe`, `stop_when_stationary` and `max_change` may be others.

        Raises
        ------
        ValueError
            With the reason, for a file that is damaged or of another format, and where environment, policy, estimator,
            learner, runs or seed are not those that it was made with; this training stays as it was.
        """
        try:
            self.restore(read_state(path, _KIND))
        except ValueError as error:
            raise ValueError(f"{error} ({path})" if str(path) not in str(error) else str(error)) from error

    def state(self) -> dict[str, Any]:
        """What `save` writes, as a dict."""
        self._require_whole("be saved")
        self._rewind()
        return {
            "settings": self._settings(),
            "episode": self._episode,
            "stationary": self._is_stationary,
            "parameters": self._theta,
            "memory": self._memory,
            "estimation": state_of(self._estimation),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """What `load` does with it."""
        if missing := [name for name in _PARTS if name not in state]:
            raise ValueError(f"a saved training should have {', '.join(missing)}; found {', '.join(state)}")
        if type(state["episode"]) is not int or state["episode"] < 0:
            raise ValueError(f"episode should be a number ≥ 0; found {state['episode']!r}")
        difference = first_difference(state["settings"], self._settings())
        if difference is not None:
            raise ValueError(difference)
        require_like(self._theta, state["parameters"], "θ")
        require_like(self._estimation, state["estimation"], "what the estimation carries")
        put_back(self._estimation, state["estimation"])
        self._ahead, self._is_whole = None, True
        self._theta, self._memory = state["parameters"].copy(), state["memory"]
        self._episode, self._is_stationary = state["episode"], bool(state["stationary"])

    def _require_whole(self, what: str) -> None:
        if not self._is_whole:
            raise ValueError(f"a training should {what} between two episodes; found one that something ended halfway")

    def _settings(self) -> dict[str, str]:
        return {**describe_environment(self._environment), **self._made_with}

    def _next(self) -> TrainingRecord:
        """Of episodes simulated ahead, or of one that is simulated now."""
        estimate = None
        if self._learning is not None:
            if self._ahead is None:
                self._ahead = _Ahead.of(self._learning, self._theta, self._step, self._course.episodes - self._episode)
            if self._ahead is not None and self._ahead.shown < self._ahead.learned.made:
                return self._show(self._ahead)
            if self._ahead is not None:  # an episode whose update is not the usual one
                learned, self._ahead = self._ahead.learned, None
                estimate, self._theta = learned.estimate(learned.made), learned.parameters[learned.made]
        episode = self._episode + 1
        estimate = estimate or estimate_episode(self._estimation, self._theta, self._course, episode)
        theta, update = update_parameters(estimate, self._learner, self._theta, self._memory, self._course, episode)
        self._theta, self._memory, self._episode = theta, update.memory, episode
        self._is_stationary = bool(update.stationary.all())
        return TrainingRecord(episode, theta, estimate, update)

    def _show(self, ahead: "_Ahead") -> TrainingRecord:
        learned = ahead.learned
        self._episode += 1
        record = _LearnedRecord.of(self._episode, learned, ahead.shown)
        ahead.shown += 1
        if ahead.shown == len(learned.change):
            self._theta, self._ahead = learned.parameters[ahead.shown], None
        return record

    def _rewind(self) -> None:
        """The estimation goes back to where it was after the last record: what it did since is done again later."""
        if self._ahead is None or self._learning is None:
            return
        put_back(self._estimation, self._ahead.before or state_of(self._estimation))
        if self._ahead.shown:
            learned = self._learning.learned_episodes(self._theta, self._step, self._ahead.shown)
            assert learned is not None
            self._theta = learned.parameters[self._ahead.shown]
        self._ahead = None


@dataclass(eq=False, slots=True)
class _Ahead:
    """Episodes that were simulated ahead of their records, and the estimation's state before them; None if untold."""

    learned: LearnedEpisodes
    before: dict[str, Any] | None
    shown: int = 0

    @classmethod
    def of(cls, learning: LearningEstimation, theta: np.ndarray, step: tuple[Any, ...], most: int) -> "_Ahead | None":
        before = state_of(learning) if hasattr(type(learning), "carried") else None
        learned = learning.learned_episodes(theta, step, most)
        return None if learned is None else cls(learned, before)


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

    Compiled episodes that nobody observes are simulated some milliseconds ahead of their records.
    `Training` takes the same and can be saved between two records.

    Parameters
    ----------
    environment
        A Gymnasium environment with vector rewards, or what hands kernels over (`envs.interface`).
    policy, estimator, learner
        What acts, what estimates ρ and Δ over an episode, what makes an update of them.
    episodes
        N_K.
    runs
        How many, or which: run i of a seed is the same, bit for bit, whatever else runs beside it.
    seed
        Of all random streams.
    initial
        Draws a run's first θ, (n,), from the run's own stream; the policy's θ for every run if not given.
    observe
        Sees every direction problem of the learner with its answer.
    stop_when_stationary
        End after the update in which every run was stationary (the paper's termination).
    max_change
        The most by which an update may move a component of θ, in its unit. A diverging update need not reach infinity:
        on the arm the paper's own throws θ so far that the policy never acts otherwise again.

    Returns
    -------
    iterator of TrainingRecord
        One record per episode.

    Raises
    ------
    ValueError
        For bad input at once.
    RolloutError
        A ValueError: for an environment's NaN or infinity, with the step, episode and run.
    DivergenceError
        When an estimate, an action or θ is not finite or θ moves further than `max_change`.
    """
    return iter(
        Training(
            environment, policy, estimator, learner,
            episodes=episodes, runs=runs, seed=seed, initial=initial, observe=observe,
            stop_when_stationary=stop_when_stationary, max_change=max_change,
        )
    )  # fmt: skip


def _require_types(policy: object, estimator: object, learner: object, initial: object, max_change: Any) -> None:
    for name, given, kind in (("policy", policy, Policy), ("estimator", estimator, GradientEstimator)):
        if not isinstance(given, kind):
            raise ValueError(f"{name} should be a {kind.__name__}; found {given!r}")
    if not isinstance(learner, Learner) or isinstance(learner, Mapping):  # which has another kind of `update`
        raise ValueError(f"learner should be a Learner; found {learner!r}")
    if not is_number(max_change) or not max_change > 0:
        raise ValueError(f"max_change should be a number > 0; found {max_change!r}")
    if initial is not None and not callable(initial):
        raise ValueError(f"initial should be a function of a random generator, or None; found {initial!r}")


def _compiled_learning(
    estimation: Estimation, learner: Learner, parameters: Float[np.ndarray, "B n"], course: TrainingCourse
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


def uniform_parameters(n: int, low: float = 0.0, high: float = 1.0) -> Initial:
    """θ₀ ~ U[low, high]ⁿ; the paper's §3.1 has U[0, 1]⁹.

    Returns
    -------
    function
        Of a random generator, as `train` takes it for `initial`.

    Raises
    ------
    ValueError
        For n < 1 and bounds that are not finite, low ≤ high.
    """
    require_count("n", n)
    if not (is_number(low) and is_number(high) and -np.inf < low <= high < np.inf):
        raise ValueError(f"low and high should be finite, low ≤ high; found {low!r}, {high!r}")
    return lambda rng: rng.uniform(low, high, n)


def _first_parameters(
    policy: Policy, initial: Initial | None, rngs: Sequence[np.random.Generator]
) -> Float[np.ndarray, "B n"]:
    if initial is None:
        return np.array([parameter_vector(policy.parameters, np.size(policy.parameters)) for _ in rngs])
    return np.array(
        [policy.with_parameters(_draw_parameters(initial, rng, len(policy.parameters))).parameters for rng in rngs]
    )


def _draw_parameters(initial: Initial, rng: np.random.Generator, n: int) -> Vector:
    try:
        return parameter_vector(initial(rng), n)
    except ValueError as error:
        raise ValueError(f"initial should return θ of shape ({n},), finite numbers: {error}") from error
