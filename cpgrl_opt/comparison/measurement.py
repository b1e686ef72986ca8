"""What the comparison measures: one solver on one problem, and how a file keeps it.

A feasible problem is solved where worst ≤ 1e-9 (the referee's), an infeasible one where the Farkas vector y has
residual ≤ 1e-6 and, behind the preparation, the direction violates least to 1e-9; claimed optimal with worst > 1e-6
is silently wrong. Times are CPU seconds, quoted as ratios to the default solver's in the same round-robin.
"""

import csv
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

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


COLUMNS = [field.name for field in fields(Measurement)]


def write_measurements(path: Path, measurements: Iterable[Measurement]) -> None:
    """measurements.csv: a row per Measurement; written beside and moved, so that there is always a whole file."""
    with whole_file(path) as beside, beside.open("w", encoding="utf-8", errors=AS_BYTES, newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(map(to_row, measurements))


def read_measurements(path: Path) -> list[Measurement]:
    """What `write_measurements` wrote, bit for bit. ValueError where the columns are others."""
    with path.open(encoding="utf-8", errors=AS_BYTES, newline="") as file:
        reader = csv.DictReader(file)
        found = list(reader.fieldnames or ())
        if found != COLUMNS:
            raise ValueError(f"{path} should have the columns {', '.join(COLUMNS)}; found {', '.join(found)}")
        return [from_row(row) for row in reader]


def to_row(measurement: Measurement) -> dict[str, str]:
    """Column → text: numbers as Python writes them, an empty cell for None, 0 or 1 for a truth value."""
    return {name: _text(value) for name, value in asdict(measurement).items()}


def from_row(row: Mapping[str, str | None]) -> Measurement:
    """The measurement of a row of text; ValueError where it is cut short."""
    if any(row.get(name) is None for name in COLUMNS):
        raise ValueError(f"a row should have {len(COLUMNS)} cells; found {list(row.values())}")
    return Measurement(**{field.name: _READERS[field.type](str(row[field.name])) for field in fields(Measurement)})


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
