"""`cpgrl reproduce arm`: training, claims, figures and comparison, and every file of the results' directory."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from .checkpoints import EVERY, Checkpoints, experiment_key, holds, require_interval
from .claims import Claim, write_claims
from .figure_style import load_figures, paper_style, save_figure
from .results_directory import results_directory
from .step_report import handing_over, in_words
from .subproblems import FILE as SUBPROBLEMS
from .subproblems import write_subproblems
from .summary import versions, write_summary
from .two_link_arm import CONDITIONS, PAPER, ArmSettings, learned_policy
from .two_link_arm_animation import write_animation
from .two_link_arm_claims import ArmEvidence, two_link_arm_claims
from .two_link_arm_comparison import compared, write_comparison
from .two_link_arm_figures import touches_figure, workspace_figure
from .two_link_arm_paths import ArmPath, arm_path, starts_beside_aversive, touched_from, typical_path, typical_run
from .two_link_arm_records import Advance, ArmResults, train_two_link_arm
from .two_link_arm_training import Outcome

FILES = (
    "learning.csv", "claims.json", "summary.json", "fig6.png", "fig6.svg", "fig7.png", "fig7.svg", "fig7.gif",
    "fig7-beside.png", "fig7-beside.svg", "compare.csv", "compare.md",
    SUBPROBLEMS,
)  # fmt: skip
_ANIMATED = 4  # episodes of the animation, from as many directions around the star
_DRAWING = 1 << 32  # spawn key of what is drawn for figures: beyond that of any run


@dataclass(frozen=True, eq=False)
class ArmReproduction:
    """Results, claims, the comparison's rows, wall seconds by part ("training", "figures", "total"), the recording."""

    results: ArmResults
    claims: Sequence[Claim]
    comparison: Sequence[Sequence[str]]
    seconds: Mapping[str, float]
    recorded: Sequence[str] = ()


def reproduce_two_link_arm(
    settings: ArmSettings,
    directory: Path,
    *,
    processes: int = 1,
    listen: Callable[[Advance], None] | None = None,
    checkpoint_every: float = EVERY,
) -> ArmReproduction:
    """Writes those of FILES that the settings ask for into the directory, as `results_directory` says.

    An earlier run's stay until these are finished. Interrupted, it leaves `learning.csv`, and `compare.csv` where
    asked for, with what was done. Stopped, killed or not, and called again, it goes on, and loses checkpoint_every
    seconds at most; the bytes of `learning.csv` and `claims.json` do not tell. Raises as `train_two_link_arm`.
    """
    require_interval(checkpoint_every)
    key = key_of(settings)
    with results_directory(directory, FILES, key) as place:
        was_stopped = holds(place, key)
        checkpoints = Checkpoints.begun(place, key, checkpoint_every)
        return _reproduce(settings, place, processes, listen, checkpoints, was_stopped=was_stopped)


def key_of(settings: ArmSettings) -> dict[str, Any]:
    """By which a checkpoint is known to be of this experiment."""
    return experiment_key("arm", settings, *_back_ends(settings))


def _reproduce(
    settings: ArmSettings,
    directory: Path,
    processes: int,
    listen: Callable[[Advance], None] | None,
    checkpoints: Checkpoints,
    *,
    was_stopped: bool,
) -> ArmReproduction:
    begun = perf_counter()
    results = train_two_link_arm(
        settings, directory, processes=processes, listen=listen, meanwhile=load_figures, checkpoints=checkpoints
    )
    trained = perf_counter()
    claims = two_link_arm_claims(evidence(results))
    write_claims(claims, directory / "claims.json")
    rows = compared(settings, results.curves, results.outcomes)
    if rows:
        write_comparison(rows, results.arm, directory / "compare.md")
    recorded = write_subproblems([outcome.recording for outcome in results.outcomes.values()], directory)
    draw(results, directory)
    ended = perf_counter()
    seconds = {"training": trained - begun, "figures": ended - trained, "total": ended - begun}
    contents = {**summary(results, seconds, processes), "was_stopped": was_stopped}
    if was_stopped:  # the wall's time is that of the last part alone
        del contents["steps_per_second_of_all_processes"]
    write_summary(directory / "summary.json", speed(results), contents)
    return ArmReproduction(results, claims, rows, seconds, recorded)


def evidence(results: ArmResults) -> ArmEvidence:
    """What the claims are judged by."""
    curves = {name: results.curves[name] for name in results.settings.conditions}
    if "b" not in curves:
        return ArmEvidence(curves)
    policies = [learned_policy(results.arm, own) for own in results.outcomes["b"].parameters]
    starts = starts_beside_aversive(results.arm)
    return ArmEvidence(curves, touched_from(results.arm, policies, starts, _rng(results, "b")))


def draw(results: ArmResults, directory: Path) -> None:
    """fig6 and fig7 as PNG and SVG, fig7 as GIF; fig7-beside holds our conditions where the paper's were trained."""
    trained = results.settings.conditions
    columns = [name for name in trained if name in PAPER] or list(trained)
    beside = [name for name in trained if name not in columns]
    with paper_style():
        save_figure(workspace_figure(results.arm), directory, "fig6")
        for name, conditions in (("fig7", columns), ("fig7-beside", beside)):
            if conditions:
                paths = {condition: _typical(results, condition) for condition in conditions}
                save_figure(touches_figure(results.curves, paths, conditions), directory, name)
        episodes = {condition: _episodes(results, condition) for condition in columns}
        write_animation(results.arm, episodes, directory / "fig7.gif")


def remarks(done: ArmReproduction) -> list[str]:
    """Speed, wall time, our additions, and whatever did not go by the plain rule."""
    results, settings = done.results, done.results.settings
    million_steps = sum(int(outcome.steps.sum()) for outcome in results.outcomes.values()) / 1e6
    lines = [
        f"{million_steps:.1f} M environment steps; CPGRL trained at {speed(results) / 1e6:.2f} M steps/s a process, "
        f"{speed(results, 'cpu_seconds') / 1e6:.2f} M per second of CPU time.",
        f"Wall time {done.seconds['total']:.1f} s: training {done.seconds['training']:.1f} s, "
        f"figures {done.seconds['figures']:.1f} s.",
        f"Safeguards, our additions: ridge = {settings.ridge:g}, max_restoration = {settings.max_restoration:g}, "
        f"drop = {settings.drop}.",
    ]
    for label, outcome in results.outcomes.items():
        counted = in_words(_totals(outcome))
        if counted:
            lines.append(f"({label}), {settings.runs * settings.episodes} updates: {counted}.")
    return [*lines, *handing_over(settings.solver, settings.step().solver, settings.formulation), *done.recorded]


def speed(results: ArmResults, clock: str = "seconds") -> float:
    """Environment steps per wall second of a process, or per "cpu_seconds", in training by CPGRL, or by all if none."""
    labels = [case.label for case in results.settings.cases() if _by_cpgrl(case.condition)] or list(results.outcomes)
    outcomes = [results.outcomes[label] for label in labels]
    return float(sum(each.steps.sum() for each in outcomes) / sum(getattr(each, clock) for each in outcomes))


def summary(results: ArmResults, seconds: Mapping[str, float], processes: int) -> dict[str, Any]:
    """What `summary.json` holds besides speed and machine."""
    settings = results.settings
    steps = sum(int(outcome.steps.sum()) for outcome in results.outcomes.values())
    return {
        "experiment": "arm",
        "settings": asdict(settings),
        "safeguards": {
            "ours": "the printed update diverges on the arm without them",
            "ridge": settings.ridge,
            "max_restoration": settings.max_restoration if np.isfinite(settings.max_restoration) else None,
            "drop": settings.drop,
        },
        "seeds": {"seed": settings.seed, "runs": "run i draws from SeedSequence(seed, spawn_key=(i,)).spawn(2)"},
        "versions": versions(*_back_ends(settings)),
        "wall_time": {name: round(value, 3) for name, value in seconds.items()},
        "processes": processes,
        "steps_per_cpu_second": round(speed(results, "cpu_seconds")),
        "steps_per_second_of_all_processes": round(steps / seconds["training"]),
        "conditions": {label: _condition(results, label) for label in results.outcomes},
    }


def _back_ends(settings: ArmSettings) -> list[str]:
    packages = {getattr(settings.step(case.solver).solver, "package", None) for case in settings.cases()}
    return sorted(package for package in packages if package)


def _condition(results: ArmResults, label: str) -> dict[str, Any]:
    case = next(case for case in results.settings.cases() if case.label == label)
    outcome, condition = results.outcomes[label], CONDITIONS[case.condition]
    return {
        "thresholds": condition.thresholds,
        "average": condition.average,
        "projected": condition.projected and condition.thresholds is not None,
        "solver": case.solver,
        "formulation": case.formulation,
        "environment_steps": int(outcome.steps.sum()),
        "training_seconds": round(outcome.seconds, 3),
        "training_cpu_seconds": round(outcome.cpu_seconds, 3),
        "steps_per_second": round(outcome.steps_per_second),
        "preparation_seconds": round(outcome.preparation, 3),
        "updates": results.settings.runs * results.settings.episodes,
        "counts": _totals(outcome, every=True),
    }


def _totals(outcome: Outcome, *, every: bool = False) -> dict[str, int]:
    """Events over all runs; "constrained", which is the rule on the arm, only with `every`."""
    return {name: int(runs.sum()) for name, runs in outcome.counts.items() if every or name != "constrained"}


def _by_cpgrl(condition: str) -> bool:
    return CONDITIONS[condition].projected and CONDITIONS[condition].thresholds is not None


def _rng(results: ArmResults, condition: str) -> np.random.Generator:
    place = list(CONDITIONS).index(condition)
    return np.random.default_rng(np.random.SeedSequence(results.settings.seed, spawn_key=(_DRAWING, place)))


def _typical(results: ArmResults, condition: str) -> ArmPath:
    run = typical_run(results.curves[condition])
    policy = learned_policy(results.arm, results.outcomes[condition].parameters[run])
    return typical_path(results.arm, policy, starts_beside_aversive(results.arm)[0], _rng(results, condition))


def _episodes(results: ArmResults, condition: str) -> list[ArmPath]:
    run = typical_run(results.curves[condition])
    policy = learned_policy(results.arm, results.outcomes[condition].parameters[run])
    starts, rng = starts_beside_aversive(results.arm), _rng(results, condition)
    return [arm_path(results.arm, policy, start, rng) for start in starts[:: len(starts) // _ANIMATED]]
