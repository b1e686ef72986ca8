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
from .solvers.compiled._direct import SHARP, WEIGHT, solve_problem
from .solvers.compiled._entry_point import entry_point, inlined

_FOLDER = Path(__file__).parent
forget_outdated_kernels(_FOLDER, "direct_step*", (_FOLDER / "solvers" / "compiled").glob("*.py"))


@inlined
def admit(gradients, slack, active, target, kept, flat):
    """Target ← −min(slack, 0); kept ← active without constraints whose gradient is 0; flat ← their number, by run.

    Returns whether a row that is kept is too large or too small for its multiplier.
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
                extreme = extreme or (largest > 0.0 and not 1.0 / LARGE < largest < LARGE)
                flat[b] += not kept[b, i]
    return extreme


@inlined
def vanishes(tangent, gradient):
    """Whether ‖s‖ ≤ NEGLIGIBLE ‖Δ¹‖; the largest entry first, as squares may overflow."""
    largest, limit, squares, square = 0.0, 0.0, 0.0, 0.0
    for j in range(len(gradient)):
        largest, limit = max(largest, abs(tangent[j])), max(limit, abs(gradient[j]))
    if largest > NEGLIGIBLE * len(gradient) * limit:  # the usual case, seen without a square
        return False
    if largest > 0.0 and limit > 0.0:
        for j in range(len(gradient)):
            squares, square = squares + (tangent[j] / largest) ** 2, square + (gradient[j] / limit) ** 2
    return largest * np.sqrt(squares) <= NEGLIGIBLE * (limit * np.sqrt(square))


@inlined
def predict(gradients, slack, change, predicted):
    """Predicted (B, m) ← slack + J · change."""
    runs, m = slack.shape
    for b in range(runs):
        for i in range(m):
            predicted[b, i] = slack[b, i]
            for j in range(change.shape[1]):
                predicted[b, i] += gradients[b, 1 + i, j] * change[b, j]


@entry_point(
    "boolean(f8[:, :, ::1], f8[:, ::1], b1[:, ::1], f8[::1], i8[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1])",
    interpreted=(0, 0),
)
def move(gradients, slack, active, settings, flat, change, multipliers, residuals, predicted):
    """change (B, n) ← α₁ s + αₑ v, flat (B,) as `admit` counts it; False where `step` has more to say about any run.

    Also the proof, as `StepResult` has it: multipliers (B, m), residuals (B, 4) and predicted slack (B, m). settings:
    those of `StepSettings._direct`. Where the formulation takes all constraints, `active` is whatever it is, and says
    afterwards which multipliers are positive.
    """
    tangent_solver, is_equality, restores_inside, takes_all = (
        settings[0] > 0.0, settings[1] > 0.0, settings[2] > 0.0, settings[3] > 0.0
    )  # fmt: skip
    step_size, restoration_rate, slack_fraction, tolerance = settings[4], settings[5], settings[6], settings[7]
    runs, channels, n = gradients.shape
    m = channels - 1
    target, kept = np.empty((runs, m)), np.empty((runs, m), np.bool_)
    considered = np.ones((runs, m), np.bool_) if takes_all else active
    if admit(gradients, slack, considered, target, kept, flat):
        return False
    g, value, rest = np.empty((1, n)), np.empty((1, n)), np.empty((1, n))
    bound, equality = np.empty(m), np.empty(m, np.bool_)
    gram, factor, small = np.empty((m, m)), np.empty((m, m)), np.empty((8, m))
    state, order, parts = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(4)
    finite = True
    for run in range(runs):
        for part in range(1 if restores_inside else 2):  # the tangent, then the restoration
            rate, inside = (step_size, 0.0) if part == 0 else (restoration_rate, 1.0)
            if restores_inside:
                inside = (1.0 if takes_all else restoration_rate) / step_size
            for i in range(m):
                asked = target[run, i]
                if takes_all:
                    asked = restoration_rate * asked - slack_fraction * max(slack[run, i], 0.0)
                bound[i] = inside * asked if kept[run, i] else -inf
                equality[i] = is_equality and kept[run, i]
            for j in range(n):
                g[0, j] = gradients[run, 0, j] if part == 0 else 0.0
            worst, _ = solve_problem(
                tangent_solver, 0, g, gradients[run, 1:], bound, equality, gram, factor, small, state, order, value,
                rest, parts,
            )  # fmt: skip
            if not (worst <= SHARP and worst <= tolerance):
                return False
            if part == 0 and vanishes(value[0], gradients[run, 0]):
                return False
            for k in range(4):
                residuals[run, k] = parts[k] if part == 0 else max(residuals[run, k], parts[k])
            if part == 0:
                for i in range(m):
                    multipliers[run, i] = small[WEIGHT, i]
            for j in range(n):
                change[run, j] = rate * value[0, j] if part == 0 else change[run, j] + rate * value[0, j]
                finite = finite and abs(change[run, j]) < inf
    if finite:
        predict(gradients, slack, change, predicted)
        if takes_all:
            for run in range(runs):
                for i in range(m):
                    active[run, i] = multipliers[run, i] > 0.0
    return finite
