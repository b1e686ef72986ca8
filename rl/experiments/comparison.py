"""Trainings beside each other: a CSV with a row for each run, and a table of means, as Markdown and for a terminal."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from cpgrl_opt.arrays import Float

from .bootstrap import mean_intervals, spread
from .json_file import write_json
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
    and their uncertainty in words; notes: of a training's outcome, more columns; details: what a JSON beside it holds.
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
    details: Callable[[Mapping[str, Outcome]], Mapping[str, Any]] | None = None

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

    def write(self, table: Sequence[Sequence[str]], outcomes: Mapping[str, Outcome], directory: Path) -> None:
        """Markdown, and JSON if there are details."""
        lines = [f"# {self.title}", "", self.legend, ""]
        lines += [f"| {' | '.join(row)} |" for row in (table[0], ["---"] * len(table[0]), *table[1:])]
        (directory / f"{self.file}.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
        if self.details is not None:
            write_json(directory / f"{self.file}.json", self.details(outcomes))

    def show(self, table: Sequence[Sequence[str]]) -> None:
        """The means on the terminal, trainings as columns where they are fewer than what is measured."""
        words = len(self.headings) - 2
        width = words + len(self.measures)
        head, *rows = [[cell.split(" ± ")[0].split(" [")[0] for cell in row[:width]] for row in table]
        shown = Table(box=SIMPLE_HEAD, padding=(0, 1), pad_edge=False, collapse_padding=True)
        shown.title, shown.title_justify = self.title, "left"
        if len(rows) < len(self.measures):
            telling = next(k for k in range(1, words + 1) if len({tuple(row[:k]) for row in rows}) == len(rows))
            columns = ["", *("\n".join(row[:telling]) for row in rows)]
            rows, words = [list(cells) for cells in zip(head, *rows, strict=True)][words:], 1
        else:
            columns = head
        for position, heading in enumerate(columns):
            is_key = position < words
            shown.add_column(heading, justify="left" if is_key else "right", no_wrap="\n" in heading)
        for row in rows:
            shown.add_row(*row)
        console = Console()
        console.print(shown)
        console.print(f"{self.legend} Here means alone.")


def with_spread(values: Float[np.ndarray, "cases R measures"], forms: Sequence[str]) -> list[list[str]]:
    """Mean ± standard deviation over the runs."""
    means, deviations = values.mean(axis=1), np.array([spread(own) for own in values])
    return [
        [f"{mean:{form}} ± {deviation:{form}}" for mean, deviation, form in zip(*row, forms, strict=True)]
        for row in zip(means, deviations, strict=True)
    ]


def with_intervals(seed: int) -> Cells:
    """Mean [its 95 % bootstrap interval], by the same resampled runs for every training."""

    def cells(values: Float[np.ndarray, "cases R measures"], forms: Sequence[str]) -> list[list[str]]:
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1 << 32,)))
        return [
            [f"{mean:{form}} [{low:{form}}, {high:{form}}]" for mean, low, high, form in zip(*row, forms, strict=True)]
            for row in mean_intervals(values, rng)
        ]

    return cells
