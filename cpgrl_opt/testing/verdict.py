"""`check_direction_solver`: every law put to a solver, and the verdict with counts and counterexamples."""

from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from scipy.special import bdtrc

from ..isolation import Isolated, apply
from ..solvers.facts import facts_of, tolerance_of
from ..solvers.interface import DirectionSolver
from ..validation import require_member
from .counterexample import counterexample_code
from .domain import forget_domain
from .examination import Examination, examine
from .law import LawError
from .laws import LAWS, Law
from .strategies import Case
from .target import get_ready

# A solver may give up on this part of the problems that float64 determines, and on one in any case.
MOST_DECLINED = 0.05
# Among fewer problems than this a rate says little: then it counts as too high where so many would come by chance, at
# the rate allowed, once in a thousand times. A decade more, and one right solver in five fails some law by chance.
_FEW, _BY_CHANCE = 50, 1e-3
_MOST_LOST = 3  # laws on which an isolated solver hung or crashed, each a minute or more, until the rest is given up
Spelled = tuple[tuple[str, ...], str]


@dataclass(frozen=True)
class CheckResult:
    """What became of one law. run = held + declined + failed + expected; skipped problems are apart.

    expected: failures of a check that was declared to fail, for the `reason` given; failed is 0 then.
    problem: what is wrong in words, "" if nothing is; counterexample: code that shows it, "" if there is none.
    """

    check: str
    statement: str
    run: int = 0
    declined: int = 0
    skipped: int = 0
    expected: int = 0
    failed: int = 0
    supported: bool = True
    reason: str = ""
    problem: str = ""
    counterexample: str = ""

    @property
    def passed(self) -> bool:
        """Held, or excused: the solver declares not to take such problems, or the failure was declared.

        A law that was put to no problem did not fail as declared.
        """
        return not self.problem or (bool(self.reason) and self.run > 0)

    @property
    def word(self) -> str:
        """The result in a word or two."""
        if not self.supported:
            return "unsupported"
        if not self.problem:
            return "held, though expected to fail" if self.reason else "held"
        return "failed as expected" if self.passed else "FAILED"

    def raise_for_failure(self) -> None:
        """LawError with the problem and the counterexample unless the check passed."""
        if not self.passed:
            raise LawError(f"{self.check}: {self.problem}\n\n{self.counterexample}".rstrip())


@dataclass(frozen=True)
class Verdict:
    """The results of all checks of one solver, in the order of `LAWS`."""

    solver: str
    tolerance: float
    max_examples: int
    seed: int
    results: tuple[CheckResult, ...]

    @property
    def passed(self) -> bool:
        """Every law held or was excused, some law was put to some problem, and not too much was declined in all."""
        return not (self.is_void or self.problem) and all(result.passed for result in self.results)

    @property
    def problem(self) -> str:
        """What is wrong with all results together: too few answers, though no law alone saw enough to tell."""
        counted = [result for result in self.results if not result.reason and _must_answer(LAWS[result.check])]
        run, declined = sum(result.run for result in counted), sum(result.declined for result in counted)
        if 0 < run == declined:
            return f"claimed nothing of any of {run} problems that float64 determines"
        if _is_by_chance(declined, run):
            return ""
        return f"declined {declined} of {run} problems that float64 determines, more than {MOST_DECLINED:.0%}"

    @property
    def is_void(self) -> bool:
        """Whether no problem was run at all, which says nothing about the solver."""
        return not any(result.run for result in self.results)

    @property
    def failures(self) -> tuple[CheckResult, ...]:
        """The results that did not pass."""
        return tuple(result for result in self.results if not result.passed)

    def __getitem__(self, check: str) -> CheckResult:
        """The result of a check by its name; ValueError for a name that was not checked."""
        results = {result.check: result for result in self.results}
        require_member("check", check, tuple(results))
        return results[check]

    def raise_for_failures(self) -> None:
        """LawError with every problem and counterexample unless the verdict is "passed"."""
        if not self.passed:
            raise LawError("\n\n".join([self.summary, *(_broken_law(result) for result in self.failures)]))

    @property
    def summary(self) -> str:
        """One sentence: how many laws held, were excused, failed."""
        words = [result.word for result in self.results]
        parts = [f"{words.count('held') + words.count('held, though expected to fail')} held"]
        parts += [
            f"{words.count(word)} {word}" for word in ("unsupported", "failed as expected", "FAILED") if word in words
        ]
        outcome = "passes" if self.passed else "does not pass"
        void = "; no problem was run: let `supports` take some of the laws' problems" if self.is_void else ""
        problem = f"; {self.problem}" if self.problem else ""
        return f"{self.solver} {outcome}: of {len(words)} laws {', '.join(parts)}{void}{problem}."

    def to_markdown(self) -> str:
        """Summary, a table with the counts of every check, then each failure with its counterexample."""
        head = "| check | law | run | declined | skipped | expected | failed | verdict |"
        lines = ["|---|---|--:|--:|--:|--:|--:|---|"]
        lines += [
            f"| {result.check} | {_cell(result.statement)} | {result.run} | {result.declined} | {result.skipped} "
            f"| {result.expected} | {result.failed} | {_cell(_with_reason(result))} |"
            for result in self.results
        ]
        title = f"# Verdict on {self.solver}"
        settings = f"Tolerance {self.tolerance:g}, {self.max_examples} examples a check, seed {self.seed}."
        broken = [_broken_law(result) for result in self.results if result.problem]
        return "\n\n".join([title, self.summary, settings, "\n".join([head, *lines]), *broken]) + "\n"


def check_direction_solver(
    solver: DirectionSolver,
    *,
    expected_failures: Mapping[str, str] | None = None,
    max_examples: int = 100,
    seed: int = 0,
    checks: Collection[str] | None = None,
    spelled: Spelled = ((), ""),
    progress: Callable[[str], None] = lambda _: None,
) -> Verdict:
    """Every law of `LAWS` put to a solver on generated problems; `isolation.Isolated` if it may hang or crash.

    A check fails when the law breaks once, when the solver declines more than 5 % (and more than one) of the problems
    that float64 determines, or when `supports` took none of those drawn though it takes examples. Of fewer than 50
    problems more may be declined, if it may be by chance; all results together are judged in the same way.

    Parameters
    ----------
    solver
        An object with `solve(problem)`, or `isolation.Isolated` of one.
    expected_failures
        Name of a check → why it is bound to fail; such failures are counted and excused.
    max_examples
        Problems a check.
    seed
        The same seed draws the same problems, among the same loaded modules.
    checks
        Names; all if None.
    spelled
        Statements and the expression by which counterexamples get the solver.
    progress
        Is told the name of each law that is done.

    Returns
    -------
    Verdict
        A result for each check, in the order of `LAWS`.

    Raises
    ------
    ValueError
        For names of checks that do not exist, and where `tolerance_of(solver)` does.
    """
    expected = dict(expected_failures or {})
    for name in (*expected, *(checks or ())):
        require_member("check", name, tuple(LAWS))
    tolerance = tolerance_of(solver)
    forget_domain(solver)
    results: list[CheckResult] = []
    lost = 0
    for law in LAWS.values():
        if checks is not None and law.name not in checks:
            continue
        before = losses_of(solver)
        reason = expected.get(law.name, "")
        if lost >= _MOST_LOST:
            problem = f"not run: the solver's process was lost on {_MOST_LOST} laws before."
            results.append(CheckResult(law.name, law.statement, reason=reason, problem=problem))
        else:
            found = check_law(law, solver, reason=reason, max_examples=max_examples, seed=seed, spelled=spelled)
            results.append(found)
        lost += losses_of(solver) > before
        progress(law.name)
    return Verdict(_solver_name(solver), tolerance, max_examples, seed, tuple(results))


def _get_ready(solver: DirectionSolver) -> None:
    with suppress(Exception):  # the laws will meet it again
        get_ready(solver)


def losses_of(solver: DirectionSolver) -> int:
    """How many processes an isolated solver has lost."""
    return solver.losses if isinstance(solver, Isolated) else 0


def check_law(
    law: Law,
    solver: DirectionSolver,
    *,
    reason: str = "",
    max_examples: int = 100,
    seed: int = 0,
    spelled: Spelled = ((), ""),
) -> CheckResult:
    """One law put to a solver; `reason` declares that it is bound to fail.

    spelled: statements and the expression by which a counterexample gets the solver; else it is left to the reader.
    """
    if isinstance(solver, Isolated):
        solver.begin_with(_get_ready)
    result = partial(CheckResult, law.name, law.statement)
    tolerance_of(solver)  # laws that need none hold for no solver whose own is out of range
    try:
        cases = apply(_cases, solver, law.name)
        if not cases:
            return result(supported=False)
    except LawError as broken:  # by `supports`, on the first problem that it was asked about
        expected, failed = int(bool(reason)), int(not reason)
        return result(run=1, expected=expected, failed=failed, reason=reason, problem=str(broken))
    found = examine(law, solver, cases, max_examples=max_examples, number=seed)
    problem = found.message or _declined_too_often(law, solver, found)
    if not problem and found.run == 0:
        if law.about_infeasible or found.untaken < found.skipped:  # the law says nothing about any that it takes
            return result(skipped=found.skipped, supported=False)
        problem = "no problem was run: `supports` took none of those drawn although it takes such cases."
    imports, expression = spelled
    code = counterexample_code(law, solver, found.arguments, imports=imports, spelled=expression)
    return result(
        run=found.run,
        declined=found.declined,
        skipped=found.skipped,
        expected=found.broken if reason else 0,
        failed=0 if reason else found.broken,
        reason=reason,
        problem=problem,
        counterexample=code if found.arguments else "",
    )


def _cases(solver: DirectionSolver, law: str) -> list[Case]:
    return LAWS[law].applies_to(solver)


def _declined_too_often(law: Law, solver: DirectionSolver, found: Examination) -> str:
    """What is wrong with the number of problems that the solver declined, and what to do about it."""
    if law.may_decline or (law.about_infeasible and not facts_of(solver).finds_infeasible):
        return ""
    is_rate = found.run >= _FEW and found.declined > max(1.0, MOST_DECLINED * found.run)
    if not is_rate and _is_by_chance(found.declined, found.run):
        return ""
    counts = f"declined {found.declined} of {found.run} problems"
    if law.about_infeasible:
        return (
            f"{counts} whose constraints no direction meets: call them INFEASIBLE, with a proof, or let the solver say "
            "`finds_infeasible = False`, if it cannot tell."
        )
    return (
        f"{counts} that float64 determines, more than {MOST_DECLINED:.0%}: answer them, or let `supports` say that "
        "they are not taken."
    )


def _is_by_chance(declined: int, run: int) -> bool:
    """Whether so many, or more, of `run` problems may be declined by a solver that gives up on 5 %: binomial tail."""
    return declined <= max(1.0, MOST_DECLINED * run) or bool(bdtrc(declined - 1, run, MOST_DECLINED) >= _BY_CHANCE)


def _must_answer(law: Law) -> bool:
    return not (law.may_decline or law.about_infeasible)


def _solver_name(solver: DirectionSolver) -> str:
    text = repr(solver)
    return type(solver).__name__ if " object at 0x" in text else text


def _with_reason(result: CheckResult) -> str:
    return f"{result.word}: {result.reason}" if result.reason else result.word


def _broken_law(result: CheckResult) -> str:
    code = f"\n\n```python\n{result.counterexample}```" if result.counterexample else ""
    return f"## {result.check}: {result.word}\n\n{result.statement}\n\n{result.problem}{code}"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
