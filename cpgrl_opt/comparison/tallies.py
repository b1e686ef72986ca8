"""The cells of one solver pooled over families, and the same problems with and without the preparation."""

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from .measurement import OUTCOMES, Cell, Measurement, cells_of

UNSAFE = ("silently-wrong", "false-infeasible", "missed-infeasible", "hang", "crash")


@dataclass(frozen=True, kw_only=True)
class Tally:
    """Counts of one solver × variant over several families, each problem weighing the same.

    counts: in the order of OUTCOMES; distance_max: from the exact direction, None where never measured, and
    ill_posed_distance: the same over the families where float64 does not determine it, which enter no distance_max;
    time_ratio: geometric mean over the problems taken, None where none was.
    """

    solver: str
    variant: str
    problems: int
    counts: tuple[int, ...]
    noise: int
    distance_max: float | None
    ill_posed_distance: float | None
    time_ratio: float | None

    def count(self, outcome: str) -> int:
        """How many problems ended so."""
        return self.counts[OUTCOMES.index(outcome)]

    @property
    def taken(self) -> int:
        """Problems of a kind that the solver takes: all but the unsupported."""
        return self.problems - self.count("unsupported")

    @property
    def unsafe(self) -> int:
        """Answers that a caller is misled by, or never gets: UNSAFE together."""
        return sum(self.count(outcome) for outcome in UNSAFE)

    def percent(self, outcome: str) -> float | None:
        """100 · count / taken; None where nothing was taken."""
        return 100.0 * self.count(outcome) / self.taken if self.taken else None

    @property
    def solved(self) -> float:
        """100 · successes / problems, what is not taken counting as not solved."""
        return 100.0 * self.count("success") / self.problems if self.problems else 0.0


def tally(solver: str, variant: str, cells: Iterable[Cell], ill_posed: Collection[str] = ()) -> Tally:
    """The cells of this solver × variant added up. ill_posed: names of families."""
    own = [cell for cell in cells if (cell.solver, cell.variant) == (solver, variant)]
    return Tally(
        solver=solver,
        variant=variant,
        problems=sum(cell.problems for cell in own),
        counts=tuple(sum(getattr(cell, name.replace("-", "_")) for cell in own) for name in OUTCOMES),
        noise=sum(cell.noise for cell in own),
        distance_max=_farthest(cell for cell in own if cell.family not in ill_posed),
        ill_posed_distance=_farthest(cell for cell in own if cell.family in ill_posed),
        time_ratio=_pooled_ratio(own),
    )


def _farthest(cells: Iterable[Cell]) -> float | None:
    return max((cell.distance_max for cell in cells if cell.distance_max is not None), default=None)


def _pooled_ratio(cells: Iterable[Cell]) -> float | None:
    """exp(Σ wᵢ log rᵢ / Σ wᵢ), wᵢ the problems taken in cell i: the geometric mean over all of them."""
    pairs = [(cell.problems - cell.unsupported, cell.time_ratio) for cell in cells]
    logs = [(weight, math.log(ratio)) for weight, ratio in pairs if weight and ratio]
    total = sum(weight for weight, _ in logs)
    return math.exp(sum(weight * log for weight, log in logs) / total) if total else None


def tallies(cells: Sequence[Cell], variant: str, ill_posed: Collection[str] = ()) -> list[Tally]:
    """One per solver that has this variant, the best first.

    Best: the most successes per problem, taken or not, then the fewest unsafe answers, the fastest, the name.
    """
    solvers = dict.fromkeys(cell.solver for cell in cells if cell.variant == variant)
    return sorted((tally(solver, variant, cells, ill_posed) for solver in solvers), key=_rank)


def _rank(each: Tally) -> tuple[float, int, float, str]:
    return -each.solved, each.unsafe, each.time_ratio or math.inf, each.solver


@dataclass(frozen=True, kw_only=True)
class Gain:
    """One solver on the problems that it met both raw and prepared: what the preparation changed."""

    raw: Tally
    prepared: Tally

    @property
    def points(self) -> float:
        """Percentage points of success that the preparation adds."""
        return (self.prepared.percent("success") or 0.0) - (self.raw.percent("success") or 0.0)


def gains(measurements: Sequence[Measurement]) -> list[Gain]:
    """The greatest first; only problems that both variants took, so that like is compared with like."""
    taken = {variant: _taken(measurements, variant) for variant in ("raw", "prepared")}
    both = taken["raw"] & taken["prepared"]
    cells = cells_of(each for each in measurements if (each.solver, each.family, each.problem) in both)
    solvers = sorted({solver for solver, _, _ in both})
    found = [Gain(raw=tally(solver, "raw", cells), prepared=tally(solver, "prepared", cells)) for solver in solvers]
    return sorted(found, key=lambda gain: (-gain.points, gain.raw.solver))


def _taken(measurements: Iterable[Measurement], variant: str) -> set[tuple[str, str, int]]:
    return {
        (each.solver, each.family, each.problem)
        for each in measurements
        if each.variant == variant and each.outcome != "unsupported"
    }
