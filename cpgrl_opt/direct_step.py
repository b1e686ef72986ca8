"""A step's usual way in one compiled call: where nothing is to be mended, dropped or reported, NumPy's calls cost most.

    admit → tangent and restoration of one run after the other → θ moves by α₁ s + αₑ v

with the numbers of `_step_run`, bit for bit.
"""

from math import inf
from pathlib import Path

import numpy as np

from .drop_rule import NEGLIGIBLE
from .formulation import LARGE
from .machine_code import forget_outdated_kernels
from .solvers.compiled._direct import SHARP, solve_problem
from .solvers.compiled._entry_point import entry_point, inlined
from .solvers.compiled._exchange import WEIGHT

_FOLDER = Path(__file__).parent
forget_outdated_kernels(_FOLDER, "direct_step*", (_FOLDER / "solvers" / "compiled").glob("*.py"))


@inlined
def admit(run, gradients, active, takes_all, kept, flat):
    """kept (m,) ← active without constraints whose gradient is 0; flat[run] ← their number.

    Returns whether a row that is kept is too large or too small for its multiplier.
    """
    extreme, flat[run] = False, 0
    for i in range(len(kept)):
        kept[i] = False
        if takes_all or active[run, i]:
            largest = 0.0
            for x in gradients[run, 1 + i]:
                largest = max(largest, abs(x))
            kept[i] = largest > 0.0
            extreme = extreme or (largest > 0.0 and not 1.0 / LARGE < largest < LARGE)
            flat[run] += not kept[i]
    return extreme


@inlined
def pose(run, part, gradients, slack, kept, settings, g, bound, equality):
    """The tangent problem of a run, part 0, or its restoration, part 1: g (1, n), bound and equality (m,)."""
    restores_inside, takes_all, step_size, restoration_rate = settings[2] > 0, settings[3] > 0, settings[4], settings[5]
    inside = (1.0 if takes_all else restoration_rate) / step_size if restores_inside else float(part)
    for i in range(len(kept)):
        asked = max(-slack[run, i], 0.0)
        if takes_all:
            asked = restoration_rate * asked - settings[6] * max(slack[run, i], 0.0)
        bound[i] = inside * asked if kept[i] else -inf
        equality[i] = settings[1] > 0.0 and kept[i]
    for j in range(g.shape[1]):
        g[0, j] = gradients[run, 0, j] if part == 0 else 0.0


@inlined
def take(run, part, rate, value, small, parts, change, multipliers, residuals):
    """change ← change + rate · value, with the proof; whether it is finite."""
    finite = True
    for j in range(change.shape[1]):
        change[run, j] = rate * value[0, j] if part == 0 else change[run, j] + rate * value[0, j]
        finite = finite and abs(change[run, j]) < inf
    for k in range(4):
        residuals[run, k] = parts[k] if part == 0 else max(residuals[run, k], parts[k])
    if part == 0:
        for i in range(multipliers.shape[1]):
            multipliers[run, i] = small[WEIGHT, i]
    return finite


@inlined
def vanishes(tangent, gradient):
    """Whether ‖s‖ ≤ NEGLIGIBLE ‖Δ¹‖, or squares do not tell."""
    short, long = 0.0, 0.0
    for j in range(len(gradient)):
        short, long = short + tangent[j] ** 2, long + gradient[j] ** 2
    return not (1.0 / LARGE < long < LARGE and short > NEGLIGIBLE**2 * long)


@inlined
def predict(gradients, slack, change, predicted):
    """Predicted (B, m) ← slack + J · change; whether all of it is finite."""
    (runs, m), finite = slack.shape, True
    for b in range(runs):
        for i in range(m):
            predicted[b, i] = slack[b, i]
            for j in range(change.shape[1]):
                predicted[b, i] += gradients[b, 1 + i, j] * change[b, j]
            finite = finite and abs(predicted[b, i]) < inf
    return finite


@entry_point(
    "boolean(f8[:, :, ::1], f8[:, ::1], b1[:, ::1], f8[::1], i8[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1])",
    interpreted=(0, 0),
)
def move_parameters(gradients, slack, active, settings, flat, change, multipliers, residuals, predicted):
    """change (B, n) ← α₁ s + αₑ v, flat (B,) as `admit` counts it; False where `step` has more to say about any run.

    Also the proof, as `StepResult` has it: multipliers (B, m), residuals (B, 4) and predicted slack (B, m). settings:
    those of `StepSettings._direct`. Where the formulation takes all constraints, `active` is whatever it is, and says
    afterwards which multipliers are positive.
    """
    tangent_solver, restores_inside, takes_all = settings[0] > 0.0, settings[2] > 0.0, settings[3] > 0.0
    runs, channels, n = gradients.shape
    m = channels - 1
    kept, bound, equality = np.empty(m, np.bool_), np.empty(m), np.empty(m, np.bool_)
    g, value, rest = np.empty((1, n)), np.empty((1, n)), np.empty((1, n))
    gram, factor, small = np.empty((m, m)), np.empty((m, m)), np.empty((8, m))
    state, order, parts = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(4)
    finite = True
    for run in range(runs):
        if admit(run, gradients, active, takes_all, kept, flat):
            return False
        for part in range(1 if restores_inside else 2):  # the tangent, then the restoration
            pose(run, part, gradients, slack, kept, settings, g, bound, equality)
            worst, _ = solve_problem(
                tangent_solver, 0, g, gradients[run, 1:], bound, equality, gram, factor, small, state, order, value,
                rest, parts,
            )  # fmt: skip
            if not (worst <= SHARP and worst <= settings[7]) or (part == 0 and vanishes(value[0], gradients[run, 0])):
                return False
            rate = settings[4 + part]  # α₁, αₑ
            finite = take(run, part, rate, value, small, parts, change, multipliers, residuals) and finite
    if not (finite and predict(gradients, slack, change, predicted)):
        return False
    if takes_all:
        active[:] = multipliers > 0.0
    return True
