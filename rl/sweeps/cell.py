"""One training of a sweep: its settings and seed, what is recorded of it, and the key by which it is known."""

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cpgrl_opt.comparison.machine import versions
from cpgrl_opt.solvers import SOLVERS

from ..experiments.checkpoints import sources_digest
from ..training import TrainingRecord
from .digest import digest_of

TrainingFunction = Callable[..., Iterable[TrainingRecord]]
Measure = Callable[[TrainingRecord], Mapping[str, Any]]
OURS = ("seed", "run", "episode", "channel", "error")  # columns that are neither settings nor measures
ENDED_BY_SIGNAL = (129, 143)  # SIGHUP, SIGTERM, as `exit_on_termination` raises them
# Whose versions may change a number, beside those of the solvers' own packages: a training may choose any of them.
_PACKAGES = ("numpy", "scipy", "numba", "gymnasium", "qpsolvers")


@dataclass(frozen=True)
class Cell:
    """Settings by name, a seed, and the key: a digest of all that the numbers depend on."""

    settings: Mapping[str, Any]
    seed: int
    key: str


@dataclass(frozen=True)
class Outcome:
    """What was recorded of a cell.

    episodes: (E,); values: by name, (E, B, 1 + m) as lists, for the B runs of its training; error: what ended it early,
    and `reached`, the episode before; seconds: on the wall, of no meaning for the numbers.
    """

    key: str
    episodes: list[int] = field(default_factory=list)
    values: dict[str, list[Any]] = field(default_factory=dict)
    error: str = ""
    reached: int = 0
    seconds: float = 0.0

    def check(self) -> "Outcome":
        """Itself; ValueError where it was not read from what is written of an outcome."""
        numbers = isinstance(self.episodes, list) and all(isinstance(episode, int) for episode in self.episodes)
        if not isinstance(self.key, str) or not numbers or not isinstance(self.values, dict) or not self.values:
            raise ValueError(f"an outcome should have a key, episodes and values; found {self!r:.100}")
        shape = {np.shape(values)[:1] for values in self.values.values()}
        if shape != {(len(self.episodes),)} or any(np.ndim(values) != 3 for values in self.values.values()):
            raise ValueError(f"values should be (episodes, runs, channels); found {self!r:.100}")
        return self


def carry_out(training: TrainingFunction, measure: Measure, every: int, cell: Cell) -> Outcome:
    """Trains a cell, and records every so many episodes and the last; an exception is an outcome too."""
    begun, reached = time.perf_counter(), 0
    recorded: dict[int, dict[str, np.ndarray]] = {}
    try:
        last = None
        records = training(**cell.settings, seed=cell.seed)
        if not isinstance(records, Iterable):
            raise ValueError(f"a training should return records, as train returns them; found {records!r}")
        for record in records:
            last, reached = record, record.episode
            if record.episode % every == 0:
                recorded[record.episode] = _measure_record(measure, record)
        if last is None:
            raise ValueError("a training should have one episode at least; found none")
        recorded.setdefault(reached, _measure_record(measure, last))
        values = _stack(recorded)
        if taken := [name for name in values if name in (*cell.settings, *OURS)]:
            raise ValueError(f"measure should have names of its own; found {', '.join(taken)}")
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and error.code in ENDED_BY_SIGNAL:
            raise
        return Outcome(cell.key, error=_in_words(error), reached=reached, seconds=_since(begun))
    return Outcome(cell.key, list(recorded), values, reached=reached, seconds=_since(begun))


def outcome_of_dead(cell: Cell) -> Outcome:
    """Of a training whose process ended without an answer."""
    words = "its process was killed, or wanted more memory than there is, or ended itself; it was alone then"
    return Outcome(cell.key, error=f"WorkerDiedError: {words}")


def _in_words(error: BaseException) -> str:
    """In one line; its class alone where it has no words or cannot say them."""
    try:
        words = str(error)
    except Exception as broken:
        words = f"its text raises {type(broken).__name__}"
    return " ".join(f"{type(error).__name__}: {words}".split()).removesuffix(":")


def _measure_record(measure: Measure, record: TrainingRecord) -> dict[str, np.ndarray]:
    found = {name: np.array(value, dtype=np.float64) for name, value in measure(record).items()}
    runs = len(record.parameters)
    if not found or any(value.ndim != 2 or len(value) != runs for value in found.values()):
        shapes = {name: value.shape for name, value in found.items()}
        raise ValueError(f"measure should return arrays ({runs}, channels) by name; found shapes {shapes}")
    return found


def _stack(recorded: Mapping[int, Mapping[str, np.ndarray]]) -> dict[str, list[Any]]:
    names = [*next(iter(recorded.values()))]
    stacked = {name: np.stack([own[name] for own in recorded.values()]) for name in names}
    if len({values.shape for values in stacked.values()}) > 1:
        shapes = {name: values.shape[1:] for name, values in stacked.items()}
        raise ValueError(f"measure should return arrays of one shape; found {shapes}")
    return {name: values.tolist() for name, values in stacked.items()}


def _since(begun: float) -> float:
    return round(time.perf_counter() - begun, 3)


def keys_of(settings: Mapping[str, Any], seeds: Iterable[int], context: str) -> list[str]:
    """For each seed, a digest of what a cell's numbers depend on; context: of `context_of`."""
    made_of = [[name, digest_of(value, f"settings[{name!r}]")] for name, value in sorted(settings.items())]
    return [_digest([made_of, seed, context]) for seed in seeds]


def context_of(training: TrainingFunction, measure: Measure, every: int) -> str:
    """A digest of what all cells of a sweep depend on: both functions and all they reach, packages, `every`."""
    packages = dict.fromkeys([*_PACKAGES, *(str(getattr(solver, "package", "")) for solver in SOLVERS.values())])
    functions = [digest_of(training, "training"), digest_of(measure, "measure")]
    return _digest([functions, every, versions(packages), sources_digest()])


def _digest(facts: object) -> str:
    return hashlib.sha256(json.dumps(facts).encode(errors="surrogateescape")).hexdigest()[:16]
