"""Which wrong lines would the tests miss?

A mutation changes one expression of the product: a sign, a comparison, a constant, the order of a matrix product, a
dropped transpose. Mutations are drawn from all that the listed modules allow, each is made in a copy of the project,
and the tests of its module run there until one fails.

    python benchmarks/mutations.py [--mutations 60] [--seed 0] [--modules cpgrl_opt/step.py …] [--processes 2]
        [--out FOLDER]

A mutation is *killed* where a test fails, *survived* where all pass, and *timed out* where they take three times as
long as unbroken and two minutes more, which is as good as a failure. The score is the share that did not survive.
Limitations: a sample; some survivors are no fault at all, as a threshold that may as well lie elsewhere. Of the tools
on the market those that switch mutations at run time cannot reach compiled kernels, and those that write them to disk
know nothing of numba's cache: here each copy starts with the kernels of the unbroken sources.
"""

import argparse
import ast
import difflib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
from tables import table, write

ROOT = Path(__file__).parents[1]
COPIED = ("cpgrl_opt", "rl", "envs", "tests", "benchmarks")
PATIENCE = 120.0  # s; kernels that have to be compiled anew take up to one minute

_REFEREE = ("certify", "violation", "infeasible_claims", "kkt_geometry", "residuals_*", "feasibility")
_CORES = (
    "compiled_*",
    "interpreted_kernels",
    "solvers_*",
    "climb_*",
    "direction_batch",
    "infeasible_claims",
    "broken_packages",
)
_LONG = ("compiled_sums", "reduction", "long_*", "vectors_*", "every_kind_*", "step_in_span")
# Modules, as patterns, and the tests that are about them.
TESTS = {
    ("cpgrl_opt/*problem.py", "cpgrl_opt/*gate.py", "cpgrl_opt/validation.py", "cpgrl_opt/linearization.py"): (
        *("problem", "gate", "long_storage"),
    ),
    ("cpgrl_opt/certify.py", "cpgrl_opt/_evidence.py", "cpgrl_opt/_violation.py", "cpgrl_opt/answers.py"): _REFEREE,
    ("cpgrl_opt/scaling.py", "cpgrl_opt/compensated.py", "cpgrl_opt/direction.py"): ("problem", "reduction", *_REFEREE),
    ("cpgrl_opt/metric*.py", "cpgrl_opt/flat.py"): ("problem", "geometry", "metric_*", "balls_*", *_REFEREE),
    ("cpgrl_opt/*step*.py", "cpgrl_opt/formulation.py", "cpgrl_opt/recovery.py", "cpgrl_opt/drop_rule.py"): (
        *("projection", "step", "step_*"),
    ),
    ("cpgrl_opt/projection.py", "cpgrl_opt/active_set.py"): ("projection", "step", "gate"),
    ("cpgrl_opt/reduction.py", "cpgrl_opt/vectors/*.py", "cpgrl_opt/solvers/span.py"): _LONG,
    ("cpgrl_opt/solvers/*gramian_core.py", "cpgrl_opt/solvers/compiled/_gramian_core.py"): _LONG,
    (
        *("cpgrl_opt/solvers/geometry.py", "cpgrl_opt/solvers/*trust_region.py", "cpgrl_opt/solvers/ball_*.py"),
        *("cpgrl_opt/solvers/with_geometry.py", "cpgrl_opt/solvers/compiled/_trust_region.py"),
    ): ("geometry", "balls_*", "climb_*", "metric_*", "feasibility", "step_geometry"),
    ("cpgrl_opt/solvers/*.py", "cpgrl_opt/solvers/compiled/*.py"): _CORES,
}


def _both_ways(*pairs: tuple[Any, Any]) -> dict[Any, Any]:
    return dict(chain(pairs, ((two, one) for one, two in pairs)))


_SWAPPED_OPERATORS = _both_ways((ast.Add, ast.Sub), (ast.Mult, ast.Div))
_SWAPPED_COMPARISONS = _both_ways(
    (ast.Lt, ast.GtE), (ast.Gt, ast.LtE), (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn)
)
_SWAPPED_NAMES = _both_ways(("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"), ("any", "all"))


@dataclass(frozen=True)
class Mutation:
    """`source`, the whole text of `file`, differs from what is there in one expression, of that kind on that line."""

    file: str
    line: int
    kind: str
    source: str

    def diff(self, root: Path) -> str:
        """What it changes, without context."""
        before = (root / self.file).read_text(encoding="utf-8").splitlines()
        lines = difflib.unified_diff(before, self.source.splitlines(), lineterm="", n=0)
        return "\n".join(line for line in lines if line[:2] not in ("--", "++", "@@"))


@dataclass(frozen=True)
class Row:
    """What became of a mutation."""

    file: str
    line: int
    kind: str
    outcome: str
    seconds: float
    diff: str


def main() -> None:
    """Draws the mutations, tries them and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutations", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--modules", nargs="+", help="files of the product; without it all that have tests listed")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    arguments = parser.parse_args()
    tests = {file: which for file, which in tests_of(ROOT, TESTS).items() if file in (arguments.modules or [file])}
    drawn = draw(ROOT, list(tests), arguments.mutations, np.random.default_rng(arguments.seed))
    rows = run(ROOT, drawn, tests, arguments.processes)
    command = f"python benchmarks/mutations.py --mutations {arguments.mutations} --seed {arguments.seed}"
    commit = ["git", "rev-parse", "--short", "HEAD"]
    sources = subprocess.run(commit, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    write("mutations", page(rows, command, sources), rows, arguments.out)


def tests_of(root: Path, tests: Mapping[tuple[str, ...], Sequence[str]]) -> dict[str, tuple[str, ...]]:
    """The test files of each module that a pattern names, the first pattern's where several do."""
    found: dict[str, tuple[str, ...]] = {}
    for patterns, subjects in tests.items():
        files = [path for each in subjects for path in sorted(root.glob(f"tests/cpgrl_opt/test_{each}.py"))]
        for path in chain.from_iterable(sorted(root.glob(pattern)) for pattern in patterns):
            found.setdefault(_name(root, path), tuple(_name(root, each) for each in files))
    return found


def _name(root: Path, path: Path) -> str:
    return path.relative_to(root).as_posix()


def draw(root: Path, files: Sequence[str], count: int, rng: np.random.Generator) -> list[Mutation]:
    """So many of the mutations that the files allow, any as likely as any other."""
    possible = [each for file in files for each in mutations(file, (root / file).read_text(encoding="utf-8"))]
    chosen = rng.choice(len(possible), min(count, len(possible)), replace=False)
    return [possible[i] for i in sorted(chosen)]


def mutations(file: str, source: str) -> Iterator[Mutation]:
    """Every mutation of a source; of annotations, decorators and messages there is none."""
    lines = source.encode().splitlines(keepends=True)  # the tree counts bytes
    starts = np.cumsum([0, *map(len, lines)])
    text = b"".join(lines)
    for node in _expressions(ast.parse(source)):
        for kind, replaced in _changes(node):
            begin, end = starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
            changed = text[:begin] + replaced.encode() + text[end:]
            yield Mutation(file, node.lineno, kind, changed.decode())


def _expressions(node: ast.AST) -> Iterator[Any]:
    """The expressions that are worked out when the code runs."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params") or isinstance(node, ast.Raise):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.expr):
                yield child
            if isinstance(child, ast.AST):
                yield from _expressions(child)


def _changes(node: ast.expr) -> Iterator[tuple[str, str]]:
    """The ways to get an expression wrong: their kind, and what stands there then."""
    match node:
        case ast.BinOp(left, operator, right) if type(operator) in _SWAPPED_OPERATORS:
            yield "operator", f"({ast.unparse(ast.BinOp(left, _SWAPPED_OPERATORS[type(operator)](), right))})"
        case ast.BinOp(left, ast.MatMult() as operator, right):
            yield "order", f"({ast.unparse(ast.BinOp(right, operator, left))})"
        case ast.Compare(left, [operator], [right]):
            changed = ast.Compare(left, [_SWAPPED_COMPARISONS[type(operator)]()], [right])
            yield "comparison", f"({ast.unparse(changed)})"
        case ast.BoolOp(operator, values):
            other = ast.Or() if isinstance(operator, ast.And) else ast.And()
            yield "and, or", f"({ast.unparse(ast.BoolOp(other, values))})"
        case ast.UnaryOp(ast.USub() | ast.Not(), operand):
            yield "sign", f"({ast.unparse(operand)})"
        case ast.IfExp(test, body, orelse):
            yield "branch", f"({ast.unparse(ast.IfExp(test, orelse, body))})"
        case ast.Attribute(value, "T"):
            yield "transpose", ast.unparse(value)
        case ast.Attribute(value, name) if name in _SWAPPED_NAMES:
            yield "extreme", ast.unparse(ast.Attribute(value, _SWAPPED_NAMES[name]))
        case ast.Name(name) if name in _SWAPPED_NAMES:
            yield "extreme", _SWAPPED_NAMES[name]
        case ast.Constant(bool(value)):
            yield "constant", str(not value)
        case ast.Constant(int(value)):
            yield "constant", str(value + 1)
        case ast.Constant(float(value)):  # a tolerance that is twice as large is none that is wrong
            yield "constant", repr(value * 1e4 if 0 < abs(value) < 1e-2 else value + 1.0)


def run(root: Path, drawn: Sequence[Mutation], tests: Mapping[str, tuple[str, ...]], processes: int = 2) -> list[Row]:
    """Each mutation in a copy of the project, after the tests of all have passed without any."""
    with tempfile.TemporaryDirectory() as folder:
        unbroken = Path(folder) / "unbroken"
        _copy(root, unbroken)
        places: SimpleQueue[Path] = SimpleQueue()
        for number in range(processes):
            places.put(Path(folder) / str(number))

        def tried(mutation: Mutation) -> Row:
            place = places.get()
            try:
                return _try(unbroken, place, mutation, tests[mutation.file], limits[tests[mutation.file]])
            finally:
                places.put(place)

        with ThreadPoolExecutor(processes) as pool:
            needed = list({tests[each.file] for each in drawn})
            limits = dict(zip(needed, pool.map(lambda which: _limit(unbroken, which), needed), strict=True))
            return list(pool.map(tried, drawn))


def _copy(root: Path, place: Path) -> None:
    """The project with its compiled kernels, which lie beside their sources and are as old as these."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    for name in COPIED:
        if (root / name).is_dir():
            shutil.copytree(root / name, place / name, ignore=shutil.ignore_patterns("*.pyc", "results"))
    shutil.copy2(root / "pyproject.toml", place)


def _limit(place: Path, tests: Sequence[str]) -> float:
    """Seconds after which the tests are ended, of how long they take unbroken; they have to pass."""
    begun = time.perf_counter()
    code, output = run_tests(place, tests, None)
    if code != 0:
        raise ValueError(f"the tests should pass without a mutation; found\n{output}")
    return 3.0 * (time.perf_counter() - begun) + PATIENCE


def _try(unbroken: Path, place: Path, mutation: Mutation, tests: Sequence[str], limit: float) -> Row:
    _copy(unbroken, place)
    (place / mutation.file).write_text(mutation.source, encoding="utf-8")
    begun = time.perf_counter()
    code, _ = run_tests(place, tests, limit)
    outcome = {0: "survived", None: "timed out"}.get(code, "killed")
    seconds = round(time.perf_counter() - begun, 1)
    print(f"{outcome:9} {seconds:6.1f} s  {mutation.file}:{mutation.line} {mutation.kind}", flush=True)
    return Row(mutation.file, mutation.line, mutation.kind, outcome, seconds, mutation.diff(unbroken))


def run_tests(place: Path, tests: Sequence[str], limit: float | None) -> tuple[int | None, str]:
    """The exit status, None at the limit, and what was said; nothing that was started goes on."""
    environment = os.environ | {
        "PYTHONPATH": str(place),
        "PYTHONDONTWRITEBYTECODE": "1",
        "HYPOTHESIS_PROFILE": "ci",
        "OMP_NUM_THREADS": "1",
    }
    environment.pop("NUMBA_CACHE_DIR", None)  # the copy's kernels lie in the copy
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    streams: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(command, cwd=place, env=environment, start_new_session=True, **streams) as process:
        try:
            output, _ = process.communicate(timeout=limit)
            return process.returncode, output
        except subprocess.TimeoutExpired:
            return None, ""
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def page(rows: Sequence[Row], command: str, sources: str) -> str:
    """The score, of each file too, and the survivors as diffs."""
    survivors = [row for row in rows if row.outcome == "survived"]
    counts = [(file, [row for row in rows if row.file == file]) for file in sorted({row.file for row in rows})]
    lines = [(file, len(those) - sum(row in survivors for row in those), len(those)) for file, those in counts]
    parts = [
        "# Wrong lines that the tests notice",
        f"`{command}`: {len(rows) - len(survivors)} of {len(rows)} noticed, "
        f"{sum(row.outcome == 'timed out' for row in rows)} of them by the time that they take; "
        f"{len(survivors)} survived. {sum(row.seconds for row in rows) / 3600:.1f} hours of one core; "
        f"on commit {sources}.",
        table("| file | noticed | tried |", "| {0[0]} | {0[1]:d} | {0[2]:d} |", lines),
        "## Survivors",
        *(f"{row.file}, line {row.line}, {row.kind}:\n\n```diff\n{row.diff}\n```" for row in survivors),
    ]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    main()
