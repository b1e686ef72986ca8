"""One measurement: a problem is drawn and judged, and a contestant timed beside the default, in a process of its own.

The process's limits are kept by its caller: a CPU timer in here (ITIMER_PROF, RLIMIT_CPU) would turn the process's CPU
clock into one that ticks every 4 ms.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from statistics import median
from time import process_time_ns
from typing import Any

from ..answers import as_direction
from ..direction import Direction
from ..exact import ExactAnswer, exact_answer, is_small_enough
from ..isolation import HangError, Isolated, IsolationError, output_size
from ..problem import DirectionProblem
from ..solvers import SOLVERS, MissingPackageError, compile_kernels
from ..solvers.packages import require_packages
from .contestants import DEFAULT_SOLVER, Contestant, contestant
from .families import ProblemFamily
from .judgement import CRASHED, HUNG, UNSUPPORTED, Judgement, judge
from .measurement import Measurement
from .named_families import family_named

Solve = Callable[[DirectionProblem], Any]

TIMING_BUDGET = 0.4  # s of CPU on one problem, for what is slow
_START_LIMIT = 600.0  # s on the clock for imports and, on a machine's first day, for compiling the default solver
_WALL_FACTOR = 4.0  # the CPU limit ends what computes; this many times it on the clock ends what sleeps
_WALL_ALLOWANCE = 2.0  # s on the clock
_TIMING = 3.0 * TIMING_BUDGET  # s of CPU for repeated calls after the answer, the default's among them
# One thread each: CPU time counts all threads, and two processes share the cores.
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "RAYON_NUM_THREADS")
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

    order: Order
    n: int
    m: int
    default_seconds: float

    def measurement(
        self, judgement: Judgement, *, seconds: float | None = None, ratio: float | None = None, noise: bool = False
    ) -> Measurement:
        """The row: at the limit without `seconds`; without `ratio`, by the default's time before."""
        order = self.order
        seconds = order.limit if seconds is None else seconds
        return Measurement(
            solver=order.solver, variant=order.variant, family=order.family, problem=order.problem,
            n=self.n, m=self.m, status=judgement.status, outcome=judgement.outcome, worst=judgement.worst,
            distance=judgement.distance, seconds=seconds, limit=order.limit, noise=noise,
            ratio=seconds / self.default_seconds if ratio is None else ratio,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Drawn:
    """A problem of a family. exact: where it is feasible, in rational arithmetic too, and small."""

    problem: DirectionProblem
    feasible: bool
    exact: ExactAnswer | None


class Bench:
    """The problems of the family at hand, drawn once for all solvers, with their exact answers."""

    def __init__(self) -> None:
        for category in (UserWarning, RuntimeWarning):  # shown each time, not once: every problem is judged alike
            warnings.simplefilter("always", category)
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

    def prepare(self, order: Order) -> Started:
        """Imports, draws and times the default. Raises what makes the order impossible."""
        family = family_named(order.family)
        self.candidate: Contestant = contestant(order.solver, order.variant)
        load_packages(order.solver)
        self.at = self.problem(family, order.problem, order.seed)
        problem = self.at.problem
        self.default(problem)
        seconds = min(seconds_of(self.default, problem) for _ in range(3))
        self.started = Started(order, problem.n, problem.m, seconds)
        return self.started

    def measure(self) -> Measurement:
        """What the contestant does with the problem that `prepare` has drawn."""
        candidate, problem, started, order = self.candidate, self.at.problem, self.started, self.started.order
        try:
            is_taken = candidate.supports(problem)
        except Exception:  # whatever a third party raises is its outcome
            return started.measurement(CRASHED)
        if not is_taken:
            return started.measurement(UNSUPPORTED, seconds=0.0, ratio=0.0)
        silent = output_size()
        own = problem.copied()  # what it does to its arrays, flags or no flags, the judge and the others do not see
        direction, first = ask_contestant(candidate.solve, own)
        judgement = CRASHED
        if direction is not None:
            is_raw = order.variant == "raw"
            judgement = judge(problem, direction, feasible=self.at.feasible, exact=self.at.exact, verdict_only=is_raw)
        if first > order.limit:  # came back before its caller looked
            judgement = HUNG
        if direction is None or judgement is HUNG:
            return started.measurement(judgement, noise=output_size() != silent)
        try:
            seconds, ratio = time_in_turns(candidate.solve, self.default, own, first=first, repeats=order.repeats)
        except Exception:  # at a later call, or of the default: what it made of the arrays is no problem any more
            return started.measurement(CRASHED, noise=output_size() != silent)
        noise = output_size() != silent
        return started.measurement(judgement, seconds=seconds, ratio=ratio, noise=noise)


def isolated_bench() -> Isolated:
    """A bench in a process of its own."""
    return Isolated(make=Bench, environment=dict.fromkeys(_ONE_THREAD, "1"))


def measurement_of(order: Order, bench: Isolated) -> Measurement:
    """The measurement; a hang or a crash of the process is one too.

    Raises ValueError for an order that cannot be carried out, RuntimeError where the process ends before the contestant
    is called.
    """
    try:
        started: Started = bench.apply(".prepare", order, time_limit=_START_LIMIT)
    except IsolationError as lost:
        raise RuntimeError(
            f"a worker should start on {order.family} for {order.solver}; found {lost} before {order.solver} was called"
        ) from lost
    except (ValueError, MissingPackageError):
        raise
    except Exception as error:  # of a module of the user's, whose traceback is told
        raise ValueError("\n".join(getattr(error, "__notes__", ()))) from error
    wall = _WALL_FACTOR * order.limit + _WALL_ALLOWANCE
    try:
        found: Measurement = bench.apply(".measure", time_limit=wall, cpu_limit=order.limit + _TIMING)
    except HangError:
        return started.measurement(HUNG)
    except IsolationError:  # whatever else is raised is a fault of ours
        return started.measurement(CRASHED)
    return found


def ask_contestant(solve: Solve, problem: DirectionProblem) -> tuple[Direction | None, float]:
    """(the direction, or None where the contestant raised or gave something else; CPU seconds)."""
    start = process_time_ns()
    try:
        answer = solve(problem)
        seconds = (process_time_ns() - start) * 1e-9
        return as_direction(answer, problem.n, problem.m), seconds
    except Exception:  # whatever a third party raises is its outcome
        return None, (process_time_ns() - start) * 1e-9


def time_in_turns(
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
