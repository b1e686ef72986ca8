"""Figures 6 and 7 of the paper: workspace and r¹; touches against episodes, with a learned path below each."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from cpgrl_opt.arrays import Float
from envs import TwoLinkArm
from envs.arm_drawing import draw_arm, draw_objects, draw_reach, frame, outcome_looks, outline

from ..bootstrap import spread
from ..figure_style import BLACK, PAGE_WIDTH, blank_figure, caption, panel_letter
from .curves import TouchCurves
from .paths import ArmPath

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PIXELS = 400  # of the map of r¹, along each axis
_POSTURES = 7  # of a learned path


def workspace_figure(arm: TwoLinkArm) -> "Figure":
    """Fig. 6: (a) the arm, the mesh of what it reaches, the objects; (b) r¹ over the same part of the plane.

    Parameters
    ----------
    arm
        What is drawn.

    Returns
    -------
    Figure
        Two panels.
    """
    figure = blank_figure(PAGE_WIDTH, 3.15)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    figure.subplots_adjust(left=0.065, right=0.9, top=0.95, bottom=0.285, wspace=0.1)
    for axes in (left, right):
        frame(axes, arm)
        axes.set_xlabel("x / m")
    left.set_ylabel("y / m")
    panel_letter(left, "a", "environment")
    panel_letter(right, "b", "intrinsic reward $r^1$")
    _mesh(left, arm)
    draw_objects(left, arm)
    draw_arm(left, arm, np.array([0.35, 0.62]) * np.pi)
    _intrinsic_reward(figure, right, arm)
    caption(
        figure,
        "(a) Mesh: what the end effector reaches between the stops; shaded: where the joint angles are within the "
        "bounds of $r^2$. The square is\nappetitive ($r^3 = 1$), the star aversive ($r^3 = -1$); an object is touched "
        "within the circle around it. (b) $r^1$ falls off with the distance\nto the nearest object; the line is the "
        "edge of what is reached.",
    )
    return figure


def touches_figure(
    curves: Mapping[str, TouchCurves], paths: Mapping[str, ArmPath], titles: Mapping[str, str]
) -> "Figure":
    """Fig. 7: for each condition touches per 100 episodes, mean ± standard deviation; below it a learned path.

    titles: of the conditions, by name, in the order of their columns.

    Parameters
    ----------
    curves
        By condition.
    paths
        A learned one of each condition.
    titles
        Of the conditions, by name, in the order of their columns.

    Returns
    -------
    Figure
        Two panels a condition.
    """
    count = len(titles)
    figure = blank_figure(PAGE_WIDTH, 4.3 if count > 1 else 2.9)
    # A single condition has its path beside it.
    panels = figure.subplots(2, count, squeeze=False) if count > 1 else figure.subplots(1, 2, squeeze=False).T
    figure.subplots_adjust(left=0.075, right=0.975, top=0.89 if count > 1 else 0.84, wspace=0.13, hspace=0.24)
    figure.subplots_adjust(bottom=0.11 if count > 1 else 0.29)
    for column, (name, title) in enumerate(titles.items()):
        above, below = panels[:, column]
        _touches(above, curves[name])
        panel_letter(above, name.replace("-", r"\text{-}"), title)
        above.tick_params(labelleft=column == 0)
        _path(below, curves[name].arm, paths[name])
    panels[0, 0].set_ylabel("touches per 100 episodes")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=len(labels), columnspacing=1.3, handlelength=1.4)
    runs, learned = len(curves[next(iter(titles))].touches), "Below" if count > 1 else "Right"
    caption(
        figure,
        f"Touches of the objects: mean (line) and standard deviation (band) of {runs} runs. {learned}: an episode of a "
        "typical run after learning,\nfrom beside the star (white circle); links at some moments, darker with time, "
        "and the way of the end effector. Shaded: the bounds of $r^2$.",
    )
    return figure


def _touches(axes: "Axes", curves: TouchCurves) -> None:
    from matplotlib.ticker import MaxNLocator

    rates, looks = curves.per_hundred(), outcome_looks(curves.arm)
    mean, deviation = rates.mean(axis=0), spread(rates)
    for k, outcome in enumerate(curves.outcomes):
        marker, colour, size = looks[outcome]
        label = outcome if outcome != "none" else "none (time-out)"
        low, high = (np.clip(mean[:, k] + sign * deviation[:, k], 0, 100) for sign in (-1, 1))
        axes.fill_between(curves.episodes, low, high, color=colour, alpha=0.18, lw=0, zorder=1)
        axes.plot(
            curves.episodes, mean[:, k], color=colour, label=label, marker=marker or None, ms=0.55 * size, mew=0,
            markevery=(len(mean) // 10 + k * len(mean) // 40, max(1, len(mean) // 4)), lw=1.1, zorder=2 + k,
        )  # fmt: skip
    axes.set(xlim=(0, curves.episodes[-1]), ylim=(0, 100), yticks=range(0, 101, 25), xlabel="episode")
    axes.xaxis.set_major_locator(MaxNLocator(4))


def _path(axes: "Axes", arm: TwoLinkArm, path: ArmPath) -> None:
    draw_reach(axes, arm)
    draw_objects(axes, arm, scale=0.85)
    last = len(path.angles) - 1
    moments = np.unique(np.linspace(0, last, min(_POSTURES, last + 1)).round().astype(int))
    for moment in moments:
        age = moment / max(last, 1)
        draw_arm(axes, arm, path.angles[moment], colour=f"{0.8 - 0.65 * age:.3f}", width=1.1 + 0.9 * age, order=5 + age)
    way = arm.forward_kinematics(path.angles)
    axes.plot(*way.T, color=BLACK, lw=0.7, zorder=7)
    axes.plot(*way[0], "o", ms=4, mfc="white", mec=BLACK, mew=0.7, zorder=8)
    frame(axes, arm)
    axes.set_axis_off()
    end = path.touched if path.touched != "none" else "no touch"
    axes.text(0.98, 0.02, f"{end}, {last} steps", transform=axes.transAxes, ha="right", va="bottom", fontsize=8)


def _mesh(axes: "Axes", arm: TwoLinkArm) -> None:
    draw_reach(axes, arm)
    mesh = arm.reachable_mesh(25)
    for lines in (mesh, mesh.swapaxes(0, 1)):
        for line in lines:
            axes.plot(*line.T, color="0.62", lw=0.35, zorder=1.5)


def _intrinsic_reward(figure: "Figure", axes: "Axes", arm: TwoLinkArm) -> None:
    low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
    x, y = np.linspace(low, high, _PIXELS).T
    reward: Float[np.ndarray, "y x"] = arm.intrinsic_reward(np.stack(np.meshgrid(x, y), axis=-1))
    extent = (low[0], high[0], low[1], high[1])
    image = axes.imshow(reward, origin="lower", extent=extent, cmap="Blues", vmin=0, vmax=1, interpolation="bilinear")
    axes.contour(x, y, reward, levels=np.arange(0.2, 1, 0.2), colors="0.3", linewidths=0.35)
    axes.plot(*outline(arm, "stops").T, color="0.2", lw=0.9)
    looks = outcome_looks(arm)
    for thing in arm.objects:
        marker, _, size = looks[thing.name]
        axes.plot(*thing.position, marker, color="white", mec=BLACK, mew=0.6, ms=0.8 * size, zorder=4)
    place = axes.get_position()
    bar = figure.colorbar(image, cax=figure.add_axes((0.915, place.y0, 0.016, place.height)))
    bar.set_ticks([0, 0.25, 0.5, 0.75, 1])
    bar.outline.set_linewidth(0.6)
