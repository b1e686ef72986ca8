"""The kernels' interpreted form gives the compiled form's bits, and gives way to it when there is work."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.machine_code import compile_function
from cpgrl_opt.solvers.compiled._direct import project_directly
from cpgrl_opt.solvers.compiled._entry_point import EntryPoint, entry_point, work
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
        monkeypatch.setattr(kernel, "run", kernel)
        monkeypatch.setattr(kernel, "calls_to_interpret", interpreted_calls)
        monkeypatch.setattr(kernel, "work_to_interpret", 10**12)
    return [bits(SOLVERS[name].solve(problem)) for problem in problems for name in ("active-set", "rosen")]


@pytest.mark.parametrize("name", SMALL)
def test_both_forms_give_the_same_bits(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problems = [FAMILIES[name].problem(number, 3) for number in range(4)]
    assert answers(problems, 10**9, monkeypatch) == answers(problems, 0, monkeypatch)


def test_both_forms_give_the_same_bits_at_the_ends_of_float64(monkeypatch: pytest.MonkeyPatch) -> None:
    assert answers(NOT_FINITE, 10**9, monkeypatch) == answers(NOT_FINITE, 0, monkeypatch)


def counting(form: list[str], name: str) -> Callable[[np.ndarray], str]:
    return lambda _rows: form.append(name) or name


def test_after_some_calls_and_for_large_problems_machine_code_takes_over() -> None:
    small, large = np.zeros((2, 3)), np.zeros((20, 30))
    for calls, expected in (
        ([small, small, small], ["interpreted", "interpreted", "compiled"]),
        ([large, small], ["compiled", "interpreted"]),
        ([small, large, small], ["interpreted", "compiled", "interpreted"]),
    ):
        form: list[str] = []
        decorate = entry_point("void(f8[:, ::1])", interpreted=(2, 2 * work((small,))))
        kernel: EntryPoint = decorate(counting(form, "interpreted"))
        kernel.__dict__["machine_code"] = counting(form, "compiled")
        assert [kernel(rows) for rows in calls] == expected
        assert form == expected


def test_without_a_folder_for_the_cache_kernels_are_compiled_with_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("numba.core.caching.FunctionCache._impl_class._locator_classes", [])
    source = tmp_path / "doubled.py"
    source.write_text("def doubled(x):\n    return 2.0 * x\n")
    namespace: dict[str, Any] = {}
    exec(compile(source.read_text(), str(source), "exec"), namespace)
    with pytest.warns(RuntimeWarning, match="NUMBA_CACHE_DIR"):
        assert compile_function("f8(f8)", namespace["doubled"])(2.0) == 4.0
