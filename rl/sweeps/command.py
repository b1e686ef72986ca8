"""`cpgrl sweep`: an experiment of the paper, or a function of one's own, over settings and seeds."""

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from cpgrl_opt.validation import listed, not_a_member, require_member

from ..experiments.experiment import Experiment
from ..experiments.registry import EXPERIMENTS, experiment_named
from ..observers import ProgressBars
from ..standard_output import say
from ..training import TrainingRecord
from .curves import draw_curves, learning_curves
from .store import TABLE, Store, store
from .sweep import Plan, Sweep, combinations, estimates

CURVES, FIGURE = "curves.csv", "curves.png"


def run_sweep(
    target: str, over: Sequence[str], out: Path, *, seeds: Sequence[int], every: int, engine: str, jobs: int, anew: bool
) -> bool:
    """Trains, and writes the table, the curves and their figure; says what came of it.

    Parameters
    ----------
    target
        An experiment's name, or package.module:FUNCTION.
    over
        "name=value,value" of each setting.
    out
        The folder.
    seeds, every, engine, jobs, anew
        As `sweep` says.

    Returns
    -------
    bool
        Whether no training ended with an error.

    Raises
    ------
    ValueError, MissingEngineError
        For what cannot be swept, before there is a folder.
    """
    import matplotlib  # noqa: F401 - refuses a wrong MPLBACKEND before the trainings rather than after them

    settings = parse_settings(over)
    measure = experiment_named(target).measure if target in EXPERIMENTS else estimates
    training = _experiment_training(target, settings) if target in EXPERIMENTS else _function(target)
    plan = Plan.of(training, settings, seeds=seeds, every=every, measure=measure, engine=engine, jobs=jobs)
    with store(out, anew=anew) as kept:  # until the curves are there too: they are of this table
        with ProgressBars({"trainings": len(plan.cells)}) as bars:
            found = plan.carry_out(kept, lambda done, *_: bars.move("trainings", done))
        files = _write_curves(found, kept, out)
    say(f"Trained {found.trained}, of which {len(found.failed)} ended with an error.")
    say(f"Wrote {', '.join([TABLE, *files])} into {out}")
    for row in found.failed[:3]:
        named = ", ".join(f"{name} {row[name]}" for name in found.columns[: found.columns.index("run")])
        say(f"{named}: {row['error']} (after episode {row['episode']})", err=True)
    return not found.failed


def _write_curves(found: Sweep, kept: Store, out: Path) -> list[str]:
    """The files' names; where there are no curves, those of an earlier table would be taken for this one's."""
    curves = learning_curves(found)
    if curves:
        kept.write(list(curves[0]), curves, CURVES)
        draw_curves(curves, out / FIGURE)
        return [CURVES, FIGURE]
    for name in (CURVES, FIGURE):
        (out / name).unlink(missing_ok=True)
    return []


def parse_settings(over: Sequence[str]) -> dict[str, list[Any]]:
    """Values by name; ValueError for a name that is there twice.

    Parameters
    ----------
    over
        "name=value,value" each.

    Returns
    -------
    dict of list
        In their order.

    Raises
    ------
    ValueError
        For a name that is there twice.
    """
    found = [*map(parse_setting, over)]
    names = [name for name, _ in found]
    if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        raise ValueError(f"over should have each name once, with all its values; found {twice[0]} twice")
    return dict(found)


def parse_setting(text: str) -> tuple[str, list[Any]]:
    """Name and values of "name=value,value": each as JSON where it is JSON, else a word.

    Parameters
    ----------
    text
        "name=value,value".

    Returns
    -------
    tuple
        Name, values.

    Raises
    ------
    ValueError
        For another text.
    """
    name, _, values = text.partition("=")
    if not name.strip() or not values.strip():
        raise ValueError(f"over should be name=value,value; found {text!r}")
    with suppress(ValueError):
        return name.strip(), json.loads(f"[{values}]")
    return name.strip(), [_value(word.strip()) for word in values.split(",")]


def _value(word: str) -> Any:
    with suppress(ValueError):
        return json.loads(word)
    return word


def parse_seeds(text: str) -> Sequence[int]:
    """How many, or which, with commas between them.

    Parameters
    ----------
    text
        A number, or numbers with commas.

    Returns
    -------
    sequence of int
        The seeds.

    Raises
    ------
    ValueError
        For another text.
    """
    with suppress(ValueError, IndexError):
        numbers = [int(word) for word in listed(text)]
        if "," in text or numbers[0] >= 1:
            return numbers if "," in text else range(numbers[0])
    raise ValueError(f"seeds should be a number ≥ 1, or numbers with commas between them; found {text!r}")


def _function(target: str) -> Callable[..., Iterable[TrainingRecord]]:
    module, colon, name = target.partition(":")
    if not (module and colon and name):
        raise not_a_member("target", target, EXPERIMENTS, ", or MODULE:FUNCTION")
    if (folder := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, folder)
    try:
        found: Callable[..., Iterable[TrainingRecord]] = resolve_name(target)
    except (ModuleNotFoundError, AttributeError, ValueError) as error:
        raise ValueError(f"target should be MODULE:FUNCTION; found {target!r}: {error}") from error
    return found


def _experiment_training(name: str, settings: Mapping[str, Sequence[Any]]) -> Callable[..., Iterable[TrainingRecord]]:
    """Of an experiment; ValueError unless it takes the settings."""
    known = ["training", *(own.name for own in fields(experiment_named(name)) if own.name != "seed")]
    for own in settings:
        require_member(f"a setting of {name}", own, known)
    for point in combinations(settings):
        _case(name, **point, seed=0)
    return partial(train_case, name)


def train_case(experiment: str, **settings: Any) -> Iterable[TrainingRecord]:
    """The records of one of its trainings, `training`, the first if not given; one run if `runs` is not given.

    Parameters
    ----------
    experiment
        Its name.
    settings
        The experiment's; `training`, the label of one of its trainings; `runs`, 1 if it is not given.

    Returns
    -------
    iterable of TrainingRecord
        The training.

    Raises
    ------
    ValueError
        For wrong settings.
    """
    found, case = _case(experiment, **settings)
    return found.begin(case, range(found.runs))[0]


def _case(name: str, training: str = "", runs: int = 1, **settings: Any) -> tuple[Experiment, Any]:
    given: dict[str, Any] = {own: tuple(value) if isinstance(value, list) else value for own, value in settings.items()}
    experiment = experiment_named(name)(**given, runs=runs)
    cases = {case.label: case for case in experiment.cases()}
    label = training or next(iter(cases))
    require_member("training", label, cases)
    return experiment, cases[label]
