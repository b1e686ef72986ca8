"""JSON files among the results: readable, whole or not at all."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cpgrl_opt.comparison.machine import machine
from cpgrl_opt.comparison.whole_file import whole_file


def write_json(path: Path, contents: Any) -> None:
    """ValueError for what JSON does not have, NaN and infinities among it.

    Parameters
    ----------
    path
        Of the file.
    contents
        Lists, dicts, texts, numbers.

    Raises
    ------
    ValueError
        For what JSON does not have, NaN and infinities among it.
    """
    text = json.dumps(contents, indent=2, ensure_ascii=False, allow_nan=False)
    # In a command: a file name that the locale cannot read goes into the file as the bytes that it is.
    with whole_file(path) as beside:
        beside.write_text(text + "\n", encoding="utf-8", errors="surrogateescape")


def write_summary(path: Path, steps_per_second: float, contents: Mapping[str, Any]) -> None:
    """`summary.json`: by what, on what and how fast a result was made.

    Parameters
    ----------
    path
        Of the file.
    steps_per_second
        Environment steps per wall second of CPGRL's training, which leads it.
    contents
        What else it holds.
    """
    speed = {"steps_per_second": round(steps_per_second)}
    write_json(path, {**speed, **contents, "machine": machine(), "command": ["cpgrl", *sys.argv[1:]]})
