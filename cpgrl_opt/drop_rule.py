"""The drop rule (§2.3): which constraints leave the active set 𝒜, by a λ of the step's own.

    Δ¹ − PΔ¹ = Ĵᵀλ̂   on the rows of 𝒜,   Ĵᵢ = Jᵢ/‖Jᵢ‖,   λ̂ᵢ = λᵢ‖Jᵢ‖

Where rows depend there are many such λ, and the one that a solver finds depends on its method and on the order of the
rows. Two things do not:

    Is there a λ ≤ 0?     Exactly where PΔ¹ is the projection of Δ¹ onto the cone Jd ≥ 0 too. Nothing is dropped then:
                          with PΔ¹ = 0 it is a KKT point, μ = −λ.
    argmin ‖λ̂‖ of all λ   One, whatever the order and the lengths of the rows. Where no λ ≤ 0 exists it has a positive
                          component. The largest is dropped, and whatever ties with it, as equal rows always do: the
                          order would decide between them.

Source: §2.3 of the paper; Moreau 1962 for the first.
"""

import numpy as np

from .arrays import Bool, Float, Number
from .formulation import FORMULATIONS, ActiveConstraints
from .projection import largest_multipliers, unit_multipliers
from .scaling import lengths
from .solvers import ActiveSet, Rosen, solve_batch

# What counts as 0 of ‖Δ¹‖: far above rounding, far below what sampling noise leaves.
NEGLIGIBLE = 1e-10


def vanish(moves: Float[np.ndarray, "B n"], constraints: ActiveConstraints) -> Bool[np.ndarray, "B"]:
    """Whether a move is 0 up to rounding, relative to Δ¹."""
    return lengths(moves) <= NEGLIGIBLE * lengths(constraints.gradients[:, 0])


def tangents(constraints: ActiveConstraints, radius: Number | None = None) -> Float[np.ndarray, "B n"]:
    """PΔ¹, in the ball where there is one, by the closed form: a solver may stop anywhere within its tolerance."""
    problems = FORMULATIONS["equality"].tangents(constraints).in_geometry(None, radius)
    return np.asarray(solve_batch(Rosen(), problems).value)


def has_positive_multipliers(constraints: ActiveConstraints) -> Bool[np.ndarray, "B"]:
    """Whether no λ ≤ 0 exists: the cone Jd ≥ 0 lets Δ¹ climb farther than Jd = 0 does."""
    in_cone = solve_batch(ActiveSet(), FORMULATIONS["cone"].tangents(constraints)).value
    return ~vanish(in_cone - tangents(constraints), constraints)


def choose_leaving(constraints: ActiveConstraints, *, raw: bool = False) -> Bool[np.ndarray, "B m"]:
    """What is dropped of 𝒜 in runs that have positive multipliers. raw: compare λᵢ instead of λ̂ᵢ, as printed."""
    size = lengths(constraints.gradients)
    size = np.where(size > 0.0, size, 1.0)
    unit = constraints.gradients / size[:, :, None]
    rows = np.where(constraints.active[:, :, None], unit[:, 1:], 0.0)
    hats = np.where(constraints.active, unit_multipliers(rows, unit[:, 0]), 0.0)  # rounding leaves some of no row
    largest = hats.max(axis=1, initial=0.0, keepdims=True)
    # Where even the largest is below NEGLIGIBLE it leaves: no λ ≤ 0 exists, and the search must get on.
    positive = constraints.active & (hats >= np.minimum(NEGLIGIBLE, largest))
    with np.errstate(over="ignore"):
        harm = constraints.original(hats / size[:, 1:]) if raw else hats
    return largest_multipliers(harm, hats, positive)
