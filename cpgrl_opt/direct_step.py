"""A step's usual way in one compiled call: where nothing is to be mended, dropped or reported, NumPy's calls cost most.

    admit → fill in the problems → project → θ moves by α₁ s + αₑ v

with the kernels that `step` uses one by one, so that the numbers are the same, bit for bit. Importing this module
imports numba.
"""

from pathlib import Path
from typing import Any

import numpy as np

from .machine_code import compiled, forget_outdated_kernels
from .solvers.compiled._direct import OPTIMAL, project_directly
from .step_kernels import admit, fill_problems, mark_vanishing

_FOLDER = Path(__file__).parent
_SOURCES = (_FOLDER / "step_kernels.py", *(_FOLDER / "solvers" / "compiled").glob("*.py"))
forget_outdated_kernels(_FOLDER, "direct_step*", _SOURCES)
_project = project_directly.machine_code


def _entry(function: Any) -> Any:
    return compiled(
        "boolean(f8[:, :, ::1], f8[:, ::1], b1[:, ::1], b1, b1, b1, f8, f8, f8, f8, i8[::1], f8[:, ::1])", function
    )


@_entry
def move(
    gradients: Any,
    slack: Any,
    active: Any,
    tangent_solver: bool,
    is_equality: bool,
    restores_inside: bool,
    step_size: float,
    restoration_rate: float,
    tolerance: float,
    relative: float,
    flat: Any,
    change: Any,
) -> bool:
    """change (B, n) ← α₁ s + αₑ v, flat (B,) as `admit` counts it; False where `step` has more to say about any run."""
    runs, channels, n = gradients.shape
    m = channels - 1
    target, kept = np.empty((runs, m)), np.empty((runs, m), np.bool_)
    if admit(gradients, slack, active, target, kept, flat)[1]:  # rows beyond 2^±400
        return False
    count = runs if restores_inside else 2 * runs
    g, J = np.empty((count, n)), np.empty((count, m, n))
    b, E = np.empty((count, m)), np.empty((count, m), np.bool_)
    ratio = restoration_rate / step_size if restores_inside else 0.0
    if not fill_problems(gradients, target, kept, is_equality, ratio, g, J, b, E):
        return False
    value, multipliers, report = np.empty(count * n), np.empty(count * m), np.empty(6 * count)
    _project(
        tangent_solver,
        g.reshape(count * n),
        J.reshape((count * m, n)),
        b.reshape(count * m),
        E.reshape(count * m),
        tolerance,
        value,
        multipliers,
        report,
    )
    for k in range(count):
        if report[k] != OPTIMAL:
            return False
    moves = value.reshape((count, n))
    if mark_vanishing(moves[:runs], gradients, relative, np.empty(runs, np.bool_)):
        return False
    finite = True
    for k in range(runs):
        for j in range(n):
            change[k, j] = step_size * moves[k, j]
            if not restores_inside:
                change[k, j] += restoration_rate * moves[runs + k, j]
            finite = finite and abs(change[k, j]) < np.inf
    return finite
