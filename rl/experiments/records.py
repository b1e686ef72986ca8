"""Training every case of an experiment, over processes, with each record on disk as it comes."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt.solvers import solver_named
from cpgrl_opt.solvers.packages import require_packages

from ..parallel import split
from .checkpoints import Checkpoints
from .experiment import Experiment, Results
from .messages import Block, Message, Outcome, join_outcomes
from .share import Share, train_share
from .tidy_csv import TidyCsv
from .workers import run_tasks

# A message of a share, and the episode that the least far of its training's runs has reached.
Listener = Callable[[Message, int], object]


def train(
    experiment: Experiment,
    directory: Path,
    *,
    processes: int = 1,
    listen: Listener | None = None,
    checkpoints: Checkpoints | None = None,
) -> Results:
    """Every case of an experiment, its records on disk as they come.

    Parameters
    ----------
    experiment
        Whose cases are trained.
    directory
        For `learning.csv` and the CSV of each comparison, which hold what was done whatever ends it.
    processes
        Over which cases and their runs are shared out; the numbers do not depend on it.
    listen
        Sees how far it is.
    checkpoints
        Where each share goes on from, and keeps how far it is.

    Returns
    -------
    Results
        By the labels of the cases.

    Raises
    ------
    MissingPackageError, DivergenceError, WorkerDiedError, CheckpointError
        As their names say.
    """
    cases = experiment.cases()
    for solver in dict.fromkeys(case.solver for case in cases if case.solver):
        require_packages(solver_named(solver))  # before a training rather than in its middle
    parts = parts_for(experiment, processes) if checkpoints is None else checkpoints.parts
    with Records(experiment, directory) as records:

        def heard(message: Message) -> None:
            least = records.hear(message)
            if listen is not None:
                listen(message, least)

        task = partial(train_share, checkpoints=checkpoints)
        outcomes = run_tasks(task, share_out(experiment, parts), heard, processes=processes)
    return Results(
        experiment,
        {case.label: records.curves(case.label) for case in cases},
        {case.label: join_outcomes([part for part in outcomes if part.label == case.label]) for case in cases},
    )


def parts_for(experiment: Experiment, processes: int) -> int:
    """Into how many shares a case is split: only if there are fewer than two cases for each process.

    Runs beside each other share what an update costs besides them.

    Parameters
    ----------
    experiment
        Its cases, and whether it splits them.
    processes
        To be kept busy.

    Returns
    -------
    int
        Shares of a case.
    """
    return min(processes, -(-2 * processes // len(experiment.cases()))) if experiment.splits else 1


def share_out(experiment: Experiment, parts: int) -> list[Share]:
    """Cases and runs, the longest first, so that at the end no process waits long for another.

    Parameters
    ----------
    experiment
        Its cases and runs.
    parts
        Shares of a case.

    Returns
    -------
    list of Share
        In the order in which they begin.
    """
    cases = sorted(experiment.cases(), key=lambda case: case.rank)
    return [(experiment, case, tuple(runs)) for case in cases for runs in split(range(experiment.runs), parts)]


class Records(ExitStack):
    """Messages of workers into the CSV files and into what the experiment makes of the records; a context."""

    def __init__(self, experiment: Experiment, directory: Path) -> None:
        super().__init__()
        self.experiment = experiment
        self.cases = {case.label: case for case in experiment.cases()}
        headings = [heading for own in experiment.recorded.values() for heading in own]
        labels = [label for label, case in self.cases.items() if case.in_learning]
        self.csv = TidyCsv(directory / "learning.csv", [experiment.key, "run", "episode", *headings], labels)
        self.comparisons = [(comparison, comparison.csv(directory)) for comparison in experiment.comparisons()]
        self.blocks: dict[str, list[Block]] = {label: [] for label in self.cases}
        self.done = {label: np.zeros(experiment.runs, dtype=np.int64) for label in self.cases}

    def hear(self, message: Message) -> int:
        """Writes what it tells; says how far the least far of its training's runs is."""
        if isinstance(message, Block) and message.values:
            self.blocks[message.label].append(message)
            if self.cases[message.label].in_learning:
                self.csv.append(_rows(message, list(self.experiment.recorded)))
        elif isinstance(message, Outcome):
            for comparison, csv in self.comparisons:
                if message.label in comparison.keys:
                    csv.append(comparison.rows(self.curves(message.label, message.runs), message))
        self.done[message.label][list(message.runs)] = message.episode
        return int(self.done[message.label].min())

    def curves(self, label: str, runs: Sequence[int] | None = None) -> Any:
        """What was recorded of a training, of all its runs or of a share."""
        blocks = sorted(self.blocks[label], key=lambda block: (block.runs, block.episode))
        shares = [list(share) for own, share in groupby(blocks, lambda block: block.runs) if runs in (None, own)]
        values = {
            name: np.concatenate([np.stack([block.values[name] for block in share], axis=1) for share in shares])
            for name in shares[0][0].values
        }
        episodes = np.array([block.episode for block in shares[0]])
        return self.experiment.curves(self.cases[label], episodes, values)

    def __enter__(self) -> "Records":
        super().__enter__()
        for csv in (self.csv, *(csv for _, csv in self.comparisons)):
            self.enter_context(csv)
        return self


def _rows(block: Block, names: Sequence[str]) -> list[list[Any]]:
    """The columns of `names` for each run."""
    columns = np.column_stack([block.values[name].reshape(len(block.runs), -1) for name in names])
    rows = zip(block.runs, columns.tolist(), strict=True)
    return [[block.label, run, block.episode, *values] for run, values in rows]
