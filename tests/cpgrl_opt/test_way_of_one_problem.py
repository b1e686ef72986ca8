"""How many functions of ours a plain solve passes: docs/architecture.md names them."""

import sys
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import cpgrl_opt
from cpgrl_opt import SOLVERS, DirectionProblem
from cpgrl_opt.solvers import compile_kernels

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
