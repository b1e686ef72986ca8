"""The body of `cpgrl check package.module:SOLVER`: a verdict on the terminal, and an exit status."""

import itertools
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ..comparison.whole_file import whole_file
from ..isolation import Isolated, IsolationError, apply, exit_on_termination
from ..validation import require_count, require_member, require_positive
from .laws import LAWS
from .target import TargetError, checkable_solver, spelling_of
from .verdict import CheckResult, Verdict, check_direction_solver

HELD, BROKEN, UNWRITTEN, INTERRUPTED = 0, 1, 2, 130
# 8 GiB: the laws' problems are a few kilobytes, but libraries that bring threads and compilers reserve some gigabytes;
# below 2 or 3 right solvers fail to start, and without a limit a wrong one takes the machine with it.
MEMORY_LIMIT = 2.0**33
_WORDS = {"failed as expected": "excused", "unsupported": "n/a", "held, though expected to fail": "held"}


def run_check(target: str, **settings: Any) -> int:
    """`check_target` on a terminal: progress and the traceback of the solver's own module on stderr.

    Ctrl-C is 130, SIGTERM 143; no process of the solver's is left behind.
    """
    try:
        with exit_on_termination():
            return check_target(target, progress=_progress_on_terminal(len(LAWS)), **settings)
    except TargetError as error:
        sys.stderr.write(error.traceback)
        raise
    except KeyboardInterrupt:
        sys.stderr.write("Interrupted.\n")
        return INTERRUPTED


def check_target(
    target: str,
    *,
    max_examples: int = 100,
    seed: int = 0,
    expected_failures: Sequence[str] = (),
    markdown: Path | None = None,
    time_limit: float = 30.0,
    memory_limit: float = MEMORY_LIMIT,
    progress: Callable[[str], None] = lambda _: None,
) -> int:
    """Checks the solver that the target names, and prints the verdict.

    Parameters
    ----------
    target
        package.module:SOLVER.
    max_examples, seed
        As for `check_direction_solver`.
    expected_failures
        "CHECK=REASON", the check with or without "check_".
    markdown
        A file for the full verdict.
    time_limit, memory_limit
        Seconds that one problem may take, and bytes that the solver's process may allocate.
    progress
        Is told the name of each law that is done.

    Returns
    -------
    int
        0 if all laws held, 1 if one broke, 2 if all held and the file could not be written.

    Raises
    ------
    TargetError
        Where there is nothing to check.
    ValueError
        For settings that are out of range.
    """
    require_count("max_examples", max_examples)
    require_count("seed", seed, 0)
    require_positive("memory_limit", memory_limit)
    if markdown is not None and (not markdown.parent.is_dir() or markdown.is_dir()):
        raise ValueError(f"markdown should be a file in a folder that exists; found {str(markdown)!r}")
    expected = expected_of(expected_failures)
    make = partial(checkable_solver, target)
    with Isolated(make=make, time_limit=time_limit, memory_limit=int(memory_limit)) as solver:
        try:
            verdict = check_direction_solver(
                solver, expected_failures=expected, max_examples=max_examples, seed=seed,
                checks=tuple(LAWS), spelled=apply(spelling_of, solver, target), progress=progress,
            )  # fmt: skip
        except IsolationError as lost:
            raise TargetError(f"{target} should import and answer a problem; found {lost}") from lost
    if not any(result.supported for result in verdict.results):
        raise TargetError(
            f"{target} should take some of the laws' problems, Euclidean ones or, with `takes_geometry = True`, those "
            "with a radius, of several rows or one; found that `supports` takes none"
        )
    return _report(replace(verdict, solver=target), markdown)


def _report(verdict: Verdict, markdown: Path | None) -> int:
    """Prints before it writes, so that neither a full disk nor a folder in the file's place costs the verdict."""
    sys.stdout.write(f"{verdict_text(verdict, markdown)}\n")
    status = HELD if verdict.passed else BROKEN
    if markdown is None:
        return status
    try:
        with whole_file(markdown) as beside:
            beside.write_text(verdict.to_markdown(), encoding="utf-8")
    except OSError as error:
        sys.stdout.flush()
        sys.stderr.write(f"cpgrl: the verdict could not be written: {error}\n")
        return status or UNWRITTEN
    sys.stdout.write(f"Wrote {markdown}\n")
    return status


def expected_of(pairs: Sequence[str]) -> dict[str, str]:
    """{check: reason} of texts "CHECK=REASON"; ValueError for other texts and for checks that do not exist."""
    expected = {}
    for pair in pairs:
        check, _, reason = pair.partition("=")
        if not check.strip() or not reason.strip():
            raise ValueError(f"expected_failure should be CHECK=REASON; found {pair!r}")
        name = f"check_{check.strip().removeprefix('check_')}"
        require_member("check in expected_failure", name, tuple(LAWS))
        expected[name] = reason.strip()
    return expected


def verdict_text(verdict: Verdict, markdown: Path | None = None) -> str:
    """Table, what is wrong with each law in a line, the shortest counterexample, and the summary last."""
    lines = [f"{'law':33}{'run':>5}{'declined':>9}{'skipped':>8}{'expected':>9}{'failed':>7}"]
    for result in verdict.results:
        counts = (
            f"{result.run:5}{result.declined:9}{result.skipped:8}{result.expected:9}{result.failed:7}"
            if result.supported
            else f"{'–':>5}{'–':>9}{'–':>8}{'–':>9}{'–':>7}"
        )
        lines.append(f"{_short(result):33}{counts}  {_WORDS.get(result.word, result.word)}")
    for line, group in _by_problem(verdict).items():
        names = ", ".join(_short(result) for result in group)
        statement = group[0].statement.partition(" Source:")[0] if len(group) == 1 else ""
        lines += ["", f"{group[0].word}: {names}", *([f"    {statement}"] if statement else []), f"    {line}"]
        lines += [f"    expected: {group[0].reason}"] if group[0].reason else []
    lines += _shown_counterexample(verdict)
    rest = sum(bool(result.counterexample) for result in verdict.results) - 1
    if rest > 0 and markdown is None:
        lines += ["", f"{rest} more in the file that --markdown names."]
    settings = f"Tolerance {verdict.tolerance:g}, {verdict.max_examples} examples a law, seed {verdict.seed}."
    return "\n".join([*lines, "", settings, verdict.summary])


def _by_problem(verdict: Verdict) -> dict[str, list[CheckResult]]:
    """The laws with a problem, those with the same one together."""
    groups: dict[str, list[CheckResult]] = {}
    for result in verdict.results:
        if result.problem:
            line = result.problem.partition("\n")[0]
            key = line if not result.reason else f"{line} "  # excused ones apart
            groups.setdefault(key, []).append(result)
    return groups


def _shown_counterexample(verdict: Verdict) -> list[str]:
    """The shortest one, of failures that are not excused first."""
    with_code = [result for result in verdict.results if result.counterexample]
    if not with_code:
        return []
    shown = min(with_code, key=lambda result: (result.passed, len(result.counterexample)))
    numbers = shown.problem.partition("\n")[2]
    test = shown.counterexample.rstrip()
    return ["", f"The counterexample of {_short(shown)}, as a test:", "", test, *(["", numbers] if numbers else [])]


def _short(result: CheckResult) -> str:
    return result.check.removeprefix("check_")


def _progress_on_terminal(total: int) -> Callable[[str], None]:
    """A line of stderr for each law that is done, and only on a terminal."""
    done = itertools.count(1)

    def tell(law: str) -> None:
        if sys.stderr.isatty():
            sys.stderr.write(f"{next(done):3} of {total} laws  {law}\n")

    return tell
