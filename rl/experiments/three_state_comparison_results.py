"""What `--compare` found: measures of every run with bootstrap intervals, as CSV, as a table and in words."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from cpgrl_opt import Status
from cpgrl_opt.arrays import Float
from envs import ThreeStateMDP

from .bootstrap import mean_intervals
from .summary import machine, versions
from .three_state_comparison import CaseOutcome, ComparisonSettings

FILES = ("comparison.csv", "comparison.md", "comparison.json")
# Of one run: name in the CSV, heading of the table, format of its mean.
MEASURES = (
    ("feasible_from", "feasible from", ".0f"),
    ("cumulative_violation", "cumulative violation", ".2f"),
    ("common_return", "ρ¹", ".3f"),
    ("common_constrained_return", "constrained return", ".3f"),
    ("final_return", "final ρ¹", ".4f"),
    ("final_constrained_return", "final constrained return", ".4f"),
    ("uncertified", "uncertified steps", ".1f"),
)


def measured(
    settings: ComparisonSettings, outcome: CaseOutcome, multipliers: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "R measures"]:
    """A row for each run, of MEASURES.

    feasible_from: the updates after which the violation v = max_i (Gⁱ − ρⁱ)₊ stays ≤ tolerance to the common end, and
    common + 1 where it does not; cumulative_violation: Σ v over the common updates; constrained return: the exact
    penalty ρ¹ − Σ μⁱ(Gⁱ − ρⁱ)₊ with the optimum's multipliers, which no policy can bring above the constrained optimum.
    """
    thresholds = np.array(settings.training.thresholds)
    below = np.maximum(thresholds - outcome.exact[:, :, 1:], 0.0)
    violation = below.max(axis=2, initial=0.0)
    broken = violation > settings.tolerance
    feasible_from = broken.shape[1] - np.argmax(broken[:, ::-1], axis=1)
    feasible_from = np.where(broken.any(axis=1), feasible_from, 0)

    def constrained(averages: Float[np.ndarray, "R channels"]) -> Float[np.ndarray, "R"]:
        penalty = np.maximum(thresholds - averages[:, 1:], 0.0) @ multipliers
        return np.asarray(averages[:, 0] - penalty)

    common = outcome.exact[:, -1]
    columns = [
        feasible_from,
        violation[:, 1:].sum(axis=1),
        common[:, 0],
        constrained(common),
        outcome.last[:, 0],
        constrained(outcome.last),
        outcome.uncertified,
    ]
    return np.asarray(np.column_stack(columns), dtype=np.float64)


def write_comparison(settings: ComparisonSettings, outcomes: Sequence[CaseOutcome], directory: Path) -> list[list[str]]:
    """FILES: a row for each run of each case, the table, what else is known of the cases. The table, heading first."""
    multipliers = ThreeStateMDP().constrained_optimum(settings.training.thresholds).multipliers
    values = [measured(settings, outcome, multipliers) for outcome in outcomes]
    names = ["formulation", "drop", "solver", "run", "episodes", *(name for name, _, _ in MEASURES)]
    lines = [",".join(names)]
    for outcome, rows in zip(outcomes, values, strict=True):
        case = outcome.case
        for run, row in enumerate(rows):
            cells = (case.formulation, case.drop, case.solver, run, case.episodes, *(f"{value:.9g}" for value in row))
            lines.append(",".join(map(str, cells)))
    (directory / "comparison.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    table = comparison_table(settings, outcomes, values)
    text = ["# CPGRL on the three-state MDP by solver, formulation and drop rule\n"]
    text += [
        "`cpgrl reproduce three-state --compare`; its options are in `comparison.json`.\n",
        f"{legend(settings)}\n",
    ]
    text += [f"| {' | '.join(row)} |" for row in (table[0], ["---"] * len(table[0]), *table[1:])]
    (directory / "comparison.md").write_text("\n".join(text) + "\n", encoding="utf-8")
    contents = json.dumps(comparison_summary(settings, outcomes), indent=2, ensure_ascii=False, allow_nan=False)
    (directory / "comparison.json").write_text(contents + "\n", encoding="utf-8")
    return table


def comparison_table(
    settings: ComparisonSettings, outcomes: Sequence[CaseOutcome], values: Sequence[Float[np.ndarray, "R measures"]]
) -> list[list[str]]:
    """A heading and a row for each case: means with 95 % bootstrap intervals, statuses, CPU time."""
    rng = np.random.default_rng(np.random.SeedSequence(settings.training.seed, spawn_key=(1 << 32,)))
    intervals = mean_intervals(np.stack(values), rng)  # the same resampled runs for every case
    rows = [["formulation", "drop", "solver", "updates", *(heading for _, heading, _ in MEASURES), "statuses", "ms"]]
    for outcome, (means, lows, highs) in zip(outcomes, intervals, strict=True):
        case = outcome.case
        cells = [
            f"{mean:{form}} [{low:{form}}, {high:{form}}]"
            for mean, low, high, (_, _, form) in zip(means, lows, highs, MEASURES, strict=True)
        ]
        statuses = ", ".join(f"{outcome.statuses[name]} {name}" for name in _statuses(outcome))
        timed = f"{1e3 * outcome.update_seconds:.2f}"
        rows.append([case.formulation, case.drop or "–", case.solver, str(case.episodes), *cells, statuses, timed])
    return rows


def legend(settings: ComparisonSettings) -> str:
    """What the table's columns mean."""
    runs, common = settings.training.runs, settings.common
    return (
        f"Means over {runs} runs with 95 % bootstrap intervals; run i has the same θ₀ and random stream in every case. "
        f"Over the first {common} updates, which every case has: feasible from: updates after which max (G − ρ)₊ stays "
        f"≤ {settings.tolerance:g} ({common + 1} where it does not); cumulative violation: Σ max (G − ρ)₊, in reward "
        f"per step × updates; ρ¹ and constrained return after update {common}. Final: after the case's own last "
        "update; cases whose solver is not compiled have fewer updates. All averages are exact. Constrained return: "
        "ρ¹ − Σ μ(G − ρ)₊ with the optimum's multipliers μ, at most the constrained optimum. Uncertified steps: "
        "updates of a run in which an answer came without certificate and active-set took over. Statuses: of the "
        "solver's own answers to problems with an active constraint. ms: CPU of an update of all runs."
    )


def _statuses(outcome: CaseOutcome) -> list[str]:
    return [status.name for status in Status if outcome.statuses.get(status.name)]


def comparison_summary(settings: ComparisonSettings, outcomes: Sequence[CaseOutcome]) -> dict[str, Any]:
    """Settings and versions; each case's statuses and times."""
    return {
        "settings": asdict(settings),
        "common_updates": settings.common,
        "versions": versions("qpsolvers", "osqp", "daqp"),
        "machine": machine(),
        "cases": [
            {
                "formulation": outcome.case.formulation,
                "drop": outcome.case.drop or None,
                "solver": outcome.case.solver,
                "updates": outcome.case.episodes,
                "statuses": dict(outcome.statuses),
                "seconds_per_update": outcome.update_seconds,
                "training_seconds": round(outcome.seconds, 3),
            }
            for outcome in outcomes
        ],
    }


def print_comparison(settings: ComparisonSettings, table: Sequence[Sequence[str]]) -> None:
    """The means, which fit a terminal; the intervals are in the files."""
    console = Console()
    printed = Table(box=SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
    printed.title, printed.title_justify = "Solvers and formulations compared, means over the runs", "left"
    kept = [column for column, heading in enumerate(table[0]) if heading != "statuses"]
    for column in kept:
        printed.add_column(table[0][column], justify="left" if column < 3 else "right")
    for row in table[1:]:
        printed.add_row(*(row[column].split(" [")[0] for column in kept))
    console.print(printed)
    console.print(legend(settings).replace(" with 95 % bootstrap intervals", ""))
