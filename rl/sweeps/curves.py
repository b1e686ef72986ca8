"""Learning curves of a sweep over its seeds and runs: mean, interquartile mean, intervals; as a table and a figure."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt.comparison.whole_file import whole_file

from ..experiments.bootstrap import interquartile_mean_intervals, mean_intervals
from ..experiments.figure_style import (
    BLACK,
    BLUE,
    DOTS_PER_INCH,
    GREEN,
    ORANGE,
    PAGE_WIDTH,
    PURPLE,
    SKY,
    VERMILION,
    YELLOW,
    blank_figure,
    paper_style,
)  # fmt: skip
from .cell import OURS
from .sweep import Sweep

STATISTICS = ("mean", "iqm")
_HEADS = [f"{name}{end}" for name in STATISTICS for end in ("", "_low", "_high")]
_RESAMPLES = 2000  # an interval's end then moves by about 2 % of its length from seed to seed
_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK, YELLOW)  # of the lines of a panel; more are left out
_DASHES = ("-", (0, (4, 2)), ":")  # of lines that lie on each other both are seen


def learning_curves(found: Sweep) -> list[dict[str, Any]]:
    """Statistics over the R runs of all seeds, for each combination of settings.

    Parameters
    ----------
    found
        What ended with an error is left out.

    Returns
    -------
    list of dict
        A row for each combination, recorded episode, channel and measure: the settings, `episode`, `channel`,
        `measure`, `runs` R; `mean`, `iqm` (the mean without the ⌊R/4⌋ smallest and largest), each with the ends `_low`
        and `_high` of a 95 % interval by 2000 bootstrap samples of the runs, the same for all that have R of them. One
        run has no length of interval.
    """
    columns = list(found.columns)
    keys = [*columns[: columns.index("seed")], "episode", "channel"]
    names = [name for name in columns[columns.index("channel") :] if name not in OURS]
    values: dict[tuple[Any, ...], list[list[float]]] = {}
    for row in found.rows:
        if not row["error"]:
            values.setdefault(tuple(row[key] for key in keys), []).append([row[name] for name in names])
    curves = []
    for place, own in values.items():
        rng, runs = np.random.default_rng(0), np.array(own)
        both = [find(runs, rng, resamples=_RESAMPLES) for find in (mean_intervals, interquartile_mean_intervals)]
        for name, statistics in zip(names, np.concatenate(both).T.tolist(), strict=True):
            known = {**dict(zip(keys, place, strict=True)), "measure": name, "runs": len(own)}
            curves.append({**known, **dict(zip(_HEADS, statistics, strict=True))})
    return curves


def draw_curves(curves: Sequence[Mapping[str, Any]], path: Path | str, statistic: str = "iqm") -> None:
    """A panel for each channel, a line for each combination of settings with its interval.

    Parameters
    ----------
    curves
        Of `learning_curves`; the first measure is drawn. Settings that do not vary are not named, and beyond eight
        combinations the others are left out, as the last line of the legend says.
    path
        PNG to write.
    statistic
        "mean" or "iqm".

    Raises
    ------
    ValueError
        Where there is nothing to draw.
    """
    if statistic not in STATISTICS or not curves:
        raise ValueError(f"there should be curves of {' or '.join(STATISTICS)}; found {len(curves)} of {statistic!r}")
    shown = [row for row in curves if row["measure"] == curves[0]["measure"]]
    channels = max(row["channel"] for row in shown) + 1
    columns = min(channels, 2)
    lines = -(-channels // columns)
    with paper_style():
        figure = blank_figure(PAGE_WIDTH, 2.1 * lines + 0.5)
        panels = list(figure.subplots(lines, columns, squeeze=False, sharex=True).flat)
        for channel, panel in enumerate(panels[:channels]):
            _draw_panel(panel, [row for row in shown if row["channel"] == channel], statistic)
            panel.set_title(rf"$\rho^{channel + 1}$", loc="left")
        for panel in panels[channels:]:
            panel.set_visible(False)
        for panel in panels[-columns:]:
            panel.set_xlabel("episode")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 2))
        figure.set_layout_engine("constrained")
        with whole_file(Path(path)) as beside:
            figure.savefig(beside, dpi=DOTS_PER_INCH, format="png")


def _draw_panel(panel: Any, rows: Sequence[Mapping[str, Any]], statistic: str) -> None:
    names = [*rows[0]][: [*rows[0]].index("episode")]
    varied = [name for name in names if len({row[name] for row in rows}) > 1]
    lines: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        label = ", ".join(f"{name} {row[name]}" for name in varied) or f"{row['runs']} runs"
        lines.setdefault(label, []).append(row)
    for k, (colour, (label, own)) in enumerate(zip(_COLOURS, lines.items(), strict=False)):
        names = ["episode", *(f"{statistic}{end}" for end in ("", "_low", "_high"))]
        episodes, values, *ends = ([row[name] for row in own] for name in names)
        panel.fill_between(episodes, *ends, color=colour, alpha=0.2, linewidth=0)
        panel.plot(episodes, values, color=colour, label=label, linestyle=_DASHES[k % len(_DASHES)])
    if len(lines) > len(_COLOURS):
        panel.plot([], [], " ", label=f"… and {len(lines) - len(_COLOURS)} more in the table")
