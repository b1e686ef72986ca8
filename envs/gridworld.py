"""A small world of cells with walls, a goal, and hazards that are bounded one kind by one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .arrays import Float64, Rewards, Transitions
from .tabular import TabularMDP
from .validation import number_between

# From S to G 4 moves through a, 6 through b, 8 through neither.
LAYOUT = (
    ".....",
    ".###.",
    "S.a.G",
    "..b..",
    "..#..",
)
ACTIONS = ("north", "east", "south", "west")
_MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))  # (rows, columns), in the order of ACTIONS
_START, _GOAL, _FREE, _WALL = "SG.#"

Cell = tuple[int, int]


@dataclass(frozen=True, init=False, eq=False)
class GridWorld(TabularMDP):
    """max ρ¹  s.t.  ρⁱ ≥ Gⁱ:   ρ¹ = goals per step,   −ρⁱ = share of time on hazards of kind i − 1.

        T(s, a, ·) = (1 − slip) δ(s ⊕ a) + ½ slip (δ(s ⊕ a⟂) + δ(s ⊕ −a⟂)),    T(goal, a, ·) = δ(start)
        r¹(s, a) = 1[s is the goal],    rⁱ(s, a) = −1[s is of kind i − 1]

    s ⊕ a is the next cell that way, or s itself where a wall or the edge is; a⟂ is at right angles to a. Without slip
    and constraints the best ρ¹ is 1/(L + 1), L the moves of a shortest way.

    Parameters
    ----------
    layout
        Rows of cells from north to south: `S` start and `G` goal, one each, `.` free, `#` wall, `a` … `z` hazards, one
        kind and channel a letter, in the order of the alphabet. Each cell that is no wall is a state, in reading order.
    slip
        Probability, in [0, 1].

    Raises
    ------
    ValueError
        For another layout, and where walls part some cell from the start.
    """

    layout: tuple[str, ...]
    slip: float

    def __init__(self, layout: Sequence[str] = LAYOUT, slip: float = 0.1) -> None:
        object.__setattr__(self, "layout", _check(layout))
        object.__setattr__(self, "slip", number_between("slip", slip, 0.0, 1.0))
        cells = self.cells
        marks = [self.layout[row][column] for row, column in cells]
        start, goal = marks.index(_START), marks.index(_GOAL)
        transitions = _transitions(cells, self.slip)
        transitions[goal] = np.eye(len(cells))[start]
        super().__init__(transitions, _rewards(marks, self.hazards), start)

    @property
    def cells(self) -> list[Cell]:
        """(row, column) of each state."""
        return _cells(self.layout)

    @property
    def hazards(self) -> list[str]:
        """The kinds of hazards: the letters of channels 1 … m."""
        return sorted({mark for row in self.layout for mark in row if mark.islower()})


def _check(layout: Sequence[str]) -> tuple[str, ...]:
    is_sequence = isinstance(layout, Sequence) and not isinstance(layout, str)
    if not is_sequence or not layout or not all(isinstance(row, str) for row in layout):
        raise ValueError(f"layout should be strings, one a row; found {layout!r}")
    rows = tuple(layout)
    if len({len(row) for row in rows}) != 1:
        raise ValueError(f"layout should have rows of one length; found {[len(row) for row in rows]}")
    marks = "".join(rows)
    strange = sorted({mark for mark in marks if mark not in "SG.#" and not "a" <= mark <= "z"})
    if strange:
        raise ValueError(f"layout should consist of S, G, ., # and a … z; found {strange[0]!r}")
    if marks.count(_START) != 1 or marks.count(_GOAL) != 1:
        raise ValueError(
            f"layout should have one S and one G; found {marks.count(_START)} and {marks.count(_GOAL)} of them"
        )
    cells = _cells(rows)
    apart = set(cells) - _reach_from(cells, cells[[rows[r][c] for r, c in cells].index(_START)])
    if apart:
        raise ValueError(f"layout should have a way from S to each cell that is no wall; found none to {min(apart)}")
    return rows


def _cells(rows: Sequence[str]) -> list[Cell]:
    return [(r, c) for r, row in enumerate(rows) for c, mark in enumerate(row) if mark != _WALL]


def _reach_from(cells: Sequence[Cell], start: Cell) -> set[Cell]:
    free, reached, edge = set(cells), {start}, [start]
    while edge:
        row, column = edge.pop()
        new = {(row + down, column + right) for down, right in _MOVES} & free - reached
        reached |= new
        edge += new
    return reached


def _transitions(cells: Sequence[Cell], slip: float) -> Float64[np.ndarray, "states actions states"]:
    number = {cell: state for state, cell in enumerate(cells)}
    transitions: Transitions = np.zeros((len(cells), len(_MOVES), len(cells)))
    for state, (row, column) in enumerate(cells):
        after = [number.get((row + down, column + right), state) for down, right in _MOVES]
        for action in range(len(_MOVES)):
            for turn, chance in ((0, 1 - slip), (1, slip / 2), (3, slip / 2)):
                transitions[state, action, after[(action + turn) % 4]] += chance
    return transitions


def _rewards(marks: Sequence[str], hazards: Sequence[str]) -> Rewards:
    """(1 + m, states, actions), the same for all actions."""
    of_states = np.array([[mark == _GOAL for mark in marks], *([mark == kind for mark in marks] for kind in hazards)])
    signs = np.where(np.arange(len(of_states)) == 0, 1.0, -1.0)
    return np.repeat((signs[:, None] * of_states)[:, :, None], len(_MOVES), axis=2)
