"""`cpgrl reproduce`: an experiment's training, claims and figures, and every file of the results' directory."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from cpgrl_opt.comparison.machine import versions
from cpgrl_opt.solvers import solver_named

from .checkpoints import EVERY, Checkpoints, experiment_key, holds, require_interval
from .claims import Claim, write_claims
from .comparison import Comparison
from .experiment import Experiment, Results
from .figure_style import load_figures, paper_style, save_figure
from .messages import Outcome
from .records import Listener, parts_for, train
from .results_directory import results_directory
from .step_report import handing_over, in_words
from .subproblems import FILE as SUBPROBLEMS
from .subproblems import write_subproblems
from .summary import PACKAGES, write_summary


@dataclass(frozen=True, eq=False)
class Reproduction:
    """Results, claims, tables of comparisons, wall seconds by part ("training", "figures", "total"), the recording."""

    results: Results
    claims: Sequence[Claim]
    tables: Sequence[tuple[Comparison, list[list[str]]]]
    seconds: Mapping[str, float]
    recorded: Sequence[str] = ()


def files_of(experiment: Experiment | type[Experiment]) -> tuple[str, ...]:
    """Names of all files that it may write."""
    return ("learning.csv", "claims.json", "summary.json", *experiment.files, SUBPROBLEMS)


def reproduce(
    experiment: Experiment,
    directory: Path,
    *,
    processes: int = 1,
    listen: Listener | None = None,
    checkpoint_every: float = EVERY,
) -> Reproduction:
    """Writes those of `files_of` that the settings ask for into the directory, as `results_directory` says.

    An earlier run's stay until these are finished. Interrupted, it leaves `learning.csv`, and the CSV of comparisons,
    with what was done. Stopped, killed or not, and called again, it goes on, and loses checkpoint_every seconds at
    most; the bytes of `learning.csv` and `claims.json` do not tell. Raises as `train`.
    """
    require_interval(checkpoint_every)
    key = key_of(experiment)
    with results_directory(directory, files_of(experiment), key) as place:
        was_stopped = holds(place, key)
        checkpoints = Checkpoints.begin(place, key, checkpoint_every, parts_for(experiment, processes))
        begun = perf_counter()
        results = train(
            experiment, place, processes=processes, listen=listen, meanwhile=_load, checkpoints=checkpoints
        )  # fmt: skip
        trained = perf_counter()
        claims = experiment.claims(results)
        write_claims(claims, place / "claims.json")
        tables = [(own, own.table(results.curves, results.outcomes)) for own in experiment.comparisons()]
        for comparison, table in tables:
            comparison.write(table, results.outcomes, place)
        recorded = write_subproblems([outcome.recording for outcome in results.outcomes.values()], place)
        draw(results, place)
        ended = perf_counter()
        seconds = {"training": trained - begun, "figures": ended - trained, "total": ended - begun}
        contents = {**summary(results, seconds, processes), "was_stopped": was_stopped}
        if was_stopped:  # the wall's time is that of the last part alone
            del contents["steps_per_second_of_all_processes"]
        write_summary(place / "summary.json", speed(results), contents)
        return Reproduction(results, claims, tables, seconds, recorded)


def key_of(experiment: Experiment) -> dict[str, Any]:
    """By which a checkpoint is known to be of this experiment."""
    return experiment_key(experiment.name, experiment, (*PACKAGES, *_back_ends(experiment)))


def draw(results: Results, directory: Path) -> None:
    """Every figure as PNG and SVG, every animation."""
    with paper_style():
        for name, figure in results.settings.figures(results).items():
            save_figure(figure(), directory, name)
        for name, write in results.settings.animations(results).items():
            write(directory / name)


def remarks(done: Reproduction) -> list[str]:
    """Speed, wall time, and whatever did not go by the plain rule."""
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
    """Environment steps per wall second of a process, or per "cpu_seconds", in training by CPGRL, or by all if none."""
    labels = [case.label for case in results.settings.cases() if case.by_cpgrl] or list(results.outcomes)
    outcomes = [results.outcomes[label] for label in labels]
    return float(sum(each.steps.sum() for each in outcomes) / sum(getattr(each, clock) for each in outcomes))


def summary(results: Results, seconds: Mapping[str, float], processes: int) -> dict[str, Any]:
    """What `summary.json` holds besides speed and machine."""
    settings = results.settings
    steps = sum(int(outcome.steps.sum()) for outcome in results.outcomes.values())
    return {
        "experiment": settings.name,
        "settings": asdict(settings),
        "seeds": {"seed": settings.seed, "runs": "run i draws from SeedSequence(seed, spawn_key=(i,)).spawn(2)"},
        "versions": versions((*PACKAGES, *_back_ends(settings))),
        "wall_time": {name: round(value, 3) for name, value in seconds.items()},
        "processes": processes,
        "steps_per_cpu_second": round(speed(results, "cpu_seconds")),
        "steps_per_second_of_all_processes": round(steps / seconds["training"]),
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
        "preparation_seconds": round(outcome.preparation, 3),
        "updates": runs * outcome.episode,
        "counts": outcome.counted(),
    }


def _back_ends(experiment: Experiment) -> list[str]:
    solvers = [solver_named(case.solver) for case in experiment.cases() if case.solver]
    return sorted({package for solver in solvers if (package := getattr(solver, "package", None))})


def _load() -> None:
    import scipy.optimize  # noqa: F401 - for exact optima; slow to import

    load_figures()
