"""What no policy of the arm can exceed: an upper bound on the average r³ per step."""

import numpy as np

from cpgrl_opt.arrays import Float
from envs import TwoLinkArm

_CELLS = 150  # of configurations along each joint, within the stops
_STARTS = 60  # of starts along each joint, within the box
_HALVINGS = 40


def greatest_average_r3(arm: TwoLinkArm) -> float:
    """An upper bound on ρ³, reward per step, over all policies, with or without exploration.

    An episode from φ that touches object k takes at least n_k(φ) = ⌈‖φ − φ′‖_∞ / (dt·max_speed)⌉ steps, φ′ the nearest
    configuration that touches it. By renewal ρ³ = E[r³ of an episode]/E[its steps], so no policy exceeds the ρ with

        E_φ[max_k r³_k − ρ n_k(φ)] = 0.

    Grids stand for starts and touching configurations, each widened by half a cell in favour of the bound.

    Parameters
    ----------
    arm
        Its objects, speed and stops.

    Returns
    -------
    float
        Reward per step.
    """
    steps = _least_steps(arm)
    rewards = np.array([thing.reward for thing in arm.objects])[:, None]
    low, high = 0.0, max(0.0, float(rewards.max()))
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        if (rewards - middle * steps).max(axis=0).mean() > 0:
            low = middle
        else:
            high = middle
    return high


def _least_steps(arm: TwoLinkArm) -> Float[np.ndarray, "objects starts"]:
    """n_k from each cell of starts, at least 1."""
    places, cell = _cells(np.array(arm.stops), _CELLS)
    starts, start_cell = _cells(np.array(arm.box).T, _STARTS)
    first, second = arm.link_lengths
    reach = arm.touch_radius + (first + second) * cell[0] / 2 + second * cell[1] / 2  # p moves no further in a cell
    points = arm.forward_kinematics(places)
    steps = []
    for thing in arm.objects:
        touching = places[np.hypot(*(points - thing.position).T) <= reach]
        apart = np.full(len(starts), np.inf)
        for place in touching:
            apart = np.minimum(apart, (np.abs(starts - place) - (cell + start_cell) / 2).max(axis=1))
        steps.append(np.maximum(1.0, np.ceil(apart / (arm.dt * arm.max_speed) - 1e-9)))
    return np.array(steps)


def _cells(
    corners: Float[np.ndarray, "2 2"], count: int
) -> tuple[Float[np.ndarray, "cells 2"], Float[np.ndarray, "2"]]:
    """Centres of count² cells between the lowest and the highest corner, and a cell's size."""
    low, high = corners
    size = (high - low) / count
    middles = low + size * (np.arange(count)[:, None] + 0.5)
    return np.stack(np.meshgrid(*middles.T, indexing="ij"), axis=-1).reshape(-1, 2), size
