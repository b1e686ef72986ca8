"""The kernels' interpreted form gives the compiled form's bits, and gives way to it when there is work."""

import subprocess
import sys
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.solvers.compiled._direct import project_directly
from cpgrl_opt.solvers.compiled._entry_point import INTERPRETED_WORK, EntryPoint, entry_point
from cpgrl_opt.solvers.compiled._projection import project_stacked

SMALL = [name for name, family in FAMILIES.items() if family.problem(0, 0).n <= 100]
NOT_FINITE = (
    DirectionProblem([1e308, 1e308], [[1e-308, 1e308], [1e308, 0.0]], [1e308, -1e-308]),
    DirectionProblem([5e-324, 0.0], [[5e-324, 5e-324]], [5e-324]),
    DirectionProblem([1.0, 1.0], np.zeros((0, 2))),
    DirectionProblem([0.0, 0.0], [[0.0, 0.0], [1.0, 1.0]], [0.0, -1.0]),
)


def bits(direction: Direction) -> tuple[object, ...]:
    return direction.status, direction.iterations, direction.value.tobytes(), direction.multipliers.tobytes()


def answers(problems: Sequence[DirectionProblem], interpreted_calls: int, monkeypatch: pytest.MonkeyPatch) -> list:
    for kernel in (project_directly, project_stacked):
        _ = kernel.machine_code  # loading it turns the interpreter off
        monkeypatch.setattr(kernel, "calls_to_interpret", interpreted_calls)
    return [bits(SOLVERS[name].solve(problem)) for problem in problems for name in ("active-set", "rosen")]


@pytest.mark.parametrize("name", SMALL)
def test_both_forms_give_the_same_bits(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problems = [FAMILIES[name].problem(number, 3) for number in range(4)]
    assert answers(problems, 10**9, monkeypatch) == answers(problems, 0, monkeypatch)


def test_both_forms_give_the_same_bits_at_the_ends_of_float64(monkeypatch: pytest.MonkeyPatch) -> None:
    assert answers(NOT_FINITE, 10**9, monkeypatch) == answers(NOT_FINITE, 0, monkeypatch)


def test_the_first_problems_of_a_process_need_no_compiler() -> None:
    code = """
import sys
from cpgrl_opt import SOLVERS, DirectionProblem, Status
for name in ("active-set", "rosen"):
    assert SOLVERS[name].solve(DirectionProblem([1.0, 1.0], [[-1.0, 0.0]], equality=True)).status == Status.OPTIMAL
opposing = DirectionProblem([1.0, 2.0], [[1.0, 0.0], [-1.0, 0.0]], [1.0, 1.0])
assert SOLVERS["active-set"].solve(opposing).status == Status.INFEASIBLE
assert "numba" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def counting(form: list[str], name: str) -> Callable[..., None]:
    return lambda *arguments: form.append(name)


def test_after_some_calls_and_for_large_problems_machine_code_takes_over() -> None:
    form: list[str] = []
    small, large = np.zeros((2, 3)), np.zeros((100, 1 + INTERPRETED_WORK // 10_000))
    for calls in ([small, small, small], [large, small]):
        kernel: EntryPoint = entry_point("void(f8[:, ::1])", interpreted_calls=2)(counting(form, "interpreted"))
        kernel.__dict__["machine_code"] = counting(form, "compiled")
        for rows in calls:
            kernel(rows)
    assert form == ["interpreted", "interpreted", "compiled", "compiled", "interpreted"]


def test_machine_code_once_loaded_is_used() -> None:
    _ = project_directly.machine_code
    assert project_directly.calls_to_interpret == 0
