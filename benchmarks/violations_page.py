"""The page of `violations_on_the_way.py`: medians over the runs and their intervals."""

from collections.abc import Mapping, Sequence
from math import comb
from typing import Any

import numpy as np


def median_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """The median, and order statistics x₍ₖ₎, x₍N+1−k₎ between which the true one lies with at least 95 % chance.

    P(x₍ₖ₎ ≤ median ≤ x₍N+1−k₎) = 1 − 2 Σ_{j<k} C(N, j)/2ᴺ, whatever the distribution. Below six runs even all of them
    are not enough, and these are taken.
    """
    ordered, count, below, k = np.sort(values), len(values), 0, 0
    while k < count and 2 * (below + comb(count, k)) <= 0.05 * 2**count:
        below += comb(count, k)
        k += 1
    first = max(k, 1) - 1
    return float(np.median(ordered)), float(ordered[first]), float(ordered[count - 1 - first])


# of a Row: name, heading, digits, unit
_COLUMNS = (
    ("violated", "violated, %", 1, 100),
    ("noticed", "by > 1 %, %", 1, 100),
    ("violated_late", "second half, %", 1, 100),
    ("largest", "largest, %", 1, 100),
    ("mean", "mean, %", 3, 100),
    ("returned", "return", 3, 1),
    ("infeasible", "infeasible", 1, 1),
)


def table(rows: Sequence[Any]) -> list[str]:
    """Lines of Markdown: a line for each task and method, medians with their intervals."""
    titles = ["task", "method", *(title for _, title, _, _ in _COLUMNS)]
    lines = [f"| {' | '.join(titles)} |", "|---|---|" + "---|" * len(_COLUMNS)]
    for name, method in dict.fromkeys((row.task, row.method) for row in rows):
        runs = [row for row in rows if (row.task, row.method) == (name, method)]
        cells = [cell([unit * getattr(run, column) for run in runs], digits) for column, _, digits, unit in _COLUMNS]
        lines.append(f"| {name} | {method} | {' | '.join(cells)} |")
    return lines


def cell(values: Sequence[float], digits: int) -> str:
    """Median (low … high)."""
    middle, low, high = (f"{value:.{digits}f}" for value in median_interval(values))
    return f"{middle} ({low} … {high})"


def page(rows: Sequence[Any], learned: Mapping[str, Any], options: str) -> str:
    """The table and what its numbers are."""
    lines = [
        "# Violations on the way",
        "",
        f"Made by `python benchmarks/violations_on_the_way.py {options}`, seed 0.",
        "Medians over the runs, and intervals that hold the true median with at least 95 % chance (order statistics).",
        "",
        "- violated: share of updates after which a constraint is violated; by > 1 %: by more than 1 % of its "
        "threshold; second half: of training",
        "- largest, mean: violation of the worst constraint over all updates, 0 where all are met, in % of its "
        "threshold",
        "- return: ρ¹ in the last twentieth, on the gridworld over that of the best feasible policy",
        "- infeasible: updates of a run in which nothing meets the linearized constraints",
        "",
        *table(rows),
        "",
    ]
    for name, task in learned.items():
        rates = ", ".join(f"{key} {value:g}" for key, value in task.rates.items())
        best = "" if task.best is None else f", best ρ¹ {task.best:.4f}"
        lines.append(f"- {name}: {task.title}; {task.updates} updates, thresholds {task.thresholds}, {rates}{best}")
    return "\n".join([*lines, "", "![Slack and return against updates](violations_on_the_way.png)", ""])
