"""How the figures look: a printed paper's page, colours that the colour-blind tell apart, PNG and SVG."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe & Ito (2008): told apart with any kind of colour vision, and in grey by lightness.
BLUE, VERMILION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, YELLOW, BLACK = "#56B4E9", "#CC79A7", "#F0E442", "#000000"

PAGE_WIDTH = 6.9  # inches: the text width of a page with two columns
DOTS_PER_INCH = 200

_STYLE: Any = {
    "font.family": "STIXGeneral",  # comes with matplotlib, so a figure looks the same on every machine
    "mathtext.fontset": "stix",
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.titlesize": 9,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "round",
    "svg.hashsalt": "cpgrl",  # the same figure gives the same file
}


@contextmanager
def paper_style() -> Iterator[None]:
    """The style while drawing and saving, whatever a user's matplotlibrc says; its settings are back afterwards."""
    from matplotlib.style import context

    with context(["default", _STYLE]):
        yield


def blank_figure(width: float, height: float) -> "Figure":
    """A figure of its own, in inches, without pyplot's global state or a window.

    Parameters
    ----------
    width, height
        Inches.

    Returns
    -------
    Figure
        Of the Agg back end.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: "Figure", directory: Path, name: str) -> list[Path]:
    """`name`.png and `name`.svg.

    Parameters
    ----------
    figure
        Drawn in `paper_style`.
    directory
        For both files.
    name
        Without an ending.

    Returns
    -------
    list of Path
        The files.
    """
    png, svg = directory / f"{name}.png", directory / f"{name}.svg"
    figure.savefig(png, dpi=DOTS_PER_INCH)
    figure.savefig(svg, metadata={"Date": None})
    return [png, svg]


def panel_letter(axes: "Axes", letter: str, text: str = "") -> None:
    """(a) in bold above the panel's left edge, then its title.

    Parameters
    ----------
    axes
        The panel.
    letter, text
        In bold, and as it is.
    """
    axes.set_title(rf"$\bf{{({letter})}}$  {text}", loc="left", y=1.0, pad=4)


def caption(figure: "Figure", text: str) -> None:
    """A few lines below the panels that say what is drawn.

    Parameters
    ----------
    figure
        With room below its panels.
    text
        Lines, broken as they are shown.
    """
    figure.text(0.012, 0.012, text, fontsize=8, color="0.25", va="bottom", ha="left", linespacing=1.25)
