"""The directory of a reproduction: results of two runs never lie side by side in it."""

from collections.abc import Sequence
from pathlib import Path


def clear(directory: Path, files: Sequence[str]) -> None:
    """Makes the directory if it is not there; removes these files, an earlier run's, and no others."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name in files:
            (directory / name).unlink(missing_ok=True)
    except OSError as error:
        raise ValueError(f"out should be a directory to write into; found {directory} ({error.strerror})") from error
