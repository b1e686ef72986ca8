"""Which solver to choose, from the numbers alone, by a rule that the report prints."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .table import count, rank

if TYPE_CHECKING:
    import pandas as pd

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
    families: Sequence[str]
    time: float
    choice_time: float


@dataclass(frozen=True)
class Choice:
    """first: the rule's choice; second: the rule's choice without the first, to cross-check with; "" without any."""

    first: str
    second: str
    specialists: Sequence[Specialist]


def choose(table: "pd.DataFrame") -> Choice:
    """RULE applied to the measurements."""
    prepared = table[table["variant"] == "prepared"]
    ranked = rank(count(prepared, ["solver"]))
    first = _best(ranked)
    return Choice(first, _best(ranked.drop(index=first, errors="ignore")), _specialists(prepared, ranked, first))


def _best(ranked: "pd.DataFrame") -> str:
    general = ranked[ranked["taken"] == ranked["taken"].max()]
    solved = 100.0 * general["success"] / general["problems"]
    near = general[solved >= solved.max() - MARGIN].assign(name=lambda rows: rows.index)
    return str(near.sort_values(["unsafe", "time", "name"]).index[0]) if len(near) else ""


def _specialists(prepared: "pd.DataFrame", ranked: "pd.DataFrame", first: str) -> list[Specialist]:
    found = []
    for solver in ranked.index:
        own = prepared[prepared["solver"] == solver]
        refused = own.loc[own["outcome"] == "unsupported", "family"]
        own = own[~own["family"].isin(refused)]
        if not len(refused) or not len(own) or ranked.loc[solver, "taken"] == ranked.loc[first, "taken"]:
            continue
        there = prepared[(prepared["solver"] == first) & prepared["family"].isin(own["family"])]
        time, choice_time = (count(rows, ["solver"])["time"].iloc[0] for rows in (own, there))
        if (own["outcome"] == "success").all() and SPEEDUP * time <= choice_time:
            found.append(Specialist(solver, list(own["family"].unique()), time, choice_time))
    return found
