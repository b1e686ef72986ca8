"""What the comparison measures: one solver on one problem, and the counts of one solver on one family.

A feasible problem is solved where worst ≤ 1e-9 (the referee's), an infeasible one where the Farkas vector y has
residual ≤ 1e-6 and, behind the preparation, the direction violates least to 1e-9; claimed optimal with worst > 1e-6
is silently wrong. Times are CPU seconds, quoted as ratios to the default solver's in the same round-robin.
"""

import csv
import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from .whole_file import whole_file

SUCCESS_TOLERANCE = 1e-9  # the worst KKT residual of a solved problem
WRONG_TOLERANCE = 1e-6  # claimed optimal beyond it is silently wrong
PROOF_TOLERANCE = 1e-6  # the worst Farkas residual of a proof
# A file name that the locale cannot read comes with surrogates in it, and goes into a file as the bytes that it is.
AS_BYTES = "surrogateescape"

OUTCOMES = (
    "success",
    "inaccurate",
    "silently-wrong",
    "honest-failure",
    "false-infeasible",
    "missed-infeasible",
    "hang",
    "crash",
    "unsupported",
)
SOLVED = ("success", "inaccurate")  # what counts with its own time; the rest, but unsupported, counts at the limit


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """One solver × variant × family × problem.

    status: the name of the Status claimed, empty where there was no answer; outcome: one of OUTCOMES; worst: the
    referee's worst residual, or Farkas residual of a rightly claimed infeasibility (inf without an answer);
    distance: ‖d − d*‖ / max(‖g‖, ‖d*‖) from the exact d* where the problem is feasible and small enough (in a ball
    ‖d − d*‖ / radius; lengths in the metric where there is one); seconds:
    CPU, median of repeats; ratio: to the default solver's; limit: seconds that a failure counts as; noise: wrote to
    stdout or stderr.
    """

    solver: str
    variant: str
    family: str
    problem: int
    n: int
    m: int
    status: str
    outcome: str
    worst: float
    distance: float | None
    seconds: float
    ratio: float
    limit: float
    noise: bool

    @property
    def scored_ratio(self) -> float | None:
        """The ratio that enters a mean: limit over the default's seconds for a failure, None for unsupported."""
        if self.outcome == "unsupported":
            return None
        return self.ratio if self.outcome in SOLVED else max(self.ratio, self.limit * self.ratio / self.seconds)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One solver × variant × family: how often each outcome, how near, how slow.

    problems: their number, the sum of the nine counts that follow; distance_*: over the distances there are (None
    without); time_ratio: geometric mean of the scored ratios (None where all is unsupported); worst_median: of the
    answered problems (None without).
    """

    solver: str
    variant: str
    family: str
    problems: int
    success: int
    inaccurate: int
    silently_wrong: int
    honest_failure: int
    false_infeasible: int
    missed_infeasible: int
    hang: int
    crash: int
    unsupported: int
    noise: int
    distance_median: float | None
    distance_max: float | None
    time_ratio: float | None
    worst_median: float | None


def cells_of(measurements: Iterable[Measurement]) -> list[Cell]:
    """The counts of each solver × variant × family, in the order in which they first come."""
    groups: dict[tuple[str, str, str], list[Measurement]] = {}
    for each in measurements:
        groups.setdefault((each.solver, each.variant, each.family), []).append(each)
    return [_cell(key, group) for key, group in groups.items()]


def _cell(key: tuple[str, str, str], group: Sequence[Measurement]) -> Cell:
    solver, variant, family = key
    counts = {name.replace("-", "_"): sum(each.outcome == name for each in group) for name in OUTCOMES}
    distances = [each.distance for each in group if each.distance is not None]
    ratios = [each.scored_ratio for each in group if each.scored_ratio is not None]
    worsts = [each.worst for each in group if each.status and each.outcome != "unsupported"]
    return Cell(
        solver=solver,
        variant=variant,
        family=family,
        problems=len(group),
        noise=sum(each.noise for each in group),
        distance_median=statistics.median(distances) if distances else None,
        distance_max=max(distances, default=None),
        time_ratio=math.exp(statistics.fmean(map(math.log, ratios))) if ratios else None,
        worst_median=statistics.median(worsts) if worsts else None,
        **counts,
    )


T = TypeVar("T", Measurement, Cell)


def write_measurements(path: Path, measurements: Iterable[Measurement]) -> None:
    """measurements.csv: a row per Measurement; written beside and moved, so that there is always a whole file."""
    _write(path, Measurement, measurements)


def read_measurements(path: Path) -> list[Measurement]:
    """What `write_measurements` wrote, bit for bit. ValueError where the columns are others."""
    return _read(path, Measurement)


def write_cells(path: Path, cells: Iterable[Cell]) -> None:
    """solvers.csv: a row per Cell, first column `solver` as in SOLVERS."""
    _write(path, Cell, cells)


def read_cells(path: Path) -> list[Cell]:
    """What `write_cells` wrote, bit for bit. ValueError where the columns are others."""
    return _read(path, Cell)


def columns(kind: type[Measurement] | type[Cell]) -> list[str]:
    """The columns of a kind's CSV."""
    return [field.name for field in fields(kind)]


def to_row(record: Measurement | Cell) -> dict[str, str]:
    """Column → text: numbers as Python writes them, an empty cell for None, 0 or 1 for a truth value."""
    return {name: _text(value) for name, value in asdict(record).items()}


def _text(value: Any) -> str:
    if value is None:
        return ""
    return str(int(value)) if isinstance(value, bool) else str(value)


_READERS: Mapping[Any, Callable[[str], Any]] = {
    str: str,
    int: int,
    float: float,
    bool: lambda text: bool(int(text)),
    float | None: lambda text: float(text) if text else None,
}


def _write(path: Path, kind: type[Measurement] | type[Cell], records: Iterable[Measurement | Cell]) -> None:
    with whole_file(path) as beside, beside.open("w", encoding="utf-8", errors=AS_BYTES, newline="") as file:
        writer = csv.DictWriter(file, columns(kind), lineterminator="\n")
        writer.writeheader()
        writer.writerows(to_row(record) for record in records)


def _read(path: Path, kind: type[T]) -> list[T]:
    with path.open(encoding="utf-8", errors=AS_BYTES, newline="") as file:
        reader = csv.DictReader(file)
        found = list(reader.fieldnames or ())
        if found != columns(kind):
            raise ValueError(f"{path} should have the columns {', '.join(columns(kind))}; found {', '.join(found)}")
        return [from_row(kind, row) for row in reader]


def from_row(kind: type[T], row: Mapping[str, str | None]) -> T:
    """The record of a row of text; ValueError where it is cut short."""
    if any(row.get(name) is None for name in columns(kind)):
        raise ValueError(f"a row should have {len(columns(kind))} cells; found {list(row.values())}")
    return kind(**{field.name: _READERS[field.type](str(row[field.name])) for field in fields(kind)})
