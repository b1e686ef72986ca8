"""What the numbers say, before it is put on a page: pooled counts, families, gains, the choice, profiles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from .choice import Choice, choose
from .measurement import Cell, Measurement
from .profiles import Key, Profile, performance_profiles, problems_met, problems_taken
from .report_context import ReportContext
from .tallies import Gain, Tally, gains, tallies, tally

FAR = 1e-6  # relative distance from the exact direction


@dataclass(frozen=True, kw_only=True)
class FamilyRow:
    """One family: who solves all of it.

    prepared, raw: the family's problems over all solvers, None where nobody was asked; solving, asked: the solvers
    behind the preparation that solve all, and their number that take any; fastest, time_ratio: among those solving.
    """

    family: str
    reason: str
    problems: int
    prepared: Tally | None
    raw: Tally | None
    solving: tuple[str, ...]
    asked: int
    fastest: str | None
    time_ratio: float | None


@dataclass(frozen=True)
class Astray:
    """The answers behind the preparation to one ill-posed family that count as success and whose d* is known.

    certified: their number; far: of them, how many are farther than FAR from d*; largest: distance, 0 without any.
    """

    family: str
    certified: int
    far: int
    largest: float


@dataclass(frozen=True, kw_only=True)
class Findings:
    """Everything that both documents show.

    prepared, raw: pooled counts, the best first; common: profiles of all solvers × variants over the problems that
    the raw back ends took too (all problems where there are no raw ones); profiles: of the prepared over all; astray:
    of each ill-posed family.
    """

    context: ReportContext
    cells: Mapping[tuple[str, str, str], Cell]
    families: tuple[str, ...]
    rows: tuple[FamilyRow, ...]
    prepared: tuple[Tally, ...]
    raw: tuple[Tally, ...]
    astray: tuple["Astray", ...]
    gains: tuple[Gain, ...]
    choice: Choice
    profiles: Mapping[Key, Profile]
    common: Mapping[Key, Profile]
    problems: int
    common_problems: int
    measured: int

    @property
    def solvers(self) -> tuple[str, ...]:
        """The prepared ones, the best first, then those that were measured raw only."""
        return tuple(dict.fromkeys(each.solver for each in (*self.prepared, *self.raw)))

    def tally(self, solver: str, variant: str) -> Tally | None:
        """The pooled counts of a solver × variant, None where it was not measured."""
        pool = self.prepared if variant == "prepared" else self.raw
        return next((each for each in pool if each.solver == solver), None)


def find(cells: Sequence[Cell], measurements: Sequence[Measurement], context: ReportContext) -> Findings:
    """All findings of a comparison."""
    met = dict.fromkeys(cell.family for cell in cells)
    families = tuple(name for name in dict.fromkeys((*context.families, *met)) if name in met)
    everything = problems_met(measurements, "prepared")
    common = problems_taken(measurements, "raw") or everything
    return Findings(
        context=context,
        cells={(cell.solver, cell.variant, cell.family): cell for cell in cells},
        families=families,
        rows=tuple(_family_row(family, context.families.get(family, ""), cells) for family in families),
        prepared=tuple(tallies(cells, "prepared", context.ill_posed)),
        raw=tuple(tallies(cells, "raw", context.ill_posed)),
        astray=tuple(_astray(family, measurements) for family in families if family in context.ill_posed),
        gains=tuple(gains(measurements)),
        choice=choose(cells),
        profiles=performance_profiles(measurements, everything, ("prepared",)),
        common=performance_profiles(measurements, common, ("prepared", "raw")),
        problems=len(everything | common),
        common_problems=len(common),
        measured=len(measurements),
    )


def _astray(family: str, measurements: Sequence[Measurement]) -> Astray:
    distances = [
        each.distance
        for each in measurements
        if (each.family, each.variant, each.outcome) == (family, "prepared", "success") and each.distance is not None
    ]
    return Astray(family, len(distances), sum(each > FAR for each in distances), max(distances, default=0.0))


def _family_row(family: str, reason: str, cells: Sequence[Cell]) -> FamilyRow:
    own = [cell for cell in cells if cell.family == family]
    taking = [cell for cell in own if cell.variant == "prepared" and cell.unsupported < cell.problems]
    solving = [cell for cell in taking if cell.success == cell.problems]
    timed = [(cell.time_ratio, cell.solver) for cell in solving if cell.time_ratio is not None]
    time_ratio, fastest = min(timed, default=(None, None))
    return FamilyRow(
        family=family,
        reason=reason,
        problems=max(cell.problems for cell in own),
        prepared=_over_solvers(own, "prepared"),
        raw=_over_solvers(own, "raw"),
        solving=tuple(cell.solver for cell in solving),
        asked=len(taking),
        fastest=fastest,
        time_ratio=time_ratio,
    )


def _over_solvers(cells: Sequence[Cell], variant: str) -> Tally | None:
    """The cells of all solvers added up, under no name."""
    own = [replace(cell, solver="") for cell in cells if cell.variant == variant]
    return tally("", variant, own) if own else None
