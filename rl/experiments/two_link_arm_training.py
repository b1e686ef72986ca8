"""Training some runs on the arm under one condition, in whatever process, with reports of every block."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from time import perf_counter, process_time

import numpy as np

from cpgrl_opt.arrays import Float, Int
from cpgrl_opt.comparison.recorder import Recorder
from cpgrl_opt.comparison.recording import Recording
from cpgrl_opt.solvers import compile_kernels
from cpgrl_opt.step import Observer
from envs import TwoLinkArm

from ..training import TrainingRecord, train
from .subproblems import subproblem_recorder
from .two_link_arm import CONDITIONS, MAX_CHANGE, ArmSettings, Case, arm_policy

_TICK = 0.2  # s between signs of life

# What is trained, and which runs.
Share = tuple[ArmSettings, Case, tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class Block:
    """Some runs of a training in the block of `size` episodes that ends at `episode`; arrays as in TouchCurves."""

    label: str
    runs: tuple[int, ...]
    episode: int
    size: int
    touches: Int[np.ndarray, "R outcomes"]
    violation: Float[np.ndarray, "R"]
    length: Float[np.ndarray, "R"]


@dataclass(frozen=True)
class Tick:
    """A sign of life: these runs have done so many episodes."""

    label: str
    runs: tuple[int, ...]
    episode: int


@dataclass(frozen=True, eq=False)
class Outcome:
    """Some runs of a training when it is done.

    steps: (R,), of the environment; seconds: of training, by the wall, and cpu_seconds, by the process' own clock,
    which others on the machine do not stretch; preparation: s, compiling or loading before it; parameters: (R, n),
    the last θ; counts: by event, (R,), as the learner counts, and "constrained": updates with an active constraint,
    in each of which the ridge acts; recording: of the direction problems, if wanted.
    """

    label: str
    runs: tuple[int, ...]
    episode: int
    steps: Int[np.ndarray, "R"]
    seconds: float
    cpu_seconds: float
    preparation: float
    parameters: Float[np.ndarray, "R n"]
    counts: Mapping[str, Int[np.ndarray, "R"]]
    recording: Recording | None = None

    @property
    def steps_per_second(self) -> float:
        """Environment steps per wall second of one process."""
        return float(self.steps.sum()) / self.seconds


Message = Block | Tick | Outcome


def train_share(share: Share, report: Callable[[Message], None]) -> Outcome:
    """All runs of the share in lockstep; reports every block as it ends, and the outcome."""
    settings, case, runs = share
    started = perf_counter()
    for _ in _records((replace(settings, episodes=1), case, runs[:1])):
        pass  # kernels are compiled, or loaded from the cache, so that the clock below sees training alone
    compile_kernels()
    begun, begun_cpu = perf_counter(), process_time()
    ticked = begun
    block, steps = _Block(share, 0), np.zeros(len(runs), dtype=np.int64)
    counts: dict[str, np.ndarray] = {"constrained": np.zeros(len(runs), dtype=np.int64)}
    watcher = _watcher(share)
    for record in _records(share, watcher):
        if watcher is not None:
            watcher.next_episode()
        block.add(record)
        steps += record.estimate.steps
        counts["constrained"] += record.update.active.any(axis=1)
        for name, number in record.update.counts.items():
            counts[name] = counts.get(name, 0) + number
        if record.episode % settings.record_every == 0 or record.episode == settings.episodes:
            report(block.finished())
            block = _Block(share, record.episode)
        elif perf_counter() - ticked > _TICK:
            ticked = perf_counter()
            report(Tick(case.label, runs, record.episode))
    times = perf_counter() - begun, process_time() - begun_cpu, begun - started
    outcome = Outcome(
        case.label, runs, settings.episodes, steps, *times, record.parameters, counts,
        None if watcher is None else watcher.recording(),
    )  # fmt: skip
    report(outcome)
    return outcome


def _watcher(share: Share) -> Recorder | None:
    settings, case, runs = share
    if CONDITIONS[case.condition].thresholds is None:  # then there are no direction problems
        return None
    return subproblem_recorder(settings.record, case.label, runs, of=settings.runs, episodes=settings.episodes)


def _records(share: Share, observe: Observer | None = None) -> Iterator[TrainingRecord]:
    settings, case, runs = share
    arm = TwoLinkArm()
    return train(
        arm, arm_policy(arm), settings.gradient_estimator(case.condition), settings.learner(case),
        episodes=settings.episodes, runs=runs, seed=settings.seed, max_change=MAX_CHANGE,
        observe=observe,
    )  # fmt: skip


class _Block:
    """A block while it fills; `before`: episodes that came before it."""

    def __init__(self, share: Share, before: int) -> None:
        _, self.case, self.runs = share
        self.before = self.episode = before
        self.touches = np.zeros((len(self.runs), len(TwoLinkArm().events) + 1), dtype=np.int64)
        self.steps, self.outside = np.zeros((2, len(self.runs)))

    def add(self, record: TrainingRecord) -> None:
        estimate = record.estimate
        self.episode = record.episode
        self.touches[np.arange(len(self.runs)), estimate.events - 1] += 1  # a time-out, event 0, in the last column
        self.steps += estimate.steps
        self.outside -= estimate.rewards[:, 1]  # r² = −1 outside the box, else 0

    def finished(self) -> Block:
        size = self.episode - self.before
        return Block(
            self.case.label, self.runs, self.episode, size, self.touches, self.outside / self.steps, self.steps / size
        )
