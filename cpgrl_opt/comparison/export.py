"""Direction problems as a test set of qpbenchmark (Caron et al.): a Parquet file that its `ParquetTestSet` reads.

    min ½xᵀPx + qᵀx   s.t.   Gx ≤ h,   Ax = b,   lb ≤ x ≤ ub        P = M, q = −g, G = −J_I, h = −b_I, A = J_E

One row per problem; matrices flattened row by row, null where a part is missing, and a name.
"""

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..problem import DirectionProblem
from ..solvers import MissingPackageError
from .recording import PARTS, Recording
from .whole_file import whole_file

COLUMNS = ("P", "q", "G", "h", "A", "b", "lb", "ub")
_AT_ONCE = 64  # problems of one row group: P alone has n² numbers


class MissingExportError(MissingPackageError):
    """Parquet files need a package that is not installed; the message is the command that installs it."""

    def __str__(self) -> str:
        """Said without arguments."""
        return (
            "the export to Parquet needs the package pyarrow, which is not installed; type: "
            "pip install 'cpgrl-opt[export]'"
        )


def write_test_set(problems: Sequence[DirectionProblem], names: Sequence[str], path: Path) -> None:
    """The Parquet file; rows that are switched off (b = −∞) are left out.

    The file takes its place when it is whole. Raises MissingExportError without pyarrow, ValueError unless there is one
    name for each problem, none of them twice, and no problem with a radius.
    """
    if len(names) != len(problems):
        raise ValueError(f"names should be {len(problems)}, one for each problem; found {len(names)}")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ValueError(f"names should differ, since readers find problems by them; found {twice[0]!r} twice")
    if any(problem.radius is not None for problem in problems):
        raise ValueError("problems to export should have no radius, which makes them no QPs; found one that has")
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise MissingExportError from error
    numbers = pyarrow.list_(pyarrow.float64())
    schema = pyarrow.schema([*((column, numbers) for column in COLUMNS), ("name", pyarrow.string())])
    with whole_file(path) as beside, pyarrow.parquet.ParquetWriter(beside, schema) as writer:
        for first in range(0, len(problems), _AT_ONCE):
            chunk = slice(first, first + _AT_ONCE)
            rows = [
                {**_row(problem), "name": name} for problem, name in zip(problems[chunk], names[chunk], strict=True)
            ]
            writer.write_table(pyarrow.Table.from_pylist(rows, schema))


def export_recording(recording: Recording, path: Path) -> None:
    """A recording as a test set; a problem is called by training, run, episode and part.

    Where an update drops constraints twice, its later problems of one part get -2, -3, … in the order of the recording.
    """
    write_test_set(recording.problems, _distinct(list(_names(recording))), path)


def _names(recording: Recording) -> Iterator[str]:
    columns = (recording.training, recording.run, recording.episode, recording.part)
    for training, run, episode, part in zip(*columns, strict=True):
        words = PARTS[part].replace(" ", "-")
        yield f"{recording.trainings[training]}-run{run}-episode{episode}-{words}"


def _distinct(names: Sequence[str]) -> list[str]:
    """The names, the later ones of equal ones with the first number ≥ 2 that makes them differ from all others."""
    taken, seen, distinct = set(names), set[str](), []
    for name in names:
        numbered = (f"{name}-{number}" for number in itertools.count(2))
        own = name if name not in seen else next(each for each in numbered if each not in taken)
        taken.add(own)
        seen.add(own)
        distinct.append(own)
    return distinct


def _row(problem: DirectionProblem) -> dict[str, Any]:
    inequality = ~problem.equality & (problem.bound > -np.inf)
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    M = np.ones(problem.n) if problem.metric is None else problem.metric
    row["P"], row["q"] = (np.diag(M) if M.ndim == 1 else M).ravel(), -problem.gradient
    if inequality.any():
        row["G"], row["h"] = -problem.jacobian[inequality].ravel(), -problem.bound[inequality]
    if problem.equality.any():
        row["A"], row["b"] = problem.jacobian[problem.equality].ravel(), problem.bound[problem.equality]
    return row
