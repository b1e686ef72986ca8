"""Figures 4 and 5 of the paper: average rewards against episodes, and policies in the triangle of probabilities."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from cpgrl_opt.arrays import Float
from envs import TabularMDP

from ..bootstrap import spread
from ..figure_style import BLACK, BLUE, GREEN, PAGE_WIDTH, PURPLE, VERMILION, blank_figure, caption, panel_letter
from .curves import LearningCurves

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

LABELS = {"cpgrl": "CPGRL", "conb": "CONB", "sum": "SUM", "conb-tolerant": r"CONB$_\eta$"}
COLOURS = {"cpgrl": BLUE, "conb": VERMILION, "sum": GREEN, "conb-tolerant": PURPLE}
_TOLERANT = r" CONB$_\eta$: with a tolerance."
_GRID = 81  # points along an edge of a triangle


def averages_figure(
    curves: Mapping[str, LearningCurves],
    optimum: Float[np.ndarray, "channels"],
    thresholds: Float[np.ndarray, "m"],
) -> "Figure":
    """Fig. 4: estimated ρ¹ … ρ⁴, mean ± standard deviation over the runs, (a) to (d); insets magnify ρ ≈ G.

    Parameters
    ----------
    curves
        By method.
    optimum
        (1 + m,): drawn dashed.
    thresholds
        (m,): reward per step.

    Returns
    -------
    Figure
        Four panels.
    """
    figure = blank_figure(PAGE_WIDTH, 4.75)
    panels = figure.subplots(2, 2, sharex=True)
    figure.subplots_adjust(left=0.07, right=0.975, top=0.89, bottom=0.175, wspace=0.17, hspace=0.22)
    boxes = {1: (0.3, 0.33, 0.66, 0.4), 2: (0.3, 0.34, 0.66, 0.4)}
    for channel, axes in enumerate(panels.flat):
        _panel(axes, curves, channel, optimum, thresholds)
        panel_letter(axes, "abcd"[channel], rf"$\rho^{channel + 1}$")
        if channel in boxes:
            inset = axes.inset_axes(boxes[channel], zorder=8)
            _panel(inset, curves, channel, optimum, thresholds)
            _magnify(inset, thresholds[channel - 1])
    for axes in panels[1]:
        axes.set_xlabel("episode")
    handles, labels = panels[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=len(labels), columnspacing=1.5, handlelength=1.7)
    runs = len(next(iter(curves.values())).estimated)
    caption(
        figure,
        f"Average rewards as estimated by eq. (4) from 0 on: mean (line) and standard deviation (band) of {runs} runs. "
        "The optimum is that of the\noccupancy-measure linear programme; a shaded region ends at the threshold $G^i$. "
        "Insets: the same, magnified." + (_TOLERANT if "conb-tolerant" in curves else ""),
    )
    return figure


def policies_figure(curves: Mapping[str, LearningCurves], mdp: TabularMDP) -> "Figure":
    """Fig. 5: Pr(a₁|s), Pr(a₂|s) over the episodes for every method (row) and state (column), on ρ¹ as grey.

    Parameters
    ----------
    curves
        By method.
    mdp
        Whose ρ¹ is the grey.

    Returns
    -------
    Figure
        A row for each method, a column for each state.
    """
    from matplotlib.ticker import MultipleLocator

    figure = blank_figure(PAGE_WIDTH, 7.0)
    panels = figure.subplots(len(curves), mdp.states, sharex=True, sharey=True, squeeze=False)
    figure.subplots_adjust(left=0.105, right=0.88, top=0.96, bottom=0.135, wspace=0.08, hspace=0.08)
    backgrounds = {method: _averages_over_triangle(mdp, learned) for method, learned in curves.items()}
    low, high = (extreme([extreme(grid) for grid in backgrounds.values()]) for extreme in (np.min, np.max))
    for row, (method, learned) in zip(panels, curves.items(), strict=True):
        for state, axes in enumerate(row):
            image = _grey_triangle(axes, backgrounds[method][state], (low, high))
            _paths(axes, learned.policies[:, :, state, :2], COLOURS[method])
            axes.tick_params(left=state == 0, bottom=row is panels[-1])
        row[0].set_ylabel(rf"$\bf{{{LABELS[method].replace('$', '')}}}$" "\n" r"$\Pr(a_2 \mid s)$", linespacing=1.6)
    for state, axes in enumerate(panels[0]):
        panel_letter(axes, "abc"[state], rf"$s_{state + 1}$")
    for axes in panels[-1]:
        axes.set_xlabel(r"$\Pr(a_1 \mid s)$")
    bar = figure.colorbar(image, cax=figure.add_axes((0.905, 0.37, 0.016, 0.36)))
    bar.locator = MultipleLocator(0.5)
    bar.update_ticks()
    bar.set_label(r"average reward $\rho^1$")
    bar.outline.set_linewidth(0.6)
    runs, _, _, _ = next(iter(curves.values())).policies.shape
    caption(
        figure,
        f"Policies over the episodes, from the white circle to the coloured one: {runs} runs (thin, small dots at the "
        "end) and their mean (thick).\nThe corners of a triangle are $a_1$ (right), $a_2$ (top) and $a_3$ (origin). "
        "Grey: exact $\\rho^1$ as a function of this state's probabilities,\nthe other states held at the mean of the "
        "method's last policies." + (_TOLERANT if "conb-tolerant" in curves else ""),
    )
    return figure


def _panel(
    axes: "Axes",
    curves: Mapping[str, LearningCurves],
    channel: int,
    optimum: Float[np.ndarray, "channels"],
    thresholds: Float[np.ndarray, "m"],
) -> None:
    for order, (method, learned) in enumerate(curves.items()):
        values = learned.estimated[:, :, channel]
        mean, deviation = values.mean(axis=0), spread(values)
        colour, above = COLOURS[method], len(curves) - order  # the first method, the paper's, lies on top
        axes.fill_between(
            learned.episodes, mean - deviation, mean + deviation, color=colour, alpha=0.2, lw=0, zorder=above
        )
        axes.plot(learned.episodes, mean, color=colour, label=LABELS[method], zorder=3 + above)
    axes.axhline(optimum[channel], color=BLACK, lw=0.8, ls=(0, (5, 4)), zorder=7, label="exact constrained optimum")
    if channel:
        low, high = axes.get_ylim()
        threshold = thresholds[channel - 1]
        axes.axhspan(min(low, threshold) - 9, threshold, color="0.92", lw=0, zorder=0, label="constraint violated")
        axes.set_ylim(low, high)
    axes.set_xlim(0, learned.episodes[-1])


def _magnify(inset: "Axes", threshold: float) -> None:
    inset.set(ylim=(threshold - 0.1, threshold + 0.1), xticklabels=[])
    inset.tick_params(labelsize=7, length=1.5)
    inset.spines[["top", "right"]].set_visible(True)


def _averages_over_triangle(mdp: TabularMDP, learned: LearningCurves) -> Float[np.ndarray, "S rows columns"]:
    """ρ¹ exactly, with Pr(a₁|s) along the columns and Pr(a₂|s) along the rows for one s at a time.

    The other states keep the mean of the runs' last policies. Outside the triangle, where nothing is shown, values
    of its edge stand, so that interpolated pixels near the edge are right.
    """
    first, second = np.meshgrid(np.linspace(0, 1, _GRID), np.linspace(0, 1, _GRID))
    total = np.maximum(first + second, 1.0)
    row = np.stack([first / total, second / total, np.maximum(0.0, 1 - (first + second) / total)], axis=-1)
    final = learned.policies[:, -1].mean(axis=0)
    policies = np.broadcast_to(final, (mdp.states, *first.shape, *final.shape)).copy()
    for state in range(mdp.states):
        policies[state, ..., state, :] = row
    averages: Float[np.ndarray, "S rows columns"] = mdp.average_rewards(policies)[..., 0]
    return averages


def _grey_triangle(
    axes: "Axes", averages: Float[np.ndarray, "rows columns"], limits: tuple[float, float]
) -> "AxesImage":
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Polygon

    greys = LinearSegmentedColormap.from_list("greys", ["0.6", "1.0"])  # never so dark that paths drown
    edge = Polygon([(0, 0), (1, 0), (0, 1)], closed=True, fill=False, ec="0.2", lw=0.7, zorder=1.5)
    axes.add_patch(edge)
    image = axes.imshow(
        averages, cmap=greys, vmin=limits[0], vmax=limits[1], origin="lower", extent=(0, 1, 0, 1),
        interpolation="bilinear", zorder=1,
    )  # fmt: skip
    image.set_clip_path(edge)
    axes.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), aspect="equal", xticks=(0, 0.5, 1), yticks=(0, 0.5, 1))
    axes.spines[["left", "bottom"]].set_visible(False)
    return image


def _paths(axes: "Axes", probabilities: Float[np.ndarray, "R E 2"], colour: str) -> None:
    for run in probabilities:
        axes.plot(*run.T, color=colour, lw=0.4, alpha=0.4, zorder=2)
    axes.plot(*probabilities[:, -1].T, "o", ms=2, mew=0, color=colour, alpha=0.8, zorder=3)
    mean = probabilities.mean(axis=0)
    axes.plot(*mean.T, color=colour, lw=1.8, zorder=4)
    axes.plot(*mean[0], "o", ms=5, mfc="white", mec=BLACK, mew=0.8, zorder=5, clip_on=False)
    axes.plot(*mean[-1], "o", ms=5.5, mfc=colour, mec=BLACK, mew=0.8, zorder=6, clip_on=False)
