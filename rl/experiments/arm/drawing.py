"""The arm, what it reaches and the objects, in the look of the figures."""

from typing import TYPE_CHECKING, Any

import numpy as np

from cpgrl_opt.arrays import Float
from envs import TwoLinkArm

from ..figure_style import BLACK, BLUE, GREEN, ORANGE, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Marker, colour and size of the paper's objects; "none" is a time-out.
LOOKS = {
    "circle": ("o", BLUE, 7.5),
    "star": ("*", VERMILION, 11.0),
    "square": ("s", GREEN, 7.0),
    "triangle": ("^", ORANGE, 8.0),
    "none": ("", "0.55", 0.0),
}
REACH, BOX, EDGE = "0.955", "0.90", "0.6"
_LINES = 60  # points along an edge of what the arm reaches


def outline(arm: TwoLinkArm, within: Any) -> Float[np.ndarray, "points 2"]:
    """The edge of what the arm reaches within its "stops" or the "box" of r²: the image of the angles' rectangle."""
    mesh = arm.reachable_mesh(_LINES, within=within)
    return np.concatenate([mesh[:, 0], mesh[-1], mesh[::-1, -1], mesh[0, ::-1]])


def frame(axes: "Axes", arm: TwoLinkArm) -> None:
    """Equal scales, limits around base, reach and objects."""
    points = np.concatenate([outline(arm, "stops"), [(0.0, 0.0)], [thing.position for thing in arm.objects]])
    low, high = points.min(axis=0) - 0.08, points.max(axis=0) + 0.08
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def draw_reach(axes: "Axes", arm: TwoLinkArm) -> None:
    """All that the stops allow, light; where r² = 0, darker with a dashed edge."""
    axes.fill(*outline(arm, "stops").T, fc=REACH, ec=EDGE, lw=0.5, zorder=1)
    axes.fill(*outline(arm, "box").T, fc=BOX, ec="none", zorder=1.1)
    axes.plot(*outline(arm, "box").T, color="0.45", lw=0.6, ls=(0, (3, 2)), zorder=1.2)


def draw_objects(axes: "Axes", arm: TwoLinkArm, scale: float = 1.0) -> None:
    """Each with the circle within which it is touched."""
    from matplotlib.patches import Circle

    for thing in arm.objects:
        marker, colour, size = LOOKS[thing.name]
        axes.add_patch(Circle(thing.position, arm.touch_radius, fc="white", ec=colour, lw=0.7, alpha=0.9, zorder=3))
        axes.plot(*thing.position, marker, color=colour, ms=scale * size, mew=0, zorder=4)


def joints(arm: TwoLinkArm, angles: Float[np.ndarray, "2"]) -> Float[np.ndarray, "3 2"]:
    """Base, elbow and end effector, m."""
    return np.array([(0.0, 0.0), arm.elbow(angles), arm.forward_kinematics(angles)])


def draw_arm(
    axes: "Axes", arm: TwoLinkArm, angles: Float[np.ndarray, "2"], *, colour: str = "0.2", width: float = 2.6,
    order: float = 5.0,
) -> None:  # fmt: skip
    """Two links, elbow, base and end effector."""
    points = joints(arm, angles)
    axes.plot(*points.T, color=colour, lw=width, solid_joinstyle="round", zorder=order)
    axes.plot(*points[1], "o", ms=1.15 * width, mfc="white", mec=colour, mew=0.3 * width, zorder=order + 0.1)
    axes.plot(*points[2], "o", ms=1.3 * width, mfc=colour, mew=0, zorder=order + 0.1)
    axes.plot(0, 0, "o", ms=2.2 * width, mfc=BLACK, mew=0, zorder=order + 0.2, clip_on=False)
