"""What is no problem, no direction and no linearization is refused by what it should be; numbers beyond float64 too."""

import os
import subprocess
import sys

import pytest

from cpgrl_opt import ConstrainedStep, DirectionProblem
from cpgrl_opt.solvers import ActiveSet

# Their annotations are checked in the tests, before they can speak for themselves.
REFUSED = """
from cpgrl_opt import *
from cpgrl_opt.solvers import solve_batch
from cpgrl_opt.vectors import Sharded
import numpy as np
problem = DirectionProblem([1.0, 0.0], [[-1.0, 0.0]])
direction = Direction(np.zeros(2), np.zeros(1), Status.OPTIMAL)
for wrong in (None, "x", 1.0, np.array(1.0), np.zeros(2), [1.0], object()):
    for call in (
        *(partial(solver.solve, wrong) for name, solver in SOLVERS.items() if name != "osqp"),
        lambda: WithGeometry(SOLVERS["nnls"]).solve(wrong),
        lambda: SOLVERS["osqp"].session(2, 1).solve(wrong),
        lambda: DirectionProblem([1.0, 0.0], [[-1.0, 0.0]], metric=[[1.0, 2.0], [3.0]]),
        lambda: Sharded(np.ones(2), np.ones((1, 2)), gather=3),
        lambda: DirectionProblem(Sharded),
        lambda: kkt_residuals(wrong, direction),
        lambda: kkt_residuals(problem, wrong),
        lambda: farkas_residual(wrong, np.zeros(1)),
        lambda: solve_batch("active-set", wrong),
        lambda: ProblemBatch.stack(wrong),
        lambda: ConstrainedStep()(wrong, [0.0]),
    ):
        try:
            call()
        except ValueError as error:
            assert "should" in str(error) and "found" in str(error), error
        else:
            raise AssertionError(wrong)
"""


def test_what_is_no_problem_is_refused() -> None:
    code = "from functools import partial\n" + REFUSED
    subprocess.run(
        [sys.executable, "-c", code], check=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    )


@pytest.mark.parametrize("name", ["step_size", "restoration_rate", "slack_fraction", "ridge", "max_restoration"])
def test_a_number_beyond_float64_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} should be"):
        ConstrainedStep(formulation="linearized" if name == "slack_fraction" else "restoring", **{name: 10**400})
    with pytest.raises(ValueError, match="radius should be"):
        DirectionProblem([1.0], [[1.0]], radius=10**400)
    with pytest.raises(ValueError, match="tolerance should be"):
        ActiveSet(tolerance=10**400)
