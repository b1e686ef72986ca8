"""Whoever looks on while a training runs: a CSV file, TensorBoard, a progress bar, or an observer of one's own.

>>> from rl.observers import CsvLog, ProgressBar, watch
>>> for record in watch(train(…, episodes=1000), CsvLog("log.csv"), ProgressBar(1000)):     # doctest: +SKIP
...     pass
"""

import csv
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np

from cpgrl_opt.arrays import Float
from cpgrl_opt.validation import require_count

from .training import TrainingRecord


@runtime_checkable
class RecordObserver(Protocol):
    """Looks at records; `close` is called once, whatever ends the training."""

    def see(self, record: TrainingRecord) -> None:
        """The record of the next episode."""

    def close(self) -> None:
        """There will be no more."""


class ObserverWarning(RuntimeWarning):
    """An observer raised; the training goes on without it."""


def watch(records: Iterable[TrainingRecord], *observers: RecordObserver) -> Iterator[TrainingRecord]:
    """The same records; each observer sees every one before it comes out.

    An observer that raises, on a full disk say, is left out from then on, and an ObserverWarning says which and why:
    a training is worth more than its log. Nothing that an observer does changes a number.

    Raises
    ------
    ValueError
        For what is no observer.
    """
    for observer in observers:
        if not isinstance(observer, RecordObserver):
            raise ValueError(f"an observer should have see(record) and close(); found {observer!r}")
    return _show_records(records, list(observers))


def _show_records(records: Iterable[TrainingRecord], watching: list[RecordObserver]) -> Iterator[TrainingRecord]:
    try:
        for record in records:
            for observer in list(watching):
                try:
                    observer.see(record)
                except Exception as error:
                    watching.remove(observer)
                    _warn(observer, f"after episode {record.episode}", error)
                    _close(observer)
            yield record
    finally:
        for observer in watching:
            _close(observer)


def _close(observer: RecordObserver) -> None:
    try:
        observer.close()
    except Exception as error:
        _warn(observer, "as it was closed", error)


def _warn(observer: RecordObserver, when: str, error: Exception) -> None:
    words = f"{type(observer).__name__} raised {type(error).__name__} {when}: {error}. The training goes on without it"
    warnings.warn(words, ObserverWarning, stacklevel=4)


def quantities(record: TrainingRecord) -> dict[str, Float[np.ndarray, "B"]]:
    """What logs hold of each run, by name.

    Returns
    -------
    dict of arrays, (B,)
        value_i, ρ of channel i as the estimator carries it; reward_i, its sum over the episode; gradient_i, ‖Δⁱ‖;
        steps, of the environment; change, ‖θ' − θ‖; then the learner's counts.
    """
    estimate, update = record.estimate, record.update
    by_channel = {
        "value": estimate.values,
        "reward": estimate.rewards,
        "gradient": np.linalg.norm(estimate.gradients, axis=2),
    }
    found = {
        f"{name}_{channel}": own[:, channel] for name, own in by_channel.items() for channel in range(own.shape[1])
    }
    return {**found, "steps": estimate.steps, "change": np.linalg.norm(update.change, axis=1), **update.counts}


class CsvLog:
    """A CSV file with a row for each run and every so many episodes: run, episode, then `quantities`.

    Each record is on the disk when the training goes on.

    Parameters
    ----------
    path
        An existing file is replaced.
    every
        Episodes, ≥ 1.

    Raises
    ------
    ValueError
        For another `every`.
    """

    def __init__(self, path: Path | str, every: int = 1) -> None:
        require_count("every", every)
        self.path, self.every = Path(path), every
        self._file: Any = None
        self._names: list[str] = []

    def see(self, record: TrainingRecord) -> None:
        """Writes its rows if it is a record's turn."""
        if record.episode % self.every:
            return
        found = quantities(record)
        if self._file is None:
            self._file = self.path.open("w", encoding="utf-8", newline="")
            self._names = list(found)
            csv.writer(self._file, lineterminator="\n").writerow(["run", "episode", *self._names])
        columns = [np.asarray(found[name]).tolist() for name in self._names]
        rows = ([run, record.episode, *values] for run, values in enumerate(zip(*columns, strict=True)))
        csv.writer(self._file, lineterminator="\n").writerows(rows)
        self._file.flush()

    def close(self) -> None:
        """Closes the file."""
        if self._file is not None:
            self._file.close()


class TensorBoardLog:
    """Event files for TensorBoard: means of `quantities` over the runs, every so many episodes.

    Parameters
    ----------
    folder
        Where the event files go.
    every
        Episodes, ≥ 1.

    Raises
    ------
    ValueError
        For another `every`.
    ImportError
        Which says what to type where tensorboardX is not installed.
    """

    def __init__(self, folder: Path | str, every: int = 1) -> None:
        require_count("every", every)
        try:
            from tensorboardX import SummaryWriter
        except ImportError as error:
            words = f"TensorBoardLog needs tensorboardX ({error}); type: pip install 'cpgrl-opt[tensorboard]'"
            raise ImportError(words) from error
        self.every = every
        self._writer: Any = SummaryWriter(str(folder))

    def see(self, record: TrainingRecord) -> None:
        """Adds its numbers, as value/0, reward/2, steps …."""
        if record.episode % self.every == 0:
            for name, values in quantities(record).items():
                self._writer.add_scalar(name.replace("_", "/", 1), float(np.mean(values)), record.episode)

    def close(self) -> None:
        """Writes what is left."""
        self._writer.close()


class ProgressBars:
    """Bars on stderr, one for each label; a context. Silent where stderr is no terminal, gone afterwards.

    Parameters
    ----------
    totals
        By label, how far its bar goes.
    waiting
        What a bar says before it moves.
    """

    def __init__(self, totals: Mapping[str, int], waiting: str = "waiting or compiling") -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(stderr=True)
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
        self.bars = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._tasks = {label: self.bars.add_task(f"{label}, {waiting}", total=own) for label, own in totals.items()}

    def move(self, label: str, done: int) -> None:
        """The label's bar to there."""
        self.bars.update(self._tasks[label], completed=done, description=label)

    def stop(self) -> None:
        """Takes the bars away."""
        self.bars.stop()

    def __enter__(self) -> Self:
        self.bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()


class ProgressBar:
    """A bar on stderr that moves with the episodes; silent where stderr is no terminal."""

    def __init__(self, episodes: int, label: str = "training") -> None:
        require_count("episodes", episodes)
        self.label, self._bars = label, ProgressBars({label: episodes})

    def see(self, record: TrainingRecord) -> None:
        """Moves it."""
        self._bars.bars.start()
        self._bars.move(self.label, record.episode)

    def close(self) -> None:
        """Takes it away."""
        self._bars.stop()
