"""What benchmarks write: a page of Markdown, and its rows as CSV."""

import csv
import platform
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np


def table(heads: str, line: str, rows: Iterable[Any]) -> str:
    """A table of Markdown: its heads, and a line for each row, as `str.format` has it; numbers to the right."""
    rulers = "|".join("--:" if ":" in cell else "---" for cell in line.split("|")[1:-1])
    return "\n".join([heads, f"|{rulers}|", *(line.format(row) for row in rows)])


def machine() -> str:
    """What a page says it was measured on."""
    import numba

    versions = f"Python {platform.python_version()}, NumPy {np.__version__}, numba {numba.__version__}"
    return f"{platform.machine()} {platform.system()}; {versions}"


def write(name: str, page: str, rows: Sequence[Any], folder: Path | None) -> None:
    """name.md and name.csv, a line for each row, a dataclass; nothing without a folder."""
    if folder is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.md").write_text(page, encoding="utf-8")
    with (folder / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(asdict(rows[0])), lineterminator="\n")
        writer.writeheader()
        writer.writerows(map(asdict, rows))
