"""Learning curves of a sweep over its seeds and runs: mean, interquartile mean, intervals; as a table and a figure."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt.comparison.whole_file import whole_file

from ..experiments.bootstrap import interquartile_mean_intervals, mean_intervals
from .cell import OURS
from .sweep import Sweep

STATISTICS = ("mean", "iqm")
_RESAMPLES = 2000  # an interval's end then moves by about 2 % of its length from seed to seed
_SHOWN = 8  # lines a panel, told apart by their colours
_DASHES = ("-", (0, (4, 2)), ":")  # of lines that lie on each other both are seen


def learning_curves(found: Sweep) -> list[dict[str, Any]]:
    """Over the R runs of all seeds, by settings, episode, channel and measure: a row with the statistics.

    Beside the columns of the settings: `episode`, `channel`, `measure`, `runs` R; `mean`, `iqm` (the mean without the
    ⌊R/4⌋ smallest and largest), each with the ends `_low` and `_high` of a 95 % interval by 2000 bootstrap samples of
    the runs, the same for all settings. What ended with an error is left out, and one run has no length of interval.
    """
    settings, names = _columns(found)
    values: dict[tuple[Any, ...], list[list[float]]] = {}
    for row in found.rows:
        if not row["error"]:
            place = (*(row[name] for name in settings), row["episode"], row["channel"])
            values.setdefault(place, []).append([row[name] for name in names])
    statistics: dict[tuple[Any, ...], np.ndarray] = {}
    for runs in {len(own) for own in values.values()}:
        places = [place for place, own in values.items() if len(own) == runs]
        alike = np.array([values[place] for place in places])
        rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(runs,)))
        of_means = mean_intervals(alike, rng, resamples=_RESAMPLES)
        both = np.concatenate([of_means, interquartile_mean_intervals(alike, rng, resamples=_RESAMPLES)], axis=1)
        statistics.update(zip(places, both, strict=True))
    heads = [f"{name}{end}" for name in STATISTICS for end in ("", "_low", "_high")]
    return [
        {**dict(zip((*settings, "episode", "channel"), place, strict=True)), "measure": name, "runs": len(own),
            **dict(zip(heads, statistics[place][:, position].tolist(), strict=True))}
        for place, own in values.items() for position, name in enumerate(names)
    ]  # fmt: skip


def _columns(found: Sweep) -> tuple[list[str], list[str]]:
    """Of settings, and of what was measured."""
    columns = list(found.columns)
    first, last = columns.index("seed"), columns.index("channel")
    return columns[:first], [name for name in columns[last:] if name not in OURS]


def draw_curves(curves: Sequence[Mapping[str, Any]], path: Path | str, statistic: str = "iqm") -> None:
    """A panel for each channel, a line for each combination of settings with its interval; a PNG.

    Of the first measure. Settings that do not vary are not named, and beyond eight combinations the others are left
    out, as the last line of the legend says. statistic: "mean" or "iqm". ValueError where there is nothing to draw.
    """
    from ..experiments.figure_style import DOTS_PER_INCH, PAGE_WIDTH, blank_figure, paper_style

    if statistic not in STATISTICS or not curves:
        raise ValueError(f"there should be curves of {' or '.join(STATISTICS)}; found {len(curves)} of {statistic!r}")
    shown = [row for row in curves if row["measure"] == curves[0]["measure"]]
    channels = max(row["channel"] for row in shown) + 1
    columns = min(channels, 2)
    with paper_style():
        lines = -(-channels // columns)
        figure = blank_figure(PAGE_WIDTH, 2.1 * lines + 0.5)
        panels = list(figure.subplots(lines, columns, squeeze=False, sharex=True).flat)
        for channel, panel in enumerate(panels):
            if channel < channels:
                _draw_panel(panel, [row for row in shown if row["channel"] == channel], channel, statistic)
            else:
                panel.set_visible(False)
        for panel in panels[-columns:]:
            panel.set_xlabel("episode")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 2))
        figure.set_layout_engine("constrained")
        with whole_file(Path(path)) as beside:
            figure.savefig(beside, dpi=DOTS_PER_INCH, format="png")


def _draw_panel(panel: Any, rows: Sequence[Mapping[str, Any]], channel: int, statistic: str) -> None:
    from ..experiments.figure_style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, YELLOW

    colours = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK, YELLOW)
    lines: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    names = [*rows[0]][: [*rows[0]].index("episode")]
    for row in rows:
        lines.setdefault(tuple(row[name] for name in names), []).append(row)
    varied = [own for own in range(len(names)) if len({settings[own] for settings in lines}) > 1]
    for k, (settings, own) in enumerate(list(lines.items())[:_SHOWN]):
        colour = colours[k]
        label = ", ".join(f"{names[own]} {settings[own]}" for own in varied) or f"{own[0]['runs']} runs"
        episodes, *ends = ([row[name] for row in own] for name in ("episode", f"{statistic}_low", f"{statistic}_high"))
        panel.fill_between(episodes, *ends, color=colour, alpha=0.2, linewidth=0)
        panel.plot(
            episodes, [row[statistic] for row in own], color=colour, label=label, linestyle=_DASHES[k % len(_DASHES)]
        )
    if len(lines) > _SHOWN:
        panel.plot([], [], " ", label=f"… and {len(lines) - _SHOWN} more in the table")
    panel.set_title(rf"$\rho^{channel + 1}$", loc="left")
