"""The best stationary policy under constraints on average rewards, as a linear programme.

    max_μ Σ r¹μ   s.t.   Σₐ μ(j, a) = Σₛₐ μ(s, a) T(s, a, j),   Σ μ = 1,   Σ rⁱμ ≥ Gⁱ (i ≥ 2),   μ ≥ 0

μ(s, a) is the share of time that is spent in s doing a. Source: Altman (1999), Constrained Markov Decision
Processes, ch. 4; Feinberg & Shwartz (1999), cited in §1 of the paper.
"""

from typing import Any

import numpy as np

from .arrays import ChannelValues, Float64, Occupancy, Rewards, Thresholds, Transitions

# The tightest that HiGHS takes; on rewards scaled to [−1, 1].
_TOLERANCE = 1e-10
# A threshold that is missed by less counts as met, on the same scale: twice the tolerance of HiGHS.
_MET = 2e-10
_INFEASIBLE = 2  # linprog's status
# HiGHS refuses huge coefficients. Violations below this part of the widest channel's range come out too large.
_MOST_RELIEF = 1e9


def best_occupancy(transitions: Transitions, rewards: Rewards, thresholds: Thresholds) -> tuple[Occupancy, Thresholds]:
    """Optimal μ and the multipliers λᵢ = −∂ρ¹/∂Gⁱ ≥ 0 of the constraints.

    Rewards are shifted and scaled to [−1, 1] first, so their units do not matter.

    Returns
    -------
    tuple of arrays
        μ, (states, actions), and λ, (m,).

    Raises
    ------
    ValueError
        With the least violation, if no policy meets the thresholds.
    RuntimeError
        If HiGHS fails.
    """
    scaled, middle, half = _scale(rewards)
    bounds = _scale_bounds(thresholds, middle, half)
    result = _linear_programme(transitions, -scaled[0].ravel(), scaled[1:], bounds)
    if result.status == _INFEASIBLE:
        # Where the feasible set is a point or a face, rounding of the thresholds alone can empty it.
        result = _linear_programme(transitions, -scaled[0].ravel(), scaled[1:], bounds - _MET)
    if result.status == _INFEASIBLE:
        violation = least_violation(transitions, rewards, thresholds)
        raise ValueError(
            "thresholds should be within reach of some policy; found that the least violation, "
            f"min over policies of max (Gⁱ − ρⁱ), is {violation:.6g}"
        )
    _require_solved(result)
    occupancy = np.maximum(result.x, 0).reshape(transitions.shape[:2])
    multipliers = np.maximum(-result.ineqlin.marginals, 0) * half[0] / half[1:]
    return occupancy / occupancy.sum(), multipliers


def least_violation(transitions: Transitions, rewards: Rewards, thresholds: Thresholds) -> float:
    """min_μ max_i (Gⁱ − Σ rⁱμ)₊: by how much all thresholds would have to come down, in the rewards' unit."""
    scaled, middle, half = _scale(rewards)
    # No policy gets a channel above its largest reward, so this much is certain, and what is left is bounded.
    certain = max(0.0, float(np.max(thresholds - rewards[1:].max(axis=(1, 2)), initial=0.0)))
    bounds = _scale_bounds(thresholds - certain, middle, half)
    unit = float(half[1:].max(initial=1.0))
    cost = np.append(np.zeros(scaled[0].size), 1.0)
    relief = np.minimum(unit / half[1:], _MOST_RELIEF)
    result = _linear_programme(transitions, cost, scaled[1:], bounds, relief)
    _require_solved(result)
    return certain + unit * float(result.fun)


def _linear_programme(
    transitions: Transitions,
    cost: Float64[np.ndarray, "variables"],
    channels: Float64[np.ndarray, "m states actions"],
    bounds: Thresholds,
    relief: Thresholds | None = None,
) -> Any:
    """Minimise costᵀ(μ, t) over flows μ ≥ 0, t ≥ 0 with Σ rⁱμ + reliefᵢ t ≥ bᵢ; t is there only if relief is."""
    from scipy.optimize import linprog

    states, actions, _ = transitions.shape
    flow = np.repeat(np.eye(states), actions, axis=1) - transitions.reshape(states * actions, states).T
    equalities = np.vstack([flow, np.ones(states * actions)])
    inequalities = -channels.reshape(len(channels), states * actions)
    if relief is not None:
        equalities = np.column_stack([equalities, np.zeros(states + 1)])
        inequalities = np.column_stack([inequalities, -relief])
    return linprog(
        cost,
        A_ub=inequalities,
        b_ub=-bounds,
        A_eq=equalities,
        b_eq=np.append(np.zeros(states), 1.0),
        method="highs-ds",  # the simplex method ends on a vertex: zeros are exact
        options={"primal_feasibility_tolerance": _TOLERANCE, "dual_feasibility_tolerance": _TOLERANCE},
    )


def _scale(
    rewards: Rewards,
) -> tuple[Rewards, ChannelValues, ChannelValues]:
    low, high = rewards.min(axis=(1, 2)), rewards.max(axis=(1, 2))
    middle = low + (high - low) / 2
    # A channel that is constant, or nearly so beside its size, is scaled by its size: what is left is rounding.
    half = np.maximum((high - low) / 2, 1e-4 * np.maximum(np.abs(low), np.abs(high)))
    half = np.where(half > 0, half, 1.0)
    return (rewards - middle[:, None, None]) / half[:, None, None], middle, half


def _scale_bounds(
    thresholds: Thresholds,
    middle: ChannelValues,
    half: ChannelValues,
) -> Thresholds:
    # Scaled averages are in [−1, 1]: what lies beyond ±2 means "always met" or "never met" all the same.
    with np.errstate(over="ignore"):
        scaled: Thresholds = (thresholds - middle[1:]) / half[1:]
    return scaled.clip(-2, 2)


def _require_solved(result: Any) -> None:
    if result.status != 0:
        raise RuntimeError(f"the occupancy-measure linear programme was not solved: {result.message}")
