"""`cpgrl sweep`: an experiment of the paper, or a function of one's own, over settings and seeds."""

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from ..experiments.experiment import Experiment
from ..experiments.registry import EXPERIMENTS, experiment_named
from ..experiments.results_directory import reserve
from ..observers import ProgressBars
from ..training import TrainingRecord
from .cell import Outcome
from .curves import draw_curves, learning_curves
from .store import TABLE, write_csv
from .sweep import Sweep, combinations, plan, sweep

CURVES, FIGURE = "curves.csv", "curves.png"


def run_sweep(target: str, over: Sequence[str], out: Path, **asked: Any) -> tuple[Sweep, list[str]]:
    """Trains, and writes the table, the curves and their figure into the folder; returns the files' names.

    target: an experiment's name, or package.module:FUNCTION; over: "name=value,value"; asked: as `sweep` says.
    ValueError for what cannot be swept.
    """
    import matplotlib  # noqa: F401 - refuses a wrong MPLBACKEND before the trainings rather than after them

    settings = parse_settings(over)
    if target in EXPERIMENTS:
        asked["measure"] = experiment_named(target).measure
        training = _experiment_training(target, settings)
    else:
        training = _function(target)
    chosen = {name: value for name, value in asked.items() if name != "anew"}
    trainings = len(plan(training, settings, **chosen))  # refuses before there is a folder
    with reserve(out):  # until the curves are there too: they are of this table
        with ProgressBars({"trainings": trainings}) as bars:

            def listen(done: int, _: int, outcome: Outcome) -> None:  # noqa: ARG001 - only that it is there
                bars.move("trainings", done)

            found = sweep(training, settings, out=out, listen=listen, **asked)
        curves = learning_curves(found)
        if not curves:  # those of an earlier table would be taken for this one's
            for name in (CURVES, FIGURE):
                (out / name).unlink(missing_ok=True)
            return found, [TABLE]
        write_csv(out / CURVES, list(curves[0]), curves)
        draw_curves(curves, out / FIGURE)
    return found, [TABLE, CURVES, FIGURE]


def parse_settings(over: Sequence[str]) -> dict[str, list[Any]]:
    """Values by name; ValueError for a name that is there twice."""
    found = [*map(parse_setting, over)]
    names = [name for name, _ in found]
    if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        raise ValueError(f"over should have each name once, with all its values; found {twice[0]} twice")
    return dict(found)


def parse_setting(text: str) -> tuple[str, list[Any]]:
    """Name and values of "name=value,value": each as JSON where it is JSON, else a word."""
    name, equals, values = text.partition("=")
    if not equals or not name.strip() or not values.strip():
        raise ValueError(f"over should be name=value,value; found {text!r}")
    try:
        return name.strip(), json.loads(f"[{values}]")
    except ValueError:
        return name.strip(), [_value(word.strip()) for word in values.split(",")]


def _value(word: str) -> Any:
    try:
        return json.loads(word)
    except ValueError:
        return word


def parse_seeds(text: str) -> Sequence[int]:
    """How many, or which, with commas between them."""
    try:
        numbers = [int(word) for word in text.split(",") if word.strip()]
    except ValueError:
        numbers = []
    if not numbers or (len(numbers) == 1 and "," not in text and numbers[0] < 1):
        raise ValueError(f"seeds should be a number ≥ 1, or numbers with commas between them; found {text!r}")
    return numbers if "," in text else range(numbers[0])


def _function(target: str) -> Callable[..., Iterable[TrainingRecord]]:
    module, colon, name = target.partition(":")
    if not (module and colon and name):
        raise ValueError(f"target should be one of {', '.join(EXPERIMENTS)}, or MODULE:FUNCTION; found {target!r}")
    if (folder := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, folder)
    try:
        found: Callable[..., Iterable[TrainingRecord]] = getattr(import_module(module), name)
    except (ModuleNotFoundError, AttributeError) as error:
        raise ValueError(f"target should be MODULE:FUNCTION; found {target!r}: {error}") from error
    return found


def _experiment_training(name: str, settings: Mapping[str, Sequence[Any]]) -> Callable[..., Iterable[TrainingRecord]]:
    """Of an experiment; ValueError unless it takes the settings."""
    known = [own.name for own in fields(experiment_named(name)) if own.name != "seed"]
    if unknown := [own for own in settings if own not in (*known, "training")]:
        raise ValueError(f"{name} has the settings training, {', '.join(known)}; found {', '.join(unknown)}")
    for point in combinations(settings):
        _case(name, **point, seed=0)
    return partial(train_case, name)


def train_case(experiment: str, **settings: Any) -> Iterable[TrainingRecord]:
    """The records of one of its trainings, `training`, the first if not given; one run if `runs` is not given."""
    found, case = _case(experiment, **settings)
    return found.begin(case, range(found.runs))[0]


def _case(name: str, training: str = "", runs: int = 1, **settings: Any) -> tuple[Experiment, Any]:
    given: dict[str, Any] = {own: tuple(value) if isinstance(value, list) else value for own, value in settings.items()}
    experiment = experiment_named(name)(**given, runs=runs)
    cases = {case.label: case for case in experiment.cases()}
    label = training or next(iter(cases))
    if label not in cases:
        raise ValueError(f"training should be one of {', '.join(cases)}; found {label!r}")
    return experiment, cases[label]
