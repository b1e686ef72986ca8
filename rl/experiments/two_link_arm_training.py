"""Training some runs on the arm under one condition, in whatever process, with reports of every block."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from time import perf_counter, process_time
from typing import Any

import numpy as np

from cpgrl_opt.arrays import Float, Int
from cpgrl_opt.comparison.recording import Recording
from cpgrl_opt.solvers import compile_kernels
from cpgrl_opt.step import Observer
from envs import TwoLinkArm

from ..carried import put_back, state_of
from ..training import Training, TrainingRecord
from .checkpoints import Checkpoint, Checkpoints, as_columns, from_columns
from .subproblems import SubproblemRecorder, subproblem_recorder
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


def train_share(share: Share, report: Callable[[Message], None], checkpoints: Checkpoints | None = None) -> Outcome:
    """All runs of the share in lockstep; reports every block as it ends, and the outcome.

    Where it was stopped before, it reports what it had, and goes on.
    """
    settings, case, runs = share
    started = perf_counter()
    for _ in _training((replace(settings, episodes=1), case, runs[:1])):
        pass  # kernels are compiled, or loaded from the cache, so that the clock below sees training alone
    compile_kernels()
    course = _Course(share, report, Checkpoint(checkpoints, f"{case.label}, {runs[0]} to {runs[-1]}"))
    for record in course.training:
        course.see(record)
    outcome = course.outcome(course.begun[0] - started)
    report(outcome)
    return outcome


class _Course:
    """A share under way, from its checkpoint if it has one: training, recorder, blocks, counts, seconds."""

    def __init__(self, share: Share, report: Callable[[Message], None], checkpoint: Checkpoint) -> None:
        self.share, self.report, self.checkpoint = share, report, checkpoint
        self.begun = perf_counter(), process_time()
        self.ticked = self.begun[0]
        saved = checkpoint.read()
        self.watcher = _watcher(share, saved)
        self.training = _training(share, self.watcher)
        self.blocks: list[Block] = []
        self.block, self.steps = _Block(share, 0), np.zeros(len(share[2]), dtype=np.int64)
        self.counts: dict[str, np.ndarray] = {"constrained": np.zeros(len(share[2]), dtype=np.int64)}
        self.before: tuple[float, float] = (0.0, 0.0)  # seconds that it took until it was stopped
        if saved is not None:
            self.training.restore(saved["training"])
            self.steps, self.counts, self.before = saved["steps"], saved["counts"], saved["seconds"]
            put_back(self.block, saved["block"])
            for block in from_columns(Block, saved["blocks"]):
                self.tell(block)

    def tell(self, block: Block) -> None:
        self.blocks.append(block)
        self.report(block)

    def see(self, record: TrainingRecord) -> None:
        """Counts, and reports what is to be reported after this update."""
        settings, case, runs = self.share
        if self.watcher is not None:
            self.watcher.next_episode()
        self.block.add(record)
        self.steps += record.estimate.steps
        self.counts["constrained"] += record.update.active.any(axis=1)
        for name, number in record.update.counts.items():
            self.counts[name] = self.counts.get(name, 0) + number
        if record.episode % settings.record_every == 0 or record.episode == settings.episodes:
            self.tell(self.block.finished())
            self.block = _Block(self.share, record.episode)
        elif perf_counter() - self.ticked > _TICK:
            self.ticked = perf_counter()
            self.report(Tick(case.label, runs, record.episode))
        if self.checkpoint.is_due(at_the_end=record.episode == settings.episodes):
            self.save()

    def save(self) -> None:
        """The checkpoint."""
        self.checkpoint.write(
            {
                "training": self.training.state(),
                "blocks": as_columns(self.blocks),
                "block": state_of(self.block),
                "steps": self.steps,
                "counts": self.counts,
                "seconds": self.seconds(),
                "recording": None if self.watcher is None else self.watcher.state(),
            }
        )

    def seconds(self) -> tuple[float, float]:
        """By the wall and by the process' own clock."""
        (wall, cpu), (begun, begun_cpu) = self.before, self.begun
        return wall + perf_counter() - begun, cpu + process_time() - begun_cpu

    def outcome(self, preparation: float) -> Outcome:
        settings, case, runs = self.share
        return Outcome(
            case.label, runs, settings.episodes, self.steps, *self.seconds(), preparation, self.training.parameters,
            self.counts, None if self.watcher is None else self.watcher.recording(),
        )  # fmt: skip


def _watcher(share: Share, saved: Mapping[str, Any] | None) -> SubproblemRecorder | None:
    settings, case, runs = share
    if CONDITIONS[case.condition].thresholds is None:  # then there are no direction problems
        return None
    return subproblem_recorder(
        settings.record, case.label, runs, of=settings.runs, episodes=settings.episodes, saved=saved
    )


def _training(share: Share, observe: Observer | None = None) -> Training:
    settings, case, runs = share
    arm = TwoLinkArm()
    return Training(
        arm, arm_policy(arm), settings.gradient_estimator(case.condition), settings.learner(case),
        episodes=settings.episodes, runs=runs, seed=settings.seed, max_change=MAX_CHANGE,
        observe=observe,
    )  # fmt: skip


class _Block:
    """A block while it fills; `before`: episodes that came before it."""

    carried = ("before", "episode", "touches", "steps", "outside")

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
