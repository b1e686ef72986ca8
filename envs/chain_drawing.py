"""A picture of a finite Markov decision process at work."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch

from .arrays import Float64, UInt8
from .canvas import HEIGHT, INCHES, INK, blank_figure, picture_of
from .tabular import TabularMDP

Place = Float64[np.ndarray, "2"]

_FAINT, _LIT, _TAKEN = "#d5dbe0", "#f2b134", "#c8452f"
_HALF_WIDTH, _HALF_HEIGHT = 1.75, 1.6  # what is shown, in units where the states stand on the unit circle
_POINTS = 72 * HEIGHT * INCHES / (2 * _HALF_HEIGHT)  # of 1/72 inch in such a unit


def draw_chain(mdp: TabularMDP, state: int, last: tuple[int, int] | None) -> UInt8[np.ndarray, "height width 3"]:
    """States on a circle, the present one lit; arrows as wide as the last action made each outcome likely.

    Without a last action the arrows show every move that some action can make. Red is the move that happened.
    """
    figure, axes = blank_figure(_caption(mdp, state, last))
    axes.set(xlim=(-_HALF_WIDTH, _HALF_WIDTH), ylim=(-_HALF_HEIGHT, _HALF_HEIGHT), aspect="equal")
    places = _places(mdp.states)
    radius = min(0.26, 1.6 / mdp.states)
    for source, target, width, colour in _moves(mdp, state, last):
        _draw_move(axes, places[source], places[target], radius, width, colour)
    for index, place in enumerate(places):
        fill = _LIT if index == state else "white"
        axes.add_patch(Circle(tuple(place), radius, facecolor=fill, edgecolor=INK, linewidth=1.5, zorder=3))
        if mdp.states <= 30:  # beyond that the names no longer fit
            name = f"$s_{{{index + 1}}}$"
            axes.text(place[0], place[1], name, ha="center", va="center", fontsize=60 * radius, zorder=4)
    return picture_of(figure)


def _places(states: int) -> Float64[np.ndarray, "states 2"]:
    # The first state on top, then clockwise.
    angle = np.pi / 2 - 2 * np.pi * np.arange(states) / states
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _moves(mdp: TabularMDP, state: int, last: tuple[int, int] | None) -> list[tuple[int, int, float, str]]:
    possible = mdp.transitions.max(axis=1) if mdp.states <= 12 else np.zeros((mdp.states, mdp.states))
    moves = [(int(s), int(j), 1.0, _FAINT) for s, j in np.argwhere(possible > 0)]
    if last is not None:
        source, action = last
        for target in np.flatnonzero(mdp.transitions[source, action] > 0):
            likely = float(mdp.transitions[source, action, target])
            moves.append((source, int(target), 1.0 + 4.0 * likely, _TAKEN if target == state else INK))
    return moves


def _draw_move(axes: Axes, source: Place, target: Place, radius: float, width: float, colour: str) -> None:
    start, end, bend, gap = source, target, 0.18, radius * _POINTS  # from the centre of a node to its rim
    if np.array_equal(source, target):
        # A loop outside the circle: leaves and enters the node left and right of its outward direction.
        side, out = np.array([-source[1], source[0]]) * 0.6 * radius, source * (1 + 0.8 * radius)
        start, end, bend, gap = out + side, out - side, -1.6, 0.0
    arrow = FancyArrowPatch(
        tuple(start), tuple(end), connectionstyle=f"arc3,rad={bend}", arrowstyle="-|>", mutation_scale=8 + 2 * width,
        shrinkA=gap, shrinkB=gap, linewidth=width, color=colour, zorder=1 if colour == _FAINT else 2,
    )  # fmt: skip
    axes.add_patch(arrow)


def _caption(mdp: TabularMDP, state: int, last: tuple[int, int] | None) -> str:
    if last is None:
        return f"start in $s_{{{state + 1}}}$"
    source, action = last
    rewards = ", ".join(f"{reward:.3g}" for reward in mdp.rewards[:6, source, action])
    more = ", …" if mdp.reward_channels > 6 else ""
    rewards = rewards.replace("-", "−")
    return f"$s_{{{source + 1}}}$, $a_{{{action + 1}}}$ → $s_{{{state + 1}}}$    r = ({rewards}{more})"
