"""Laws of a solver among others: whoever runs beside it, before it or after it in one process sees nothing of it."""

import random
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, cast

import numpy as np

from ..problem import DirectionProblem
from ..solvers.interface import DirectionSolver
from .law import (
    Answer,
    LawError,
    answer_of,
    ask,
    law,
    read_answer,
    require,
    same_bits,
    skip_unless,
    takes,
    vary,
)
from .process_state import CHANGED_BY_IMPORTS, changes_since, restore_generators, restore_process, snapshot
from .sensitivity import require_same_optimum

_THREADS, _ROUNDS = 4, 1
_SWITCH_INTERVAL = 5e-5  # s, for 5 ms: threads then meet inside of one solve
_LONGEST_WAIT = 120.0  # s, for threads that should be done in a moment


@law
def check_answers_stay(solver: DirectionSolver, problem: DirectionProblem, between: DirectionProblem) -> None:
    """An answer does not change when another problem is solved, and nothing changes when it is written to.

    Bit for bit; of solve and, where there is one, of solve_batch. Read-only arrays are not written to.
    Source: answers are kept beside each other; an array that is returned is the caller's.
    """
    skip_unless(takes(solver, problem))
    _require_lasting(solver, problem, between, lambda each: solver.solve(vary(each)))
    if hasattr(solver, "solve_batch") and between.jacobian.shape == problem.jacobian.shape:
        batch: Callable[[Any], Any] = cast(Any, solver).solve_batch
        _require_lasting(solver, problem, between, lambda each: batch([vary(each)])[0])


@law
def check_threads_do_not_meet(solver: DirectionSolver, problem: DirectionProblem, between: DirectionProblem) -> None:
    """Four threads that solve at once get the answers that one gets, and streams, filters and modes stay as they were.

    Each solves the two problems in turn. The same status and, where OPTIMAL, ‖Δd‖ ≤ 2 · `distance_bound`(ε).
    Source: a solver is a function.
    """
    problems = [each for each in (problem, between) if takes(solver, each)]
    skip_unless(bool(problems))
    alone = [answer_of(solver, problem) for problem in problems]
    with restore_process():
        sys.setswitchinterval(_SWITCH_INTERVAL)
        before = snapshot()
        together = _in_threads(solver, problems)
        changed = changes_since(before)
    for k, answer in together:
        if isinstance(answer, Exception):
            message = f"solve should answer while other threads solve too; it raised {type(answer).__name__}: {answer}"
            raise LawError(message, problems[k])
        advice = "Keep what a call works with in that call: threads share the solver's attributes and module's globals."
        statuses = f"say {alone[k].status.name} in a thread too; found {answer.status.name}"
        same = alone[k].status == answer.status
        require(same, f"solve should {statuses}. {advice}", problems[k], alone[k], answer)
        require_same_optimum(solver, problems[k], (alone[k], answer), "‖d − d'‖ of one thread and of four", advice)
    advice = "What is swapped and put back by each call is put back in another order by two"
    _require_unchanged(changed, "four threads that solve should", advice, problems[0])


@law
def check_global_state_is_unchanged(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """Generators, floating-point modes, warning filters, environment, folder, signals, streams, threads stay.

    Of two calls in a row; what the import of a package may change once (filters, environment, sys.path, threads) is
    looked at in the second only. Source: it belongs to the caller, whose random numbers the seed of a solver repeats.
    """
    for call in (0, 1):
        with restore_generators(), restore_process():
            random.seed(91 + call)
            np.random.seed(91 + call)  # noqa: NPY002 - the caller's, whom the solver must not meet
            before = snapshot()
            answer_of(solver, problem)
            changed = [name for name in changes_since(before) if call == 1 or name not in CHANGED_BY_IMPORTS]
        _require_unchanged(changed, "solve should", "Use a generator, a context or an option of your own", problem)


def _require_unchanged(changed: Sequence[str], who: str, advice: str, problem: DirectionProblem) -> None:
    require(not changed, f"{who} leave the process as it was; found changed: {', '.join(changed)}. {advice}", problem)


def _require_lasting(
    solver: DirectionSolver, problem: DirectionProblem, between: DirectionProblem, solve: Callable[[Any], Any]
) -> None:
    kept = ask(solve, problem, problem)
    first = read_answer(problem, kept)
    if takes(solver, between):
        with suppress(Exception):  # other laws are about what becomes of it
            solve(between)
    later = read_answer(problem, kept)
    message = (
        "an answer should stay as it is when another problem is solved; found that it changed: return copies of what "
        "the next call writes to"
    )
    require(same_bits(first, later), message, problem, first, later)
    for array in (kept.value, kept.multipliers):
        if isinstance(array, np.ndarray) and array.flags.writeable:
            array[...] = 77.0
    again = read_answer(problem, ask(solve, problem, problem))
    message = (
        "what a caller writes into an answer should not come back in the next; found that it did: return copies of "
        "what is kept"
    )
    require(same_bits(first, again), message, problem, first, again)


def _in_threads(solver: DirectionSolver, problems: Sequence[DirectionProblem]) -> list[tuple[int, Answer | Exception]]:
    """(index, answer) of all problems, several times over, each thread beginning with another."""
    answers: list[tuple[int, Answer | Exception]] = []
    start = threading.Barrier(_THREADS)

    def work(number: int) -> None:
        start.wait()
        for step in range(_ROUNDS * len(problems)):
            k = (number + step) % len(problems)
            try:
                answers.append((k, read_answer(problems[k], solver.solve(problems[k]))))
            except Exception as error:
                answers.append((k, error))

    threads = [threading.Thread(target=work, args=(number,), daemon=True) for number in range(_THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(_LONGEST_WAIT)
        if thread.is_alive():
            raise LawError("four threads should all come back; found one that waits", problems[0])
    return answers
