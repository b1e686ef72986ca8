"""One law put to one solver: many generated problems, counted, and the smallest counterexample."""

import math
import random
import tempfile
import zlib
from collections.abc import Callable, Collection, Hashable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, Verbosity, configuration, given, seed, settings
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable

from ..isolation import HangError, Isolated, IsolationError, apply
from ..problem import DirectionProblem
from ..solvers.facts import tolerance_of
from ..solvers.interface import DirectionSolver
from .domain import domain_of, traits_of
from .draws import only_shapes, small_shapes
from .law import LawError, Outcome, takes
from .laws import Arguments, Law, part_drawn
from .process_state import restore_generators, restore_process
from .strategies import Case

# Shrinking asks the solver this often at most: slow solvers then keep a counterexample that is not quite minimal.
_SHRINKING_CALLS = 400
# Of a law that says that it costs time: failures until the verdict is clear, and calls to shrink. A lost process is as
# long a wait, and one is enough.
_ENOUGH_BROKEN, _FEW_CALLS = 3, 20
# To shrink a hang an answer is waited for so many times as long as answers usually take, and two seconds at least: with
# a tenth an answer of a busy machine is taken for a hang, with ten times as much a law costs minutes.
_TIMES_USUAL, _LEAST_WAIT = 50.0, 2.0
_SMALL_EXAMPLES = 200  # of small shapes, among which a counterexample is looked for first
# Problems kept for the next solver, a few kilobytes each.
_MOST_KEPT = 10_000
# Problems in a row that a solver does not take, until no more are drawn: of 1 in 100 some are found nearly always.
_MOST_REFUSED = 300
_Judge = Callable[[dict[str, Any]], object]


@dataclass
class Examination:
    """Counts of outcomes, and of what broke the law: its smallest arguments and message.

    untaken: of those skipped, the problems that the solver's `supports` does not take. loss: what ended the
    solver's process, if anything did.
    """

    held: int = 0
    declined: int = 0
    skipped: int = 0
    untaken: int = 0
    broken: int = 0
    loss: BaseException | None = None
    arguments: dict[str, Any] = field(default_factory=dict)
    message: str = ""
    tolerance: float = 0.0
    _unsupported: list[set[Hashable]] = field(default_factory=list)
    _answered: set[Hashable] = field(default_factory=set)

    @property
    def run(self) -> int:
        """Problems on which the solver was asked about the law."""
        return self.held + self.declined + self.broken

    def count(self, law: Law, solver: DirectionSolver, arguments: dict[str, Any]) -> LawError | None:
        """Puts the law to the solver once and counts the outcome; what broke it, if anything did."""
        try:
            outcome, tolerance = _outcome(law, solver, arguments)
            self._require_one_tolerance(tolerance)
        except LawError as broken:
            self.broken += 1
            self.loss = broken.__cause__ if isinstance(broken.__cause__, IsolationError) else None
            self.message = self.message or str(broken)
            return broken
        self.held += outcome == Outcome.HELD
        self.declined += outcome == Outcome.DECLINED
        self.skipped += outcome == Outcome.SKIPPED
        if outcome == Outcome.SKIPPED:
            self.untaken += not apply(_are_taken, solver, arguments)
        for problem in _problems_in(arguments)[:1]:
            if outcome == Outcome.UNSUPPORTED:
                self._unsupported.append(traits_of(problem))
            elif outcome != Outcome.SKIPPED:
                self._answered |= traits_of(problem)
        return None

    def settle(self) -> None:
        """Count what was called UNSUPPORTED: skipped where that is a limit of the solver's, else declined.

        A limit shows in a trait of the problem, such as n or the kind of constraints, with which none was answered.
        """
        for traits in self._unsupported:
            self.declined += traits <= self._answered
            self.skipped += not traits <= self._answered
        self._unsupported.clear()

    def _require_one_tolerance(self, tolerance: float) -> None:
        self.tolerance = self.tolerance or tolerance
        if tolerance != self.tolerance:
            raise LawError(f"tolerance should be one number; found {self.tolerance:g}, then {tolerance:g}")


def examine(
    law: Law, solver: DirectionSolver, cases: Collection[Case], *, max_examples: int, number: int
) -> Examination:
    """Counts over `max_examples` problems drawn by the seed `number`, which is mixed with the name of their source.

    Then, where the law broke, the same draws again up to the first failure, and from there to the smallest.
    """
    found = Examination()

    def judge(arguments: dict[str, Any]) -> None:
        found.count(law, solver, arguments)
        if found.loss or (law.costs_time and found.broken == _ENOUGH_BROKEN):
            raise _Enough

    with _traceless():
        draws, found.untaken = _draws_for(law, solver, cases, math.ceil(part_drawn(law) * max_examples), number)
        found.skipped = found.untaken
        with suppress(_Enough):
            draws.each(judge, math.ceil(law.part * max_examples))
        found.settle()
        if found.broken:
            found.arguments, message = _smallest(law, solver, draws, found.loss)
            found.message = message if found.arguments else f"{found.message}\n    ({message})"
    return found


def first_break(law: Law, solver: DirectionSolver, *, max_examples: int, number: int = 0) -> Examination:
    """Counts over `max_examples` problems, or up to the first that breaks the law, and its arguments and message."""
    found = Examination()

    def judge(arguments: dict[str, Any]) -> None:
        if broken := found.count(law, solver, arguments):
            found.arguments, found.message = arguments, str(broken)
            raise _Enough

    with _traceless(), suppress(_Enough):
        draws, _ = _draws_for(law, solver, law.applies_to(solver), max_examples, number)
        draws.search(judge, Phase.generate)
    found.settle()
    return found


def _draws_for(
    law: Law, solver: DirectionSolver, cases: Collection[Case], max_examples: int, number: int
) -> tuple["_Draws", int]:
    """The problems to draw, and how many of the first hundred were left out since the solver does not take them.

    All solvers get the same problems, and nothing is left out. But where a solver takes less than half of them, it gets
    as many others that it does take.
    """
    draws = _Draws(law.arguments, tuple(cases), max_examples, number)
    sample = replace(draws, max_examples=min(max_examples, 100))._draw_all()
    untaken = apply(_untaken, solver, sample)
    return (draws, 0) if 2 * untaken <= len(sample) else (replace(draws, solver=solver), untaken)


def _untaken(solver: DirectionSolver, sample: Sequence[dict[str, Any]]) -> int:
    return sum(not _are_taken(solver, arguments) for arguments in sample)


def _are_taken(solver: DirectionSolver, arguments: dict[str, Any]) -> bool:
    """Whether the law may put them to the solver; one whose `supports` raises is reported by the law."""
    try:
        return all(takes(solver, problem) for problem in _problems_in(arguments))
    except LawError:
        return True


def _problems_in(arguments: dict[str, Any]) -> list[DirectionProblem]:
    """The problem of the law, or all of its batch."""
    problems = arguments.get("problems", [arguments.get("problem")])
    return [problem for problem in problems if isinstance(problem, DirectionProblem)]


@dataclass(frozen=True)
class _Draws:
    """The same arguments each time they are gone through, as long as nothing fails.

    Laws that are about the same problems share them, since to draw takes longer than to solve. solver: only what it
    takes is drawn, for as long as that is found at all.
    """

    source: Callable[[tuple[Case, ...]], Arguments]
    cases: tuple[Case, ...]
    max_examples: int
    number: int
    solver: DirectionSolver | None = field(default=None, compare=False)

    def each(self, judge: _Judge, count: int) -> None:
        """The first `count`, kept for the next solver unless they are too many: drawing takes longer than solving."""
        if self.max_examples > _MOST_KEPT or self.solver is not None:
            replace(self, max_examples=count).search(judge, Phase.generate)
            return
        for arguments in self._draw_all()[:count]:
            judge(arguments)

    @lru_cache(maxsize=32)  # noqa: B019 - a few, by value
    def _draw_all(self) -> tuple[dict[str, Any], ...]:
        drawn: list[dict[str, Any]] = []
        self.search(drawn.append, Phase.generate)
        return tuple(drawn)

    def search(self, judge: _Judge, *phases: Phase) -> None:
        """As Hypothesis draws them, which ends, or shrinks, where the judge raises."""
        chosen = settings(
            max_examples=self.max_examples,
            phases=phases,
            database=None,
            deadline=None,
            derandomize=False,
            print_blob=False,
            report_multiple_bugs=False,
            suppress_health_check=list(HealthCheck),
            verbosity=Verbosity.quiet,
        )

        ended: list[SystemExit] = []  # by a signal; Hypothesis would take it for a failure, and shrink it

        def asked(drawn: list[dict[str, Any]]) -> None:
            try:
                judge(drawn[0])
            except SystemExit as end:
                ended.append(end)
                raise _Enough from end

        drawn = self.source(self.cases)
        if self.solver is not None:
            drawn = drawn.filter(_taken_by(self.solver))
        # Inside a unique list Hypothesis copies no part over another; else five of six problems were such variants of
        # the sixth, most of its shape, and a hundred examples were those of about twenty shapes.
        alone = st.lists(drawn, min_size=1, max_size=1, unique_by=id)
        test: Callable[[], None] = chosen(given(alone)(asked))
        shapes = () if self.solver is None else apply(domain_of, self.solver).rare_shapes
        with only_shapes(shapes), suppress(Unsatisfiable, _TakesNone):
            try:
                seed(zlib.crc32(self.source.__name__.encode()) + self.number)(test)()
            except _Enough:
                if ended:
                    raise ended[0] from None
                raise


class _Enough(KeyboardInterrupt):
    """Ends the search: the one kind of exception that Hypothesis does not take for a failure of the test."""


class _TakesNone(_Enough):
    """The solver takes none, or hardly any, of the problems drawn."""


def _taken_by(solver: DirectionSolver) -> Callable[[dict[str, Any]], bool]:
    """Whether the solver takes the problems; `_TakesNone` after many in a row that it does not."""
    refused = 0

    def is_taken(arguments: dict[str, Any]) -> bool:
        nonlocal refused
        taken = bool(apply(_are_taken, solver, arguments))
        refused = 0 if taken else refused + 1
        if refused == _MOST_REFUSED:
            raise _TakesNone
        return taken

    return is_taken


def _smallest(
    law: Law, solver: DirectionSolver, draws: _Draws, loss: BaseException | None
) -> tuple[dict[str, Any], str]:
    """The counterexample of a search among small shapes; of all where it holds on these."""
    with small_shapes():
        few = replace(draws, max_examples=max(draws.max_examples, _SMALL_EXAMPLES))
        found = _shrink(law, solver, few, loss)
    return (
        found
        or _shrink(law, solver, draws, loss)
        or ({}, "the law broke in the first pass and held in the second: the solver does not repeat its answers")
    )


def _shrink(
    law: Law, solver: DirectionSolver, draws: _Draws, loss: BaseException | None
) -> tuple[dict[str, Any], str] | None:
    """The last failure that Hypothesis saw, None for none: it tries only smaller ones after each."""
    smallest: list[tuple[dict[str, Any], str]] = []
    limit = None
    if isinstance(solver, Isolated) and isinstance(loss, HangError):
        limit = min(solver.time_limit, max(_LEAST_WAIT, _TIMES_USUAL * solver.usual_seconds))
    calls = 0

    def judge(arguments: dict[str, Any]) -> None:
        nonlocal calls
        calls += bool(smallest)
        if calls > (_FEW_CALLS if law.costs_time or loss else _SHRINKING_CALLS):
            raise _Enough
        try:
            _outcome(law, solver, arguments, limit)
        except LawError as broken:
            smallest[:] = [(arguments, str(broken))]
            raise

    try:
        draws.search(judge, Phase.generate, Phase.shrink)
    except (LawError, _Enough):
        return smallest[0]
    except Exception as flaky:  # Hypothesis' own: a solver that answers the same problem now so, now otherwise
        if not smallest:
            raise
        return smallest[0][0], f"{smallest[0][1]}\n    (not every time: {type(flaky).__name__})"
    return None


def _outcome(
    law: Law, solver: DirectionSolver, arguments: dict[str, Any], limit: float | None = None
) -> tuple[Outcome, float]:
    """The law put to the solver, and its tolerance then; LawError, caused by IsolationError, where it gets lost.

    limit: seconds that an isolated solver has, in place of its usual limit.
    """
    if not isinstance(solver, Isolated):
        return _outcome_here(solver, law.check, arguments)
    try:
        found: tuple[Outcome, float] = solver.apply(_outcome_here, law.check, arguments, time_limit=limit)
    except IsolationError as lost:
        message = f"solve should come back with a Direction; found {lost}"
        raise LawError(message, *_problems_in(arguments)[:1]) from lost
    return found


def _outcome_here(
    solver: DirectionSolver, check: Callable[..., Outcome], arguments: dict[str, Any]
) -> tuple[Outcome, float]:
    """The solver finds the global generators in one state before each problem.

    So do tests that Hypothesis runs; but problems that were kept are put to a solver outside of it.
    """
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002 - `_traceless` gives the caller's state back
    with restore_process():  # what a solver changes once, and finds changed ever after, would pass the law about it
        return check(solver, **arguments), tolerance_of(solver)


@contextmanager
def _traceless() -> Iterator[None]:
    """Generators and environment are as before afterwards; what Hypothesis notes goes to a folder that vanishes.

    It keeps notes in ./.hypothesis even without a database.
    """
    folder_before = getattr(configuration, "__hypothesis_home_directory", None)
    with restore_generators(), tempfile.TemporaryDirectory() as folder:
        configuration.set_hypothesis_home_dir(folder)
        try:
            yield
        finally:
            configuration.set_hypothesis_home_dir(folder_before)
