"""`summary.json`: with what a result was made, by what, on what, and how long it took."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cpgrl_opt.comparison.machine import machine

PACKAGES = ("cpgrl-opt", "numpy", "scipy", "numba", "gymnasium", "matplotlib")  # that every experiment stands on


def write_summary(path: Path, steps_per_second: float, contents: Mapping[str, Any]) -> None:
    """The file; `steps_per_second`, environment steps per wall second of CPGRL's training, leads it."""
    summary = {
        "steps_per_second": round(steps_per_second),
        **contents,
        "machine": machine(),
        "command": ["cpgrl", *sys.argv[1:]],
    }
    text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
    # In the command: a file name that the locale cannot read goes into the file as the bytes that it is.
    path.write_text(text + "\n", encoding="utf-8", errors="surrogateescape")
