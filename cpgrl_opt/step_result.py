"""What a step answers: the change of θ, and its proof."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from .arrays import Bool, Float, Int
from .validation import read_only

COUNTS = ("infeasible", "fallback", "skipped", "dropped", "capped", "softened", "flat", "long")


@dataclass(frozen=True, eq=False)
class StepResult:
    """The parameter change and what happened on the way; leading axes as in the linearization.

    change: (…, n), or in the form in which the gradients came; active: (…, m), the set that the rule chose, with
    `linearized` the constraints with μ > 0;
    stationary: (…), PΔ¹ = 0 and some λ ≤ 0 exists, both up to rounding: a KKT point.
    counts, by name (…): infeasible (subproblems, solved by least violation), fallback (handed to active-set),
    skipped (no certified direction: change 0), dropped (constraints), capped (restoration shortened), softened (by the
    ridge, where a constraint was active),
    flat (active constraints whose gradient is 0: to first order no direction changes them, so they are left out),
    long (the change is longer than step_size · radius, for a restoration knows no radius).
    multipliers: (…, m), μ of the tangent problem, which is the only one of `restoring` and `linearized`; 0 where a
    constraint is not active or was dropped, a Farkas vector where the problem is infeasible.
    residuals: (…, 4) in the order of `KKTResiduals`, each the largest of the tangent and restoration problems'
    certificates; NaN where one of them has none, being infeasible or skipped.
    predicted_slack: (…, m), slack + J · change.
    """

    change: Any
    active: Bool[np.ndarray, "*runs m"]
    stationary: Bool[np.ndarray, "*runs"]
    counts: Mapping[str, Int[np.ndarray, "*runs"]]
    multipliers: Float[np.ndarray, "*runs m"] | None = None
    residuals: Float[np.ndarray, "*runs 4"] | None = None
    predicted_slack: Float[np.ndarray, "*runs m"] | None = None

    def reshape(self, runs: tuple[Any, ...]) -> "StepResult":
        """The same with these axes for the one of its runs."""
        parts = {name: part.reshape((*runs, *part.shape[1:])) for name, part in vars(self).items() if name != "counts"}
        return StepResult(**parts, counts={name: counted.reshape(runs) for name, counted in self.counts.items()})


@cache
def _no_counts(runs: tuple[Any, ...]) -> dict[str, Int[np.ndarray, "*runs"]]:
    """Zeros that nobody can write to: what is counted in most updates."""
    return dict.fromkeys(COUNTS, read_only(np.zeros(runs, np.int64)))


def usual_result(
    change: Float[np.ndarray, "*runs n"],
    active: Bool[np.ndarray, "*runs m"],
    flat: Int[np.ndarray, "*runs"],
    proof: Sequence[np.ndarray | None] = (None, None, None),
) -> StepResult:
    """What `move_parameters` did: nothing but `flat` is counted. proof: multipliers, residuals, predicted slack."""
    result = object.__new__(StepResult)  # past the frozen dataclass's own constructor, which takes a tenth of a step
    known = vars(result)
    known["change"], known["active"], known["stationary"] = change, active, np.zeros(flat.shape, np.bool_)
    known["counts"] = {**_no_counts(flat.shape), "flat": flat}
    known["multipliers"], known["residuals"], known["predicted_slack"] = proof
    return result


def skipped_result(zero: Any, slack: Float[np.ndarray, "m"], active: Bool[np.ndarray, "m"]) -> StepResult:
    """A run that stays where it is; zero: its change."""
    counts = {name: np.array(name == "skipped", np.int64) for name in COUNTS}
    return StepResult(zero, active, np.array(False), counts, np.zeros(len(slack)), np.full(4, np.nan), slack.copy())


def stack_results(results: Sequence[StepResult], runs: tuple[Any, ...]) -> StepResult:
    """Results of runs one by one, at least one, stacked to these axes; the one result where there are none."""
    if not runs:
        return results[0]
    names = [name for name in vars(results[0]) if name != "counts"]
    counts = {name: np.array([each.counts[name] for each in results]) for name in COUNTS}
    parts = {name: np.array([getattr(each, name) for each in results]) for name in names}
    return StepResult(**parts, counts=counts).reshape(runs)
