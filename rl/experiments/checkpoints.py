"""What an experiment that was stopped, killed or not, needs to go on: a folder among its results, a file a training.

It is there from the beginning of an experiment until its results are complete.
"""

import hashlib
import json
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from cpgrl_opt.comparison.machine import versions
from cpgrl_opt.comparison.whole_file import whole_file

from ..saved_state import read_state, write_state

FOLDER = ".cpgrl-checkpoint"  # a name that nobody else has: it is removed with all that is in it
EVERY = 10.0  # s between two checkpoints of a training
_KIND = "checkpoint of an experiment"
_KEY = "experiment.json"
_PACKAGES = ("cpgrl_opt", "envs", "rl")


class CheckpointError(ValueError):
    """A checkpoint that cannot be gone on from; says why, and what to do."""


def experiment_key(experiment: str, settings: Any, packages: Iterable[str]) -> dict[str, Any]:
    """All that decides the results' bytes: only an experiment of the same key goes on from a checkpoint.

    settings: a dataclass; packages: names of those that it stands on.
    """
    key = {"experiment": experiment, "settings": asdict(settings), "versions": versions(packages)}
    found: dict[str, Any] = json.loads(json.dumps({**key, "sources": sources_digest()}))
    return found


def sources_digest() -> str:
    """Of all sources of these packages."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for folder in getattr(find_spec(package), "submodule_search_locations", None) or ():
            for source in sorted(Path(folder).rglob("*.py")):
                digest.update(source.relative_to(folder).as_posix().encode() + b"\n" + source.read_bytes())
    return digest.hexdigest()


def holds(place: Path, key: Mapping[str, Any]) -> bool:
    """Whether the place has a checkpoint of this experiment."""
    return _parts(place, key) > 0


def _parts(place: Path, key: Mapping[str, Any]) -> int:
    """Into how many shares each training's runs were split in this place; 0 where it has no checkpoint of the key."""
    try:
        found = json.loads((place / FOLDER / _KEY).read_text(encoding="utf-8"))
        return int(found["parts"]) if found["key"] == key else 0
    except (OSError, ValueError, TypeError, KeyError):
        return 0


def require_interval(every: float) -> None:
    """ValueError unless it is a finite number of seconds."""
    if not 0 <= every < np.inf:
        raise ValueError(f"checkpoint_every should be a finite number of seconds ≥ 0; found {every!r}")


def forget(place: Path) -> None:
    """Its checkpoint is no longer there: first what says whose it is."""
    (place / FOLDER / _KEY).unlink(missing_ok=True)
    shutil.rmtree(place / FOLDER, ignore_errors=True)


@dataclass(frozen=True)
class Checkpoints:
    """An experiment's checkpoints.

    every: how many seconds may be lost when it is killed; parts: into how many shares each training's runs are split.
    """

    folder: Path
    every: float
    parts: int

    @classmethod
    def begin(cls, place: Path, key: Mapping[str, Any], every: float, parts: int) -> "Checkpoints":
        """Those of the experiment in this place, in as many parts as it began with; or none yet."""
        if not holds(place, key):
            forget(place)
            (place / FOLDER).mkdir(exist_ok=True)
            with whole_file(place / FOLDER / _KEY) as beside:
                beside.write_text(json.dumps({"key": key, "parts": parts}), encoding="utf-8")
        return cls(place / FOLDER, every, _parts(place, key))


class Checkpoint:
    """One training's file; without Checkpoints there is none."""

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
