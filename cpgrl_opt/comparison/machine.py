"""What a result was made on, without a name of the one machine, and with what."""

import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_CPUINFO = Path("/proc/cpuinfo")


def machine() -> dict[str, object]:
    """Operating system, architecture, processor and cores."""
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
    }


def versions(packages: Iterable[str]) -> dict[str, str]:
    """Of Python and of each package."""
    return {"python": platform.python_version()} | {package: version_of(package) for package in packages}


def version_of(package: str) -> str:
    """The version of a package where it has one."""
    try:
        return version(package)
    except PackageNotFoundError:  # an optional one, a bare checkout, someone's own module
        return "no version known"


def _processor() -> str:
    """The processor's model where the system tells it, else what Python knows, else its architecture."""
    try:
        lines = _CPUINFO.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # not Linux
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()  # which may start a process
