"""`cpgrl reproduce three-state`: training, claims and figures, and every file of the results' directory."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from envs import ThreeStateMDP

from .checkpoints import EVERY, Checkpoints, experiment_key, holds, require_interval
from .claims import Claim, write_claims
from .figure_style import load_figures, paper_style, save_figure
from .learning_curves import spread
from .results_directory import results_directory
from .step_report import handing_over, in_words
from .subproblems import FILE as SUBPROBLEMS
from .subproblems import write_subproblems
from .summary import versions, write_summary
from .three_state import METHODS, Listener, ThreeStateResults, ThreeStateSettings, train_three_state
from .three_state_claims import three_state_claims
from .three_state_comparison import ComparisonSettings, Progress, compare_three_state
from .three_state_comparison_results import FILES as COMPARISON
from .three_state_comparison_results import print_comparison, write_comparison
from .three_state_evidence import Evidence
from .three_state_figures import averages_figure, policies_figure

FILES = (
    "learning.csv",
    "claims.json",
    "summary.json",
    "fig4.png",
    "fig4.svg",
    "fig5.png",
    "fig5.svg",
    SUBPROBLEMS,
    *COMPARISON,
)


@dataclass(frozen=True)
class Reproduction:
    """Results, claims, wall seconds by part ("training", "figures", "total"), and what was recorded, in words."""

    results: ThreeStateResults
    claims: Sequence[Claim]
    seconds: Mapping[str, float]
    recorded: Sequence[str] = ()


def reproduce_three_state(
    settings: ThreeStateSettings,
    directory: Path,
    *,
    processes: int = 1,
    listen: Listener | None = None,
    checkpoint_every: float = EVERY,
) -> Reproduction:
    """Writes FILES into the directory as `results_directory` says: an earlier run's stay until these are finished.

    Direction problems are written only if settings.record > 0. Interrupted, it leaves `learning.csv` with what was
    recorded. Stopped, killed or not, and called again, it goes on, and loses checkpoint_every seconds at most; the
    bytes of `learning.csv` and `claims.json` do not tell. Raises as `train_three_state`.
    """
    require_interval(checkpoint_every)
    key = key_of(settings)
    with results_directory(directory, FILES, key) as place:
        was_stopped = holds(place, key)
        checkpoints = Checkpoints.begun(place, key, checkpoint_every)
        return _reproduce(settings, place, processes, listen, checkpoints, was_stopped=was_stopped)


def key_of(settings: ThreeStateSettings) -> dict[str, Any]:
    """By which a checkpoint is known to be of this experiment."""
    return experiment_key("three-state", settings, *_back_end(settings))


def _reproduce(
    settings: ThreeStateSettings,
    directory: Path,
    processes: int,
    listen: Listener | None,
    checkpoints: Checkpoints,
    *,
    was_stopped: bool,
) -> Reproduction:
    begun = perf_counter()
    results = train_three_state(
        settings, directory / "learning.csv", processes=processes, listen=listen, meanwhile=_load,
        checkpoints=checkpoints,
    )  # fmt: skip
    trained = perf_counter()
    claims = three_state_claims(evidence(results))
    write_claims(claims, directory / "claims.json")
    recorded = write_subproblems([outcome.recording for outcome in results.outcomes.values()], directory)
    draw(results, directory)
    ended = perf_counter()
    seconds = {"training": trained - begun, "figures": ended - trained, "total": ended - begun}
    write_summary(
        directory / "summary.json",
        results.outcomes["cpgrl"].steps_per_second,
        {**summary(results, seconds, processes), "was_stopped": was_stopped},
    )
    return Reproduction(results, claims, seconds, recorded)


def compare_in(
    directory: Path, settings: ComparisonSettings, *, processes: int = 1, listen: Callable[[Progress], None]
) -> None:
    """The comparison, into its files and onto the terminal."""
    outcomes = compare_three_state(settings, processes=processes, listen=listen)
    print_comparison(settings, write_comparison(settings, outcomes, directory))


def _load() -> None:
    import scipy.optimize  # noqa: F401 - for the linear programme; slow to import

    load_figures()


def evidence(results: ThreeStateResults) -> Evidence:
    """What the claims are judged by."""
    updates = results.settings.runs * results.settings.episodes
    return Evidence(
        results.curves,
        results.optimum.values,
        np.array(results.settings.thresholds),
        results.outcomes["conb"].counts["objective"] / updates,
    )


def draw(results: ThreeStateResults, directory: Path) -> None:
    """fig4 and fig5 as PNG and SVG."""
    thresholds = np.array(results.settings.thresholds)
    figures: dict[str, Callable[[], Any]] = {
        "fig4": lambda: averages_figure(results.curves, results.optimum.values, thresholds),
        "fig5": lambda: policies_figure(results.curves, ThreeStateMDP()),
    }
    for name, figure in figures.items():
        with paper_style():
            save_figure(figure(), directory, name)


def remarks(done: Reproduction) -> list[str]:
    """Speed, wall time, and whatever did not go by the plain rule."""
    outcomes, settings = done.results.outcomes, done.results.settings
    million_steps = sum(outcome.steps for outcome in outcomes.values()) / 1e6
    lines = [
        f"{million_steps:.1f} M environment steps; CPGRL trained at "
        f"{outcomes['cpgrl'].steps_per_second / 1e6:.1f} M steps/s. Wall time {done.seconds['total']:.1f} s: "
        f"training {done.seconds['training']:.1f} s, figures {done.seconds['figures']:.1f} s."
    ]
    counted = in_words(outcomes["cpgrl"].counts)
    if counted:
        lines.append(f"In {settings.runs * settings.episodes} updates of CPGRL: {counted}.")
    lines += handing_over(settings.solver, settings.step().solver, settings.formulation)
    lines += done.recorded
    return lines


def summary(results: ThreeStateResults, seconds: Mapping[str, float], processes: int) -> dict[str, Any]:
    """What `summary.json` holds besides speed and machine."""
    settings = results.settings
    return {
        "experiment": "three-state",
        "settings": asdict(settings),
        "seeds": {"seed": settings.seed, "runs": "run i draws from SeedSequence(seed, spawn_key=(i,)).spawn(2)"},
        "versions": versions(*_back_end(settings)),
        "wall_time": {name: round(value, 3) for name, value in seconds.items()},
        "processes": processes,
        "methods": {method: _method(results, method) for method in METHODS},
        "optimum": {
            "values": results.optimum.values.tolist(),
            "policy": results.optimum.policy.tolist(),
            "multipliers": results.optimum.multipliers.tolist(),
        },
    }


def _method(results: ThreeStateResults, method: str) -> dict[str, Any]:
    outcome, curves = results.outcomes[method], results.curves[method]
    return {
        "environment_steps": outcome.steps,
        "training_seconds": round(outcome.seconds, 3),
        "steps_per_second": round(outcome.steps_per_second),
        "preparation_seconds": round(outcome.preparation, 3),
        "updates": results.settings.runs * results.settings.episodes,
        "counts": dict(outcome.counts),
        "final": {
            "mean": curves.exact[:, -1].mean(axis=0).tolist(),
            "standard_deviation": spread(curves.exact[:, -1]).tolist(),
            "policy": curves.policies[:, -1].mean(axis=0).tolist(),
        },
    }


def _back_end(settings: ThreeStateSettings) -> list[str]:
    package = getattr(settings.step().solver, "package", None)
    return [package] if package else []
