"""Raw back ends are the libraries at their defaults: signs by hand, claims passed on, scaling not mended."""

from pathlib import Path

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.comparison.contestants import contestant, installed, solver_of, variants_of
from cpgrl_opt.comparison.judgement import judge
from cpgrl_opt.comparison.raw import RAW
from cpgrl_opt.exact import exact_answer
from cpgrl_opt.solvers import is_installed
from cpgrl_opt.solvers.through_qpsolvers import BACK_ENDS

# An active and a slack inequality, and an equality whose multiplier is negative: d* = (2, 1, −1), by hand.
BY_HAND = DirectionProblem(
    [2.0, -1.0, 0.0], [[0.0, 2.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [2.0, -5.0, -1.0], [False, False, True]
)
RAW_INSTALLED = [name for name in RAW if is_installed(SOLVERS[name])]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", RAW_INSTALLED)
def test_an_easy_problem_is_solved_with_multipliers_of_the_right_signs(name: str) -> None:
    answer = RAW[name](BY_HAND)
    assert answer.status == Status.OPTIMAL
    np.testing.assert_allclose(answer.value, [2.0, 1.0, -1.0], atol=1e-2)
    np.testing.assert_allclose(answer.multipliers, [1.0, 0.0, -1.0], atol=1e-2)


@pytest.mark.parametrize("name", ["osqp", "clarabel", "scs"])
def test_nothing_mends_the_scale_of_the_problem(name: str) -> None:
    if name not in RAW_INSTALLED:
        pytest.skip(f"{name} is not installed")
    tiny = DirectionProblem(BY_HAND.gradient * 1e-9, BY_HAND.jacobian * 1e-9, BY_HAND.bound * 1e-18, BY_HAND.equality)
    answer = RAW[name](tiny)
    assert answer.status == Status.OPTIMAL
    assert judge(tiny, answer, feasible=True).outcome == "silently-wrong"
    prepared = SOLVERS[name].solve(tiny)
    assert kkt_residuals(tiny, prepared).worst <= 1e-9


@pytest.mark.parametrize("name", RAW_INSTALLED)
@pytest.mark.filterwarnings("ignore")
def test_opposing_demands_are_not_solved(name: str) -> None:
    impossible = DirectionProblem([3.0, -4.0], [[0.0, 1.0], [0.0, -1.0]], [1.0, 1.0])
    answer = RAW[name](impossible)
    assert isinstance(answer, Direction)
    assert judge(impossible, answer, feasible=False).outcome in (
        "success",
        "inaccurate",
        "honest-failure",
        "missed-infeasible",
    )
    if name in ("quadprog", "clarabel", "daqp"):
        assert answer.status == Status.INFEASIBLE


def test_whoever_stands_on_a_library_is_tried_raw_too() -> None:
    raw = {name for name in SOLVERS if "raw" in variants_of(name)}
    assert raw == set(RAW) >= {"nnls", "osqp", *BACK_ENDS, "cvxpy"}
    assert not raw & {"rosen", "rosen-drop", "active-set", "enumeration"}, "there is no library behind them"
    assert variants_of("somebody.else:SOLVER") == ("prepared",)


def test_raw_back_ends_take_neither_metric_nor_ball() -> None:
    in_metric = DirectionProblem(BY_HAND.gradient, BY_HAND.jacobian, BY_HAND.bound, BY_HAND.equality, [1.0, 2.0, 3.0])
    in_ball = DirectionProblem(BY_HAND.gradient, BY_HAND.jacobian, BY_HAND.bound, BY_HAND.equality, radius=9.0)
    for name in RAW_INSTALLED:
        raw, prepared = contestant(name, "raw"), contestant(name, "prepared")
        assert raw.supports(BY_HAND)
        assert not raw.supports(in_metric)
        assert not raw.supports(in_ball)
        assert prepared.supports(in_metric)
        assert prepared.supports(in_ball)


@pytest.mark.parametrize(
    ("geometry", "off", "distance"),
    [
        ({}, 2.0, 0.5),
        ({"metric": [4.0, 4.0]}, 0.5, 0.5),
        ({"metric": [16.0, 1.0]}, 1.0, 1.0),
        ({"radius": 10.0}, 2.0, 0.2),
    ],
)
def test_distances_are_in_the_unit_of_the_problem(geometry: dict, off: float, distance: float) -> None:
    """g = (0, 4): ‖L⁻¹g‖ is 4, 2, 4, and d* = (0, 4), (0, 1), (0, 4), or (0, 10) in the ball."""
    problem = DirectionProblem([0.0, 4.0], np.zeros((0, 2)), **geometry)
    exact = exact_answer(problem)
    claimed = Direction(exact.direction + off * np.array([1.0, 0.0]), np.zeros(0), Status.OPTIMAL)
    assert judge(problem, claimed, feasible=True, exact=exact).distance == pytest.approx(distance, rel=1e-14)


def test_a_missing_package_is_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cpgrl_opt.solvers.packages.has_package", lambda package: package != "scs")
    assert installed(["active-set", "scs", "active-set"]) == (("active-set",), {"scs": "not installed"})


def test_a_wrong_name_is_answered_with_the_right_ones() -> None:
    with pytest.raises(ValueError, match=r"one of rosen, .*cvxpy, or package.module:SOLVER; found 'ospq'"):
        solver_of("ospq")
    with pytest.raises(ValueError, match=r"found 'nosuch\.module:SOLVER'"):
        solver_of("nosuch.module:SOLVER")
    with pytest.raises(ValueError, match=r"json:dumps should have a method solve\(problem\)"):
        solver_of("json:dumps")
    with pytest.raises(ValueError, match="found no 'SOLVER' in json"):
        solver_of("json:SOLVER")


@pytest.mark.parametrize(
    ("source", "error"), [("import json; json.nosuch", AttributeError), ("import nosuch", ModuleNotFoundError)]
)
def test_what_a_module_raises_on_import_is_the_modules(
    source: str, error: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / f"{error.__name__}_broken.py").write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(error, match="nosuch"):
        solver_of(f"{error.__name__}_broken:SOLVER")
