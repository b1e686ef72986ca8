"""A problem, a batch and whatever else holds arrays: copies that nobody can change, one or many, pickled or not."""

import copy
import pickle

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep, DirectionProblem, Linearization, ProblemBatch
from cpgrl_opt.solvers import ActiveSet

GOOD = {"gradient": [1.0, 2.0], "jacobian": [[1.0, 0.0], [0.0, 1.0]], "bound": [0.0, 1.0], "equality": [False, True]}
ARRAYS = {name: np.array([value]) for name, value in GOOD.items()}
MATRIX = np.array([[2.0, 0.5], [0.5, 1.0]])


def problem_with(**changes):
    return DirectionProblem(**{**GOOD, **changes})


def test_defaults_are_the_cone_through_the_origin_and_no_constraint_is_a_problem_too():
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0]])
    assert (problem.bound.tolist(), problem.equality.tolist(), problem.n, problem.m) == ([0.0], [False], 2, 1)
    assert DirectionProblem([1.0, 2.0], np.zeros((0, 2))).m == 0
    assert problem_with(bound=[-np.inf, 1.0]).bound[0] == -np.inf
    assert DirectionProblem(np.ma.array([1.0, 2.0]), [[1.0, 0.0]]).gradient.tolist() == [1.0, 2.0]


def test_problems_and_batches_are_copies_that_nobody_makes_writable():
    arrays = {name: array.copy() for name, array in ARRAYS.items()}
    problem, batch = DirectionProblem(**{name: array[0] for name, array in arrays.items()}), ProblemBatch(**arrays)
    for name, array in arrays.items():
        array[...] = array[:, ::-1]
        for held in (getattr(problem, name), getattr(batch, name)[0]):
            np.testing.assert_array_equal(held, GOOD[name])
            with pytest.raises(ValueError, match="WRITEABLE"):
                held.flags.writeable = True


def test_nobody_makes_what_a_long_problem_owns_writable():
    problem = DirectionProblem(np.ones(60_000), np.eye(2, 60_000), np.zeros(2))
    for array in (problem.bound, problem.equality):
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.flags.writeable = True


def test_a_batch_reads_as_its_problems():
    problems = [
        problem_with(metric=[1.0, 4.0], radius=0.5),
        problem_with(metric=[[2.0, 1.0], [1.0, 2.0]], radius=2.0),
        problem_with(gradient=[3.0, 4.0], radius=1.0),
    ]
    batch = ProblemBatch.stack(problems)
    for one, other, metric in zip(batch, problems, (np.diag([1.0, 4.0]), problems[1].metric, np.eye(2)), strict=True):
        for name in GOOD:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        np.testing.assert_array_equal(one.metric, metric)
        assert one.radius == other.radius
    for part in (batch[1:], batch.select(np.array([False, True, True]))):
        np.testing.assert_array_equal(part.radius, [2.0, 1.0])
        np.testing.assert_array_equal(part[0].metric, problems[1].metric)
        assert part[0].whitening is not None
    assert batch[:0].metric is not None
    assert ProblemBatch(**ARRAYS, metric=[[1.0, 4.0]], radius=[3.0])[0].radius == 3.0
    for each in ProblemBatch(np.ones((3, 2)), np.ones((3, 4, 2)), 0.5, True):  # one bound for all
        assert (each.bound.tolist(), each.equality.tolist()) == ([0.5] * 4, [True] * 4)
    assert ProblemBatch(np.ones((3, 2)), np.ones((3, 4, 2))).bound.shape == (3, 4)


@pytest.mark.parametrize("half", [np.array(0.5), np.float32(0.5)], ids=repr)
def test_a_number_is_a_number_whatever_library_spelt_it_and_whoever_changes_it_later(half):
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0]], half, radius=half)
    assert (problem.bound.tolist(), problem.radius) == ([0.5], 0.5)
    names = ("step_size", "restoration_rate", "ridge", "max_restoration", "radius")
    step, same = (ConstrainedStep(**dict.fromkeys(names, number)) for number in (half, 0.5))
    assert (step, hash(step)) == (same, hash(same))
    assert ProblemBatch([[1.0, 2.0]], [[[1.0, 0.0]]]).in_geometry(None, half).radius.tolist() == [0.5]
    given = np.array(1e-9)
    solver = ActiveSet(tolerance=given)
    given[...] = 1.0
    assert (solver, hash(solver)) == (ActiveSet(tolerance=1e-9), hash(ActiveSet(tolerance=1e-9)))


def test_a_metric_is_judged_in_no_units_and_rounding_leaves_it_symmetric():
    """diag(1e-200, 1e200) scaled by row and column is as definite as what it was made of."""
    units = np.array([1e-100, 1e100])
    matrix = np.array([[2.0, 1.0], [1.0, 2.0]]) * units * units[:, None]
    problem = problem_with(metric=matrix)
    np.testing.assert_allclose(problem.whitening.factor @ problem.whitening.factor.T, matrix, rtol=1e-14)
    metric = problem_with(metric=np.array([[2.0, 1.0 + 2e-16], [1.0, 2.0]])).metric
    np.testing.assert_array_equal(metric, metric.T)


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


THREE = {"gradient": [[1.0, 2.0]] * 3, "jacobian": [[[1.0, 0.0]]] * 3}


def geometric():
    return ProblemBatch(**THREE, metric=[MATRIX, 2.0 * MATRIX, np.eye(2)], radius=[1.0, 2.0, 3.0])


HOLDERS = {
    "a step in a diagonal metric": lambda: ConstrainedStep(metric=[1.0, 2.0], radius=1.0, formulation="restoring"),
    "a problem": lambda: DirectionProblem([1.0, 2.0], [[1.0, 0.0]], [-np.inf], metric=MATRIX, radius=3.0),
    "a batch": lambda: ProblemBatch(
        [[1.0, 2.0]] * 3, [[[1.0, 0.0]]] * 3, metric=[MATRIX, MATRIX, np.eye(2)], radius=[1.0] * 3
    ),
    "a member": lambda: ProblemBatch(**THREE).in_geometry(MATRIX, 1.0)[1],
    "a batch in one geometry": lambda: ProblemBatch(**THREE).in_geometry([1.0, 2.0], 1.0),
    "the chosen": lambda: geometric().select(np.array([True, False, True])),
    "a stack": lambda: ProblemBatch.stack(list(geometric())),
    "a trusted one": lambda: DirectionProblem.trusted(np.ones(2), np.ones((1, 2)), np.zeros(1), np.zeros(1, np.bool_)),
    "a whitening": lambda: DirectionProblem([1.0, 2.0], [[1.0, 0.0]], metric=MATRIX).whitening,
}
COPIES = {"copy": copy.copy, "deepcopy": copy.deepcopy, "pickle": lambda each: pickle.loads(pickle.dumps(each))}


@pytest.mark.parametrize("how", COPIES)
@pytest.mark.parametrize("holder", HOLDERS)
def test_what_is_read_only_is_so_after_copying_and_unpickling(holder, how):
    original = HOLDERS[holder]()
    other = COPIES[how](original)
    assert type(other) is type(original)
    pairs = list(zip(arrays_in(original), arrays_in(other), strict=True))
    assert pairs
    for one, two in pairs:
        assert not one.flags.writeable
        assert not two.flags.writeable
        assert one.dtype == two.dtype
        np.testing.assert_array_equal(one, two)
    if isinstance(original, ConstrainedStep):
        assert (other, hash(other)) == (original, hash(original))
        linearization = Linearization([0.0, -1.0], [[1.0, 2.0], [1.0, -1.0]])
        np.testing.assert_array_equal(other(linearization, [0.0]).change, original(linearization, [0.0]).change)


@pytest.mark.parametrize("kind", [DirectionProblem, ProblemBatch])
def test_problems_that_were_pickled_when_they_had_one_file_are_found(kind):
    assert pickle.loads(f"ccpgrl_opt.problem\n{kind.__name__}\n.".encode()) is kind
