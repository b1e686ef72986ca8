"""Learned behaviour: episodes of learned policies, and which of them is typical."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cpgrl_opt.arrays import Float, Vector
from envs import TwoLinkArm, TwoLinkArmEnv

from ...policies import NormalizedGaussianNetwork
from .curves import TouchCurves

_BESIDE = 0.16  # m: how far from the aversive object's centre a path begins; it is touched within 0.06 m
_DIRECTIONS = 8  # around it
_TRIES = 15  # episodes among which the typical one is chosen
_GRID = 60  # lines of the mesh on which a start is looked for


@dataclass(frozen=True, eq=False)
class ArmPath:
    """One episode: angles (T + 1, 2), rad, from the start to the end; touched: an object's name or "none"."""

    angles: Float[np.ndarray, "T 2"]
    touched: str


def arm_path(arm: TwoLinkArm, policy: NormalizedGaussianNetwork, start: Vector, rng: np.random.Generator) -> ArmPath:
    """An episode from `start`, (2,), rad, actions drawn as in training.

    Parameters
    ----------
    arm
        What moves.
    policy
        Draws its actions as in training.
    start
        (2,): angles, rad.
    rng
        Of the actions.

    Returns
    -------
    ArmPath
        To the touch that ends it, or the limit.
    """
    environment = TwoLinkArmEnv(arm)
    angles, _ = environment.reset(seed=0, options={"angles": start})
    visited, ended, info = [angles], False, {"touched": "none"}
    while not ended:
        angles, _, terminated, truncated, info = environment.step(policy.sample(angles, rng))
        visited.append(angles)
        ended = terminated or truncated
    return ArmPath(np.array(visited), info["touched"])


def typical_path(
    arm: TwoLinkArm, policy: NormalizedGaussianNetwork, start: Vector, rng: np.random.Generator
) -> ArmPath:
    """Of _TRIES episodes from `start` one of median length among those that end in the most frequent way.

    Parameters
    ----------
    arm, policy, start, rng
        As `arm_path` says.

    Returns
    -------
    ArmPath
        One that ends as most do.
    """
    paths = [arm_path(arm, policy, start, rng) for _ in range(_TRIES)]
    (outcome, _), *_ = Counter(path.touched for path in paths).most_common()
    alike = sorted((path for path in paths if path.touched == outcome), key=lambda path: len(path.angles))
    return alike[len(alike) // 2]


def typical_run(curves: TouchCurves) -> int:
    """The run whose last touches are nearest to the mean over the runs.

    Parameters
    ----------
    curves
        Of R runs.

    Returns
    -------
    int
        Its position among them.
    """
    rates = curves.late().rates()
    return int(np.abs(rates - rates.mean(axis=0)).sum(axis=1).argmin())


def starts_beside_aversive(arm: TwoLinkArm) -> Float[np.ndarray, "directions 2"]:
    """Angles in the box, rad, that put the end effector beside the object of least reward, in each direction.

    The paper's Fig. 7 (b) shows a path that begins in the neighbourhood of the aversive object.

    Parameters
    ----------
    arm
        Its objects and box.

    Returns
    -------
    (8, 2)
        Rad, the first to the right of the object.
    """
    low, high = np.array(arm.box).T
    axes = np.linspace(low, high, _GRID).T
    angles = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    free = angles[arm.touched(arm.forward_kinematics(angles)) == 0]
    points = arm.forward_kinematics(free)
    directions = np.linspace(0, 2 * np.pi, _DIRECTIONS, endpoint=False)  # the first is to the right
    aversive = min(arm.objects, key=lambda thing: thing.reward)
    goals = np.array(aversive.position) + _BESIDE * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    return np.array([free[np.hypot(*(points - goal).T).argmin()] for goal in goals])


def count_touches(
    arm: TwoLinkArm,
    policies: Sequence[NormalizedGaussianNetwork],
    starts: Float[np.ndarray, "starts 2"],
    rng: np.random.Generator,
) -> dict[str, float]:
    """Per 100 episodes, one of each policy from each start, how many end at each object or at none.

    Parameters
    ----------
    arm
        What moves.
    policies
        One of each run.
    starts
        (S, 2): angles, rad.
    rng
        Of the actions.

    Returns
    -------
    dict of float
        By object, and "none".
    """
    ends = Counter(arm_path(arm, policy, start, rng).touched for policy in policies for start in starts)
    return {outcome: 100 * ends[outcome] / ends.total() for outcome in (*arm.events, "none")}
