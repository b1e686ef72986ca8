"""What stands between an update rule and what plays its episodes.

A rule says what happens at a step. A driver plays episodes: on a finite MDP, in a compiled environment, in Gymnasium.
Any rule runs with any driver, since both see an episode as a `Course`. Nothing here imports numba; `kernels` compiles
what the compiled drivers need of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from cpgrl_opt.arrays import Float

from .._late_kernels import LateKernel


class Score(NamedTuple):
    """ψ of a step: zero but for `values`, which stand from `place` on. A table's is zero outside its state."""

    place: int
    values: Float[np.ndarray, "k"]


class Course(NamedTuple):
    """One run's episode under way, as a rule sees it. A rule writes to the last four.

    Parameters
    ----------
    constants
        (k,), the rule's numbers.
    average
        (1 + m,), ρ per step, this step's reward included.
    channels
        (k, 1 + m), as the rule says how many; they begin anew with each episode, at the rule's.
    vectors
        (k, n), as the rule says how many; they begin anew with each episode, at 0.
    memory
        (k, n), goes on from episode to episode.
    gradients
        (1 + m, n), Σ over the steps of what enters Δ, from 0.
    """

    constants: Float[np.ndarray, "k"]
    average: Float[np.ndarray, "channels"]
    channels: Float[np.ndarray, "k channels"]
    vectors: Float[np.ndarray, "k n"]
    memory: Float[np.ndarray, "k n"]
    gradients: Float[np.ndarray, "channels n"]


class RuleStep(Protocol):
    """What a rule does at step t, from 0.

    Parameters
    ----------
    score, following
        ψ_t and ψ_{t+1}, which is 0 after an event that ends the episode, and, for a rule that does not look ahead,
        after the last step.
    reward
        (1 + m,), what (x_t, u_t) yields.
    last
        Whether the episode ends here.
    """

    def __call__(
        self,
        course: Course,
        t: int,
        score: Score,
        reward: Float[np.ndarray, "channels"],
        following: Score,
        last: bool,
        /,
    ) -> None:
        """Moves what `course` holds one step on."""


@dataclass(frozen=True, eq=False)
class Rule:
    """An update rule, written once for all drivers. What does not fit is refused where an estimation starts.

    Parameters
    ----------
    step
        Plain Python, or compiled (`compiled_step`).
    constants, channels, vectors, memory
        What `Course` has, (k,) and (k, 1 + m), the last two as numbers of rows.
    first
        The first step whose reward enters ρ per step, and from which updates are counted.
    from_start
        (1 + m,), channels in whose Δ earlier rewards enter all the same.
    looks_ahead
        Whether one more action is drawn at the time limit, for ψ_{t+1}.
    span
        Which of the vectors is Σ_t of what the rewards meet, for a rule that leaves it to `ReportedGradient` to
        subtract ρ; None where nothing is to be subtracted.
    """

    step: RuleStep
    constants: Sequence[float] = ()
    channels: Float[np.ndarray, "k channels"] | None = None
    vectors: int = 0
    memory: int = 0
    first: int = 0
    from_start: np.ndarray | None = None
    looks_ahead: bool = False
    span: int | None = None


class Batch(NamedTuple):
    """B runs as drivers see them: the rule's settings, what is carried, scratch, and what an episode fills.

    averages: (B, 1 + m), eq. 4, and totals: (B,), its sum of weights, are advanced, as is memory (B, k, n).
    """

    constants: np.ndarray
    initial: np.ndarray  # (k, 1 + m), where an episode's channels begin
    first: int
    from_start: np.ndarray
    looks_ahead: bool
    span: int  # −1 for none
    rate: float  # α_r
    averages: np.ndarray
    totals: np.ndarray
    memory: np.ndarray
    average: np.ndarray  # scratch of a run, as the next two
    channels: np.ndarray
    vectors: np.ndarray
    gradients: np.ndarray  # (B, 1 + m, n), filled: Δ, the mean over the updates
    spans: np.ndarray  # (B, n), filled: the vector `span`
    rewards: np.ndarray  # (B, 1 + m), filled: Σ r
    entered: np.ndarray  # (B, 1 + m), filled: Σ of the rewards in Δ
    steps: np.ndarray  # (B,), filled
    events: np.ndarray  # (B,), filled


class Driver(Protocol):
    """Plays episodes of B runs, each with its own random stream.

    `carried` names what goes from episode to episode, as in `rl.estimators.Estimation`.
    """

    @property
    def shape(self) -> tuple[int, int, int]:
        """B, 1 + m, n."""

    @property
    def limit(self) -> int:
        """The most steps of an episode."""

    def play(self, step: RuleStep, parameters: Float[np.ndarray, "B n"], batch: Batch) -> None:
        """One episode of each run: for each `open_run`, for each step `account` and the rule's step, `close_run`."""

    def reorder(self, vectors: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "... n"]:
        """Vectors that a rule has filled, in θ's order."""


def open_run(batch: Batch, run: int) -> Course:
    """The course of a run's new episode."""
    for k in range(batch.initial.shape[0]):
        for i in range(batch.initial.shape[1]):
            batch.channels[k, i] = batch.initial[k, i]
    batch.vectors[:] = 0.0
    batch.gradients[run] = 0.0
    batch.rewards[run] = 0.0
    batch.entered[run] = 0.0
    for i in range(batch.average.size):
        batch.average[i] = batch.averages[run, i] / batch.totals[run] if batch.totals[run] > 0.0 else 0.0
    return Course(
        batch.constants, batch.average, batch.channels, batch.vectors, batch.memory[run], batch.gradients[run]
    )


def account(batch: Batch, run: int, t: int, reward: Float[np.ndarray, "channels"]) -> None:
    """Sums of the rewards, and ρⁱ ← ρⁱ + α_r (rⁱ − ρⁱ), eq. 4, with the sum of its weights; before the rule's step."""
    enters = t >= batch.first
    if enters:
        batch.totals[run] += batch.rate * (1.0 - batch.totals[run])
    for i in range(reward.size):
        batch.rewards[run, i] += reward[i]
        if enters or batch.from_start[i]:
            batch.entered[run, i] += reward[i]
        if enters:
            batch.averages[run, i] += batch.rate * (reward[i] - batch.averages[run, i])
            batch.average[i] = batch.averages[run, i] / batch.totals[run] if batch.totals[run] > 0.0 else 0.0


def close_run(batch: Batch, run: int, steps: int, event: int) -> None:
    """Ends a run's episode: Δ becomes the mean over its updates."""
    batch.steps[run], batch.events[run] = steps, event
    updates = max(steps - batch.first, 1)
    for i in range(batch.gradients.shape[1]):
        for j in range(batch.gradients.shape[2]):
            batch.gradients[run, i, j] /= updates
    if batch.span >= 0:
        for j in range(batch.spans.shape[1]):
            batch.spans[run, j] = batch.vectors[batch.span, j]


class CompiledStep(LateKernel):
    """A rule's step that drivers run as machine code."""

    @cached_property
    def machine_code(self) -> Any:
        """The function compiled for the signature of all rules."""
        from .._kernels import kernel  # numba loads here

        return kernel(step_signature())(self.function)

    @cached_property
    def entry_point(self) -> Any:
        """To be called from Python, without a look at the types of what it is handed."""
        overloads = getattr(self.machine_code, "overloads", None)  # none under NUMBA_DISABLE_JIT
        return self.machine_code if overloads is None else next(iter(overloads.values())).entry_point


def step_signature() -> Any:
    """Of a compiled `RuleStep`, for numba."""
    from numba import types

    vector, rows = (types.Array(types.float64, axes, "C") for axes in (1, 2))
    course = types.NamedTuple((vector, vector, rows, rows, rows, rows), Course)
    score = types.NamedTuple((types.int64, vector), Score)
    return types.void(course, types.int64, score, vector, score, types.boolean)


def compiled_step(function: Callable[..., None]) -> CompiledStep:
    """Decorates a `RuleStep` that numba can compile."""
    return CompiledStep("", function)
