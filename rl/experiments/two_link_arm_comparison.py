"""`--compare`: the same training under each formulation; what is touched, how r² is kept, what acted and failed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from cpgrl_opt.arrays import Float
from envs import TwoLinkArm

from .learning_curves import spread
from .tidy_csv import TidyCsv
from .two_link_arm import ArmSettings, Case
from .two_link_arm_curves import TouchCurves
from .two_link_arm_training import Outcome

# Measurements of one run, beside its touches per 100 of the last episodes: name, heading, format.
_MEASURES = (
    ("early_violation", "outside, first", ".4f"),
    ("violation", "outside, last", ".4f"),
    ("length", "steps", ".1f"),
    ("constrained", "constrained", ".3f"),
    ("capped", "shortened", ".3f"),
    ("infeasible", "infeasible", ".3f"),
    ("uncertified", "uncertified", ".3g"),
)
_LEGEND = (
    "Mean ± standard deviation over the runs. Touches per 100 of the last episodes by object, time-outs under none. "
    "Outside: share of steps outside the box of r², in the first and in the last episodes. Steps: mean length of the "
    "last episodes. Per update: constrained (a constraint is active, and the ridge acts; under linearized, which has "
    "none, a constraint has a multiplier), restorations shortened, subproblems without a solution (least violation "
    "taken), answers without certificate (active-set took over, or θ stayed)."
)


def measured(curves: TouchCurves, outcome: Outcome) -> Float[np.ndarray, "R measures"]:
    """A row for each run: touches per 100 of the last episodes, then _MEASURES.

    violation: share of steps outside the box, in the first and in the last episodes; length: mean of the last ones.
    constrained, capped, infeasible, uncertified: per update, how often a constraint was active, the restoration was
    shortened, a subproblem had no solution, an answer came without certificate (active-set took over, or θ stayed).
    """
    late, updates = curves.late(), outcome.episode
    counts = outcome.counts
    length = (late.length * late.sizes).sum(axis=1) / late.sizes.sum()
    shares = [counts["constrained"], counts["capped"], counts["infeasible"], counts["fallback"] + counts["skipped"]]
    columns = [curves.early().outside(), late.outside(), length, *(share / updates for share in shares)]
    return np.column_stack([late.rates(), *columns])


class ComparisonCsv:
    """`compare.csv`: condition, formulation, solver, run, episode (the last), measurements; a context."""

    def __init__(self, settings: ArmSettings, arm: TwoLinkArm, path: Path) -> None:
        self.labels = {case.label: _key(case) for case in settings.compared()}
        columns = ["condition", "formulation", "solver", "run", "episode", *headings(arm)]
        self.csv = TidyCsv(path, columns, list(self.labels.values()))

    def append(self, outcome: Outcome, curves: TouchCurves) -> None:
        """Rows of finished runs, if their training is one of those compared."""
        if outcome.label in self.labels:
            rows = zip(outcome.runs, measured(curves, outcome), strict=True)
            self.csv.append([(self.labels[outcome.label], run, outcome.episode, *map(float, row)) for run, row in rows])

    def __enter__(self) -> "ComparisonCsv":
        self.csv.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self.csv.__exit__(*error)


def headings(arm: TwoLinkArm) -> list[str]:
    """The columns of `measured`."""
    return [*arm.events, "none", *(name for name, _, _ in _MEASURES)]


def compared(
    settings: ArmSettings, curves: Mapping[str, TouchCurves], outcomes: Mapping[str, Outcome]
) -> list[list[str]]:
    """The table: a row for each case, mean ± standard deviation over the runs."""
    rows = []
    for case in settings.compared():
        values = measured(curves[case.label], outcomes[case.label])
        formats = [".1f"] * len(curves[case.label].outcomes) + [form for _, _, form in _MEASURES]
        cells = zip(values.mean(axis=0), spread(values), formats, strict=True)
        rows.append(
            [case.condition, case.formulation, case.solver, *(f"{mean:{f}} ± {sd:{f}}" for mean, sd, f in cells)]
        )
    return rows


def titles(arm: TwoLinkArm) -> list[str]:
    """Headings of the table."""
    return ["condition", "formulation", "solver", *arm.events, "none", *(title for _, title, _ in _MEASURES)]


def write_comparison(rows: Sequence[Sequence[str]], arm: TwoLinkArm, path: Path) -> None:
    """`compare.md`: the table with its legend."""
    lines = ["# The arm under each formulation", "", _LEGEND, ""]
    lines += [f"| {' | '.join(row)} |" for row in (titles(arm), ["---"] * len(titles(arm)), *rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def print_comparison(rows: Sequence[Sequence[str]], arm: TwoLinkArm) -> None:
    """The means with cases as columns, which fits a terminal."""
    table = Table("", box=SIMPLE_HEAD, padding=(0, 1), pad_edge=False, collapse_padding=True)
    table.title, table.title_justify = "Formulations compared", "left"
    for condition, formulation, *_ in rows:
        table.add_column(f"({condition})\n{formulation}", justify="right", no_wrap=True)
    for title, *cells in list(zip(titles(arm), *rows, strict=True))[3:]:
        table.add_row(title, *(cell.split(" ± ")[0] for cell in cells))
    console = Console()
    console.print(table)
    console.print(_LEGEND.replace("Mean ± standard deviation over the runs.", "Means over the runs."))


def _key(case: Case) -> str:
    # TidyCsv sorts by its first column; three columns travel in it.
    return f"{case.condition},{case.formulation},{case.solver}"
