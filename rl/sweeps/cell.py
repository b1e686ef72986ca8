"""One training of a sweep: its settings and seed, what is recorded of it, and the key by which it is known."""

import hashlib
import inspect
import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from cpgrl_opt.comparison.machine import versions
from cpgrl_opt.comparison.sources import sources_of

from ..description import describe
from ..experiments.checkpoints import sources_digest
from ..training import TrainingRecord

TrainingFunction = Callable[..., Iterable[TrainingRecord]]
Measure = Callable[[TrainingRecord], Mapping[str, Any]]
OURS = ("seed", "run", "episode", "channel", "error")  # columns that are neither settings nor measures
ENDED_BY_SIGNAL = (129, 143)  # SIGHUP, SIGTERM, as `exit_on_termination` raises them
_PACKAGES = ("numpy", "scipy", "numba", "gymnasium")  # whose versions may change a number


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
        for record in training(**cell.settings, seed=cell.seed):
            last, reached = record, record.episode
            if record.episode % every == 0:
                recorded[record.episode] = _measured(measure, record)
        if last is None:
            raise ValueError("a training should have one episode at least; found none")
        recorded.setdefault(reached, _measured(measure, last))
        values = _stacked(recorded)
        if taken := [name for name in values if name in (*cell.settings, *OURS)]:
            raise ValueError(f"measure should have names of its own; found {', '.join(taken)}")
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and error.code in ENDED_BY_SIGNAL:
            raise
        return Outcome(cell.key, error=_in_words(error), reached=reached, seconds=_since(begun))
    return Outcome(cell.key, list(recorded), values, reached=reached, seconds=_since(begun))


def _in_words(error: BaseException) -> str:
    """In one line; its class alone where it has no words or cannot say them."""
    try:
        words = str(error)
    except Exception as broken:
        words = f"its text raises {type(broken).__name__}"
    return " ".join(f"{type(error).__name__}: {words}".split()).removesuffix(":")


def _measured(measure: Measure, record: TrainingRecord) -> dict[str, np.ndarray]:
    found = {name: np.asarray(value, dtype=np.float64) for name, value in measure(record).items()}
    runs = len(record.parameters)
    if not found or any(value.ndim != 2 or len(value) != runs for value in found.values()):
        shapes = {name: value.shape for name, value in found.items()}
        raise ValueError(f"measure should return arrays ({runs}, channels) by name; found shapes {shapes}")
    return found


def _stacked(recorded: Mapping[int, Mapping[str, np.ndarray]]) -> dict[str, list[Any]]:
    names = [*next(iter(recorded.values()))]
    stacked = {name: np.stack([own[name] for own in recorded.values()]) for name in names}
    if len({values.shape for values in stacked.values()}) > 1:
        shapes = {name: values.shape[1:] for name, values in stacked.items()}
        raise ValueError(f"measure should return arrays of one shape; found {shapes}")
    return {name: values.tolist() for name, values in stacked.items()}


def _since(begun: float) -> float:
    return round(time.perf_counter() - begun, 3)


def key_of(settings: Mapping[str, Any], seed: int, context: str) -> str:
    """A digest of what a cell's numbers depend on; context: of `context_of`."""
    facts = [{name: describe(value) for name, value in settings.items()}, seed, context]
    return _digest(facts)


def context_of(training: TrainingFunction, measure: Measure, every: int) -> str:
    """A digest of what all cells of a sweep depend on: both functions and what they import, packages, `every`."""
    return _digest([_made_of(training), _made_of(measure), every, versions(_PACKAGES), sources_digest()])


def _made_of(function: Any) -> Any:
    """A function's name, source, what it encloses, and the sources of its module and of all that imports."""
    while hasattr(function, "func"):  # of functools.partial
        return [_made_of(function.func), describe([function.args, function.keywords])]
    found = function if hasattr(function, "__code__") else type(function)
    try:
        source = inspect.getsource(found)
    except (OSError, TypeError):  # typed in where nobody keeps it
        source = repr(_code(getattr(found, "__code__", None)))
    enclosed = [cell.cell_contents for cell in getattr(found, "__closure__", None) or ()]
    defaults = [getattr(found, name, None) for name in ("__defaults__", "__kwdefaults__")]  # a loop's variable, often
    owner = getattr(found, "__self__", None) if found is function else function
    sources = _sources_of(found.__module__ or "__main__")
    return [found.__module__, found.__qualname__, source, describe([enclosed, defaults, owner]), sources]


@cache
def _sources_of(module: str) -> str:
    """But for ours, of which `sources_digest` tells."""
    return sources_of(module, apart=("cpgrl_opt", "envs", "rl")).digest


def _code(code: Any) -> Any:
    if not hasattr(code, "co_code"):
        return code
    return [code.co_code.hex(), code.co_names, [_code(each) for each in code.co_consts]]


def _digest(facts: object) -> str:
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode(errors="surrogateescape")).hexdigest()[:16]
