"""One gate for whatever comes in: what should be and what was found, for problem and batch, settings and answers."""

import dataclasses
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from cpgrl_opt import (
    SOLVERS,
    ConstrainedStep,
    DirectionProblem,
    Linearization,
    ProblemBatch,
    WithGeometry,
    farkas_residual,
    hysteresis,
    kkt_residuals,
    project_onto_tangent,
    projection_matrix,
    solve,
    violated,
)
from cpgrl_opt.published import PUBLISHED
from cpgrl_opt.solvers import ActiveSet
from cpgrl_opt.testing import FunctionSolver
from cpgrl_opt.validation import require_within

GOOD = {
    "gradient": [1.0, 2.0],
    "jacobian": [[1.0, 0.0], [0.0, 1.0]],
    "bound": [0.0, 1.0],
    "equality": [False, True],
    "metric": [1.0, 2.0],
}


def masked(values):
    return np.ma.masked_array(values, mask=np.eye(np.size(values), dtype=bool)[0].reshape(np.shape(values)))


REFUSED = [
    ("gradient", ["1", "2"], "an array of real numbers"),
    ("gradient", [1j, 2.0], "an array of real numbers"),
    ("gradient", [np.nan, 1.0], "finite; found nan"),
    ("gradient", masked([1.0, 2.0]), "no masked entries"),
    ("jacobian", [[1.0], [2.0, 3.0]], "a rectangular array"),
    ("bound", [True, False], "an array of real numbers"),
    ("bound", [0.0, np.nan], "finite, or −inf on an inequality"),
    ("bound", [0.0, -np.inf], "finite on an equality; found −inf"),
    ("equality", [0, 1], "an array of booleans"),
    ("metric", [1.0, 0.0], "positive diagonal entries; found 0.0"),
    ("metric", [[1.0, 0.0], [0.1, 1.0]], "symmetric; found"),
    ("metric", [[1.0, -3.0], [-3.0, 1.0]], "positive definite; found the eigenvalue -2"),
]


@pytest.mark.parametrize(("name", "value", "message"), REFUSED)
def test_a_batch_refuses_what_a_problem_refuses(name, value, message):
    with pytest.raises(ValueError, match=f"{name} should (be|have) {message}"):
        DirectionProblem(**{**GOOD, name: value})
    stacked = np.ma.stack([value]) if isinstance(value, np.ma.MaskedArray) else [value]
    with pytest.raises(ValueError, match=f"{name} should (be|have) {message}"):
        ProblemBatch(**{key: [each] for key, each in GOOD.items()} | {name: stacked})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gradient": [1.0]}, r"gradient should have shape \(2,\); found \(1,\)"),
        ({"gradient": [[1.0, 2.0]]}, "gradient should have 1 axes"),
        ({"gradient": [], "jacobian": np.zeros((2, 0)), "metric": None}, "gradient should have at least one component"),
        ({"bound": [0.0]}, "bound should have shape"),
        ({"metric": [1.0]}, r"metric should have shape \(2,\); found \(1,\)"),
        ({"metric": [[[1.0]]]}, "metric should be None"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        DirectionProblem(**{**GOOD, **changes})


@pytest.mark.parametrize("name", [name for name in GOOD if name != "jacobian"])
@pytest.mark.parametrize("value", [[[1.0, 2.0, 3.0]], [[[1.0, 2.0]]], [[1.0, 2.0], [1.0, 2.0]]])
def test_a_batch_of_other_shapes_is_refused(name, value):
    value = np.array(value) > 0 if name == "equality" else value
    with pytest.raises(ValueError, match=f"{name} should have"):
        ProblemBatch(**{key: [each] for key, each in GOOD.items()} | {name: value})


@pytest.mark.parametrize("radius", [np.array([0.5]), np.nan, np.array(0.0), np.inf, np.ma.masked, True, "1", 10**400])
def test_what_is_no_number_is_no_radius(radius):
    for made in (lambda r: DirectionProblem([1.0], [[1.0]], radius=r), lambda r: ConstrainedStep(radius=r)):
        with pytest.raises(ValueError, match="radius should be a finite number > 0"):
            made(radius)


SETTINGS = {
    "tolerance": [np.nan, -1, 2e-3, "1e-6", None, True, [1e-6], 10**400],
    "iteration_limit": [0, 2.5, True],
    "time_limit": [0.0, np.nan, np.inf, "1"],
    "rho": [0.0],
    "polish": [None],
    "raw_multipliers": [1],
    "memory_strength": [-1.0],
    "slack_allowed": [np.nan],
}


@pytest.mark.parametrize("solver", [*SOLVERS.values(), *PUBLISHED.values()], ids=str)
def test_settings_of_solvers_are_checked_on_construction(solver):
    names = [field.name for field in dataclasses.fields(solver) if field.name in SETTINGS]
    assert "tolerance" in names
    for name in names:
        for value in SETTINGS[name]:
            with pytest.raises(ValueError, match=rf"{name} should be"):
                dataclasses.replace(solver, **{name: value})
    for tolerance in (1e-3, 1e-12, np.float64(1e-6)):
        assert dataclasses.replace(solver, tolerance=tolerance).tolerance == tolerance


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"solver": "simplex"}, "rosen.*active-set.*found 'simplex'"),
        ({"solver": ActiveSet}, "solver should be a name or have a method solve"),
        ({"formulation": "sphere"}, "formulation should be one of equality, cone, .*; found 'sphere'"),
        ({"rule": object}, "rule should .*; found"),
        ({"drop": "sometimes"}, "drop should be one of never, stationary, always"),
        ({"on_failure": "ignore"}, "on_failure should be one of"),
        ({"step_size": -1.0}, "step_size should be a number ≥ 0; found -1.0"),
        ({"ridge": np.nan}, "ridge should be a number ≥ 0; found nan"),
        ({"formulation": "restoring", "step_size": 1e-300, "restoration_rate": 1e300}, "restoration_rate / step_size"),
        ({"metric": 2.0}, r"metric should be None, \(n,\), \(n, n\) or a function"),
        ({"metric": [1.0], "metric_tolerance": -1.0}, "metric_tolerance should .*; found"),
        ({"formulation": "linearized", "ridge": 0.1}, "ridge should be 0 with formulation 'linearized'"),
        ({"formulation": "linearized", "rule": hysteresis}, "rule should be the default with formulation 'linearized'"),
        ({"formulation": "linearized", "step_size": 0.0}, "step_size should be > 0 with formulation 'linearized'"),
        ({"formulation": "linearized", "slack_fraction": 1.5}, r"slack_fraction should be a number in \[0, 1\]"),
    ],
)
def test_settings_of_steps_are_checked_on_construction(settings, message):
    with pytest.raises(ValueError, match=message):
        ConstrainedStep(**settings)


@pytest.mark.parametrize(
    ("interval", "taken", "refused"),
    [("[0, 1)", [0, 0.5], [-0.1, 1, np.nan, "0"]), ("(0, 1]", [0.5, 1], [0, 1.5]), ("(0, inf)", [1e300], [0, np.inf])],
)
def test_the_ends_of_an_interval_are_taken_where_it_is_closed(interval, taken, refused):
    for value in taken:
        require_within("rate", value, interval)
    for value in refused:
        with pytest.raises(ValueError, match=rf"rate should be in {re.escape(interval)}; found"):
            require_within("rate", value, interval)


PROBLEM = DirectionProblem([1.0, 2.0], [[1.0, 0.0], [0.0, 1.0]])
LINEARIZATION = Linearization(np.zeros(3), np.ones((3, 2)))
STEP = ConstrainedStep()


@pytest.mark.parametrize(
    ("message", "taken"),
    [
        ("values should be finite; found nan", lambda: Linearization([np.nan, 0.0], np.zeros((2, 3)))),
        (r"values should have shape \(2,\); found \(3,\)", lambda: Linearization(np.zeros(3), np.zeros((2, 3)))),
        ("at least the objective's channel", lambda: Linearization(np.zeros(0), np.zeros((0, 3)))),
        ("gradients should .*; found", lambda: Linearization(np.zeros(3), {"a": 1})),
        ("thresholds should be", lambda: STEP(LINEARIZATION, ["0", "0"])),
        ("thresholds should be finite", lambda: STEP(LINEARIZATION, [0.0, np.nan])),
        ("previous should have shape", lambda: STEP(LINEARIZATION, [0.0, 0.0], np.array([True]))),
        ("rule should return booleans", lambda: ConstrainedStep(rule=lambda slack, _: slack)(LINEARIZATION, [0, 0])),
        (r"metric should have shape \(2, 2\)", lambda: ConstrainedStep(metric=np.eye(3))(LINEARIZATION, [0.0, 0.0])),
        ("problems should have one shape", lambda: ProblemBatch.stack([PROBLEM, DirectionProblem([1.0], [[1.0]])])),
        ("no problem", lambda: ProblemBatch.stack([])),
        (
            "problems should all have a radius, or none; found 1 of 2",
            lambda: ProblemBatch.stack([PROBLEM, dataclasses.replace(PROBLEM, radius=1.0)]),
        ),
        (r"radius should have shape \(1,\)", lambda: ProblemBatch([[1.0]], [[[1.0]]], radius=[1.0, 2.0])),
        ("metric should", lambda: DirectionProblem([1.0], [[1.0]], metric=object)),  # a type, which could be called
        ("gradient should", lambda: DirectionProblem([True, False], np.eye(2))),  # a mask that was taken for numbers
        ("margin should be a number ≥ 0; found -0.1", lambda: violated(np.zeros(2), margin=-0.1)),
        ("slack should", lambda: hysteresis([0.0, np.nan])),
        ("previous should", lambda: hysteresis([0.0, 1.0], "both")),
        ("leave − enter should be a number ≥ 0", lambda: hysteresis(np.zeros(1), enter=0.1, leave=0.0)),
        ("gradient should have shape", lambda: project_onto_tangent(np.eye(2), [1.0])),
        ("jacobian should be finite", lambda: projection_matrix([[np.nan]])),
        ("solver should be a name or have a method solve", lambda: solve(PROBLEM, 3)),
        ("solver should have a method solve", lambda: WithGeometry("active-set")),
        ("tolerance should be a number in", lambda: FunctionSolver(lambda g, _: g, tolerance=np.nan)),
        (
            "value should be an array of real numbers",
            lambda: kkt_residuals(PROBLEM, SimpleNamespace(value=np.array([1.0, 1j]), multipliers=np.zeros(2))),
        ),
    ],
)
def test_what_does_not_fit_is_refused_by_its_name(message, taken):
    with pytest.raises(ValueError, match=message):
        taken()


@pytest.mark.parametrize(
    ("name", "taken"),
    [
        ("jacobian", lambda: DirectionProblem([1.0, 2.0], [[np.ma.masked, 1.0]])),
        ("thresholds", lambda: STEP(LINEARIZATION, [np.ma.masked, 0.0])),
        ("previous", lambda: STEP(LINEARIZATION, [0.0, 0.0], masked([True, False]))),
        ("y", lambda: farkas_residual(PROBLEM, masked([1.0, 2.0]))),
        ("the direction", lambda: FunctionSolver(lambda g, _: masked(g)).solve(PROBLEM)),
    ],
)
def test_masks_are_not_dropped_in_silence(name, taken):
    with pytest.raises(ValueError, match=f"{name} should have no masked entries"):
        taken()


# Their annotations are checked in the tests, before they can speak for themselves.
NO_PROBLEM = """
from functools import partial
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
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", NO_PROBLEM], check=True, env=environment)
