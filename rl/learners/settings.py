"""Settings that learners share: thresholds and step size, checked once."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpgrl_opt.validation import real_values, require_nonnegative


def threshold_vector(thresholds: ArrayLike) -> NDArray[np.float64]:
    """A read-only copy of Gⁱ, (m,); ValueError for another shape, NaN, infinities."""
    vector = real_values("thresholds", thresholds).copy()
    if vector.ndim != 1 or not np.isfinite(vector).all():
        raise ValueError(f"thresholds should be finite numbers, (m,); found {vector.tolist()}")
    vector.flags.writeable = False
    return vector


def require_step_size(step_size: float) -> float:
    """ValueError unless α₁ is a finite number ≥ 0."""
    require_nonnegative("step_size", step_size)
    return float(step_size)
