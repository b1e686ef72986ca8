"""A process that solves what it is sent, until its parent is gone, or it hangs or dies.

Orders come pickled on stdin, replies go pickled to what was stdout. File descriptors 1 and 2 lead into a file
meanwhile, so that whatever a library prints, from C too, is noticed. The parent watches the clocks: a CPU timer in
here (ITIMER_PROF, RLIMIT_CPU) would turn the process's CPU clock into one that ticks every 4 ms.
"""

import ctypes
import os
import pickle
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from statistics import median
from time import process_time_ns
from typing import Any, BinaryIO

from ..answers import as_direction
from ..direction import Direction
from ..problem import DirectionProblem
from ..solvers import SOLVERS, MissingPackageError, compile_kernels
from ..solvers.packages import require_packages
from .contestants import DEFAULT_SOLVER, contestant
from .exact import ExactAnswer, exact_answer, is_small_enough
from .families import ProblemFamily
from .judgement import CRASHED, HUNG, UNSUPPORTED, Judgement, judge
from .measurement import Measurement
from .named_families import family_named

Solve = Callable[[DirectionProblem], Any]

TIMING_BUDGET = 0.4  # s of CPU on one problem, for what is slow
_WARM_BELOW = 2e-3  # s: what is faster is called once more before each timed call, its caches being another's


@dataclass(frozen=True)
class Order:
    """One measurement to make. limit: CPU seconds that one answer may take; repeats: timed calls."""

    solver: str
    variant: str
    family: str
    problem: int
    seed: int
    limit: float
    repeats: int


@dataclass(frozen=True)
class Started:
    """The problem is drawn and the default solver timed; now comes the contestant. default_seconds: CPU."""

    n: int
    m: int
    default_seconds: float


@dataclass(frozen=True)
class Refused:
    """The order cannot be carried out at all."""

    message: str


def unanswered(order: Order, started: Started, judgement: Judgement, *, noise: bool = False) -> Measurement:
    """The measurement of a contestant that gave no answer: it counts as the limit."""
    return measured(order, started, judgement, seconds=order.limit, noise=noise)


def measured(
    order: Order, started: Started, judgement: Judgement, *, seconds: float, noise: bool, ratio: float | None = None
) -> Measurement:
    """A measurement of an order; ratio: measured in turns, or else by the default's time before."""
    return Measurement(
        solver=order.solver, variant=order.variant, family=order.family, problem=order.problem,
        n=started.n, m=started.m, status=judgement.status, outcome=judgement.outcome, worst=judgement.worst,
        distance=judgement.distance, seconds=seconds, limit=order.limit, noise=noise,
        ratio=seconds / started.default_seconds if ratio is None else ratio,
    )  # fmt: skip


def serve() -> None:
    """Carries out orders until stdin ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which ends this process
    with NoiseFile() as noise:
        bench: Bench | None = None
        while (order := receive(sys.stdin.buffer)) is not None:
            bench = bench or Bench()
            try:
                for reply in bench.carry_out(order, noise):
                    send(noise.channel, reply)
            except Exception as error:  # the parent raises it; what a contestant raises does not come here
                told = "".join(traceback.format_exception(error))
                is_known = isinstance(error, ValueError | MissingPackageError)
                send(noise.channel, Refused(str(error) if is_known else told))


@dataclass(frozen=True, eq=False)
class Drawn:
    """A problem of a family. exact: where it is feasible, in rational arithmetic too, and small."""

    problem: DirectionProblem
    feasible: bool
    exact: ExactAnswer | None


class Bench:
    """The problems of the family at hand, drawn once for all solvers, with their exact answers."""

    def __init__(self) -> None:
        self.default: Solve = SOLVERS[DEFAULT_SOLVER].solve
        compile_kernels()  # so that no measurement does
        self.key: tuple[str, int] = ("", 0)
        self.drawn: dict[int, Drawn] = {}

    def problem(self, family: ProblemFamily, number: int, seed: int) -> "Drawn":
        """The problem with its facts."""
        if self.key != (family.name, seed):
            self.key, self.drawn = (family.name, seed), {}
        if number not in self.drawn:
            problem = family.problem(number, seed)
            feasible = family.is_feasible(problem)
            exact = exact_answer(problem) if feasible and is_small_enough(problem) else None
            self.drawn[number] = Drawn(problem, feasible, exact if exact is not None and exact.feasible else None)
        return self.drawn[number]

    def carry_out(self, order: Order, noise: "NoiseFile") -> Iterator[Started | Measurement]:
        """First what the default needs, then what the contestant does."""
        family = family_named(order.family)
        candidate = contestant(order.solver, order.variant)
        load_packages(order.solver)
        drawn = self.problem(family, order.problem, order.seed)
        problem = drawn.problem
        self.default(problem)
        started = Started(problem.n, problem.m, min(seconds_of(self.default, problem) for _ in range(3)))
        yield started
        if not candidate.supports(problem):
            yield measured(order, started, UNSUPPORTED, seconds=0.0, ratio=0.0, noise=False)
            return
        noise.grew()
        own = problem.copied()  # what it does to its arrays, flags or no flags, the judge and the others do not see
        direction, first = answered(candidate.solve, own)
        judgement = CRASHED
        if direction is not None:
            is_raw = order.variant == "raw"
            judgement = judge(problem, direction, feasible=drawn.feasible, exact=drawn.exact, verdict_only=is_raw)
        if first > order.limit:  # came back before its parent looked
            judgement = HUNG
        if direction is None or judgement is HUNG:
            yield unanswered(order, started, judgement, noise=noise.grew())
            return
        seconds, ratio = timed(candidate.solve, self.default, own, first=first, repeats=order.repeats)
        yield measured(order, started, judgement, seconds=seconds, ratio=ratio, noise=noise.grew())


def answered(solve: Solve, problem: DirectionProblem) -> tuple[Direction | None, float]:
    """(the direction, or None where the contestant raised or gave something else; CPU seconds)."""
    start = process_time_ns()
    try:
        answer = solve(problem)
        seconds = (process_time_ns() - start) * 1e-9
        return as_direction(answer, problem.n, problem.m), seconds
    except Exception:  # whatever a third party raises is its outcome
        return None, (process_time_ns() - start) * 1e-9


def timed(
    solve: Solve, default: Solve, problem: DirectionProblem, *, first: float, repeats: int
) -> tuple[float, float]:
    """(median CPU seconds, their ratio to the default's median), the two taking turns; `first` is known already."""
    count = min(repeats, int(TIMING_BUDGET / max(first, 1e-9)))
    own, others = [], []
    for _ in range(count):
        others.append(seconds_of(default, problem))
        own.append(seconds_of(solve, problem, warm=first < _WARM_BELOW))
    if not own:  # too slow to be called again
        own, others = [first], [seconds_of(default, problem) for _ in range(repeats)]
    seconds = max(median(own), 1e-9)
    return seconds, seconds / max(median(others), 1e-9)


def seconds_of(solve: Solve, problem: DirectionProblem, *, warm: bool = True) -> float:
    """CPU seconds of one call, after an untimed one where `warm`."""
    if warm:
        solve(problem)
    start = process_time_ns()
    solve(problem)
    return (process_time_ns() - start) * 1e-9


def load_packages(solver: str) -> None:
    """Imports what a solver of SOLVERS stands on, so that no measurement does. Raises UnusablePackageError."""
    if solver in SOLVERS:
        require_packages(SOLVERS[solver])
        for name in ("qpsolvers", "scipy.sparse", "scipy.optimize"):
            import_module(name)


class NoiseFile:
    """Takes over file descriptors 1 and 2; `channel` is the former 1."""

    def __enter__(self) -> "NoiseFile":
        self.channel: BinaryIO = os.fdopen(os.dup(1), "wb")
        self.file = tempfile.TemporaryFile()
        for descriptor in (1, 2):
            os.dup2(self.file.fileno(), descriptor)
        for category in (UserWarning, RuntimeWarning):  # shown each time, not once: every problem is judged alike
            warnings.simplefilter("always", category)
        self._flush_c: Callable[..., Any] | None = getattr(c_library(), "fflush", None)
        self.size = 0
        return self

    def grew(self) -> bool:
        """Whether anything was written since the last look."""
        sys.stdout.flush()
        sys.stderr.flush()
        if self._flush_c is not None:
            self._flush_c(None)  # all of C's streams
        before, self.size = self.size, os.fstat(self.file.fileno()).st_size
        return self.size > before

    def __exit__(self, *exception: object) -> None:
        self.channel.close()


def c_library() -> Any:
    """The C library that Python itself uses."""
    if os.name == "nt":
        return getattr(ctypes, "cdll").msvcrt  # noqa: B009 - absent elsewhere
    return ctypes.CDLL(None)


def send(stream: BinaryIO, message: object) -> None:
    """One pickled message, at once."""
    pickle.dump(message, stream)
    stream.flush()


def receive(stream: BinaryIO) -> Any:
    """The next message, None where the other side is gone."""
    try:
        return pickle.load(stream)
    except (EOFError, pickle.UnpicklingError, OSError):
        return None
