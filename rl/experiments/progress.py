"""Progress bars on stderr, one for each thing that is trained; silent where stderr is no terminal."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn


class Report(Protocol):
    """What a training task reports: what it trains, how far it is; `recorded = True` if the results hold it."""

    @property
    def label(self) -> str:
        """Method or condition."""

    @property
    def episode(self) -> int:
        """Updates done."""


class TrainingProgress:
    """Bars by label; `recorded` remembers how far the results of each reach."""

    def __init__(self, bars: Progress, totals: Mapping[str, int]) -> None:
        self.bars = bars
        self._tasks: dict[str, TaskID] = {
            label: bars.add_task(f"{label}, waiting or compiling", total=episodes) for label, episodes in totals.items()
        }
        self.recorded: dict[str, int] = {}

    def listen(self, report: Report) -> None:
        """Moves the bar."""
        if getattr(report, "recorded", False):
            self.recorded[report.label] = report.episode
        self.bars.update(self._tasks[report.label], completed=report.episode, description=report.label)

    def stop(self) -> None:
        """Takes the bars away."""
        self.bars.stop()


@contextmanager
def training_progress(totals: Mapping[str, int]) -> Iterator[TrainingProgress]:
    """Bars while the context lasts, gone afterwards; totals: episodes by label."""
    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        yield TrainingProgress(bars, totals)
