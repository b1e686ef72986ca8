"""Progress bars on stderr, one for each thing that is trained; silent where stderr is no terminal."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from .records import Advance


class TrainingProgress:
    """Bars by label; `recorded` remembers how far the results of each reach."""

    def __init__(self, bars: Progress, totals: Mapping[str, int]) -> None:
        self.bars = bars
        self._tasks: dict[str, TaskID] = {
            label: bars.add_task(f"{label}, waiting or compiling", total=episodes) for label, episodes in totals.items()
        }
        self.recorded: dict[str, int] = {}

    def listen(self, advance: Advance) -> None:
        """Moves the bar."""
        if advance.recorded:
            self.recorded[advance.label] = advance.episode
        self.bars.update(self._tasks[advance.label], completed=advance.episode, description=advance.label)

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
