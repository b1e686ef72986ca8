"""Does every correct solver pass thousands of problems a law, and how many does it decline?

Each law of `cpgrl_opt.testing` is put to each solver of `SOLVERS` that is installed, on as many problems as the
Hypothesis profile `nightly` asks for, the same that `pytest tests/cpgrl_opt/test_laws.py` draws under that profile:
one seed for each law, so all solvers that take the same cases are given the same problems.
`rosen-drop` is left out: it is not the cone projection, and says so.

    python benchmarks/nightly_laws.py [--max-examples 10000] [--solvers active-set,daqp] [--laws …]
        [--processes 2] [--out FOLDER]

A law and solver whose row is in FOLDER/nightly_laws.csv is not run again: a run that was cut off is taken up where it
was. Rows name the sources they were measured on, by a digest of the solvers, the referee and the laws, and the page
lists these.
Limitations: laws are put to generated problems of at most five rows; the seed is fixed, so a second run finds nothing
new. Exit status 1 if a law broke.
"""

import ast
import csv
import hashlib
import sys
import time
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields
from functools import cache
from pathlib import Path

from joblib import Parallel, delayed
from tables import RESULTS, publish, read_arguments

import cpgrl_opt
from cpgrl_opt import SOLVERS
from cpgrl_opt.solvers import is_usable
from cpgrl_opt.testing import LAWS
from cpgrl_opt.testing.verdict import check_law

NOT_A_PROJECTION = "rosen-drop"


@dataclass(frozen=True)
class Row:
    """What became of one law under one solver; `run` problems were asked about, `problem` is what broke."""

    law: str
    solver: str
    max_examples: int
    run: int
    declined: int
    skipped: int
    failed: int
    cpu_seconds: float
    sources: str
    problem: str


def main() -> None:
    """Runs what is missing, then writes the page."""
    usual = {"max_examples": 10_000, "solvers": correct_solvers(), "laws": list(LAWS), "processes": 1}
    arguments = read_arguments(__doc__, RESULTS, **usual)
    for option, known in (("solvers", correct_solvers()), ("laws", list(LAWS))):
        if unknown := sorted(set(getattr(arguments, option)) - set(known)):
            arguments.refuse(f"--{option} should be of {', '.join(known)}; found {', '.join(unknown)}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    record, least = arguments.out / "nightly_laws.csv", arguments.max_examples
    if not record.exists():
        record.write_text(",".join(each.name for each in fields(Row)) + "\n", encoding="utf-8")
    done = {(row.law, row.solver) for row in read(record) if row.max_examples >= least and not row.problem}
    missing = {law: [name for name in arguments.solvers if (law, name) not in done] for law in arguments.laws}
    work = (delayed(examine)(law, names, least, record) for law, names in missing.items())
    Parallel(arguments.processes)(work)
    rows = read(record)
    publish(
        arguments, f"Laws on {least} problems each", parts([row for row in rows if row.max_examples >= least]), rows
    )
    if any(row.problem for row in rows if row.max_examples >= least):
        sys.exit(1)


def correct_solvers() -> list[str]:
    """The installed solvers that claim to project."""
    return [name for name, solver in SOLVERS.items() if name != NOT_A_PROJECTION and is_usable(solver)]


def examine(law: str, names: list[str], max_examples: int, record: Path) -> None:
    """One law put to the solvers one after the other, a row written after each."""
    for name in names:
        start = time.process_time()
        result = check_law(LAWS[law], SOLVERS[name], max_examples=max_examples)
        counts = (result.run, result.declined, result.skipped, result.failed)
        seconds = round(time.process_time() - start, 1)
        row = Row(law, name, max_examples, *counts, seconds, sources(), " ".join(result.problem.split()))
        with record.open("a", newline="", encoding="utf-8") as file:  # one write: several processes share the file
            csv.writer(file, lineterminator="\n").writerow(astuple(row))


@cache
def sources() -> str:
    """Eight digits that change with the problems, the referee, the solvers and the laws.

    Not with imports, docstrings, comments and layout: hours of measurement stay valid when a name is moved.
    """
    folder = Path(cpgrl_opt.__file__).parent
    paths = sorted(folder.glob("*.py"))
    for part in ("vectors", "solvers", "testing"):
        paths += sorted((folder / part).rglob("*.py"))
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.relative_to(folder).as_posix().encode() + _code(path.read_text(encoding="utf-8")).encode())
    return digest.hexdigest()[:8]


def _code(source: str) -> str:
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [each for each in body if not _is_silent(each)]  # type: ignore[attr-defined]
    return ast.dump(tree)


def _is_silent(node: ast.AST) -> bool:
    """Imports and docstrings."""
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    return is_text or isinstance(node, ast.Import | ast.ImportFrom)


def read(record: Path) -> list[Row]:
    """The rows of the record, the last of each law and solver."""
    with record.open(newline="", encoding="utf-8") as file:
        rows = [_row(line) for line in csv.DictReader(file)]
    return list({(row.law, row.solver): row for row in rows}.values())


def _row(line: dict[str, str]) -> Row:
    return Row(**{each.name: each.type(line[each.name]) for each in fields(Row)})  # type: ignore[operator, arg-type]


def parts(rows: list[Row]) -> list[str]:
    """Markdown: problems run and declined, a line a law and a column a solver, and what broke."""
    cells = {(row.law, row.solver): row for row in rows}
    names = [name for name in SOLVERS if any(row.solver == name for row in rows)]
    broken = [f"**{row.law}, {row.solver}**: {row.problem}" for row in rows if row.problem]
    head = "| law | " + " | ".join(names) + " |\n|---|" + "--:|" * len(names)
    lines = [f"| {_label(law)} | " + " | ".join(_cells(cells, law, names)) + " |" for law in LAWS]
    versions, now = sorted({row.sources for row in rows}), sources()
    age = "the present ones" if versions == [now] else f"older sources than the present {now}"
    return [
        f"{len(rows)} laws under solvers, {sum(row.run for row in rows)} problems run, {len(broken)} broken; "
        f"{sum(row.cpu_seconds for row in rows) / 3600:.1f} hours of one core. "
        f"Measured on {', '.join(versions)}: {age}.",
        "A cell is how many problems the solver declined (it claimed nothing), of those that the law is about; "
        "– where the solver does not take the law's cases, or has not what the law is about; ✗ where the law "
        "broke; empty where it was not run. Laws with a * include problems that no solver need answer.",
        "\n".join([head, *lines]),
        *broken,
    ]


def _label(law: str) -> str:
    return law.removeprefix("check_") + (" *" if LAWS[law].may_decline else "")


def _cells(cells: dict[tuple[str, str], Row], law: str, names: list[str]) -> Iterator[str]:
    for name in names:
        row = cells.get((law, name))
        if row is None:
            yield ""
        elif row.problem:
            yield "✗"
        else:
            yield str(row.declined) if row.run else "–"


if __name__ == "__main__":
    main()
