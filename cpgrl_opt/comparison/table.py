"""The measurements as one tidy table, and what is counted in it.

A row per solver × variant × family × problem, columns as `Measurement` names them; a problem that a solver does not
take, "unsupported", enters no share and no mean.
"""

from collections.abc import Collection, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .measurement import AS_BYTES, COLUMNS, OUTCOMES, SOLVED, Measurement

if TYPE_CHECKING:
    import pandas as pd

UNSAFE = ("silently-wrong", "false-infeasible", "missed-infeasible", "hang", "crash")  # misled, or never answered
_TEXT = {each.name: str for each in fields(Measurement) if each.type is str}
_LEAST_RATIO = 1e-6  # also in s: a clock that did not tick between two readings gives 0


class ReportPackagesError(ImportError):
    """pandas or Jinja is not installed; the message is the command that installs them."""

    def __init__(self) -> None:
        super().__init__("the report needs the packages pandas and jinja2; type: pip install 'cpgrl-opt[report]'")


def pandas() -> Any:
    """The module; ReportPackagesError that says what to type where it, or Jinja, is not there."""
    try:
        import jinja2  # noqa: F401 - what the report is made with
        import pandas as module
    except ImportError as error:
        raise ReportPackagesError from error
    return module


def readable(name: str) -> str:
    """A file name whose bytes the locale could not read, as UTF-8, which pandas' strings are."""
    return name.encode("utf-8", AS_BYTES).decode("utf-8", "replace")


def load(folder: Path | str) -> "pd.DataFrame":
    """The measurements of `cpgrl compare --out folder`, a row each: the columns of measurements.csv.

    Parameters
    ----------
    folder
        Where `measurements.csv` lies.

    Returns
    -------
    DataFrame
        `distance` is NaN where the exact direction is not known, `noise` is 0 or 1; `seconds` and `limit` are seconds
        of CPU.

    Raises
    ------
    ImportError
        Without the extra `report`.
    FileNotFoundError
        Where there are no measurements.
    ValueError
        Where their columns are others.
    """
    path = Path(folder) / "measurements.csv"
    told = {"keep_default_na": False, "na_values": {"distance": [""]}, "encoding_errors": "replace", "dtype": _TEXT}
    frame: pd.DataFrame = pandas().read_csv(path, **told)
    if list(frame.columns) != COLUMNS:
        raise ValueError(f"{path} should have the columns {COLUMNS}; found {list(frame.columns)}")
    return frame


def as_table(measurements: Sequence[Measurement]) -> "pd.DataFrame":
    """The same of measurements in memory."""
    rows = [vars(each) | {"solver": readable(each.solver), "family": readable(each.family)} for each in measurements]
    frame: pd.DataFrame = pandas().DataFrame(rows, columns=COLUMNS)
    return frame.astype({"distance": float})


def count(table: "pd.DataFrame", by: Sequence[str], ill_posed: Collection[str] = ()) -> "pd.DataFrame":
    """How the problems of each group ended: a column for each of OUTCOMES, `problems`, `taken`, `unsafe`, `noise`.

    time: geometric mean of the time ratios of what is taken, failures at the time limit; distance, ill_posed: the
    largest from the exact direction, on families of which float64 determines it, and on the others.
    """
    is_taken, ill = table["outcome"] != "unsupported", table["family"].isin(list(ill_posed))
    ratio, seconds = (table[name].where(is_taken).clip(lower=_LEAST_RATIO) for name in ("ratio", "seconds"))
    at_limit = np.maximum(ratio, table["limit"] * ratio / seconds)
    ratio = ratio.where(table["outcome"].isin(SOLVED), at_limit)
    table = table.assign(
        _log=np.log(ratio),
        _near=table["distance"].where(~ill),
        _far=table["distance"].where(ill),
    )
    groups = table.groupby(list(by), sort=False)
    found = groups["outcome"].value_counts().unstack(fill_value=0).reindex(columns=list(OUTCOMES), fill_value=0)
    found = found.reindex(groups.size().index)
    found["problems"] = groups.size()
    found["taken"] = found["problems"] - found["unsupported"]
    found["unsafe"] = found[list(UNSAFE)].sum(axis=1)
    found["noise"] = groups["noise"].sum().astype(int)
    found["distance"], found["ill_posed"] = groups["_near"].max(), groups["_far"].max()
    found["time"] = np.exp(groups["_log"].mean())
    return found


def count_cells(table: "pd.DataFrame") -> "pd.DataFrame":
    """solvers.csv: how often each outcome, how near, how slow, of each solver × variant × family.

    problems: their number, the sum of the nine counts that follow; distance_*: over the distances there are;
    time_ratio: geometric mean, failures at the limit, none where all is unsupported; worst_median: of what is answered.
    """
    cell = ["solver", "variant", "family"]
    is_answered = (table["status"] != "") & (table["outcome"] != "unsupported")
    counts, groups = count(table, cell), table.assign(worst=table["worst"].where(is_answered)).groupby(cell, sort=False)
    found = counts[["problems", *OUTCOMES, "noise"]].rename(columns=lambda name: name.replace("-", "_"))
    found["distance_median"], found["distance_max"] = groups["distance"].median(), groups["distance"].max()
    found["time_ratio"], found["worst_median"] = counts["time"], groups["worst"].median()
    return found.reset_index()


def rank(counts: "pd.DataFrame") -> "pd.DataFrame":
    """The best first: the most successes, taken or not, then the fewest unsafe answers, the fastest, the name."""
    ranked = counts.assign(_solved=-counts["success"] / counts["problems"], _name=counts.index)
    return ranked.sort_values(["_solved", "unsafe", "time", "_name"]).drop(columns=["_solved", "_name"])


def taken_by_both(table: "pd.DataFrame") -> "pd.DataFrame":
    """The rows of problems that a solver took both raw and behind the preparation: like compared with like."""
    taken = table[table["outcome"] != "unsupported"]
    return taken[taken.groupby(["solver", "family", "problem"])["variant"].transform("nunique") == 2]


def profiles(table: "pd.DataFrame") -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """(τ, ρ(τ)) of each solver: ρ is the share of all problems solved within τ of the fastest solver there.

    A step function, 0 before its first τ. What is no success sets no pace and is never solved, and so is a problem that
    a solver was not put to. Source: Dolan & Moré 2002.
    """
    problems = len(table.groupby(["family", "problem"]))
    solved = table[table["outcome"] == "success"]
    ratio = solved["ratio"].clip(lower=_LEAST_RATIO)
    factor = ratio / ratio.groupby([solved["family"], solved["problem"]]).transform("min")
    found = {}
    for solver in table["solver"].unique():
        own = np.sort(factor[solved["solver"] == solver].to_numpy())
        found[solver] = own, np.arange(1, len(own) + 1) / max(problems, 1)
    return found
