"""The comparison survives what it compares: every misconduct gets its name, and what was finished stays."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpgrl_opt import Direction, DirectionProblem, Status
from cpgrl_opt.comparison.bench import Order, Started, measurement_of
from cpgrl_opt.comparison.judgement import judge
from cpgrl_opt.comparison.measurement import Measurement, read_measurements
from cpgrl_opt.comparison.runner import ComparisonSettings, Listen, open_checkpoint, run_comparison
from cpgrl_opt.exact import exact_answer

from .comparisons import BenchHere, finish

UNRULY = """
import os, sys, time
import numpy as np
from cpgrl_opt import SOLVERS, Direction, Status

class Solver:
    def __init__(self, act, status=Status.OPTIMAL):
        self.act, self.status = act, status
    def solve(self, problem):
        self.act()
        return Direction(problem.gradient + 0.1, np.zeros(problem.m), self.status)

class Choosy(Solver):
    def supports(self, problem):
        self.act()

class Tired:
    calls = 0
    def solve(self, problem):
        self.calls += 1
        if self.calls > 1:
            fail()
        return SOLVERS["active-set"].solve(problem)

class Printing:
    def solve(self, problem):
        os.write(1, b"iteration 1")
        return SOLVERS["active-set"].solve(problem)

def fail():
    raise RuntimeError("broken")

nothing = lambda: None
LYING = Solver(nothing)
DECLINING = Solver(nothing, Status.UNCERTIFIED)
PESSIMISTIC = Solver(nothing, Status.INFEASIBLE)
RAISING = Solver(fail)
CHOOSY = Choosy(fail)
EXITING = Solver(lambda: os._exit(3))
SLEEPING = Solver(lambda: time.sleep(60))
"""

EXPECTED = {
    "active-set": "success",
    "unruly:LYING": "silently-wrong",
    "unruly:DECLINING": "honest-failure",
    "unruly:PESSIMISTIC": "false-infeasible",
    "unruly:RAISING": "crash",
    "unruly:CHOOSY": "crash",
    "unruly:Tired": "crash",
    "unruly:Printing": "success",
    "unruly:EXITING": "crash",  # the last two lose their process, and each start costs two seconds
    "unruly:SLEEPING": "hang",
}


@pytest.fixture
def unruly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "unruly.py").write_text(UNRULY)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "unruly", raising=False)
    return tmp_path


def run(folder: Path, *, listen: Listen | None = None, **settings: object) -> list[Measurement]:
    chosen = ComparisonSettings(**{"problems": 1, "repeats": 1, "limit": 0.1, **settings})  # type: ignore[arg-type]
    return run_comparison(chosen, open_checkpoint(chosen, folder, {}), listen=listen)


def test_every_misconduct_gets_its_name_and_costs_one_problem(unruly: Path) -> None:
    measurements = run(unruly / "out", solvers=tuple(EXPECTED), families=("well-conditioned-equality",))
    assert {each.solver: each.outcome for each in measurements} == EXPECTED
    assert [each.solver for each in measurements if each.noise] == ["unruly:Printing"]
    assert read_measurements(unruly / "out" / "measurements.csv") == measurements
    late = next(each for each in measurements if each.outcome == "hang")
    assert (late.seconds, late.worst) == (0.1, float("inf"))
    assert late.ratio > 100


def test_a_fault_of_our_own_is_no_crash_of_a_solver() -> None:
    class Faulty:
        def apply(self, method: str, *_: object, **__: object) -> Started:
            return Started(order, 9, 3, 1e-5) if method == ".prepare" else {}[method]

    order = Order("nnls", "prepared", "zero-rows", 0, 0, 1.0, 1)
    with pytest.raises(KeyError):
        measurement_of(order, Faulty())  # type: ignore[arg-type]


def test_an_interrupted_comparison_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cpgrl_opt.comparison.runner.isolated_bench", BenchHere)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    path = tmp_path / "measurements.csv"
    settings = {"solvers": ("active-set",), "families": ("zero-rows", "duplicate"), "problems": 2, "limit": 5.0}
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, listen=interrupt, **settings)
    before = read_measurements(path)
    assert [each.family for each in before] == ["zero-rows"] * 2
    whole = path.read_text()
    other = whole.splitlines()[1].replace("zero-rows", "duplicate")
    path.write_text(f"{whole}{other}\n{other[:20]}")  # as a crash in the midst of writing leaves it
    after = run(tmp_path, **settings)
    assert after[:2] == before, "measured once, to the last digit of its time"
    assert [each.family for each in after] == ["zero-rows"] * 2 + ["duplicate"] * 2
    assert after[2].seconds != before[0].seconds, "a cell that was cut short is measured anew"


def test_cells_that_are_not_asked_for_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = ComparisonSettings(solvers=("active-set", "nnls"), families=("zero-rows", "duplicate"), problems=2)
    rows = finish(whole, tmp_path, {"numpy": "2.4", "scipy": "1.17"})
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
