"""How many functions of ours a plain solve passes: docs/architecture.md names them."""

import sys
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

import cpgrl_opt
from cpgrl_opt import SOLVERS, DirectionProblem
from cpgrl_opt.solvers import compile_kernels, is_installed

OURS = str(Path(cpgrl_opt.__file__).parent)


def functions_passed(work: Any) -> list[str]:
    """Names of our Python functions that run, in their order; compiled code is none."""
    seen = []

    def note(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(OURS) and f"{OURS}/solvers/compiled" not in code.co_filename:
            seen.append(code.co_name)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(before)
    return seen


def test_a_plain_solve_passes_four_functions() -> None:
    compile_kernels(thorough=False)
    rng, solver = np.random.default_rng(0), SOLVERS["active-set"]
    problem = DirectionProblem(rng.normal(size=9), rng.normal(size=(3, 9)))
    solver.solve(problem)
    assert functions_passed(lambda: solver.solve(problem)) == ["solve", "solve_rows", "project", "make"]


FULL = np.random.default_rng(1).normal(size=(9, 9))
FULL = FULL @ FULL.T + np.eye(9)


BACK_ENDS = ("osqp", "quadprog", "daqp", "piqp", "proxqp", "clarabel", "highs", "scs", "cvxpy")


# What stands in docs/architecture.md.
@pytest.mark.parametrize(
    ("solver", "geometry", "most"),
    [
        ("active-set", {"radius": 0.5}, 5),
        ("active-set", {"metric": np.arange(1.0, 10.0)}, 20),
        ("active-set", {"metric": FULL, "radius": 0.5}, 38),
        *((name, {"metric": FULL, "radius": 0.5}, 60) for name in BACK_ENDS),
    ],
)
def test_a_metric_and_a_ball_are_a_few_functions_more(solver: str, geometry: dict[str, Any], most: int) -> None:
    if not is_installed(SOLVERS[solver]):
        pytest.skip(f"{solver} is not installed")
    compile_kernels(thorough=False)
    rng, asked = np.random.default_rng(0), 0
    for _ in range(5):
        g, J = rng.normal(size=9), rng.normal(size=(3, 9))
        SOLVERS[solver].solve(DirectionProblem(g, J, 0.05, **geometry))
        problem = DirectionProblem(g, J, 0.05, **geometry)
        passed = functions_passed(partial(SOLVERS[solver].solve, problem))
        calls = passed.count("solve_small")
        assert len(passed) <= most + 16 * max(0, calls - 1)  # each further call of a core costs sixteen at most
        asked += calls
    assert asked > 0 or solver == "active-set"
