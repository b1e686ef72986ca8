"""One law put to one solver: many generated problems, counted, and the smallest counterexample."""

import random
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, Verbosity, configuration, given, seed, settings

from ..solvers.interface import DirectionSolver
from .law import LawBroken, Outcome
from .laws import Law
from .strategies import Case

# Shrinking asks the solver this often at most: slow solvers then keep a counterexample that is not quite minimal.
_SHRINKING_CALLS = 400
# Problems kept for the next solver, a few kilobytes each.
_MOST_KEPT = 20_000
_Judge = Callable[[dict[str, Any]], object]


@dataclass
class Examination:
    """Counts of outcomes, and of what broke the law: its smallest arguments and message."""

    held: int = 0
    declined: int = 0
    skipped: int = 0
    broken: int = 0
    arguments: dict[str, Any] = field(default_factory=dict)
    message: str = ""

    @property
    def run(self) -> int:
        """Problems on which the solver was asked about the law."""
        return self.held + self.declined + self.broken

    def count(self, law: Law, solver: DirectionSolver, arguments: dict[str, Any]) -> LawBroken | None:
        """Puts the law to the solver once and counts the outcome; what broke it, if anything did."""
        try:
            outcome = _outcome(law, solver, arguments)
        except LawBroken as broken:
            self.broken += 1
            return broken
        self.held += outcome == Outcome.HELD
        self.declined += outcome == Outcome.DECLINED
        self.skipped += outcome == Outcome.SKIPPED
        return None


def examine(law: Law, solver: DirectionSolver, *, max_examples: int, number: int) -> Examination:
    """Counts over `max_examples` problems drawn by the seed `number`, which is mixed with the law's name.

    Then, where the law broke, the same draws again up to the first failure, and from there to the smallest.
    """
    found = Examination()
    draws = _Draws(law, tuple(law.applies_to(solver)), max_examples, number)
    with _traceless():
        draws.each(partial(found.count, law, solver))
        if found.broken:
            found.arguments, found.message = _smallest(law, solver, draws)
    return found


def first_break(law: Law, solver: DirectionSolver, *, max_examples: int, number: int = 0) -> Examination:
    """Counts over `max_examples` problems, or up to the first that breaks the law, and its arguments and message."""
    found = Examination()

    def judge(arguments: dict[str, Any]) -> None:
        if broken := found.count(law, solver, arguments):
            found.arguments, found.message = arguments, str(broken)
            raise _Enough

    draws = _Draws(law, tuple(law.applies_to(solver)), max_examples, number)
    with _traceless(), suppress(_Enough):
        draws.searched(judge, Phase.generate)
    return found


@dataclass(frozen=True)
class _Draws:
    """The same arguments each time they are gone through, as long as nothing fails."""

    law: Law
    cases: tuple[Case, ...]
    max_examples: int
    number: int

    def each(self, judge: _Judge) -> None:
        """All of them, kept for the next solver unless they are too many: drawing takes longer than solving."""
        if self.max_examples > _MOST_KEPT:
            self.searched(judge, Phase.generate)
            return
        for arguments in self._kept():
            judge(arguments)

    @lru_cache(maxsize=4)  # noqa: B019 - a few, by value
    def _kept(self) -> tuple[dict[str, Any], ...]:
        drawn: list[dict[str, Any]] = []
        self.searched(drawn.append, Phase.generate)
        return tuple(drawn)

    def searched(self, judge: _Judge, *phases: Phase) -> None:
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

        def asked(arguments: dict[str, Any]) -> None:
            judge(arguments)

        test: Callable[[], None] = chosen(given(self.law.arguments(self.cases))(asked))
        seed(zlib.crc32(self.law.name.encode()) + self.number)(test)()


class _Enough(KeyboardInterrupt):
    """Ends the search: the one kind of exception that Hypothesis does not take for a failure of the test."""


def _smallest(law: Law, solver: DirectionSolver, draws: _Draws) -> tuple[dict[str, Any], str]:
    """The last failure that Hypothesis saw: it tries only smaller ones after each."""
    smallest: list[tuple[dict[str, Any], str]] = []
    calls = 0

    def judge(arguments: dict[str, Any]) -> None:
        nonlocal calls
        calls += bool(smallest)
        if calls > _SHRINKING_CALLS:
            raise _Enough
        try:
            _outcome(law, solver, arguments)
        except LawBroken as broken:
            smallest[:] = [(arguments, str(broken))]
            raise

    try:
        draws.searched(judge, Phase.generate, Phase.shrink)
    except (LawBroken, _Enough):
        return smallest[0]
    except Exception as flaky:  # Hypothesis' own: a solver that answers the same problem now so, now otherwise
        if not smallest:
            raise
        return smallest[0][0], f"{smallest[0][1]}\n    (not every time: {type(flaky).__name__})"
    return {}, "the law broke in the first pass and held in the second: the solver does not repeat its answers"


def _outcome(law: Law, solver: DirectionSolver, arguments: dict[str, Any]) -> Outcome:
    """The law put to the solver, which finds the global generators in one state before each problem.

    So do tests that Hypothesis runs; but problems that were kept are put to a solver outside of it.
    """
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002 - `_traceless` gives the caller's state back
    return law.check(solver, **arguments)


@contextmanager
def _traceless() -> Iterator[None]:
    """Global generators are as before afterwards; what Hypothesis notes goes to a folder that vanishes.

    It keeps notes in ./.hypothesis even without a database.
    """
    folder_before = getattr(configuration, "__hypothesis_home_directory", None)
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - the caller's
    with tempfile.TemporaryDirectory() as folder:
        configuration.set_hypothesis_home_dir(folder)
        try:
            yield
        finally:
            configuration.set_hypothesis_home_dir(folder_before)
            random.setstate(python)
            np.random.set_state(numpy)  # noqa: NPY002
