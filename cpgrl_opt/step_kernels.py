"""Compiled filling of arrays around a step: twenty runs of nine parameters are too small for NumPy's calls.

Arrays are C-contiguous; every output is passed in.
"""

from functools import partial
from typing import Any

import numpy as np

from .machine_code import CompiledLate

_MATRIX, _CUBE, _MASK = "float64[:, ::1]", "float64[:, :, ::1]", "boolean[:, ::1]"


# What counts as 0 of ‖Δ¹‖: far above rounding, far below what sampling noise leaves.
NEGLIGIBLE = 1e-10
_LARGE = 2.0**400  # rows between 1/_LARGE and _LARGE can be divided by their squared length without a thought


def _kernel(*signature: str, returns: str = "void") -> Any:
    return partial(CompiledLate, f"{returns}({', '.join(signature)})")


@_kernel(_CUBE, _MATRIX, _MASK, _MATRIX, _MASK, "int64[::1]", returns="boolean")
def admit(gradients: Any, slack: Any, active: Any, target: Any, kept: Any, flat: Any) -> Any:
    """Target ← −min(slack, 0); kept ← active without constraints whose gradient is 0; flat ← their number, by run.

    Returns whether a row that is kept is beyond 2^±400.
    """
    runs, m = active.shape
    extreme = False
    for b in range(runs):
        flat[b] = 0
        for i in range(m):
            target[b, i] = max(-slack[b, i], 0.0)
            kept[b, i] = False
            if active[b, i]:
                largest = 0.0
                for x in gradients[b, 1 + i]:
                    largest = max(largest, abs(x))
                kept[b, i] = largest > 0.0
                extreme = extreme or (largest > 0.0 and not 1.0 / _LARGE < largest < _LARGE)
                flat[b] += not kept[b, i]
    return extreme


@_kernel(_CUBE, _MATRIX, _MATRIX, _MATRIX)
def predict(gradients: Any, slack: Any, change: Any, predicted: Any) -> None:
    """Predicted (B, m) ← slack + J · change."""
    runs, m = slack.shape
    for b in range(runs):
        for i in range(m):
            predicted[b, i] = slack[b, i]
            for j in range(change.shape[1]):
                predicted[b, i] += gradients[b, 1 + i, j] * change[b, j]


@_kernel(_MATRIX, _CUBE, "boolean[::1]", returns="boolean")
def mark_vanishing(tangent: Any, gradients: Any, vanishing: Any) -> Any:
    """Whether ‖s‖ ≤ NEGLIGIBLE · ‖Δ¹‖, by run, and whether any is; the largest entry first, as squares may overflow."""
    runs, n = tangent.shape
    found = False
    for b in range(runs):
        largest, limit = 0.0, 0.0
        for j in range(n):
            largest = max(largest, abs(tangent[b, j]))
            limit = max(limit, abs(gradients[b, 0, j]))
        if largest > NEGLIGIBLE * n * limit:  # the usual case, seen without a square
            vanishing[b] = False
            continue
        if largest > 0.0 and limit > 0.0:
            squares, square = 0.0, 0.0
            for j in range(n):
                squares += (tangent[b, j] / largest) ** 2
                square += (gradients[b, 0, j] / limit) ** 2
            largest, limit = largest * np.sqrt(squares), limit * np.sqrt(square)
        vanishing[b] = largest <= NEGLIGIBLE * limit
        found = found or vanishing[b]
    return found
