"""Pictures of the two-link arm at work."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from .arrays import Float64, UInt8
from .two_link_arm import TwoLinkArm

_INK, _FAINT, _REACH, _BOX = "#26323b", "#aab4bb", "#f3f5f6", "#dcebf5"
_INCHES, _DPI = 4.0, 100  # 400 × 400 pixels
_LOOKS = {  # marker and colour of the paper's objects
    "circle": ("o", "#2f7fc4"),
    "star": ("*", "#c8452f"),
    "square": ("s", "#3c9a5f"),
    "triangle": ("^", "#f2b134"),
}
_OTHER_LOOKS = [("D", "#8d5fb5"), ("P", "#4fb3b0"), ("X", "#a0672e"), ("v", "#d96fa8"), ("p", "#6b7a1e")]


def object_looks(arm: TwoLinkArm) -> dict[str, tuple[str, str]]:
    """Marker and colour of each object by name; names other than the paper's take others in turn."""
    others = [name for name in arm.events if name not in _LOOKS]
    spare = {name: _OTHER_LOOKS[k % len(_OTHER_LOOKS)] for k, name in enumerate(others)}
    return {name: _LOOKS[name] if name in _LOOKS else spare[name] for name in arm.events}


def draw_workspace(axes: Axes, arm: TwoLinkArm) -> None:
    """What the arm reaches, the image of the r² box within it, and the objects with their touch radius."""
    axes.add_patch(Polygon(_outline(arm, "stops"), facecolor=_REACH, edgecolor=_FAINT, linewidth=1.2, zorder=1))
    axes.add_patch(Polygon(_outline(arm, "box"), facecolor=_BOX, edgecolor=_FAINT, linestyle="--", zorder=2))
    looks = object_looks(arm)
    for thing in arm.objects:
        marker, colour = looks[thing.name]
        axes.add_patch(Circle(thing.position, arm.touch_radius, facecolor="none", edgecolor=colour, zorder=3))
        axes.plot(*thing.position, marker=marker, color=colour, markersize=8, linestyle="none", zorder=4)
    low, high = _extent(arm)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def draw_arm(axes: Axes, arm: TwoLinkArm, angles: Float64[np.ndarray, "2"]) -> None:
    """The two links at `angles`, rad, from the base at the origin to the end effector."""
    joints = np.array([np.zeros(2), arm.elbow(angles), arm.forward_kinematics(angles)])
    axes.plot(*joints.T, color=_INK, linewidth=4, solid_capstyle="round", alpha=0.85, zorder=5)
    axes.plot(*joints[:2].T, "o", color="white", markeredgecolor=_INK, markersize=8, zorder=6)
    axes.plot(*joints[2], "o", color=_INK, markersize=5, zorder=7)


def arm_picture(
    arm: TwoLinkArm, angles: Float64[np.ndarray, "2"], caption: str = ""
) -> UInt8[np.ndarray, "height width 3"]:
    """Workspace and arm, 400 × 400 pixels; the scale depends on the arm's constants, not on `angles`."""
    figure = Figure(figsize=(_INCHES, _INCHES), dpi=_DPI)
    canvas = FigureCanvasAgg(figure)  # no pyplot: no global state, no window
    axes = figure.add_axes((0, 0, 1, 0.9))
    draw_workspace(axes, arm)
    draw_arm(axes, arm, angles)
    axes.set_axis_off()
    figure.text(0.5, 0.94, caption, ha="center", va="center", color=_INK, fontsize=10)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.array(canvas.buffer_rgba())[:, :, :3].copy()  # type: ignore[no-untyped-call]


def _outline(arm: TwoLinkArm, within: str) -> Float64[np.ndarray, "points 2"]:
    # p is one-to-one while 0 < φ₂ < π, so the edges of the grid of angles map to the edge of what is reached.
    mesh = arm.reachable_mesh(60, within="box" if within == "box" else "stops")
    return np.concatenate([mesh[:, 0], mesh[-1], mesh[::-1, -1], mesh[0, ::-1]])


def _extent(arm: TwoLinkArm) -> tuple[Float64[np.ndarray, "2"], Float64[np.ndarray, "2"]]:
    low, high = arm.stops
    elbows = arm.elbow(np.linspace(low, high, 60))
    objects = np.array([thing.position for thing in arm.objects])
    points = np.concatenate([np.zeros((1, 2)), _outline(arm, "stops"), elbows, objects])
    margin = 0.05 * float(np.ptp(points, axis=0).max()) + arm.touch_radius
    return points.min(axis=0) - margin, points.max(axis=0) + margin
