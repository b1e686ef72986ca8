"""One gate for whatever comes in: a batch refuses what a problem refuses, and settings are checked on construction."""

import copy
import dataclasses
import pickle

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
    project_onto_tangent,
    restoration_move,
    tangent_multipliers,
    violated,
)
from cpgrl_opt.published import PUBLISHED
from cpgrl_opt.solvers import ActiveSet
from cpgrl_opt.testing import FunctionSolver

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
    ("gradient", ["1", "2"], "gradient should be an array of real numbers"),
    ("gradient", [1j, 2.0], "gradient should be an array of real numbers"),
    ("gradient", [None, 1.0], "gradient should be an array of real numbers"),
    ("gradient", [np.nan, 1.0], "gradient should be finite"),
    ("gradient", [np.inf, 1.0], "gradient should be finite"),
    ("gradient", masked([1.0, 2.0]), "gradient should have no masked entries"),
    ("jacobian", [["1", "0"], ["0", "1"]], "jacobian should be an array of real numbers"),
    ("jacobian", masked([[1.0, 0.0], [0.0, 1.0]]), "jacobian should have no masked entries"),
    ("jacobian", [[1.0], [2.0, 3.0]], "jacobian should be a rectangular array"),
    ("bound", ["0", "1"], "bound should be an array of real numbers"),
    ("bound", [0.0, np.inf], "bound should be finite"),
    ("bound", masked([0.0, 1.0]), "bound should have no masked entries"),
    ("equality", [0, 1], "equality should be an array of booleans"),
    ("equality", [0, 2], "equality should be an array of booleans"),
    ("equality", ["", "yes"], "equality should be an array of booleans"),
    ("equality", masked([True, False]), "equality should have no masked entries"),
    ("metric", ["1", "2"], "metric should be an array of real numbers"),
    ("metric", [1j, 2.0], "metric should be an array of real numbers"),
    ("metric", masked([1.0, 2.0]), "metric should have no masked entries"),
    ("metric", [1.0, -2.0], "metric should have positive diagonal entries"),
    ("metric", 2.0, "metric should"),
]


@pytest.mark.parametrize(("name", "value", "message"), REFUSED)
def test_a_batch_refuses_what_a_problem_refuses(name, value, message):
    arrays = {**GOOD, name: value}
    with pytest.raises(ValueError, match=message):
        DirectionProblem(**arrays)
    stacked = np.ma.stack([value]) if isinstance(value, np.ma.MaskedArray) else [value]
    stacked = value if isinstance(value, float) else stacked
    with pytest.raises(ValueError, match=message):
        ProblemBatch(**{key: [each] for key, each in GOOD.items()} | {name: stacked})


@pytest.mark.parametrize("name", [name for name in GOOD if name != "jacobian"])
@pytest.mark.parametrize("value", [[[1.0, 2.0, 3.0]], [[[1.0, 2.0]]], [[1.0, 2.0], [1.0, 2.0]]])
def test_a_batch_of_other_shapes_is_refused(name, value):
    value = np.array(value) > 0 if name == "equality" else value
    with pytest.raises(ValueError, match=f"{name} should have"):
        ProblemBatch(**{key: [each] for key, each in GOOD.items()} | {name: value})


def test_one_bound_and_one_truth_value_are_for_all_constraints_of_a_batch_too():
    batch = ProblemBatch(np.ones((3, 2)), np.ones((3, 4, 2)), 0.5, True)
    problem = DirectionProblem(np.ones(2), np.ones((4, 2)), 0.5, True)
    for each in batch:
        np.testing.assert_array_equal(each.bound, problem.bound)
        np.testing.assert_array_equal(each.equality, problem.equality)
    assert ProblemBatch(np.ones((3, 2)), np.ones((3, 4, 2))).bound.shape == (3, 4)


def test_a_batch_is_a_copy_as_a_problem_is():
    arrays = {key: np.array([each]) for key, each in GOOD.items()}
    batch = ProblemBatch(**arrays)
    for name, array in arrays.items():
        array[...] = array[:, ::-1]
        np.testing.assert_array_equal(getattr(batch, name), [GOOD[name]])


HALF = [0.5, np.array(0.5), np.float32(0.5), np.float64(0.5), np.array(0.5, np.float32)]


@pytest.mark.parametrize("half", HALF, ids=repr)
def test_a_number_is_a_number_whatever_library_spelt_it(half):
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0]], half, radius=half)
    assert (problem.bound.tolist(), problem.radius) == ([0.5], 0.5)
    names = ("step_size", "restoration_rate", "ridge", "max_restoration", "radius")
    step, same = (ConstrainedStep(**dict.fromkeys(names, number)) for number in (half, 0.5))
    assert step == same
    assert hash(step) == hash(same)
    assert ProblemBatch([[1.0, 2.0]], [[[1.0, 0.0]]]).in_geometry(None, half).radius.tolist() == [0.5]


def test_a_tolerance_is_a_number_that_its_caller_cannot_change():
    given = np.array(1e-9)
    solver = ActiveSet(tolerance=given)
    given[...] = 1.0
    assert (solver, hash(solver)) == (ActiveSet(tolerance=1e-9), hash(ActiveSet(tolerance=1e-9)))


@pytest.mark.parametrize("radius", [np.array([0.5]), np.array(np.nan), np.array(0.0), np.ma.masked, True, "1", 1j])
def test_what_is_no_number_is_no_radius(radius):
    for made in (lambda r: DirectionProblem([1.0], [[1.0]], radius=r), lambda r: ConstrainedStep(radius=r)):
        with pytest.raises(ValueError, match="radius should be a finite number > 0"):
            made(radius)


SETTINGS = {
    "tolerance": [np.nan, -1, 0.0, 1.0, 2e-3, np.inf, "1e-6", None, True, 1j, [1e-6]],
    "iteration_limit": [0, -5, 2.5, "many", True],
    "time_limit": [0.0, -1.0, np.nan, np.inf, "1", None],
    "rho": [0.0, -1.0, np.nan],
    "polish": [1, None, "no"],
    "raw_multipliers": [1, None],
    "memory_strength": [-1.0, np.nan],
    "slack_allowed": [-1.0, np.nan],
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


def test_what_wraps_a_solver_or_a_function_checks_it_too():
    for wrong in (None, ActiveSet, "active-set", 3):
        with pytest.raises(ValueError, match="solver should have a method solve"):
            WithGeometry(wrong)
    for tolerance in (np.nan, 1.0, -1, "fine"):
        with pytest.raises(ValueError, match="tolerance should be a number in"):
            FunctionSolver(lambda g, _: g, tolerance=tolerance)


@pytest.mark.parametrize("settings", [{"margin": np.nan}, {"margin": -1.0}, {"margin": "1"}, {"margin": True}])
def test_a_margin_that_is_none_is_refused(settings):
    with pytest.raises(ValueError, match="margin should be a number ≥ 0"):
        violated(np.zeros(2), **settings)


@pytest.mark.parametrize(
    ("name", "value"),
    [("enter", np.nan), ("enter", "0"), ("leave", None), ("leave", np.nan), ("leave − enter", -1.0)],
)
def test_a_band_that_is_none_is_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} should be a number"):
        hysteresis(np.zeros(2), **{name.split()[0]: value})


PROBLEM = DirectionProblem([1.0, 2.0], [[1.0, 0.0], [0.0, 1.0]])
LINEARIZATION = Linearization(np.zeros(3), np.ones((3, 2)))


@pytest.mark.parametrize(
    ("name", "taken"),
    [
        ("values", lambda: Linearization(masked(np.zeros(3)), np.ones((3, 2)))),
        ("gradients", lambda: Linearization(np.zeros(3), [masked([1.0, 1.0])] * 3)),
        ("gradients", lambda: Linearization(np.zeros((2, 3)), [[masked([1.0, 1.0])] * 3] * 2)),
        ("jacobian", lambda: DirectionProblem([1.0, 2.0], [[np.ma.masked, 1.0]])),
        ("jacobian", lambda: ProblemBatch([[1.0, 2.0]], [[masked([1.0, 1.0])]])),
        ("equality", lambda: ProblemBatch([[1.0, 2.0]], [[[1.0, 0.0]]], 0.0, [[np.ma.array(True, mask=True)]])),
        ("thresholds", lambda: ConstrainedStep()(LINEARIZATION, masked([0.0, 0.0]))),
        ("thresholds", lambda: ConstrainedStep()(LINEARIZATION, [np.ma.masked, 0.0])),
        ("previous", lambda: ConstrainedStep()(LINEARIZATION, [0.0, 0.0], masked([True, False]))),
        ("metric", lambda: ConstrainedStep(metric=masked([1.0, 1.0]))),
        ("slack", lambda: violated(masked([1.0, 1.0]))),
        ("slack", lambda: hysteresis(masked([1.0, 1.0]))),
        ("jacobian", lambda: project_onto_tangent(masked([[1.0, 0.0]]), [1.0, 2.0])),
        ("slack", lambda: restoration_move([[1.0, 0.0], [0.0, 1.0]], masked([1.0, 2.0]))),
        ("gradient", lambda: tangent_multipliers([[1.0, 0.0]], masked([1.0, 2.0]))),
        ("y", lambda: farkas_residual(PROBLEM, masked([1.0, 2.0]))),
        ("the direction", lambda: FunctionSolver(lambda g, _: masked(g)).solve(PROBLEM)),
    ],
)
def test_masks_are_not_dropped_in_silence(name, taken):
    with pytest.raises(ValueError, match=f"{name} should have no masked entries"):
        taken()


def test_a_masked_array_without_a_masked_entry_is_an_array():
    assert DirectionProblem(np.ma.array([1.0, 2.0]), [[1.0, 0.0]]).gradient.tolist() == [1.0, 2.0]


@pytest.mark.parametrize("thresholds", [["0", "0"], [0j, 0.0], None, [[0.0], [0.0, 0.0]]])
def test_thresholds_that_are_no_numbers_are_refused(thresholds):
    with pytest.raises(ValueError, match="thresholds should be"):
        ConstrainedStep()(LINEARIZATION, thresholds)


MATRIX = np.array([[2.0, 0.5], [0.5, 1.0]])


def arrays_in(thing, seen=None):
    """Every array that an object of ours holds, in whatever it holds."""
    seen = set() if seen is None else seen
    if isinstance(thing, np.ndarray):
        yield thing
    elif isinstance(thing, tuple | list | dict):
        for each in thing.values() if isinstance(thing, dict) else thing:
            yield from arrays_in(each, seen)
    elif type(thing).__module__.startswith("cpgrl_opt") and id(thing) not in seen and hasattr(thing, "__dict__"):
        seen.add(id(thing))
        yield from arrays_in(vars(thing), seen)


HOLDERS = {
    "a step": ConstrainedStep(metric=MATRIX),
    "a step in a diagonal metric": ConstrainedStep(metric=[1.0, 2.0], radius=1.0),
    "a problem": DirectionProblem([1.0, 2.0], [[1.0, 0.0]], metric=MATRIX),
    "a batch": ProblemBatch([[1.0, 2.0]] * 3, [[[1.0, 0.0]]] * 3, metric=[MATRIX, MATRIX, np.eye(2)], radius=[1.0] * 3),
    "a member": ProblemBatch([[1.0, 2.0]] * 3, [[[1.0, 0.0]]] * 3).in_geometry(MATRIX, 1.0)[1],
    "a batch in one geometry": ProblemBatch([[1.0, 2.0]] * 3, [[[1.0, 0.0]]] * 3).in_geometry([1.0, 2.0], 1.0),
    "a whitening": DirectionProblem([1.0, 2.0], [[1.0, 0.0]], metric=MATRIX).whitening,
}
COPIES = {"copy": copy.copy, "deepcopy": copy.deepcopy, "pickle": lambda each: pickle.loads(pickle.dumps(each))}


@pytest.mark.parametrize("how", COPIES)
@pytest.mark.parametrize("holder", HOLDERS)
def test_what_is_read_only_is_so_after_copying_and_unpickling(holder, how):
    original = HOLDERS[holder]
    other = COPIES[how](original)
    assert type(other) is type(original)
    pairs = list(zip(arrays_in(original), arrays_in(other), strict=True))
    assert pairs
    for one, two in pairs:
        assert not one.flags.writeable
        assert not two.flags.writeable
        assert one.dtype == two.dtype
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("how", COPIES)
def test_a_copied_step_is_the_same_step(how):
    step = ConstrainedStep(metric=MATRIX, radius=2.0, formulation="restoring")
    other = COPIES[how](step)
    assert (other, hash(other)) == (step, hash(step))
    linearization = Linearization([0.0, -1.0], [[1.0, 2.0], [1.0, -1.0]])
    np.testing.assert_array_equal(other(linearization, [0.0]).change, step(linearization, [0.0]).change)


@pytest.mark.parametrize("bound", [True, np.True_, np.array([True, False])], ids=["bool", "numpy's", "array"])
def test_truth_values_are_no_bounds(bound: object) -> None:
    with pytest.raises(ValueError, match="bound should be an array of real numbers"):
        DirectionProblem([1.0, 0.0], np.eye(2), bound)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "taken"),
    [
        ("gradient", lambda: DirectionProblem([True, False], np.eye(2))),  # a mask that was taken for numbers
        ("metric_tolerance", lambda: DirectionProblem([1.0], [[1.0]], metric=[1.0], metric_tolerance="small")),
        ("metric_iterations", lambda: ProblemBatch([[1.0]], [[[1.0]]], metric=[[1.0]], metric_iterations=0.5)),
        ("metric_tolerance", lambda: ConstrainedStep(metric=[1.0], metric_tolerance=-1.0)),
        ("metric", lambda: ConstrainedStep(metric=[])),
        ("metric", lambda: ConstrainedStep(metric=3)),
        ("metric", lambda: DirectionProblem([1.0], [[1.0]], metric=object)),  # a type, which could be called
        ("rule", lambda: ConstrainedStep(rule=object)),
        ("metric", lambda: DirectionProblem({"a": np.ones(1)}, [{"a": np.ones(1)}], metric=object)),
        ("slack", lambda: violated([0.0, np.nan])),
        ("slack", lambda: hysteresis([0.0, np.nan])),
        ("previous", lambda: hysteresis([0.0, 1.0], "both")),
        ("previous", lambda: hysteresis([0.0, 1.0], np.array([True]))),
        ("gradients", lambda: Linearization(np.zeros(3), {"a": 1})),
    ],
)
def test_what_was_taken_in_silence_or_failed_somewhere_else_is_refused_by_its_name(name, taken):
    with pytest.raises(ValueError, match=rf"^{name} should .*; found"):
        taken()
