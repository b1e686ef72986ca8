"""Trainings beside each other: a CSV with a row for each run, and a table of means as Markdown."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cpgrl_opt.arrays import Float

from .bootstrap import mean_intervals, spread
from .messages import Outcome
from .tidy_csv import TidyCsv

Cells = Callable[[Float[np.ndarray, "cases R measures"], Sequence[str]], list[list[str]]]


class Measure(NamedTuple):
    """Something measured of a run: its name in the CSV, its heading in the table, the format of its mean."""

    name: str
    heading: str
    form: str


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What is compared with what.

    file: name of its CSV and Markdown; keys: what tells the trainings apart, as many words as `headings` has before
    "run" and the number of episodes, by label; measure(curves, outcome): a row of `measures` for each run; cells: means
    and their uncertainty in words; notes: of a training's outcome, more columns.
    """

    file: str
    title: str
    legend: str
    headings: Sequence[str]
    keys: Mapping[str, Sequence[str]]
    measures: Sequence[Measure]
    measure: Callable[[Any, Outcome], Float[np.ndarray, "R measures"]]
    cells: Cells
    notes: Callable[[Outcome], Mapping[str, str]] = lambda _: {}

    def csv(self, directory: Path) -> TidyCsv:
        """Its CSV, to be filled as trainings end."""
        columns = [*self.headings, *(measure.name for measure in self.measures)]
        return TidyCsv(directory / f"{self.file}.csv", columns, [",".join(words) for words in self.keys.values()])

    def rows(self, curves: Any, outcome: Outcome) -> list[list[Any]]:
        """Of finished runs for the CSV, where several words travel in the first column."""
        measured = self.measure(curves, outcome)
        key = ",".join(self.keys[outcome.label])
        return [[key, run, outcome.episode, *map(float, row)] for run, row in zip(outcome.runs, measured, strict=True)]

    def table(self, curves: Mapping[str, Any], outcomes: Mapping[str, Outcome]) -> list[list[str]]:
        """Headings, then a row for each training."""
        values = np.stack([self.measure(curves[label], outcomes[label]) for label in self.keys])
        notes = [self.notes(outcomes[label]) for label in self.keys]
        cells = self.cells(values, [measure.form for measure in self.measures])
        head = [*self.headings[:-2], *(measure.heading for measure in self.measures), *notes[0]]
        rows = zip(self.keys.values(), cells, notes, strict=True)
        return [head, *([*(word or "–" for word in key), *own, *more.values()] for key, own, more in rows)]

    def write(self, curves: Mapping[str, Any], outcomes: Mapping[str, Outcome], directory: Path) -> None:
        """The table as Markdown."""
        head, *rows = self.table(curves, outcomes)
        lines = [f"# {self.title}", "", self.legend, ""]
        lines += [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]
        (directory / f"{self.file}.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def with_spread(values: Float[np.ndarray, "cases R measures"], forms: Sequence[str]) -> list[list[str]]:
    """Mean ± standard deviation over the runs.

    Parameters
    ----------
    values
        (cases, R, measures): of R runs.
    forms
        Of the numbers, one a measure.

    Returns
    -------
    list of list of str
        A row for each case.
    """
    means, deviations = values.mean(axis=1), np.array([spread(own) for own in values])
    return [
        [f"{mean:{form}} ± {deviation:{form}}" for mean, deviation, form in zip(*row, forms, strict=True)]
        for row in zip(means, deviations, strict=True)
    ]


def with_intervals(seed: int) -> Cells:
    """Mean [its 95 % bootstrap interval], by the same resampled runs for every training.

    Parameters
    ----------
    seed
        Of the resampling.

    Returns
    -------
    Cells
        A function like `with_spread`.
    """

    def cells(values: Float[np.ndarray, "cases R measures"], forms: Sequence[str]) -> list[list[str]]:
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1 << 32,)))
        return [
            [f"{mean:{form}} [{low:{form}}, {high:{form}}]" for mean, low, high, form in zip(*row, forms, strict=True)]
            for row in mean_intervals(values, rng)
        ]

    return cells
