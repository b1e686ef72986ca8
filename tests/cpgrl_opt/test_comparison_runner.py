"""The comparison survives what it compares: every misconduct gets its name, and what was finished stays."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpgrl_opt import Direction, DirectionProblem, Status
from cpgrl_opt.comparison.judgement import judge
from cpgrl_opt.comparison.measurement import Measurement, read_measurements
from cpgrl_opt.comparison.runner import ComparisonSettings, open_checkpoint, run_comparison
from cpgrl_opt.exact import exact_answer

MISCONDUCT = """
import os, sys, time
import numpy as np
from cpgrl_opt import SOLVERS, Direction, Status

class Solver:
    def __init__(self, act, status=Status.OPTIMAL):
        self.act, self.status = act, status
    def solve(self, problem):
        self.act()
        return Direction(problem.gradient + 0.1, np.zeros(problem.m), self.status)

class Printing:
    def solve(self, problem):
        os.write(1, b"iteration 1")
        return SOLVERS["active-set"].solve(problem)

def fail():
    raise RuntimeError("broken")

def escape():  # leaves somebody behind who holds the pipes
    if os.fork() == 0:
        time.sleep(600)
    os._exit(3)

nothing = lambda: None
LYING = Solver(nothing)
DECLINING = Solver(nothing, Status.UNCERTIFIED)
PESSIMISTIC = Solver(nothing, Status.INFEASIBLE)
RAISING = Solver(fail)
EXITING = Solver(lambda: os._exit(3))
ESCAPING = Solver(escape)
SLEEPING = Solver(lambda: time.sleep(60))
SLOW = Solver(lambda: time.sleep(3))
"""

EXPECTED = {
    "active-set": "success",
    "misconduct:LYING": "silently-wrong",
    "misconduct:DECLINING": "honest-failure",
    "misconduct:PESSIMISTIC": "false-infeasible",
    "misconduct:RAISING": "crash",
    "misconduct:EXITING": "crash",
    "misconduct:ESCAPING": "crash",
    "misconduct:SLEEPING": "hang",
    "misconduct:Printing": "success",
}


if os.name == "nt":
    del EXPECTED["misconduct:ESCAPING"]  # Windows has no fork


@pytest.fixture
def misconduct(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "misconduct.py").write_text(MISCONDUCT)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "misconduct", raising=False)
    return tmp_path


def run(folder: Path, *, anew: bool = False, **settings: object) -> list[Measurement]:
    chosen = ComparisonSettings(**{"problems": 1, "repeats": 1, "limit": 0.1, **settings})  # type: ignore[arg-type]
    return run_comparison(chosen, open_checkpoint(chosen, folder, {}, anew=anew))


def test_every_misconduct_gets_its_name_and_costs_one_problem(misconduct: Path) -> None:
    measurements = run(misconduct / "out", solvers=tuple(EXPECTED), families=("well-conditioned-equality",))
    assert {each.solver: each.outcome for each in measurements} == EXPECTED
    assert [each.solver for each in measurements if each.noise] == ["misconduct:Printing"]
    assert read_measurements(misconduct / "out" / "measurements.csv") == measurements
    late = next(each for each in measurements if each.outcome == "hang")
    assert (late.seconds, late.worst) == (0.1, float("inf"))
    assert late.ratio > 100


def test_a_killed_comparison_goes_on_where_it_was(misconduct: Path) -> None:
    settings = "solvers=('active-set', 'misconduct:SLOW'), families=('zero-rows',), problems=2, repeats=1"
    program = (
        f"import sys; sys.path[:] = {[str(misconduct), *sys.path]!r}\n"
        "from pathlib import Path\n"
        "from cpgrl_opt.comparison.runner import *\n"
        f"settings = ComparisonSettings({settings})\n"
        f"run_comparison(settings, open_checkpoint(settings, Path({str(misconduct / 'out')!r}), {{}}))\n"
    )
    path = misconduct / "out" / "measurements.csv"
    with subprocess.Popen([sys.executable, "-c", program]) as process:
        while process.poll() is None and not (path.exists() and path.read_text().count("\n") > 2):
            time.sleep(0.05)
        process.kill()
    assert process.returncode != 0, "killed in the midst of the second solver"
    before = read_measurements(path)
    assert [each.solver for each in before] == ["active-set"] * 2
    path.write_text(path.read_text() + "active-set,prepared,duplica")  # as a crash in the midst of writing leaves it
    after = run(misconduct / "out", solvers=("active-set",), families=("zero-rows", "duplicate"), problems=2, limit=5.0)
    assert after[:2] == before, "measured once, to the last digit of its time"
    assert [each.family for each in after] == ["zero-rows"] * 2 + ["duplicate"] * 2


def test_cells_that_are_not_asked_for_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = ComparisonSettings(solvers=("active-set", "nnls"), families=("zero-rows", "duplicate"), problems=2)
    checkpoint = open_checkpoint(whole, tmp_path, {"numpy": "2.4", "scipy": "1.17"})
    checkpoint.finished({})
    rows = [
        Measurement(
            solver=solver, variant=variant, family=family, problem=number, n=9, m=4, status="OPTIMAL",
            outcome="success", worst=0.0, distance=None, seconds=1e-5, ratio=1.0, limit=5.0, noise=False,
        )
        for solver, variant, family in whole.cells() for number in range(2)
    ]  # fmt: skip
    checkpoint.append(rows)
    monkeypatch.setattr("cpgrl_opt.isolation.process_group.Popen", None)  # no worker is needed
    part = replace(whole, solvers=("active-set",), families=("duplicate",))
    others = {"numpy": "2.4", "osqp": "1.1"}  # another solver stands on other packages
    checkpoint = open_checkpoint(part, tmp_path, others)
    asked = [each for each in rows if (each.solver, each.family) == ("active-set", "duplicate")]
    assert run_comparison(part, checkpoint) == asked
    assert len(checkpoint.kept) == 5
    assert checkpoint.wall_seconds == 0.0, "nothing was measured"
    assert read_measurements(checkpoint.path) == asked + [each for each in rows if each not in asked]
    assert run_comparison(whole, open_checkpoint(whole, tmp_path, others)) == rows
    assert read_measurements(checkpoint.path) == rows
    with pytest.raises(ValueError, match=r"versions: scipy = \"1\.17\", and versions: scipy is now \"1\.18\""):
        open_checkpoint(whole, tmp_path, {"scipy": "1.18"})
    with pytest.raises(ValueError, match=r"made with seed = 0, and seed is now 1; .* or --anew"):
        open_checkpoint(replace(whole, seed=1), tmp_path, others)
    open_checkpoint(replace(whole, seed=1), tmp_path, {}, anew=True)


def test_a_hole_in_the_file_costs_its_cell_only(tmp_path: Path) -> None:
    settings = ComparisonSettings(solvers=("active-set",), families=("zero-rows", "duplicate"), problems=2)
    checkpoint = open_checkpoint(settings, tmp_path, {})
    checkpoint.finished({})
    row = Measurement(
        solver="active-set", variant="prepared", family="zero-rows", problem=0, n=9, m=4, status="OPTIMAL",
        outcome="success", worst=0.0, distance=None, seconds=1e-5, ratio=1.0, limit=5.0, noise=False,
    )  # fmt: skip
    checkpoint.append([row, replace(row, problem=1)])
    checkpoint.append([replace(row, family="duplicate"), replace(row, family="duplicate", problem=1)])
    lines = checkpoint.path.read_text().splitlines(keepends=True)
    checkpoint.path.write_text("".join(lines[:-1]) + lines[-1][:20])
    finished = checkpoint.finished(settings.cells())
    assert list(finished) == [("active-set", "prepared", "zero-rows")]
    assert read_measurements(checkpoint.path) == [row, replace(row, problem=1)]


def test_wrong_settings_say_what_should_be() -> None:
    with pytest.raises(ValueError, match=r"solver should be one of rosen, .*, or package.module:SOLVER; found 'ospq'"):
        ComparisonSettings(solvers=("ospq",), families=())
    with pytest.raises(ValueError, match=r"problems should be an integer ≥ 1; found 0"):
        ComparisonSettings(solvers=("active-set",), families=(), problems=0)
    with pytest.raises(ValueError, match=r"limit should be positive seconds; found -1"):
        ComparisonSettings(solvers=("active-set",), families=(), limit=-1.0)


HALF_PLANE = DirectionProblem([3.0, -4.0], [[0.0, 1.0]])  # d* = (3, 0), μ = 4
IMPOSSIBLE = DirectionProblem([3.0, -4.0], [[0.0, 1.0], [0.0, -1.0]], [1.0, 1.0])  # y = (1, 1)


@pytest.mark.parametrize(
    ("error", "outcome"), [(0.0, "success"), (1e-10, "success"), (1e-7, "inaccurate"), (1e-5, "silently-wrong")]
)
def test_a_claim_of_optimality_is_worth_its_residual(error: float, outcome: str) -> None:
    answer = Direction(np.array([3.0, -5.0 * error]), np.array([4.0 - 5.0 * error]), Status.OPTIMAL)
    judged = judge(HALF_PLANE, answer, feasible=True, exact=exact_answer(HALF_PLANE))
    assert judged.outcome == outcome
    assert judged.distance == pytest.approx(error, abs=1e-15)


def test_a_verdict_of_infeasibility_is_worth_its_proof() -> None:
    for y, outcome in (([1.0, 1.0], "success"), ([1.0, 1.001], "inaccurate"), ([0.0, 0.0], "inaccurate")):
        answer = Direction(np.zeros(2), np.array(y), Status.INFEASIBLE)
        assert judge(IMPOSSIBLE, answer, feasible=False).outcome == outcome
    claimed = Direction(np.zeros(2), np.zeros(2), Status.OPTIMAL)
    assert judge(IMPOSSIBLE, claimed, feasible=False).outcome == "missed-infeasible"
    assert judge(IMPOSSIBLE, replace(claimed, status=Status.UNCERTIFIED), feasible=False).outcome == "honest-failure"
