"""`summary.json`: with what a result was made, by what, on what, and how long it took."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cpgrl_opt.comparison.machine import machine

from .json_file import write_json

PACKAGES = ("cpgrl-opt", "numpy", "scipy", "numba", "gymnasium", "matplotlib")  # that every experiment stands on


def write_summary(path: Path, steps_per_second: float, contents: Mapping[str, Any]) -> None:
    """The file; `steps_per_second`, environment steps per wall second of CPGRL's training, leads it."""
    speed = {"steps_per_second": round(steps_per_second)}
    write_json(path, {**speed, **contents, "machine": machine(), "command": ["cpgrl", *sys.argv[1:]]})
