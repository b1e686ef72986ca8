"""Figures look the same whatever a user's matplotlibrc says, and leave its settings alone."""

import matplotlib as mpl
import numpy as np

from rl.experiments.figure_style import blank_figure, panel_letter, paper_style, save_figure

# As somebody's matplotlibrc may have it.
ODD = {
    "axes.grid": True,
    "axes.facecolor": "black",
    "lines.linestyle": "--",
    "savefig.bbox": "tight",
    "savefig.transparent": True,
    "svg.fonttype": "none",
    "figure.subplot.left": 0.4,
}


def drawn(directory):
    """The bytes of a figure with lines, legend and letters."""
    directory.mkdir()
    with paper_style():
        figure = blank_figure(3.0, 2.0)
        axes = figure.subplots()
        axes.plot(np.arange(5) ** 2, label="squares")
        axes.legend()
        panel_letter(axes, "a", "title")
        return [path.read_bytes() for path in save_figure(figure, directory, "figure")]


def test_a_users_matplotlibrc_changes_nothing_and_is_not_changed(tmp_path):
    plain = drawn(tmp_path / "plain")
    with mpl.rc_context(ODD):
        before = dict(mpl.rcParams)
        assert drawn(tmp_path / "odd") == plain
        assert dict(mpl.rcParams) == before
