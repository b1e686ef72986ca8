"""A direction problem is validated once, on construction, and its arrays cannot be changed afterwards."""

import pickle

import numpy as np
import pytest

from cpgrl_opt import DirectionProblem, Linearization, ProblemBatch
from cpgrl_opt.scaling import lengths, unit_rows

GOOD = {"gradient": [1.0, 2.0], "jacobian": [[1.0, 0.0], [0.0, 1.0]], "bound": [0.0, 1.0], "equality": [False, True]}


def problem_with(**changes):
    return DirectionProblem(**{**GOOD, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gradient": [1.0, np.nan]}, "gradient should be finite; found nan"),
        ({"gradient": [1.0, np.inf]}, "gradient should be finite; found inf"),
        ({"gradient": [1.0]}, r"gradient should have shape \(2,\); found \(1,\)"),
        ({"gradient": [[1.0, 2.0]]}, "gradient should have 1 axes"),
        ({"gradient": ["a", "b"]}, "gradient should be an array of real numbers"),
        ({"gradient": [1j, 0.0]}, "gradient should be an array of real numbers"),
        ({"gradient": None}, "gradient should be an array of real numbers"),
        ({"jacobian": [[1.0, -np.inf], [0.0, 1.0]]}, "jacobian should be finite"),
        ({"jacobian": [[1.0, 2.0], [3.0]]}, "jacobian should be a rectangular array"),
        ({"jacobian": [1.0, 2.0]}, "jacobian should have 2 axes"),
        ({"bound": [0.0, np.inf]}, r"bound should be finite, or −inf on an inequality; found NaN or \+inf"),
        ({"bound": [0.0, np.nan]}, "bound should be finite"),
        ({"bound": [0.0, -np.inf]}, "bound should be finite on an equality; found −inf"),
        ({"bound": [0.0]}, "bound should have shape"),
        ({"equality": [0, 1]}, "equality should be an array of booleans"),
        ({"equality": [True]}, "equality should have shape"),
        ({"gradient": [], "jacobian": np.zeros((2, 0))}, "gradient should have at least one component"),
    ],
)
def test_bad_input_is_refused_with_what_should_be_and_what_was_found(changes, message):
    with pytest.raises(ValueError, match=message):
        problem_with(**changes)


def test_defaults_are_the_cone_through_the_origin():
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0]])
    assert problem.bound.tolist() == [0.0]
    assert problem.equality.tolist() == [False]
    assert (problem.n, problem.m) == (2, 1)


def test_no_constraint_is_a_problem_too():
    problem = DirectionProblem([1.0, 2.0], np.zeros((0, 2)))
    assert problem.m == 0


def test_minus_infinity_switches_an_inequality_off():
    assert problem_with(bound=[-np.inf, 1.0]).bound[0] == -np.inf


def test_arrays_are_copies_that_cannot_be_written():
    gradient = np.array([1.0, 2.0])
    problem = problem_with(gradient=gradient)
    gradient[0] = 7.0
    assert problem.gradient[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        problem.gradient[0] = 7.0


def test_a_batch_reads_as_its_problems():
    problems = [problem_with(), problem_with(gradient=[3.0, 4.0])]
    batch = ProblemBatch.stack(problems)
    assert len(batch) == 2
    for one, other in zip(batch, problems, strict=True):
        for name in ("gradient", "jacobian", "bound", "equality"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert batch.chosen(np.array([False, True]))[0].gradient.tolist() == [3.0, 4.0]


def test_a_batch_of_different_shapes_is_refused():
    with pytest.raises(ValueError, match="problems should have one shape"):
        ProblemBatch.stack([problem_with(), DirectionProblem([1.0], [[1.0]])])
    with pytest.raises(ValueError, match="no problem"):
        ProblemBatch.stack([])


@pytest.mark.parametrize("name", ["gradient", "jacobian", "bound"])
def test_a_batch_with_nan_is_refused(name):
    arrays = {key: np.array([value]) for key, value in GOOD.items()}
    arrays[name] = np.full_like(arrays[name], np.nan)
    with pytest.raises(ValueError, match=f"{name} should be finite"):
        ProblemBatch(**arrays)


@pytest.mark.parametrize("scale", [1e-300, 1e-170, 1.0, 1e170, 1e300])
def test_unit_rows_have_length_one_at_any_scale(scale):
    rng = np.random.default_rng(0)
    jacobian = rng.standard_normal((4, 6))
    jacobian[2] = 0.0
    rows = unit_rows(scale * jacobian)
    np.testing.assert_allclose(np.linalg.norm(rows.jacobian, axis=1), [1, 1, 0, 1], rtol=1e-15)
    np.testing.assert_allclose(lengths(scale * jacobian), scale * np.linalg.norm(jacobian, axis=1), rtol=1e-14)


@pytest.mark.parametrize("neighbour", [0.0, 1e-170, 1e170])
def test_a_length_does_not_depend_on_the_vectors_beside_it(neighbour):
    vectors = np.random.default_rng(3).normal(size=(200, 7))
    in_company = lengths(np.concatenate([vectors, np.full((1, 7), neighbour)]))
    np.testing.assert_array_equal(in_company[:-1], [lengths(vector) for vector in vectors])
    np.testing.assert_allclose(in_company[-1], neighbour * np.sqrt(7), rtol=1e-14)


def test_a_linearization_refuses_what_an_estimator_must_not_hand_over():
    with pytest.raises(ValueError, match="values should be finite; found nan"):
        Linearization([np.nan, 0.0], np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"values should have shape \(2,\); found \(3,\)"):
        Linearization(np.zeros(3), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="gradients should have shape"):
        Linearization(np.zeros(()), np.zeros(3))
    with pytest.raises(ValueError, match="at least the objective's channel"):
        Linearization(np.zeros(0), np.zeros((0, 3)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"metric": [1.0]}, r"metric should have shape \(2,\); found \(1,\)"),
        ({"metric": np.eye(3)}, r"metric should have shape \(2, 2\); found \(3, 3\)"),
        ({"metric": [[[1.0]]]}, "metric should be None"),
        ({"metric": [1.0, np.nan]}, "metric should be finite"),
        ({"metric": [1.0, np.inf]}, "metric should be finite"),
        ({"metric": [1.0, 0.0]}, "metric should have positive diagonal entries; found 0.0"),
        ({"metric": [[1.0, 0.0], [0.1, 1.0]]}, "metric should be symmetric; found"),
        ({"metric": [[1.0, 1.0], [1.0, 1.0]]}, "metric should be positive definite; found the eigenvalue"),
        ({"metric": [[1.0, -3.0], [-3.0, 1.0]]}, "metric should be positive definite; found the eigenvalue -2"),
        ({"radius": -1.0}, "radius should be a finite number > 0; found -1.0"),
        ({"radius": np.nan}, "radius should be a finite number > 0; found nan"),
    ],
)
def test_what_is_no_metric_and_no_radius_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        problem_with(**changes)


def test_a_metric_is_judged_in_no_units():
    """diag(1e-200, 1e200) scaled by row and column is as definite as what it was made of."""
    units = np.array([1e-100, 1e100])
    matrix = np.array([[2.0, 1.0], [1.0, 2.0]]) * units * units[:, None]
    problem = problem_with(metric=matrix)
    np.testing.assert_allclose(problem.whitening.factor @ problem.whitening.factor.T, matrix, rtol=1e-14)
    with pytest.raises(ValueError, match="read-only"):
        problem.metric[0, 0] = 1.0


def test_rounding_leaves_a_metric_symmetric():
    matrix = np.array([[2.0, 1.0 + 2e-16], [1.0, 2.0]])
    metric = problem_with(metric=matrix).metric
    np.testing.assert_array_equal(metric, metric.T)


def test_a_batch_keeps_metrics_and_radii():
    problems = [
        problem_with(metric=[1.0, 4.0], radius=0.5),
        problem_with(metric=[[2.0, 1.0], [1.0, 2.0]], radius=2.0),
        problem_with(radius=1.0),
    ]
    batch = ProblemBatch.stack(problems)
    assert batch.metric.shape == (3, 2, 2)
    assert batch[1].radius == 2.0
    np.testing.assert_array_equal(batch[0].metric, np.diag([1.0, 4.0]))
    np.testing.assert_array_equal(batch[2].metric, np.eye(2))
    for part in (batch[1:], batch.chosen(np.array([False, True, True]))):
        np.testing.assert_array_equal(part.radius, [2.0, 1.0])
        np.testing.assert_array_equal(part[0].metric, problems[1].metric)
        assert part[0].whitening is not None
    assert batch[:0].metric is not None
    arrays = {key: np.array([value]) for key, value in GOOD.items()}
    assert ProblemBatch(**arrays, metric=[[1.0, 4.0]], radius=[3.0])[0].radius == 3.0
    with pytest.raises(ValueError, match=r"radius should have shape \(1,\)"):
        ProblemBatch(**arrays, radius=[1.0, 2.0])
    with pytest.raises(ValueError, match="metric should have one entry a problem"):
        ProblemBatch(**arrays, metric=[[1.0, 4.0], [1.0, 4.0]])


def test_a_batch_of_problems_with_and_without_a_radius_is_refused():
    with pytest.raises(ValueError, match="problems should all have a radius, or none; found 1 of 2"):
        ProblemBatch.stack([problem_with(), problem_with(radius=1.0)])


@pytest.mark.parametrize("kind", [DirectionProblem, ProblemBatch])
def test_problems_that_were_pickled_when_they_had_one_file_are_found(kind):
    assert pickle.loads(f"ccpgrl_opt.problem\n{kind.__name__}\n.".encode()) is kind
