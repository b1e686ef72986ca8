"""The main table on a terminal: one line per solver, prepared beside raw."""

import math
from collections.abc import Iterable, Sequence

from .measurement import Cell


def print_summary(cells: Sequence[Cell]) -> None:
    """Success, silently wrong (`wrong`), and time of each solver over all families, behind the preparation and raw."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title="prepared | raw: the library alone, on small problems")
    table.add_column("solver", no_wrap=True)
    for variant in ("prepared", "raw"):
        for column in ("success", "wrong", "time ×"):
            table.add_column(f"{column}\n{variant}", justify="right")
    for solver in dict.fromkeys(cell.solver for cell in cells):
        row: list[str] = []
        for variant in ("prepared", "raw"):
            row += summary_row([cell for cell in cells if (cell.solver, cell.variant) == (solver, variant)])
        table.add_row(f"[bold]{escape(solver)}[/bold]", *row)
    Console().print(table)


def summary_row(cells: Iterable[Cell]) -> tuple[str, str, str]:
    """Percentages of the problems that are taken, and the geometric mean time ratio; dashes where there are none."""
    taken = [(cell, cell.problems - cell.unsupported) for cell in cells if cell.problems > cell.unsupported]
    total = sum(count for _, count in taken)
    if total == 0:
        return "–", "–", "–"
    success = 100 * sum(cell.success for cell, _ in taken) / total
    wrong = 100 * sum(cell.silently_wrong for cell, _ in taken) / total
    logs = sum(count * math.log(cell.time_ratio) for cell, count in taken if cell.time_ratio)
    return f"{success:.1f} %", f"{wrong:.1f} %", f"{math.exp(logs / total):.3g}"
