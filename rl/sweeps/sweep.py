"""`rl.sweep`: a training for each of many settings and seeds, in one tidy table."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt.validation import require_count

from ..streams import run_indices
from ..training import TrainingRecord
from .cell import OURS, Cell, Measure, Outcome, TrainingFunction, carry_out, context_of, keys_of, outcome_of_dead
from .engines import map_unordered, require_engine
from .store import Store, plain, rows_of, store

Settings = Mapping[str, Sequence[Any]] | Sequence[Mapping[str, Any]]
Listener = Callable[[int, int, Outcome], object]


def estimates(record: TrainingRecord) -> dict[str, Any]:
    """ρ as the estimator carries it, (B, 1 + m), under the name `value`.

    Parameters
    ----------
    record
        Of a training.

    Returns
    -------
    dict
        `value`, (B, 1 + m).
    """
    return {"value": record.estimate.values}


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a sweep found: `columns` and `rows` of its table.

    `pandas.DataFrame(found.rows)` is the table. trained: how many cells were trained now, the others had been before.
    """

    columns: Sequence[str]
    rows: Sequence[Mapping[str, Any]]
    trained: int

    @property
    def failed(self) -> list[Mapping[str, Any]]:
        """The rows of trainings that ended with an error."""
        return [row for row in self.rows if row["error"]]


def sweep(
    training: TrainingFunction,
    settings: Settings,
    *,
    seeds: int | Sequence[int] = 5,
    every: int = 100,
    measure: Measure = estimates,
    out: Path | str | None = None,
    anew: bool = False,
    engine: str = "loky",
    jobs: int = 1,
    listen: Listener | None = None,
) -> Sweep:
    """training(**settings, seed=seed) for all settings and seeds; the rows do not depend on engine and jobs.

    Parameters
    ----------
    training
        Returns a `Training`, or what `train` returns, drawing from nothing but the seed. Its parameters are the
        settings' names, and `seed`.
    settings
        Values by name, all of whose combinations are trained, the last name changing fastest; or a list of
        combinations.
    seeds
        How many (0, 1, …), or which. The same seed has the same streams under all settings.
    every
        Episodes between two records of a training; the last episode is always recorded.
    measure
        What is recorded: arrays (B, 1 + m) by name, of the B runs of a training. ρ̂ if not given.
    out
        Folder: `sweep.csv`, the table, when all is done; `outcomes.jsonl` keeps each training as it ends. The same call
        goes on where it was stopped or killed. A training whose settings, seed or sources have changed is a new one.
        Trainings that ended with an error are tried again.
    anew
        Forgets what the folder holds.
    engine, jobs
        As `map_unordered` says.
    listen
        Called as each training ends: how many are done, of how many, its outcome.

    Returns
    -------
    Sweep
        A row for each setting, seed, run, recorded episode and channel, in the order of settings and seeds. A training
        that raises, or that ends its worker process, has one row, with its `error` and the last `episode` that it
        reached; the others go on. With one job there is no worker process.

    Raises
    ------
    ValueError
        For settings that are none, that training does not take or whose names are columns of the table; for seeds,
        every, engine, jobs; for a folder that cannot be made.
    FolderInUseError, MissingEngineError
        See there.
    """
    plan = Plan.of(training, settings, seeds=seeds, every=every, measure=measure, engine=engine, jobs=jobs)
    with store(None if out is None else Path(out), anew=anew) as kept:
        return plan.carry_out(kept, listen)


@dataclass(frozen=True, eq=False)
class Plan:
    """What is trained, in the order of the table: task(cell) → its outcome, by jobs of an engine."""

    cells: Sequence[Cell]
    task: Callable[[Cell], Outcome]
    engine: str
    jobs: int

    @classmethod
    def of(
        cls, training: TrainingFunction, settings: Settings, *, seeds: int | Sequence[int], every: int,
        measure: Measure, engine: str, jobs: int,
    ) -> "Plan":  # fmt: skip
        """Raises what `sweep` raises before it trains."""
        require_count("every", every)
        require_engine(engine, jobs)
        points = combinations(settings)
        _require_taken(training, points[0])
        if len({tuple(map(plain, point.values())) for point in points}) < len(points):
            raise ValueError(
                "settings should differ in the table, in numbers, texts, names or classes; found two alike in "
                f"{settings!r:.200}"
            )
        numbers, context = run_indices(seeds, "seeds"), context_of(training, measure, every)
        cells = [
            Cell(point, seed, key)
            for point in points
            for seed, key in zip(numbers, keys_of(point, numbers, context), strict=True)
        ]
        return cls(cells, partial(carry_out, training, measure, every), engine, jobs)

    def carry_out(self, kept: Store, listen: Listener | None = None) -> Sweep:
        """Trains what is not kept, and writes the table."""
        missing = [cell for cell in self.cells if cell.key not in kept.found]
        ended, done = dict(kept.found), len(self.cells) - len(missing)
        for outcome in map_unordered(self.task, missing, outcome_of_dead, engine=self.engine, jobs=self.jobs):
            kept.add(outcome)
            ended[outcome.key], done = outcome, done + 1
            if listen is not None:
                listen(done, len(self.cells), outcome)
        measured = dict.fromkeys(name for cell in self.cells for name in ended[cell.key].values)
        names = list(measured) or ["value"]  # where every training ended with an error
        rows = [row for cell in self.cells for row in rows_of(cell, ended[cell.key], names)]
        kept.write(list(rows[0]), rows)
        return Sweep(list(rows[0]), rows, len(missing))


def combinations(settings: Any) -> list[dict[str, Any]]:
    """Of `settings` as `sweep` takes it; ValueError unless all have the same names.

    Parameters
    ----------
    settings
        As `sweep` takes it.

    Returns
    -------
    list of dict
        All of the same names.

    Raises
    ------
    ValueError
        For others.
    """
    if isinstance(settings, Mapping):
        settings = {name: own.tolist() if isinstance(own, np.ndarray) else own for name, own in settings.items()}
        for name, values in settings.items():
            if isinstance(values, str) or not isinstance(values, Sequence) or not values:
                raise ValueError(f"settings[{name!r}] should be a list of values, one at least; found {values!r}")
        settings = [dict(zip(settings, values, strict=True)) for values in product(*settings.values())]
    is_listed = isinstance(settings, Sequence) and all(isinstance(point, Mapping) for point in settings)
    points = [dict(point) for point in settings] if is_listed else []
    if not points or any(list(point) != list(points[0]) for point in points):
        raise ValueError(f"settings should be lists by name, or dicts of the same names; found {settings!r}")
    if taken := [name for name in points[0] if name in OURS]:
        raise ValueError(f"settings should not be named {', '.join(OURS)}; found {', '.join(taken)}")
    return points


def _require_taken(training: Any, point: Mapping[str, Any]) -> None:
    if not callable(training):
        raise ValueError(f"training should be a function of the settings and a seed; found {training!r}")
    try:
        inspect.signature(training).bind(**point, seed=0)
    except TypeError as error:
        names = ", ".join([*map(str, point), "seed"])
        raise ValueError(f"training should take {names}: {error}") from error
