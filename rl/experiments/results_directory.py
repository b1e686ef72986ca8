"""The directory of a reproduction: finished results stay until others are finished, and two runs never mix in it."""

import itertools
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from cpgrl_opt.comparison.folder_lock import FolderInUseError, locked_folder

from ..interrupts import InterruptsHeld
from .checkpoints import forget, holds

UNFINISHED = "unfinished"
_LAST = "summary.json"  # without it a directory does not hold a finished run


class UnusableDirectoryError(ValueError):
    """The directory asked for is not there and cannot be made."""


@contextmanager
def results_directory(directory: Path, files: Sequence[str], key: Mapping[str, Any] | None = None) -> Iterator[Path]:
    """Where to write these files: the directory, made if it is not there, or a folder of its own within it.

    If any of them is in the directory already, an earlier run's, `place_for` names the folder; with a key, of
    `experiment_key`, it is where that experiment was stopped, if it was. At the context's end
    what is in it takes their place, and those that were not written anew are removed; on an exception both stay as
    they are. Other files are left alone. Meanwhile the directory is this process's alone. Raises
    UnusableDirectoryError where there can be no directory, FolderInUseError where another process writes into it.
    """
    with reserve(directory):
        place = place_for(directory, files, key)
        place.mkdir(exist_ok=True)
        try:
            yield place
        except BaseException:
            if place != directory and not any(place.iterdir()):
                place.rmdir()
            raise
        if place != directory:
            _swap_in(place, directory, files)
        forget(place)
        if place != directory:
            place.rmdir()


@contextmanager
def reserve(directory: Path) -> Iterator[None]:
    """The directory, made if it is not there, for this process alone; see `results_directory` for what is raised."""
    with ExitStack() as stack:
        try:
            stack.enter_context(locked_folder(directory))
        except FolderInUseError:
            raise
        except OSError as error:
            raise UnusableDirectoryError(
                f"out should be a directory to write into; found {directory} ({error.strerror})"
            ) from error
        yield


def place_for(directory: Path, files: Sequence[str], key: Mapping[str, Any] | None = None) -> Path:
    """Where a checkpoint of the key's experiment is, among the directory, unfinished, unfinished-2 …

    Else the directory if it has none of the files, else the first of the others that is not there.
    """
    if key is not None:
        places = (place for place in (directory, *sorted(directory.glob(f"{UNFINISHED}*"))) if holds(place, key))
        if (found := next(places, None)) is not None:
            return found
    if not any((directory / name).exists() for name in files):
        return directory
    names = itertools.chain([UNFINISHED], (f"{UNFINISHED}-{number}" for number in itertools.count(2)))
    return next(directory / name for name in names if not (directory / name).exists())


def _swap_in(place: Path, directory: Path, files: Sequence[str]) -> None:
    with InterruptsHeld():
        forget(directory)  # of another run, which was stopped: its learning.csv goes too
        # The summary goes first and comes last: killed in between, the directory does not pass for finished.
        (directory / _LAST).unlink(missing_ok=True)
        for name in sorted(files, key=lambda name: name == _LAST):
            if (place / name).exists():
                os.replace(place / name, directory / name)
            else:
                (directory / name).unlink(missing_ok=True)
