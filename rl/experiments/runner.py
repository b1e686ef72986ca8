"""`cpgrl reproduce`: an experiment's training, claims and figures, and every file of the results' directory."""

import json
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from cpgrl_opt.comparison.machine import versions
from cpgrl_opt.solvers import solver_named
from cpgrl_opt.validation import require_nonnegative

from ..digest import digest_of_text, sources_digest
from .checkpoints import EVERY, Checkpoints
from .claims import Claim, write_claims
from .experiment import Experiment, Results
from .figure_style import paper_style, save_figure
from .json_file import write_summary
from .messages import Outcome
from .records import Listener, parts_for, train
from .results_directory import parts_of, results_directory
from .step_report import handing_over, in_words
from .subproblems import FILE as SUBPROBLEMS
from .subproblems import write_subproblems

PACKAGES = ("cpgrl-opt", "numpy", "scipy", "numba", "gymnasium", "matplotlib")  # that every experiment stands on


@dataclass(frozen=True, eq=False)
class Reproduction:
    """Results, claims, wall seconds by part ("training", "figures", "total"), and what --record kept, in words."""

    results: Results
    claims: Sequence[Claim]
    seconds: Mapping[str, float]
    recorded: Sequence[str] = ()


def files_of(experiment: Experiment | type[Experiment]) -> tuple[str, ...]:
    """Names of all files that it may write."""
    return ("learning.csv", "claims.json", "summary.json", *experiment.files, SUBPROBLEMS)


def reproduce(
    experiment: Experiment, directory: Path, *, processes: int = 1, listen: Listener | None = None,
    checkpoint_every: float = EVERY, anew: bool = False,
) -> Reproduction:  # fmt: skip
    """Trains, and writes those of `files_of` that the settings ask for.

    Parameters
    ----------
    experiment
        With its settings.
    directory
        An earlier run's files stay in it until these are finished; meanwhile see `results_directory`.
    processes, listen
        As `train` says.
    checkpoint_every
        Seconds that are lost at most where it is stopped, killed or not, and called again. The bytes of `learning.csv`
        and `claims.json` do not tell.
    anew
        Starts over where it was stopped.

    Returns
    -------
    Reproduction
        What came of it.

    Raises
    ------
    ValueError
        For an interval that is none, and as `results_directory` and `train`.
    """
    require_nonnegative("checkpoint_every", checkpoint_every)
    with workplace(experiment, directory, processes=processes, anew=anew) as place:
        return carry_out(experiment, place, processes=processes, listen=listen, checkpoint_every=checkpoint_every)


def workplace(
    experiment: Experiment, directory: Path, *, processes: int = 1, anew: bool = False
) -> AbstractContextManager[Path]:
    """The `results_directory` of an experiment; its key: all that decides the results' bytes.

    Parameters
    ----------
    experiment, directory, processes, anew
        As `reproduce` says.

    Returns
    -------
    context of Path
        Where the experiment works.

    Raises
    ------
    UnusableDirectoryError, FolderInUseError
        See `results_directory`.
    """
    settings, packages = json.dumps(asdict(experiment)), versions((*PACKAGES, *_back_ends(experiment)))
    key = digest_of_text(experiment.name, settings, json.dumps(packages), sources_digest())
    return results_directory(directory, files_of(experiment), key, parts=parts_for(experiment, processes), anew=anew)


def carry_out(
    experiment: Experiment, place: Path, *, processes: int, listen: Listener | None, checkpoint_every: float
) -> Reproduction:
    """What `reproduce` does in a `workplace`.

    Parameters
    ----------
    experiment, processes, listen, checkpoint_every
        As `reproduce` says.
    place
        What `workplace` gives.

    Returns
    -------
    Reproduction
        As `reproduce` says.

    Raises
    ------
    MissingPackageError, DivergenceError, WorkerDiedError, CheckpointError
        As their names say.
    """
    was_stopped = any(place.iterdir())
    checkpoints = Checkpoints(place, checkpoint_every, parts_of(place))
    begun = perf_counter()
    results = train(experiment, place, processes=processes, listen=listen, checkpoints=checkpoints)
    trained = perf_counter()
    claims = experiment.claims(results)
    write_claims(claims, place / "claims.json")
    for comparison in experiment.comparisons():
        comparison.write(results.curves, results.outcomes, place)
    recorded = write_subproblems([outcome.recording for outcome in results.outcomes.values()], place)
    draw(results, place)
    ended = perf_counter()
    seconds = {"training": trained - begun, "figures": ended - trained, "total": ended - begun}
    contents = {**summary(results, seconds, processes), "was_stopped": was_stopped}
    write_summary(place / "summary.json", speed(results), contents)
    return Reproduction(results, claims, seconds, recorded)


def draw(results: Results, directory: Path) -> None:
    """Every figure as PNG and SVG, every animation.

    Parameters
    ----------
    results
        Of the experiment that draws.
    directory
        For the files.
    """
    with paper_style():
        for name, figure in results.settings.figures(results).items():
            if "." in name:
                figure(directory / name)
            else:
                save_figure(figure(), directory, name)


def remarks(done: Reproduction) -> list[str]:
    """Speed, wall time, and whatever did not go by the plain rule.

    Parameters
    ----------
    done
        A reproduction.

    Returns
    -------
    list of str
        Sentences.
    """
    results, settings = done.results, done.results.settings
    million_steps = sum(int(outcome.steps.sum()) for outcome in results.outcomes.values()) / 1e6
    lines = [
        f"{million_steps:.1f} M environment steps; CPGRL trained at {speed(results) / 1e6:.2f} M steps/s a process, "
        f"{speed(results, 'cpu_seconds') / 1e6:.2f} M per second of CPU time.",
        f"Wall time {done.seconds['total']:.1f} s: training {done.seconds['training']:.1f} s, "
        f"figures {done.seconds['figures']:.1f} s.",
        *settings.remarks(),
    ]
    for label, outcome in results.outcomes.items():
        counted = in_words(outcome.counted())
        if counted:
            lines.append(f"({label}), {settings.runs * outcome.episode} updates: {counted}.")
    return [*lines, *handing_over(settings.solver, settings.step().solver, settings.formulation), *done.recorded]


def speed(results: Results, clock: str = "seconds") -> float:
    """Environment steps per wall second of a process, or per "cpu_seconds", in training by CPGRL, or by all if none.

    Parameters
    ----------
    results
        With outcomes.
    clock
        "seconds" of the wall or "cpu_seconds".

    Returns
    -------
    float
        Steps per second.
    """
    labels = [case.label for case in results.settings.cases() if case.by_cpgrl] or list(results.outcomes)
    outcomes = [results.outcomes[label] for label in labels]
    return float(sum(each.steps.sum() for each in outcomes) / sum(getattr(each, clock) for each in outcomes))


def summary(results: Results, seconds: Mapping[str, float], processes: int) -> dict[str, Any]:
    """What `summary.json` holds besides speed and machine.

    Parameters
    ----------
    results
        With outcomes.
    seconds
        Of the wall, by part.
    processes
        That trained.

    Returns
    -------
    dict
        For JSON.
    """
    settings = results.settings
    return {
        "experiment": settings.name,
        "settings": asdict(settings),
        "seeds": {"seed": settings.seed, "runs": "run i draws from SeedSequence(seed, spawn_key=(i,)).spawn(2)"},
        "versions": versions((*PACKAGES, *_back_ends(settings))),
        "wall_time": {name: round(value, 3) for name, value in seconds.items()},
        "processes": processes,
        "steps_per_cpu_second": round(speed(results, "cpu_seconds")),
        f"{settings.key}s": {
            case.label: {**_cost(results.outcomes[case.label], settings.runs), **settings.summary_of(case, results)}
            for case in settings.cases()
        },
        **settings.summary(results),
    }


def _cost(outcome: Outcome, runs: int) -> dict[str, Any]:
    return {
        "environment_steps": int(outcome.steps.sum()),
        "training_seconds": round(outcome.seconds, 3),
        "training_cpu_seconds": round(outcome.cpu_seconds, 3),
        "steps_per_second": round(outcome.steps_per_second),
        "updates": runs * outcome.episode,
        "counts": outcome.counted(),
    }


def _back_ends(experiment: Experiment) -> list[str]:
    solvers = [solver_named(case.solver) for case in experiment.cases() if case.solver]
    return sorted({package for solver in solvers if (package := getattr(solver, "package", None))})
