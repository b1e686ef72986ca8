"""One training of a sweep: its settings and seed, what is recorded of it, and the key by which it is known."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from traceback import format_exception_only
from typing import Any

import numpy as np

from cpgrl_opt.comparison.machine import versions
from cpgrl_opt.solvers import SOLVERS

from ..endings import TERMINATED
from ..training import TrainingRecord

TrainingFunction = Callable[..., Iterable[TrainingRecord]]
Measure = Callable[[TrainingRecord], Mapping[str, Any]]
OURS = ("seed", "run", "episode", "channel", "error")  # columns that are neither settings nor measures
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
    and `reached`, the episode before.
    """

    key: str
    episodes: list[int] = field(default_factory=list)
    values: dict[str, list[Any]] = field(default_factory=dict)
    error: str = ""
    reached: int = 0


def carry_out(training: TrainingFunction, measure: Measure, every: int, cell: Cell) -> Outcome:
    """Trains a cell, and records every so many episodes and the last; an exception is an outcome too.

    Parameters
    ----------
    training, measure, every
        As `sweep` says.
    cell
        Settings and seed.

    Returns
    -------
    Outcome
        With what was recorded, or with the error.
    """
    reached, recorded = 0, dict[int, dict[str, np.ndarray]]()
    try:
        for record in training(**cell.settings, seed=cell.seed):
            last, reached = record, record.episode
            if record.episode % every == 0:
                recorded[record.episode] = _measure_record(measure, record)
        if not reached:
            raise ValueError("a training should have one episode at least; found none")
        recorded.setdefault(reached, _measure_record(measure, last))
        values = _stack(recorded)
        if taken := [name for name in values if name in (*cell.settings, *OURS)]:
            raise ValueError(f"measure should have names of its own; found {', '.join(taken)}")
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and error.code in TERMINATED:
            raise
        words = " ".join("".join(format_exception_only(error)).split())
        return Outcome(cell.key, error=words, reached=reached)
    return Outcome(cell.key, list(recorded), values, reached=reached)


def outcome_of_dead(cell: Cell) -> Outcome:
    """Of a training whose process ended without an answer.

    Parameters
    ----------
    cell
        Whose process it was.

    Returns
    -------
    Outcome
        With an error.
    """
    words = "its process was killed, or wanted more memory than there is, or ended itself; it was alone then"
    return Outcome(cell.key, error=f"WorkerDiedError: {words}")


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


def keys_of(settings: Mapping[str, Any], seeds: Iterable[int], context: str) -> list[str]:
    """For each seed, a digest of what a cell's numbers depend on; context: of `context_of`.

    Parameters
    ----------
    settings
        By name.
    seeds
        A key for each.
    context
        Of `context_of`.

    Returns
    -------
    list of str
        16 hexadecimal digits each.

    Raises
    ------
    ValueError
        For settings that cannot be pickled.
    """
    from ..digest import digest_of, digest_of_text  # joblib loads with it

    made_of = [f"{name} {digest_of(value, f'settings[{name!r}]')}" for name, value in sorted(settings.items())]
    return [digest_of_text(*made_of, str(seed), context) for seed in seeds]


def context_of(training: TrainingFunction, measure: Measure, every: int) -> str:
    """A digest of what all cells of a sweep depend on: both functions and all they reach, packages, `every`.

    Parameters
    ----------
    training, measure, every
        As `sweep` says.

    Returns
    -------
    str
        16 hexadecimal digits.

    Raises
    ------
    ValueError
        For functions that hold what cannot be pickled.
    """
    from ..digest import digest_of, digest_of_text, sources_digest

    packages = dict.fromkeys([*_PACKAGES, *(str(getattr(solver, "package", "")) for solver in SOLVERS.values())])
    functions = digest_of(training, "training"), digest_of(measure, "measure")
    return digest_of_text(*functions, str(every), str(versions(packages)), sources_digest())
