"""Training every case of the experiment, over processes, with each block on disk as it comes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from envs import TwoLinkArm

from ..parallel import split
from .checkpoints import Checkpoints
from .solver_cases import require_installed
from .subproblems import joined_recordings
from .tidy_csv import TidyCsv
from .two_link_arm import ArmSettings
from .two_link_arm_comparison import ComparisonCsv
from .two_link_arm_curves import TouchCurves
from .two_link_arm_training import Block, Message, Outcome, Share, train_share
from .workers import run_tasks

# By what an episode takes: without a square to reach, or with time to wait, episodes are long.
_LONGEST_FIRST = ("b", "a", "c-episode", "c", "c-no-projection", "c-feasible")


@dataclass(frozen=True)
class Advance:
    """How far a training is, the run that is least far; recorded: whether `learning.csv` holds it to there."""

    label: str
    episode: int
    recorded: bool


@dataclass(frozen=True, eq=False)
class ArmResults:
    """What was found, by the labels of the settings' cases."""

    settings: ArmSettings
    arm: TwoLinkArm
    curves: Mapping[str, TouchCurves]
    outcomes: Mapping[str, Outcome]


def train_two_link_arm(
    settings: ArmSettings,
    directory: Path,
    *,
    processes: int = 1,
    listen: Callable[[Advance], None] | None = None,
    meanwhile: Callable[[], object] | None = None,
    checkpoints: Checkpoints | None = None,
) -> ArmResults:
    """Every case; `learning.csv`, and `compare.csv` if settings.compare, hold what was done whatever ends it.

    processes: over which cases and their runs are shared out; the numbers do not depend on it. listen: sees how far
    it is. meanwhile: see `run_tasks`. checkpoints: where each share goes on from, and keeps how far it is. Raises
    MissingPackageError, DivergenceError, WorkerDiedError, CheckpointError.
    """
    cases = settings.cases()
    for case in cases:
        require_installed(settings.step(case.solver).solver)
    parts = parts_for(settings, processes)
    shares = shared_out(settings, parts if checkpoints is None else checkpoints.parts(parts))
    with Recorder(settings, directory) as recorder:

        def heard(message: Message) -> None:
            advance = recorder.hear(message)
            if listen is not None:
                listen(advance)

        task = partial(train_share, checkpoints=checkpoints)
        outcomes = run_tasks(task, shares, heard, processes=processes, meanwhile=meanwhile)
    return ArmResults(
        settings,
        recorder.arm,
        {case.label: recorder.curves(case.label) for case in cases},
        {case.label: joined([part for part in outcomes if part.label == case.label]) for case in cases},
    )


def parts_for(settings: ArmSettings, processes: int) -> int:
    """Into how many shares a case is split: only if there are fewer than two cases for each process.

    Runs beside each other share what an update costs besides them.
    """
    return min(processes, -(-2 * processes // len(settings.cases())))


def shared_out(settings: ArmSettings, parts: int) -> list[Share]:
    """Cases and runs, the longest first, so that at the end no process waits long for another."""
    cases = sorted(settings.cases(), key=lambda case: _LONGEST_FIRST.index(case.condition))
    return [(settings, case, tuple(runs)) for case in cases for runs in split(range(settings.runs), parts)]


class Recorder:
    """Messages of workers into the CSV files and into learning curves."""

    def __init__(self, settings: ArmSettings, directory: Path) -> None:
        self.settings = settings
        self.arm = TwoLinkArm()
        columns = ["condition", "run", "episode", *self.arm.events, "none", "violation", "length"]
        self.csv = TidyCsv(directory / "learning.csv", columns, settings.conditions)
        self.comparison = ComparisonCsv(settings, self.arm, directory / "compare.csv") if settings.compare else None
        self.blocks: dict[str, list[Block]] = {case.label: [] for case in settings.cases()}
        self.done = {label: np.zeros(settings.runs, dtype=np.int64) for label in self.blocks}

    def hear(self, message: Message) -> Advance:
        """Writes what it tells; says how far its training is."""
        recorded = isinstance(message, Block) and message.label in self.settings.conditions
        if isinstance(message, Block):
            self.blocks[message.label].append(message)
            if recorded:
                self.csv.append(_rows(message))
        elif isinstance(message, Outcome) and self.comparison is not None:
            self.comparison.append(message, self.curves(message.label, message.runs))
        done = self.done[message.label]
        done[list(message.runs)] = message.episode
        least = int(done.min())
        # When a share catches up to the end of a block, the others have recorded theirs.
        return Advance(message.label, least, recorded and least == message.episode)

    def curves(self, label: str, runs: Sequence[int] | None = None) -> TouchCurves:
        """What was recorded of a training, of all its runs or of a share."""
        blocks = sorted(self.blocks[label], key=lambda block: (block.runs, block.episode))
        shares = [list(share) for own, share in groupby(blocks, lambda block: block.runs) if runs in (None, own)]

        def collected(name: str) -> np.ndarray:
            return np.concatenate([np.stack([getattr(block, name) for block in share], axis=1) for share in shares])

        return TouchCurves(
            self.arm,
            np.array([block.episode for block in shares[0]]),
            np.array([block.size for block in shares[0]]),
            collected("touches"),
            collected("violation"),
            collected("length"),
        )

    def __enter__(self) -> "Recorder":
        self.csv.__enter__()
        if self.comparison is not None:
            self.comparison.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self.csv.__exit__(*error)
        if self.comparison is not None:
            self.comparison.__exit__(*error)


def joined(parts: Sequence[Outcome]) -> Outcome:
    """The outcome of all runs from those of shares, in their order."""
    first = parts[0]
    return Outcome(
        first.label,
        tuple(run for part in parts for run in part.runs),
        first.episode,
        np.concatenate([part.steps for part in parts]),
        sum(part.seconds for part in parts),
        sum(part.cpu_seconds for part in parts),
        sum(part.preparation for part in parts),
        np.concatenate([part.parameters for part in parts]),
        {name: np.concatenate([part.counts[name] for part in parts]) for name in first.counts},
        joined_recordings([part.recording for part in parts]),
    )


def _rows(block: Block) -> list[Sequence[str | int | float]]:
    measured = zip(block.runs, block.touches, block.violation, block.length, strict=True)
    return [
        (block.label, run, block.episode, *(int(count) for count in touches), float(violation), float(length))
        for run, touches, violation, length in measured
    ]
