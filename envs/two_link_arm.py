"""The two-link arm of §4 of the paper: kinematics only, four objects to touch, three rewards."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from .arm_constants import (
    LEAST,
    MOST,
    OBJECTS,
    ArmObject,
    Pair,
    angle_box,
    distinct_objects,
    pair_between,
)
from .arrays import Float64, Int64
from .interface import ContinuousKernels, register_code
from .validation import finite_array, number_between, positive_integer

Angles = Float64[np.ndarray, "*points 2"]
Points = Float64[np.ndarray, "*points 2"]

_STARTS = 64  # lines of the grid on which room for a start is looked for
_ROOM = 0.01  # least share of it: a start is then found after a hundred draws on average


@register_code
@dataclass(frozen=True, kw_only=True)
class TwoLinkArm:
    """φ′ = stops(φ + dt·clip(u, ±max_speed)),   rewards r¹ … r³ of what the step reached.

        p(φ) = (l₁ cos φ₁ + l₂ cos(φ₁ + φ₂), l₁ sin φ₁ + l₂ sin(φ₁ + φ₂))
        r¹ = exp(−d²/(2·reward_width²)),  d = distance of p(φ′) to the centre of the nearest object
        r² = 0 if φ + dt·clip(u) lies in `box`, edges included, else −1: judged before the stops hold the arm
        r³ = reward of the nearest object if d ≤ touch_radius, which ends the episode; else 0

    The state is φ, rad; the action u, rad/s. Stops are `box` widened on each side by `stop_margin` of its
    width. An episode starts uniformly in `box` where nothing is touched, and lasts `max_steps` at most.

    Parameters
    ----------
    link_lengths
        (l₁, l₂), m, as `touch_radius`, within which an object counts as touched, and `reward_width`.
    dt
        s, of a step.
    max_speed
        rad/s, of each joint.
    box
        ((least φ₁, greatest φ₁), (least φ₂, greatest φ₂)), rad.
    stop_margin
        Part of the box's width.
    objects
        One `ArmObject` or more, whose names differ.
    max_steps
        Time limit.

    Raises
    ------
    ValueError
        For constants that make no such arm.

    Notes
    -----
    The paper gives `box`, `max_steps` and the rewards' form (§4.1), docs/reproduction.md §3 the rest.
    """

    link_lengths: Pair = (1.0, 1.0)  # m
    dt: float = 0.05  # s
    max_speed: float = 3.0  # rad/s, of each joint
    box: tuple[Pair, Pair] = ((math.pi / 10, math.pi / 2), (math.pi / 4, 3 * math.pi / 4))  # rad; rows: φ₁, φ₂
    stop_margin: float = 0.25  # of the box's width, on each side
    objects: tuple[ArmObject, ...] = OBJECTS
    touch_radius: float = 0.06  # m
    reward_width: float = 0.3  # m
    max_steps: int = 1000

    def __post_init__(self) -> None:
        checked = {
            "link_lengths": pair_between("link_lengths", self.link_lengths, LEAST, MOST),
            "box": angle_box(self.box),
            "stop_margin": number_between("stop_margin", self.stop_margin, 0.0, MOST),
            "objects": distinct_objects(self.objects),
            "max_steps": positive_integer("max_steps", self.max_steps),
        }
        for name in ("dt", "max_speed", "touch_radius", "reward_width"):
            checked[name] = number_between(name, getattr(self, name), LEAST, MOST)
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        free = float(np.mean(self.touched(self.reachable_mesh(_STARTS, within="box")) == 0))
        if free < _ROOM:
            raise ValueError(f"at least {_ROOM:.0%} of the box should be free of objects to start in; found {free:.2%}")

    @property
    def reward_channels(self) -> int:
        """3: r¹ intrinsic, r² of the joints, r³ of the objects."""
        return 3

    @property
    def events(self) -> tuple[str, ...]:
        """The objects' names: event k ≥ 1 is a touch of the k-th."""
        return tuple(thing.name for thing in self.objects)

    @property
    def stops(self) -> tuple[Float64[np.ndarray, "2"], Float64[np.ndarray, "2"]]:
        """Least and greatest angles, rad, that the joints reach."""
        low, high = np.array(self.box).T
        margin = self.stop_margin * (high - low)
        return low - margin, high + margin

    def elbow(self, angles: ArrayLike) -> Points:
        """(l₁ cos φ₁, l₁ sin φ₁), m; angles: (…, 2), rad."""
        first = _vectors("angles", angles)[..., 0]
        return self.link_lengths[0] * np.stack([np.cos(first), np.sin(first)], axis=-1)

    def forward_kinematics(self, angles: ArrayLike) -> Points:
        """p(φ), m: the end effector; angles: (…, 2), rad, not stopped."""
        total = _vectors("angles", angles).sum(axis=-1)
        return self.elbow(angles) + self.link_lengths[1] * np.stack([np.cos(total), np.sin(total)], axis=-1)

    def intrinsic_reward(self, points: ArrayLike) -> Float64[np.ndarray, "*points"]:
        """r¹ at points (…, 2), m, of the plane, reachable or not: Fig. 6 (b)."""
        squared = self._squared_distances(points).min(axis=-1)
        return np.asarray(np.exp(-squared / (2 * self.reward_width**2)))

    def touched(self, points: ArrayLike) -> Int64[np.ndarray, "*points"]:
        """The event at points (…, 2), m: k if the nearest object is the k-th and within reach, else 0."""
        squared = self._squared_distances(points)
        touches = squared.min(axis=-1) <= self.touch_radius**2
        return np.where(touches, squared.argmin(axis=-1) + 1, 0)

    def reachable_mesh(
        self, lines: int = 25, *, within: Literal["stops", "box"] = "stops"
    ) -> Float64[np.ndarray, "lines lines 2"]:
        """p(φ), m, on a grid of angles: axis 0 is φ₁, axis 1 φ₂, edges included: the mesh of Fig. 6 (a).

        Parameters
        ----------
        lines
            ≥ 2 along each axis.
        within
            All that the stops allow, or the box where r² = 0.

        Raises
        ------
        ValueError
            For fewer lines and another `within`.
        """
        if positive_integer("lines", lines) < 2:
            raise ValueError(f"lines should be an integer ≥ 2; found {lines}")
        if within not in ("stops", "box"):
            raise ValueError(f"within should be 'stops' or 'box'; found {within!r}")
        low, high = self.stops if within == "stops" else np.array(self.box).T
        first, second = np.linspace(low, high, lines).T
        return self.forward_kinematics(np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1))

    def continuous_kernels(self) -> ContinuousKernels:
        """The dynamics for compiled code, and the only ones: the Gymnasium environment steps by them too."""
        from .arm_kernels import pack, reset, step  # numba loads here

        return ContinuousKernels(2, 2, self.reward_channels, pack(self), reset, step, self.max_steps, self.events)

    def _squared_distances(self, points: ArrayLike) -> Float64[np.ndarray, "*points objects"]:
        centres = np.array([thing.position for thing in self.objects])
        offsets = _vectors("points", points)[..., None, :] - centres
        return np.asarray((offsets**2).sum(axis=-1))


def _vectors(name: str, values: ArrayLike) -> Float64[np.ndarray, "*points 2"]:
    array = finite_array(name, values)
    if array.ndim == 0 or array.shape[-1] != 2:
        raise ValueError(f"{name} should have shape (…, 2); found {array.shape}")
    return array
