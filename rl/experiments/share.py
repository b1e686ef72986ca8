"""Training some runs of a case, in whatever process, with reports of every record and checkpoints on the way."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter, process_time
from typing import Any

import numpy as np

from .._carried import put_back, state_of
from ..training import TrainingRecord
from .checkpoints import Checkpoint, Checkpoints
from .experiment import Experiment, TrainingCase
from .messages import Block, Message, Outcome
from .subproblems import SubproblemRecorder

_TICK = 0.2  # s between signs of life

# What is trained, and which runs.
Share = tuple[Experiment, TrainingCase, tuple[int, ...]]


def train_share(share: Share, report: Callable[[Message], None], checkpoints: Checkpoints | None = None) -> Outcome:
    """All runs of the share in lockstep; reports every record, and the outcome.

    Where it was stopped before, it reports what it had, and goes on.

    Parameters
    ----------
    share
        Experiment, case and runs.
    report
        Hears every record, and the outcome.
    checkpoints
        Where it goes on from if it was stopped; None for none.

    Returns
    -------
    Outcome
        Of these runs.

    Raises
    ------
    DivergenceError, CheckpointError
        As their names say.
    """
    experiment, case, runs = share
    for _ in experiment.begin(replace(case, episodes=1), runs[:1])[0]:
        pass  # kernels are compiled, or loaded from the cache, so that the clock below sees training alone
    experiment.prepare(case)
    course = _Course(share, report, Checkpoint(checkpoints, f"{case.label}, {runs[0]} to {runs[-1]}"))
    for record in course.training:
        course.see(record)
    outcome = course.outcome()
    report(outcome)
    return outcome


class _Course:
    """A share under way, from its checkpoint if it has one: training, recorder, blocks, counts, seconds."""

    def __init__(self, share: Share, report: Callable[[Message], None], checkpoint: Checkpoint) -> None:
        self.experiment, self.case, self.runs = share
        self.report, self.checkpoint = report, checkpoint
        self.begun = perf_counter(), process_time()
        self.ticked = self.begun[0]
        saved = checkpoint.read()
        self.watcher = self._watcher(saved)
        self.training, self.recorder = self.experiment.begin(self.case, self.runs, self.watcher)
        self.blocks: list[Block] = []
        self.steps = np.zeros(len(self.runs), dtype=np.int64)
        self.counts: dict[str, np.ndarray] = {}
        self.before: tuple[float, float] = (0.0, 0.0)  # seconds that it took until it was stopped
        if saved is not None:
            self._go_on_from(saved)
        elif self.case.from_start:
            self._tell(0)

    def _watcher(self, saved: Mapping[str, Any] | None) -> SubproblemRecorder | None:
        settings, case = self.experiment, self.case
        if not case.kept or not settings.record:
            return None
        return SubproblemRecorder(
            settings.record, case.label, self.runs, of=settings.runs, episodes=case.episodes, saved=saved
        )

    def _go_on_from(self, saved: Mapping[str, Any]) -> None:
        self.training.restore(saved["training"])
        put_back(self.recorder, saved["recorder"])
        self.steps, self.counts, self.before = saved["steps"], saved["counts"], saved["seconds"]
        for position, episode in enumerate(saved["blocks"]["episode"]):
            values = {name: own[position] for name, own in saved["blocks"]["values"].items()}
            self._tell(episode, values)

    def _tell(self, episode: int, values: dict[str, np.ndarray] | None = None) -> None:
        values = self.recorder.values() if values is None else values
        self.blocks.append(Block(self.case.label, self.runs, episode, values))
        self.report(self.blocks[-1])

    def see(self, record: TrainingRecord) -> None:
        """Counts, and reports what is to be reported after this update."""
        case, is_last = self.case, record.episode == self.case.episodes
        if self.watcher is not None:
            self.watcher.next_episode()
        self.steps += record.estimate.steps
        for name, number in {**self.recorder.see(record), **record.update.counts}.items():
            self.counts[name] = self.counts[name] + number if name in self.counts else number
        if record.episode % case.every == 0 or is_last:
            self._tell(record.episode)
        elif perf_counter() - self.ticked > _TICK:
            self.ticked = perf_counter()
            self.report(Block(case.label, self.runs, record.episode))
        if self.checkpoint.is_due(at_the_end=is_last):
            self._save()

    def _save(self) -> None:
        self.checkpoint.write(
            {
                "training": self.training.state(),
                "recorder": state_of(self.recorder),
                "blocks": {
                    "episode": [block.episode for block in self.blocks],
                    "values": _stack([block.values for block in self.blocks]),
                },
                "steps": self.steps,
                "counts": self.counts,
                "seconds": self._seconds(),
                "recording": None if self.watcher is None else self.watcher.state(),
            }
        )

    def _seconds(self) -> tuple[float, float]:
        """By the wall and by the process' own clock."""
        (wall, cpu), (begun, begun_cpu) = self.before, self.begun
        return wall + perf_counter() - begun, cpu + process_time() - begun_cpu

    def outcome(self) -> Outcome:
        """What it came to."""
        recording = None if self.watcher is None else self.watcher.recording()
        return Outcome(
            self.case.label, self.runs, self.case.episodes, self.steps, *self._seconds(), self.training.parameters,
            self.counts, self.recorder.totals(), recording,
        )  # fmt: skip


def _stack(records: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    names = records[0] if records else ()
    return {name: np.stack([values[name] for values in records]) for name in names}
