"""--compare: (b) and (c) under each formulation, by a solver that takes it."""

from collections.abc import Mapping, Sequence

import numpy as np

from cpgrl_opt.arrays import Float

from ..comparison import Comparison, Measure, with_spread
from ..messages import Outcome
from .curves import OUTCOMES, TouchCurves

MEASURES = (
    *(Measure(outcome, outcome, ".1f") for outcome in OUTCOMES),  # per 100 of the last episodes
    Measure("early_violation", "outside, first", ".4f"),
    Measure("violation", "outside, last", ".4f"),
    Measure("length", "steps", ".1f"),
    Measure("constrained", "constrained", ".3f"),
    Measure("capped", "shortened", ".3f"),
    Measure("infeasible", "infeasible", ".3f"),
    Measure("uncertified", "uncertified", ".3g"),
)
_LEGEND = (
    "Mean ± standard deviation over the runs. Touches per 100 of the last episodes by object, time-outs under none. "
    "Outside: share of steps outside the box of r², in the first and in the last episodes. Steps: mean length of the "
    "last episodes. Per update: constrained (a constraint is active, and the ridge acts; under linearized, which has "
    "none, a constraint has a multiplier), restorations shortened, subproblems without a solution (least violation "
    "taken), answers without certificate (active-set took over, or θ stayed)."
)


def formulation_table(keys: Mapping[str, Sequence[str]]) -> Comparison:
    """keys: condition, formulation and solver of the trainings, by label.

    Parameters
    ----------
    keys
        Condition, formulation and solver of the trainings, by label.

    Returns
    -------
    Comparison
        With mean ± standard deviation.
    """
    return Comparison(
        file="compare",
        title="The arm under each formulation",
        legend=_LEGEND,
        headings=("condition", "formulation", "solver", "run", "episode"),
        keys=keys,
        measures=MEASURES,
        measure=measure,
        cells=with_spread,
    )


def measure(curves: TouchCurves, outcome: Outcome) -> Float[np.ndarray, "R measures"]:
    """A row for each run, of MEASURES; see the legend.

    Parameters
    ----------
    curves
        Touches by block.
    outcome
        Counts of the updates.

    Returns
    -------
    (R, measures)
        A row for each run, see the legend.
    """
    late, updates, counts = curves.late(), outcome.episode, outcome.counts
    length = (late.length * late.sizes).sum(axis=1) / late.sizes.sum()
    shares = [counts["constrained"], counts["capped"], counts["infeasible"], counts["fallback"] + counts["skipped"]]
    columns = [curves.early().outside(), late.outside(), length, *(share / updates for share in shares)]
    return np.column_stack([late.rates(), *columns])
