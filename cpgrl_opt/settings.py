"""Settings of solvers, checked on construction."""

from typing import Any

import numpy as np

from .validation import is_number, require_count, require_positive

LARGEST_TOLERANCE = 1e-3  # residuals are relative: at 1, d = g with μ = 0 passes for an optimum everywhere


class CheckedSettings:
    """Base of a frozen dataclass of settings: those named here are checked, ValueError where one is wrong."""

    def __post_init__(self) -> None:
        settings: Any = self
        if hasattr(self, "tolerance"):
            require_tolerance(settings.tolerance)
        for name in ("polish", "raw_multipliers"):
            if not isinstance(getattr(self, name, True), bool | np.bool_):
                raise ValueError(f"{name} should be True or False; found {getattr(self, name)!r}")
        for name in ("time_limit", "rho"):
            require_positive(name, getattr(self, name, 1.0))
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):  # of no axes, checked above: a number that no caller can change
                object.__setattr__(self, name, value[()])
        if (limit := getattr(self, "iteration_limit", None)) is not None:
            require_count("iteration_limit", limit)


def require_tolerance(tolerance: Any) -> None:
    """ValueError unless it is a number in (0, 1e-3]."""
    if not is_number(tolerance) or not 0 < tolerance <= LARGEST_TOLERANCE:
        raise ValueError(f"tolerance should be a number in (0, {LARGEST_TOLERANCE:g}]; found {tolerance!r}")
