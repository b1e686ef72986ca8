"""An update rule with a driver: episodes of B runs become estimates."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cpgrl_opt.arrays import Float
from cpgrl_opt.validation import require_count, require_shape

from ..drivers import Batch, Driver, Rule, driver_for
from ..policies import Policy
from ..streams import MOST_COUNTED
from .interface import Estimate, Estimation
from .one_class import require_one_class
from .reported_gradient import ReportedGradient, UpdateWatch, require_gradient, require_updates
from .stored_average import StoredAverage, kinds_of_average, require_average_settings

_FILLED = ("gradients", "spans", "rewards", "entered", "steps", "events")  # of a batch, anew in each episode


@dataclass(frozen=True, kw_only=True)
class SamplingEstimator:
    """Settings that every estimator by samples has; a subclass adds its own, and its rule.

    Parameters
    ----------
    average_rate
        α_r, in [0, 1].
    average
        "step" or "episode", for all channels or for each: see `StoredAverage`.
    steps
        T, an episode's time limit, unless the environment's own is shorter.
    gradient
        "reported", of the ρ that `average` reports, or "episode mean": see `ReportedGradient`.
    bias_correction
        Whether an average that starts at 0 is divided by the sum of its weights.

    Raises
    ------
    ValueError
        For numbers out of range and unknown names; where it starts, for a rule, an environment or a policy that does
        not fit.
    """

    average_rate: float = 0.02
    average: str | Sequence[str] = "step"
    steps: int = 100
    gradient: str = "reported"
    bias_correction: bool = True

    def __post_init__(self) -> None:
        require_count("steps", self.steps, most=MOST_COUNTED)
        object.__setattr__(self, "average", kinds_of_average(self.average))
        require_average_settings(self)
        require_gradient(self.gradient)

    def rule(self, reported: ReportedGradient) -> Rule:
        """What happens at a step. reported: which channels report a sum over the episode, and what is subtracted."""
        raise NotImplementedError

    def start(self, environment: Any, policy: Policy, streams: Sequence[np.random.SeedSequence]) -> Estimation:
        """By the first of the drivers that takes environment and policy: compiled, or in Python."""
        require_one_class(environment, policy, self.average)
        return self.with_driver(driver_for(environment, policy, streams, int(self.steps)))

    def with_driver(self, driver: Driver) -> Estimation:
        """B runs played by this driver."""
        return Sampling(self, driver)


class Sampling:
    """B runs of an estimator's rule, played by a driver."""

    carried: tuple[str, ...] = ("driver", "average", "reported", "watch", "memory")

    def __init__(self, settings: SamplingEstimator, driver: Driver) -> None:
        runs, channels, n = driver.shape
        self.driver = driver
        self.average = StoredAverage(settings, runs, channels)
        self.reported = ReportedGradient(
            self.average.by_episode, settings.average_rate, runs, as_printed=settings.gradient == "episode mean"
        )
        self.rule = rule = settings.rule(self.reported)
        require_rule(rule, channels)
        from_start = np.full(channels, rule.first == 0) if rule.from_start is None else rule.from_start
        require_updates(rule.first, from_start, driver.limit)
        self.watch = None if from_start.all() else UpdateWatch()
        self.memory = np.zeros((runs, rule.memory, n))
        self.batch = _batch(rule, from_start, self.average, self.memory, driver.shape)

    @property
    def critics(self) -> Float[np.ndarray, "B k n"]:
        """What the rule carries, in θ's order; a fresh array."""
        return self.driver.reorder(self.memory).copy()

    def episode(self, parameters: Float[np.ndarray, "B n"]) -> Estimate:
        """One episode of each run."""
        filled = {name: np.empty_like(getattr(self.batch, name)) for name in _FILLED}
        batch = self.batch._replace(**filled)
        self.driver.play(self.rule.step, np.ascontiguousarray(parameters, dtype=np.float64), batch)
        updates = batch.steps - self.rule.first
        if self.watch is not None:
            self.watch.see(updates)
        spans = None if self.rule.span is None else batch.spans
        gradients = self.reported.convert(batch.gradients, updates, batch.entered, spans)
        return Estimate(self.average.store(batch.rewards), gradients, batch.steps, batch.rewards, batch.events)


def require_rule(rule: Any, channels: int) -> None:
    """ValueError unless a rule's arrays and numbers fit each other and the environment's 1 + m channels."""
    if not isinstance(rule, Rule):
        raise ValueError(f"the rule of an estimator should be a Rule; found {rule!r}")
    if not callable(rule.step):
        raise ValueError(f"step of a rule should be a function; found {rule.step!r}")
    for name in ("first", "vectors", "memory"):
        require_count(f"{name} of a rule", getattr(rule, name), 0)
    if rule.span is not None and (rule.span not in range(rule.vectors) or isinstance(rule.span, bool)):
        raise ValueError(f"span of a rule should be None or one of its {rule.vectors} vectors; found {rule.span!r}")
    if _numbers("constants", rule.constants).ndim != 1:
        raise ValueError(f"constants of a rule should be numbers, (k,); found shape {np.shape(rule.constants)}")
    if rule.channels is not None:
        rows = _numbers("channels", rule.channels)
        require_shape("channels of a rule", rows, (*rows.shape[:1], channels))
    if rule.from_start is not None:
        chosen = np.asarray(rule.from_start)
        require_shape("from_start of a rule", chosen, (channels,))
        if chosen.dtype != np.bool_:
            raise ValueError(f"from_start of a rule should be truth values; found dtype {chosen.dtype}")


def _numbers(name: str, values: Any) -> Float[np.ndarray, "..."]:
    try:
        numbers = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} of a rule should be numbers; found {values!r}") from None
    if np.isnan(numbers).any():
        raise ValueError(f"{name} of a rule should hold no NaN; found {values!r}")
    return numbers


def _batch(
    rule: Rule, from_start: np.ndarray, average: StoredAverage, memory: np.ndarray, shape: tuple[int, int, int]
) -> Batch:
    """The arrays of what is carried, and others that each episode fills."""
    runs, channels, n = shape
    initial = np.empty((0, channels)) if rule.channels is None else np.array(rule.channels, dtype=np.float64)
    return Batch(
        constants=np.array(rule.constants, dtype=np.float64),
        initial=initial,
        first=rule.first,
        from_start=from_start,
        looks_ahead=rule.looks_ahead,
        span=-1 if rule.span is None else rule.span,
        rate=average.rate,
        averages=average.per_step,
        totals=average.totals,
        memory=memory,
        average=np.empty(channels),
        channels=np.empty(initial.shape),
        vectors=np.empty((rule.vectors, n)),
        gradients=np.empty((runs, channels, n)),
        spans=np.empty((runs, n)),
        rewards=np.empty((runs, channels)),
        entered=np.empty((runs, channels)),
        steps=np.empty(runs, dtype=np.int64),
        events=np.empty(runs, dtype=np.int64),
    )
