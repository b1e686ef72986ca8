"""The directory of a reproduction: finished results stay until others are finished, and two runs never mix in it.

An experiment works in a folder of its own in it, unfinished-KEY-PARTS. There are what it wrote so far and its
checkpoints, from the beginning until its results are complete; only an experiment of the same key goes on there.
"""

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from cpgrl_opt.comparison.folder_lock import FolderInUseError, locked_folder

from ..interrupts import InterruptsHeld

_LAST = "summary.json"  # without it a directory does not hold a finished run


class UnusableDirectoryError(ValueError):
    """The directory asked for is not there and cannot be made."""


@contextmanager
def results_directory(
    directory: Path, files: Sequence[str], key: str, *, parts: int = 1, anew: bool = False
) -> Iterator[Path]:
    """The folder to write into, whose files take their places in the directory at the end.

    Parameters
    ----------
    directory
        Made if it is not there, and this process's alone meanwhile. Files of other names are left alone.
    files
        Names of all that may be written. Those that were not written anew are removed at the end.
    key
        What decides the results' bytes.
    parts
        Number of shares of a training's runs; where the experiment goes on, what the folder's name ends in counts.
    anew
        Starts over where the experiment was stopped.

    Yields
    ------
    Path
        Empty at the beginning of an experiment. On an exception it stays as it is, unless it is empty.

    Raises
    ------
    UnusableDirectoryError, FolderInUseError
        Where there can be no directory; where another process writes into it.
    """
    with reserve(directory):
        stopped = sorted(directory.glob(f"unfinished-{key}-*"))
        place = stopped[0] if stopped else directory / f"unfinished-{key}-{parts}"
        if anew:
            shutil.rmtree(place, ignore_errors=True)
        place.mkdir(exist_ok=True)
        try:
            yield place
        except BaseException:
            with suppress(OSError):
                place.rmdir()  # where nothing was written
            raise
        _swap_in(place, directory, files)
        shutil.rmtree(place)


def parts_of(place: Path) -> int:
    """Into how many shares the runs were split where an experiment began to work."""
    return int(place.name.rpartition("-")[2])


@contextmanager
def reserve(directory: Path) -> Iterator[None]:
    """The directory, made if it is not there, for this process alone; see `results_directory` for what is raised.

    Parameters
    ----------
    directory
        Made with its parents.

    Raises
    ------
    UnusableDirectoryError, FolderInUseError
        See `results_directory`.
    """
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


def _swap_in(place: Path, directory: Path, files: Sequence[str]) -> None:
    with InterruptsHeld():
        # The summary goes first and comes last: killed in between, the directory does not pass for finished.
        (directory / _LAST).unlink(missing_ok=True)
        for name in sorted(files, key=lambda name: name == _LAST):
            if (place / name).exists():
                os.replace(place / name, directory / name)
            else:
                (directory / name).unlink(missing_ok=True)
