"""What a training that was stopped, killed or not, needs to go on: a file of each share, where the experiment works."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from ..saved_state import read_state, write_state

EVERY = 10.0  # s between two checkpoints of a training
_KIND = "checkpoint of an experiment"


class CheckpointError(ValueError):
    """A checkpoint that cannot be gone on from; says why, and what to do."""


@dataclass(frozen=True)
class Checkpoints:
    """Where an experiment's are, how many seconds may be lost, and into how many shares each training's runs are split.

    Raises ValueError unless `every` is a finite number of seconds.
    """

    folder: Path
    every: float
    parts: int

    def __post_init__(self) -> None:
        if not 0 <= self.every < np.inf:
            raise ValueError(f"checkpoint_every should be a finite number of seconds ≥ 0; found {self.every!r}")


class Checkpoint:
    """One share's file; without Checkpoints there is none."""

    def __init__(self, checkpoints: Checkpoints | None, name: str) -> None:
        self.every = np.inf if checkpoints is None else checkpoints.every
        self.path = None if checkpoints is None else checkpoints.folder / f"{name}.npz"
        self.last = perf_counter()

    def read(self) -> dict[str, Any] | None:
        """What was written last; None at the beginning. CheckpointError where the file is damaged."""
        if self.path is None or not self.path.exists():
            return None
        try:
            return read_state(self.path, _KIND)
        except ValueError as error:
            raise CheckpointError(f"{error}. --anew starts over") from error

    def is_due(self, *, at_the_end: bool) -> bool:
        """Whether as much time has passed as may be lost, or nothing follows."""
        return self.path is not None and (at_the_end or perf_counter() - self.last >= self.every)

    def write(self, state: Mapping[str, Any]) -> None:
        """In the last one's place, if there are checkpoints."""
        if self.path is not None:
            write_state(self.path, _KIND, state)
            self.last = perf_counter()
