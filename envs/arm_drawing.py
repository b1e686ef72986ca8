"""The two-link arm at work: a picture of it, and the parts that figures of it are drawn from."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from .arrays import Float64, UInt8
from .canvas import blank_figure, picture_of
from .two_link_arm import TwoLinkArm

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Points = Float64[np.ndarray, "points 2"]

# Marker, colour and size of the paper's objects; "none" is a time-out. Colours of Okabe & Ito (2008): told apart with
# any kind of colour vision, and in grey by lightness.
_LOOKS = {
    "circle": ("o", "#0072B2", 7.5),
    "star": ("*", "#D55E00", 11.0),
    "square": ("s", "#009E73", 7.0),
    "triangle": ("^", "#E69F00", 8.0),
    "none": ("", "0.55", 0.0),
}
_OTHER_LOOKS = (("D", "#8d5fb5"), ("P", "#4fb3b0"), ("X", "#a0672e"), ("v", "#d96fa8"), ("p", "#6b7a1e"))
_LINES = 60  # points along an edge of what the arm reaches


def outcome_looks(arm: TwoLinkArm) -> dict[str, tuple[str, str, float]]:
    """Marker, colour and size of each object by name, and of "none"; names that the paper has not take others in turn.

    Sizes are in points.
    """
    others = [name for name in arm.events if name not in _LOOKS]
    spare = {name: (*_OTHER_LOOKS[k % len(_OTHER_LOOKS)], 7.0) for k, name in enumerate(others)}
    return {name: spare.get(name) or _LOOKS[name] for name in (*arm.events, "none")}


def outline(arm: TwoLinkArm, within: Literal["stops", "box"]) -> Points:
    """The edge of what the arm reaches within its stops or the box of r²: the image of the angles' rectangle.

    p is one-to-one while 0 < φ₂ < π, so that edges are mapped to edges.
    """
    mesh = arm.reachable_mesh(_LINES, within=within)
    return np.concatenate([mesh[:, 0], mesh[-1], mesh[::-1, -1], mesh[0, ::-1]])


def frame(axes: "Axes", arm: TwoLinkArm, margin: float = 0.08, also: Sequence[Points] = ()) -> None:
    """Equal scales; limits, m, around base, reach and objects, and `also` around these points."""
    centres = [thing.position for thing in arm.objects]
    points = np.concatenate([outline(arm, "stops"), [(0.0, 0.0)], centres, *also])
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def draw_reach(axes: "Axes", arm: TwoLinkArm) -> None:
    """All that the stops allow, light; where r² = 0, darker with a dashed edge."""
    axes.fill(*outline(arm, "stops").T, fc="0.955", ec="0.6", lw=0.5, zorder=1)
    axes.fill(*outline(arm, "box").T, fc="0.90", ec="none", zorder=1.1)
    axes.plot(*outline(arm, "box").T, color="0.45", lw=0.6, ls=(0, (3, 2)), zorder=1.2)


def draw_objects(axes: "Axes", arm: TwoLinkArm, scale: float = 1.0) -> None:
    """Each with the circle within which it is touched."""
    from matplotlib.patches import Circle

    looks = outcome_looks(arm)
    for thing in arm.objects:
        marker, colour, size = looks[thing.name]
        axes.add_patch(Circle(thing.position, arm.touch_radius, fc="white", ec=colour, lw=0.7, alpha=0.9, zorder=3))
        axes.plot(*thing.position, marker, color=colour, ms=scale * size, mew=0, zorder=4)


def joints(arm: TwoLinkArm, angles: Float64[np.ndarray, "2"]) -> Float64[np.ndarray, "3 2"]:
    """Base, elbow and end effector, m."""
    return np.array([(0.0, 0.0), arm.elbow(angles), arm.forward_kinematics(angles)])


def draw_arm(
    axes: "Axes", arm: TwoLinkArm, angles: Float64[np.ndarray, "2"], *, colour: str = "0.2", width: float = 2.6,
    order: float = 5.0,
) -> None:  # fmt: skip
    """Two links, elbow, base and end effector."""
    points = joints(arm, angles)
    axes.plot(*points.T, color=colour, lw=width, solid_joinstyle="round", zorder=order)
    axes.plot(*points[1], "o", ms=1.15 * width, mfc="white", mec=colour, mew=0.3 * width, zorder=order + 0.1)
    axes.plot(*points[2], "o", ms=1.3 * width, mfc=colour, mew=0, zorder=order + 0.1)
    axes.plot(0, 0, "o", ms=2.2 * width, mfc="#000000", mew=0, zorder=order + 0.2, clip_on=False)


def arm_picture(
    arm: TwoLinkArm, angles: Float64[np.ndarray, "2"], caption: str = ""
) -> UInt8[np.ndarray, "height width 3"]:
    """Workspace and arm, 400 × 400 pixels; the scale depends on the arm's constants, not on `angles`."""
    figure, axes = blank_figure(caption)
    draw_reach(axes, arm)
    draw_objects(axes, arm)
    draw_arm(axes, arm, angles, width=4.0)
    elbows = arm.elbow(np.linspace(*arm.stops, _LINES))
    frame(axes, arm, arm.touch_radius + 0.05 * sum(arm.link_lengths), [elbows])
    return picture_of(figure)
