"""Which wrong lines would the tests miss?

A mutation changes one expression of the product: a sign, a comparison, a constant, the order of a matrix product, a
dropped transpose. Mutations are drawn from all that the modules allow, each is made in a copy of the project, and tests
run there until one fails: those of the test files that are nearest to the module by imports, the quickest of a file
first, up to --seconds of them.

    python benchmarks/mutations.py [--mutations 30] [--seed 0] [--modules 'cpgrl_opt/step.py,rl/**/*.py']
        [--seconds 12] [--processes 2] [--out FOLDER]

A mutation is *killed* where a test fails, *survived* where all pass, *timed out* where they take three times as long as
without it and half a minute more, as good as a failure, and *unclear* where pytest tells neither, as where tests cannot
be collected. The score is the share of killed and timed out among those that are clear.
A module that has to do with kernels is interpreted, since machine code cached by another file would hide the change;
tests that then do not pass are not asked.
Limitations: a sample, and a sample of the tests: the whole suite may notice more. Some survivors are no fault at all,
as a threshold that may as well lie elsewhere.
"""

import ast
import difflib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import accumulate, chain
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
from tables import publish, read_arguments, table

ROOT = Path(__file__).parents[1]
PRODUCT = ("cpgrl_opt", "rl", "envs")
COPIED = (*PRODUCT, "tests", "benchmarks", "docs", "pyproject.toml", "README.md")
NEAREST = 5  # test files of a module; with more, what the unbroken tests take exceeds what mutations take
OUTCOMES = ("killed", "timed out", "survived", "unclear")
PATIENCE = 30.0  # s; to start and to import, on a busy machine
WATCH = """
import os, pytest
def pytest_runtest_logreport(report):
    if report.when == "call" or report.failed:
        with open(os.environ["MUTATION_TIMES"], "a") as file:
            file.write(f"{report.outcome}\\t{report.duration}\\t{report.nodeid}\\n")
"""


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
    modules = [f"{room}/**/*.py" for room in PRODUCT]
    arguments = read_arguments(__doc__, mutations=30, seed=0, modules=modules, seconds=12.0, processes=2)
    files = sorted(set(chain.from_iterable(_files(ROOT, pattern) for pattern in arguments.modules)))
    drawn = draw(ROOT, files, arguments.mutations, np.random.default_rng(arguments.seed))
    describe = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    commit = subprocess.run(describe, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    begun = os.times()
    rows = run(ROOT, drawn, arguments.seconds, arguments.processes)
    used = sum(os.times()[2:4]) - sum(begun[2:4])  # of the processes that ran the tests
    found = parts(rows, f"{used / 60:.0f} minutes of a core; on commit {commit}")
    publish(arguments, "Wrong lines that the tests notice", found, rows)


def draw(root: Path, files: Sequence[str], count: int, rng: np.random.Generator) -> list[Mutation]:
    """So many of the mutations that the files allow, any as likely as any other."""
    possible = [each for file in files for each in mutate(file, (root / file).read_text(encoding="utf-8"))]
    chosen = rng.choice(len(possible), min(count, len(possible)), replace=False)
    return [possible[i] for i in sorted(chosen)]


def mutate(file: str, source: str) -> Iterator[Mutation]:
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


class Imports:
    """Who imports names of whom; names that packages pass on are followed to the module that defines them."""

    def __init__(self, root: Path) -> None:
        self.files = {_dotted(file): file for room in PRODUCT for file in _files(root, f"{room}/**/*.py")}
        trees = {name: _parse(root / file) for name, file in self.files.items()}
        self.passed_on = {
            package: {alias.asname or alias.name: (source, alias.name) for alias, source in self.names(tree, package)}
            for package, tree in trees.items()
        }
        self.used = {name: self.modules(tree, name) for name, tree in trees.items()}
        self.tests = {file: self.modules(_parse(root / file), "") for file in _files(root, "tests/**/test_*.py")}

    def names(self, tree: ast.AST, module: str) -> Iterator[tuple[ast.alias, str]]:
        """What a source imports from where, relative imports too."""
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                is_package = self.files.get(module, "").endswith("__init__.py")
                above = module.split(".")[: len(module.split(".")) - node.level + is_package] if node.level else []
                source = ".".join([*above, *([node.module] if node.module else [])])
                yield from ((alias, source) for alias in node.names)

    def modules(self, tree: ast.AST, module: str) -> set[str]:
        """Those that define what a source imports, or names in a string, as for import_module."""
        found = {self.defining(source, alias.name) for alias, source in self.names(tree, module)}
        found |= {
            node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)
        }
        return found & self.files.keys()

    def defining(self, package: str, name: str) -> str:
        """The module in which a name of a package is defined."""
        if f"{package}.{name}" in self.files:
            return f"{package}.{name}"
        source, original = self.passed_on.get(package, {}).get(name, (package, name))
        return package if source == package else self.defining(source, original)

    def nearest(self, file: str) -> list[str]:
        """Test files from which the fewest imports lead here; of equals those named like it, and that import less."""
        levels, reached = {}, {_dotted(file)}
        while reached - levels.keys():
            levels |= dict.fromkeys(reached - levels.keys(), len(set(levels.values())))
            reached = {name for name, used in self.used.items() if used & reached}
        stem = Path(file).stem.strip("_")
        ranks = {
            test: (min((levels.get(name, 99) for name in used), default=99), stem not in test, len(used), test)
            for test, used in self.tests.items()
        }
        return sorted(ranks, key=ranks.__getitem__)[:NEAREST]


def _files(root: Path, pattern: str) -> list[str]:
    return sorted(path.relative_to(root).as_posix() for path in root.glob(pattern))


def _parse(path: Path) -> ast.AST:
    return ast.parse(path.read_text(encoding="utf-8"))


def _dotted(file: str) -> str:
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def run(root: Path, drawn: Sequence[Mutation], seconds: float, processes: int = 2) -> list[Row]:
    """Each mutation in a copy of the project, after the tests of all have been timed without any."""
    imports = Imports(root)
    near = {file: imports.nearest(file) for file in {each.file for each in drawn}}
    needed = sorted({(test, has_kernels(root / file)) for file, tests in near.items() for test in tests})
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(processes) as pool:
        unbroken, places = Path(folder) / "unbroken", SimpleQueue[Path]()
        _copy(root, unbroken)
        for number in range(processes):
            places.put(Path(folder) / str(number))
        times = dict(zip(needed, pool.map(lambda each: time_tests(unbroken, *each, seconds), needed), strict=True))

        def attempt(mutation: Mutation) -> Row:
            place, interpreted = places.get(), has_kernels(root / mutation.file)
            try:
                tests = choose([times[test, interpreted] for test in near[mutation.file]], seconds)
                return _attempt(unbroken, place, mutation, tests, interpreted=interpreted)
            finally:
                places.put(place)

        return list(pool.map(attempt, drawn))


def has_kernels(path: Path) -> bool:
    """Whether code of it may be compiled, and then cached beside files that call it."""
    text = path.read_text(encoding="utf-8")
    return any(word in text for word in ("kernel", "njit", "compile_function(", "CompiledLate"))


def time_tests(place: Path, file: str, interpreted: bool, seconds: float) -> dict[str, float]:
    """Seconds of the tests of a file that pass before its time is up."""
    with tempfile.NamedTemporaryFile("r") as record:
        run_tests(place, [file], seconds + PATIENCE, interpreted=interpreted, times=record.name)
        lines = [line.split("\t") for line in record.read().splitlines()]
    return {test: float(duration) for outcome, duration, test in lines if outcome == "passed"}


def choose(files: Sequence[dict[str, float]], seconds: float) -> dict[str, float]:
    """Tests of the files, nearest first and of each the quickest first, until the time is spent."""
    ordered = list(chain.from_iterable(sorted(times.items(), key=lambda each: each[1]) for times in files))
    spent = accumulate(duration for _, duration in ordered)
    return {test: duration for (test, duration), so_far in zip(ordered, spent, strict=True) if so_far <= seconds}


def _copy(root: Path, place: Path) -> None:
    """The project with its compiled kernels, which lie beside their sources and are as old as these."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    for name in COPIED:
        if (root / name).is_dir():
            shutil.copytree(root / name, place / name, ignore=shutil.ignore_patterns("*.pyc", "results"))
        elif (root / name).exists():
            shutil.copy2(root / name, place)


def _attempt(unbroken: Path, place: Path, mutation: Mutation, tests: dict[str, float], *, interpreted: bool) -> Row:
    _copy(unbroken, place)
    (place / mutation.file).write_text(mutation.source, encoding="utf-8")
    begun = time.perf_counter()
    limit = 3.0 * sum(tests.values()) + PATIENCE
    code = run_tests(place, ["-x", *tests], limit, interpreted=interpreted) if tests else 5
    outcome = {0: "survived", 1: "killed", None: "timed out"}.get(code, "unclear")
    seconds = round(time.perf_counter() - begun, 1)
    print(f"{outcome:9} {seconds:6.1f} s  {mutation.file}:{mutation.line} {mutation.kind}", flush=True)
    return Row(mutation.file, mutation.line, mutation.kind, outcome, seconds, mutation.diff(unbroken))


def run_tests(
    place: Path, tests: Sequence[str], limit: float, *, interpreted: bool = False, times: str = os.devnull
) -> int | None:
    """The exit status, None at the limit; nothing that was started goes on. times: a file for what each test took."""
    (place / "watch_tests.py").write_text(WATCH, encoding="utf-8")
    environment = os.environ | {
        "PYTHONPATH": str(place),
        "PYTHONDONTWRITEBYTECODE": "1",
        "NUMBA_DISABLE_JIT": str(int(interpreted)),
        "HYPOTHESIS_PROFILE": "ci",
        "OMP_NUM_THREADS": "1",
        "MUTATION_TIMES": times,
    }
    environment.pop("NUMBA_CACHE_DIR", None)  # the copy's kernels lie in the copy
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "watch_tests", *tests]
    streams: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.STDOUT}
    with subprocess.Popen(command, cwd=place, env=environment, start_new_session=True, **streams) as process:
        try:
            return process.wait(limit)
        except subprocess.TimeoutExpired:
            return None
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def parts(rows: Sequence[Row], run: str) -> list[str]:
    """The score, of each file too, and the survivors as diffs."""
    counts = {outcome: sum(row.outcome == outcome for row in rows) for outcome in OUTCOMES}
    noticed, clear = counts["killed"] + counts["timed out"], len(rows) - counts["unclear"]
    files = [(file, [row.outcome for row in rows if row.file == file]) for file in sorted({row.file for row in rows})]
    lines = [(file, *(outcomes.count(outcome) for outcome in OUTCOMES)) for file, outcomes in files]
    told = [row for row in rows if row.outcome == "survived"]
    return [
        f"{noticed} of {clear} noticed, {counts['timed out']} of them by the time that they take; {counts['survived']} "
        f"survived; {counts['unclear']} unclear. {run}.",
        table(f"| file | {' | '.join(OUTCOMES)} |", "| {0[0]} | {0[1]:d} | {0[2]:d} | {0[3]:d} | {0[4]:d} |", lines),
        "## Survivors",
        *(f"{row.file}, line {row.line}, {row.kind}:\n\n```diff\n{row.diff}\n```" for row in told),
    ]


if __name__ == "__main__":
    main()
