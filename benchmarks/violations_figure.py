"""The figure of `violations_on_the_way.py`: slack of the worst constraint, and return, against updates."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rl.experiments.figure_style import (
    BLUE,
    DOTS_PER_INCH,
    GREEN,
    PAGE_WIDTH,
    VERMILION,
    blank_figure,
    caption,
    panel_letter,
    paper_style,
)

# Line and colour of each method, in their order; told apart in grey by the dashes.
_LOOKS = ((VERMILION, "-"), (BLUE, "-"), (GREEN, (0, (4, 1.5))))
_LINEAR = 0.1  # slack, in units of the threshold, within which a long axis is linear
_LONG = 1.0  # an axis that goes further down is logarithmic there
_MOMENTS = 250  # drawn at most; more would only blacken the noise


def write_figure(courses: Mapping[tuple[str, str], Any], path: Path) -> None:
    """A column for each task: above the slack, below the return; courses by (task, method)."""
    names = list(dict.fromkeys(name for name, _ in courses))
    with paper_style():
        figure = blank_figure(PAGE_WIDTH, 4.2)
        panels = figure.subplots(2, len(names), sharex="col")
        figure.subplots_adjust(left=0.09, right=0.975, top=0.87, bottom=0.2, wspace=0.27, hspace=0.12)
        for column, name in enumerate(names):
            mine = {method: course for (task, method), course in courses.items() if task == name}
            _draw_task(panels[:, column], mine, "abc"[column])
        panels[0, 0].set_ylabel("slack, % of threshold")
        panels[1, 0].set_ylabel("return")
        figure.align_ylabels(panels[:, 0])
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper center", ncols=len(labels), columnspacing=2.0)
        runs = len(next(iter(courses.values())).values)
        caption(
            figure,
            f"Median (line) and middle 80 % (band) of {runs} runs. Above: the worst constraint, violated where shaded; "
            f"(c) is logarithmic beyond\n±{100 * _LINEAR:.0f} %. Below: $\\rho^1$, on the gridworld over that of the "
            "best feasible policy. Exact on the gridworld, means over episodes on the arm.",
        )
        figure.savefig(path, dpi=DOTS_PER_INCH)


def _draw_task(panels: Any, courses: Mapping[str, Any], letter: str) -> None:
    above, below = panels
    task = next(iter(courses.values())).task
    for (method, course), look in zip(courses.items(), _LOOKS, strict=True):
        _draw_band(above, course.slack, task.updates, look, method)
        _draw_band(below, course.returns, task.updates, look, method)
    _shade_violations(above)
    panel_letter(above, letter, task.title)
    below.set(xlabel="updates", xlim=(0, task.updates))


def _shade_violations(axes: Any) -> None:
    low, high = axes.get_ylim()
    if low < -_LONG:
        axes.set_yscale("symlog", linthresh=_LINEAR, linscale=1.0)
        axes.set_yticks([*(-(10.0**power) for power in range(int(np.log10(-low)), -2, -1)), 0.0, _LINEAR])
        axes.minorticks_off()
    axes.axhspan(2 * low - 1, 0, color="0.93", lw=0, zorder=0)
    axes.axhline(0, color="0.3", lw=0.6, zorder=1)
    axes.set_ylim(low, high)
    axes.yaxis.set_major_formatter(lambda slack, _: f"{100 * slack:.0f}".replace("-", "−"))


def _draw_band(axes: Any, values: np.ndarray, updates: int, look: tuple[str, Any], label: str) -> None:
    colour, dashes = look
    drawn = slice(None, None, -(-values.shape[1] // _MOMENTS))
    moments = np.arange(1, values.shape[1] + 1) * updates / values.shape[1]
    low, middle, high = np.quantile(values[:, drawn], [0.1, 0.5, 0.9], axis=0)
    axes.fill_between(moments[drawn], low, high, color=colour, alpha=0.2, lw=0, zorder=2)
    axes.plot(moments[drawn], middle, color=colour, ls=dashes, label=label, lw=1.1, zorder=3)
