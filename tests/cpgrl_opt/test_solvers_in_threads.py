"""Solvers in threads: the same answers, and nothing that belongs to the process is touched."""

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status
from cpgrl_opt.solvers import OSQP, DirectionSolver, QPSolversBackend, facts_of, is_usable, supports

NAMES = [name for name, solver in SOLVERS.items() if is_usable(solver)]
THREADS = 4
CATCH_CTRL_C = [name for name in ("osqp", "scs") if name in NAMES]


NASTY = [
    DirectionProblem([1.0, -2, 0.5], [[1, 0, 0], [-1, 1e-9, 0]], [1, 1]),
    DirectionProblem([1.0, -2, 0.5], [[1, 0, 0], [-1, 1e-12, 0]]),
    DirectionProblem([1.0, -2, 0.5], [[1, 0, 0], [-1, 0, 0]], [1, 1]),
    DirectionProblem([-1e12, 1e12, 3], [[1e12, 1, 0], [-1e12, 1, 1]], [1e12, -1e12]),
    DirectionProblem([1.5e308] * 3, [[1.0, 1, 1]], 0),
    DirectionProblem([1.0, 2, 3], np.ones((6, 3)), 1, True),
    DirectionProblem([0.0, 0], np.zeros((2, 2)), [0, 1]),
    DirectionProblem([-5e-324, 5e-324], [[1.0, 1], [1, -1]], 0),
    DirectionProblem([1e-170, -1e-170], [[1e170, 0], [0, 1e-170]], 0),
    DirectionProblem(  # SCS gives up on this one aloud
        [0.13456099515095846, 0.8561291067700574, -0.5441199396342818],
        [
            [1.5424487907688098, 0.1701719145212017, -0.3607191624722186],
            [0.7503927274275288, -0.06934030162812423, -1.766929602211422],
            [-2.29284151508086, -0.10083161849780248, 2.1276487814560174],
        ],
    ),
]


def problems(solver: DirectionSolver) -> list[DirectionProblem]:
    """Cones, a tangent, and what made libraries speak."""
    rng = np.random.default_rng(0)
    drawn = [DirectionProblem(rng.normal(size=4), rng.normal(size=(3, 4))) for _ in range(4)]
    tangent = DirectionProblem(drawn[0].gradient, drawn[0].jacobian, 0.0, True)
    return [problem for problem in (*drawn, *NASTY, tangent) if supports(solver, problem)]


def fingerprint(answer: Direction) -> tuple[Any, ...]:
    assert np.isfinite(answer.value).all()
    assert np.isfinite(answer.multipliers).all()
    return answer.status, answer.value.tobytes(), answer.multipliers.tobytes(), answer.iterations


@pytest.fixture
def hurried() -> Iterator[None]:
    """Threads take turns a thousand times as often."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(5e-6)
    yield
    sys.setswitchinterval(interval)


@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize("name", NAMES)
def test_threads_give_the_same_answers_and_touch_no_stream_and_no_filter(
    name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    solver = SOLVERS[name] if name != "scs" else QPSolversBackend("scs", iteration_limit=1000)
    given = problems(solver)
    alone = [fingerprint(solver.solve(problem)) for problem in given]
    capfd.readouterr()
    mine = (sys.stdout, sys.stderr, warnings.showwarning, warnings.filters, list(warnings.filters), dict(os.environ))
    seen: list[bool] = []

    def run(number: int) -> list[tuple[Any, ...]]:
        answers = []
        for k, problem in enumerate(given):
            sys.stdout.write(f"thread {number} problem {k}\n")
            answers.append(fingerprint(solver.solve(problem)))
            seen.append(sys.stdout is mine[0] and warnings.filters == mine[4])
        return answers

    with ThreadPoolExecutor(THREADS) as pool:
        for answers in pool.map(run, range(THREADS)):
            assert answers == alone
    now = (sys.stdout, sys.stderr, warnings.showwarning, warnings.filters, list(warnings.filters), dict(os.environ))
    assert all(before is after for before, after in zip(mine[:4], now[:4], strict=True))
    assert now[4:] == mine[4:]
    assert all(seen)
    printed = capfd.readouterr()
    said = [f"thread {number} problem {k}" for number in range(THREADS) for k in range(len(given))]
    assert sorted(printed.out.splitlines()) == sorted(said)
    assert printed.err == ""


def solve_and_wait(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """A solver that is done before the signal comes has not lost it; one that caught it has."""
    solver.solve(problem)
    time.sleep(1.0)


@pytest.mark.usefixtures("hears_interrupts")
@pytest.mark.parametrize("name", CATCH_CTRL_C)
def test_ctrl_c_while_a_library_solves_reaches_python(name: str) -> None:
    endless: dict[str, Any] = {"tolerance": 1e-30, "time_limit": 60.0, "iteration_limit": 2**31 - 1}
    solver = OSQP(**endless) if name == "osqp" else QPSolversBackend(name, **endless)
    problem = DirectionProblem([1.0, -2.0, 0.3], [[1.0, 0.1, 0.2], [-1.0, 0.2, 0.3]], [0.3, 0.1])
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        solve_and_wait(solver, problem)


def test_a_fresh_process_prints_nothing() -> None:
    code = (
        "from cpgrl_opt import SOLVERS, DirectionProblem as P\n"
        f"for name in {[name for name in NAMES if facts_of(SOLVERS[name]).packages]}:\n"
        "    SOLVERS[name].solve(P([0.0, 1.0], [[1.0, 0.0]], 1.0))\n"
    )
    done = subprocess.run([sys.executable, "-W", "always", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""
    for package in ("cpgrl_opt", "qpsolvers", "scs", "clarabel", "highspy", "cvxpy"):
        assert f"/{package}/" not in done.stderr.replace("\\", "/")


def run_highs(**options: Any) -> Callable[[], None]:
    """Anybody else's HiGHS: max x, x ≤ 1."""

    def run() -> None:
        import highspy

        solver = highspy.Highs()
        for name, value in {"output_flag": False, **options}.items():
            solver.setOptionValue(name, value)
        solver.addVar(0.0, 1.0)
        solver.changeColCost(0, -1.0)
        assert solver.run() == highspy.HighsStatus.kOk
        assert solver.getSolution().col_value[0] == 1.0

    return run


def solve_with_highs(**options: Any) -> Callable[[], None]:
    """Ours: min ½d², d ≥ 1."""

    def run() -> None:
        answer = QPSolversBackend("highs", options=options).solve(DirectionProblem([0.0], [[1.0]], 1.0))
        assert answer.status == Status.OPTIMAL
        np.testing.assert_allclose(answer.value, [1.0], atol=1e-12)

    return run


@pytest.mark.skipif("highs" not in NAMES, reason="HiGHS is not installed")
@pytest.mark.parametrize("theirs", [{}, {"threads": 1}, {"threads": 3}], ids=str)
def test_highs_is_right_before_and_after_anybody_elses_use_of_it(theirs: dict[str, int]) -> None:
    other, one, two = run_highs(**theirs), solve_with_highs(), solve_with_highs(threads=2)
    for order in itertools.permutations((other, one, two)):
        with ThreadPoolExecutor(1) as fresh:  # HiGHS remembers by thread
            for call in (*order, *order):
                fresh.submit(call).result()
