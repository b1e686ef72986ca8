"""A sheet for an environment's picture, without pyplot: no global state, no window."""

from typing import TYPE_CHECKING

import numpy as np

from .arrays import UInt8

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#26323b"
INCHES, _DPI = 4.0, 100  # 400 × 400 pixels
HEIGHT = 0.9  # of the sheet, below the caption


def blank_figure(caption: str) -> "tuple[Figure, Axes]":
    """The sheet with its caption, and what is drawn on."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(INCHES, INCHES), dpi=_DPI)
    FigureCanvasAgg(figure)
    figure.text(0.5, 0.94, caption, ha="center", va="center", color=INK, fontsize=10)
    axes = figure.add_axes((0, 0, 1, HEIGHT))
    axes.set_axis_off()
    return figure, axes


def picture_of(figure: "Figure") -> UInt8[np.ndarray, "height width 3"]:
    """Its pixels."""
    canvas = figure.canvas
    canvas.draw()
    return np.array(canvas.buffer_rgba())[:, :, :3].copy()  # type: ignore[attr-defined]
