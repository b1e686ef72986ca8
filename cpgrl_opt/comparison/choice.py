"""Which solver to choose, from the numbers alone, by a rule that the report prints."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .measurement import Cell
from .tallies import Tally, tallies, tally

MARGIN = 5.0  # percentage points of success that a safer solver may be behind the best
SPEEDUP = 1.5  # times mean less below it, on a machine that does other things too

RULE = (
    "Only solvers behind the preparation, as the package offers them; of these, the ones that take the most problems.",
    f"Of these, the ones whose success is at most {MARGIN:g} percentage points below the highest.",
    "Of these, the ones with the fewest unsafe answers (silently wrong, false or missed infeasible, hang, crash).",
    "Of these, the fastest by the geometric mean of its time ratio.",
    "Beside it, a solver that takes only some problems is named where it solves every problem of the families that it "
    f"takes, at least {SPEEDUP:g} times as fast as the choice.",
)


@dataclass(frozen=True)
class Specialist:
    """A solver that takes only some families, and there solves everything, much faster than the general choice."""

    solver: str
    families: tuple[str, ...]
    time_ratio: float
    choice_time_ratio: float


@dataclass(frozen=True)
class Choice:
    """first: the rule's choice; second: the rule's choice without the first, to cross-check with; None without any."""

    first: Tally | None
    second: Tally | None
    specialists: tuple[Specialist, ...]


def choose(cells: Sequence[Cell]) -> Choice:
    """RULE applied to the cells."""
    ranked = tallies(cells, "prepared")
    first = _best(ranked)
    second = _best([each for each in ranked if each is not first])
    return Choice(first, second, _specialists(cells, ranked, first) if first else ())


def _best(candidates: Sequence[Tally]) -> Tally | None:
    if not candidates:
        return None
    most = max(each.taken for each in candidates)
    general = [each for each in candidates if each.taken == most]
    highest = max(each.solved for each in general)
    near = [each for each in general if each.solved >= highest - MARGIN]
    return min(near, key=lambda each: (each.unsafe, each.time_ratio or math.inf, each.solver))


def _specialists(cells: Sequence[Cell], ranked: Sequence[Tally], first: Tally) -> tuple[Specialist, ...]:
    found = []
    for each in ranked:
        if each.taken == first.taken or not each.taken:
            continue
        own = [
            cell for cell in cells if (cell.solver, cell.variant) == (each.solver, "prepared") and not cell.unsupported
        ]
        families = tuple(cell.family for cell in own)
        there = tally(first.solver, "prepared", [cell for cell in cells if cell.family in families])
        here = tally(each.solver, "prepared", own)
        perfect = here.count("success") == here.problems
        if perfect and here.time_ratio and there.time_ratio and SPEEDUP * here.time_ratio <= there.time_ratio:
            found.append(Specialist(each.solver, families, here.time_ratio, there.time_ratio))
    return tuple(found)
