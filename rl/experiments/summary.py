"""`summary.json`: with what a result was made, by what, on what, and how long it took."""

import json
import os
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

_PACKAGES = ("cpgrl-opt", "numpy", "scipy", "numba", "gymnasium", "matplotlib")
_CPUINFO = Path("/proc/cpuinfo")


def versions(*packages: str) -> dict[str, str]:
    """Versions of Python, of what every experiment uses, and of these packages where they are installed."""
    found = {"python": platform.python_version()}
    for package in (*_PACKAGES, *packages):
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # an optional one, or the project run from a bare checkout
            found[package] = "not installed"
    return found


def machine() -> dict[str, Any]:
    """Operating system, architecture, processor and cores; nothing that names this one machine."""
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "processor": _processor(),
        "cores": os.cpu_count(),
    }


def _processor() -> str:
    """The processor's model where the system tells it, else what Python knows, else its architecture."""
    try:
        lines = _CPUINFO.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # not Linux
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(iter(models), platform.processor() or platform.machine())


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
