"""The frame of a benchmark: what was typed, tables, what it was measured on, and the page and rows that it writes."""

import argparse
import csv
import math
import os
import platform
import shlex
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).with_name("results")
_BUSY = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan  # as the benchmark begins


def read_arguments(doc: str | None, out: Path | None = None, **defaults: Any) -> argparse.Namespace:
    """--name VALUE for each of these, of its default's type, a list by commas; and --out, the folder to write to.

    `name` of the answer is the benchmark's, `command` what makes its page again.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in defaults.items():
        parser.add_argument(_option(name), default=default, help=f"default: {default}", **_type_of(default))
    parser.add_argument("--out", type=Path, default=out, help="folder for the page and its rows")
    arguments, script = parser.parse_args(), Path(sys.argv[0])
    typed = ["python", f"benchmarks/{script.name}"]
    for name, default in defaults.items():
        if (value := getattr(arguments, name)) != default:
            text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
            typed += [_option(name), *([] if value is True else [text])]
    arguments.name, arguments.command = script.stem, shlex.join(typed)
    arguments.refuse = parser.error
    return arguments


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _type_of(default: Any) -> dict[str, Any]:
    if isinstance(default, bool):
        return {"action": "store_true"}
    if isinstance(default, list):
        each = _whole if default and isinstance(default[0], int) else str
        return {"type": lambda text: [each(part) for part in text.split(",") if part]}
    return {"type": type(default)}


def _whole(text: str) -> int:
    return int(float(text))  # 1e6


def table(heads: str, line: str, rows: Iterable[Any]) -> str:
    """A table of Markdown: its heads, and a line for each row, as `str.format` has it; numbers to the right."""
    rulers = "|".join("--:" if ":" in cell else "---" for cell in line.split("|")[1:-1])
    return "\n".join([heads, f"|{rulers}|", *(line.format(row) for row in rows)])


def verdict(ratio: float, bar: float) -> str:
    """Of a ratio that should be at most its bar; nothing where the bar is NaN."""
    return "" if math.isnan(bar) else "kept" if ratio <= bar else "missed"


def machine(*packages: str) -> str:
    """What a page says it was measured on."""
    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba", *packages))
    where = f"{os.cpu_count()} cores, {platform.machine()} {platform.system()}, {_BUSY:.1f} processes busy at the start"
    return f"{where}; Python {platform.python_version()}, {versions}"


def publish(arguments: argparse.Namespace, title: str, parts: Sequence[str], rows: Sequence[Any]) -> None:
    """Prints the page: title, parts, command; with --out writes NAME.md, and NAME.csv, a line a row, a dataclass."""
    command = (
        f"Command: `{arguments.command} --out benchmarks/results`; what is measured, and limitations, at its head."
    )
    page = "\n\n".join([f"# {title}", *parts, command]) + "\n"
    print(page)
    if arguments.out is None:
        return
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / f"{arguments.name}.md").write_text(page, encoding="utf-8")
    with (arguments.out / f"{arguments.name}.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, [each.name for each in fields(rows[0])], lineterminator="\n")
        writer.writeheader()
        writer.writerows(map(asdict, rows))
