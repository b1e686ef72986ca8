"""Published methods: values worked out by hand, identities between them, and with our own problems."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from cpgrl_opt import SOLVERS, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.published import AGEM, CPO, CRPO, GEM, MGDA, PCPO, PUBLISHED, PCGrad, UPGrad
from cpgrl_opt.published._mgda import shortest_of_hull
from cpgrl_opt.testing import direction_problems
from cpgrl_opt.testing.strategies import Case

FEW = settings(max_examples=10)
CONES = direction_problems(cases=[Case.CONE])
CONFLICT = DirectionProblem([-4.0, 1.0, 1.0], [[6.0, 1.0, 1.0]])  # TorchJD's example


def value(method, problem):
    return method.solve(problem).value


@st.composite
def balls(draw):
    """A trust region with one constraint, of small integers, in a metric or none."""
    small = st.integers(-3, 3)
    n = draw(st.sampled_from((1, 2, 3)))
    gradient, row = (draw(st.lists(small, min_size=n, max_size=n)) for _ in range(2))
    bound = draw(st.sampled_from((0.0, 1.0, -1.0, 5.0, -5.0, -np.inf)))
    metric = draw(st.sampled_from((None, np.arange(1.0, n + 1), np.eye(n) + 1.0)))
    return DirectionProblem(gradient, [row], bound, metric=metric, radius=draw(st.sampled_from((1.0, 0.5, 3.0))))


@pytest.mark.parametrize(
    ("method", "problem", "expected"),
    [
        (MGDA(), CONFLICT, [0.0, 1.0, 1.0]),
        (PCGrad(), CONFLICT, [-4 + 66 / 19 + 6 - 44 / 9, 2 + 11 / 19 + 11 / 9, 2 + 11 / 19 + 11 / 9]),
        (UPGrad(), CONFLICT, [(2 + 66 / 19 - 44 / 9) / 2, (2 + 11 / 19 + 11 / 9) / 2, (2 + 11 / 19 + 11 / 9) / 2]),
        (GEM(), CONFLICT, [-4 + 66 / 19, 1 + 11 / 19, 1 + 11 / 19]),
        (GEM(memory_strength=0.5), DirectionProblem([1.0, 0.0], [[-2.0, 0.0], [0.0, 1.0]]), [-1.0, 0.5]),
        (AGEM(), DirectionProblem([1.0, 0.0], [[-3.0, 0.0], [1.0, 2.0]]), [0.5, 0.5]),
        (AGEM(), DirectionProblem([1.0, 0.0], [[-3.0, 0.0], [4.0, 0.0]]), [1.0, 0.0]),
        (CRPO(), DirectionProblem([1.0, 0.0], [[0.0, 1.0], [0.0, 2.0]], [0.1, 0.2]), [0.0, 2.0]),
        (CRPO(slack_allowed=0.3), DirectionProblem([1.0, 0.0], [[0.0, 1.0]], [0.2]), [1.0, 0.0]),
        (MGDA(), DirectionProblem([2.0, 0.0], [[0.0, 1.0]]), [0.4, 0.8]),
        (CPO(), DirectionProblem([3.0, 4.0], [[0.0, -1.0]], radius=5.0), [5.0, 0.0]),
        (CPO(), DirectionProblem([3.0, 4.0], [[0.0, -1.0]], [4.0], radius=5.0), [3.0, -4.0]),
        (CPO(), DirectionProblem([3.0, 4.0], [[0.0, -2.0]], [20.0], radius=5.0), [0.0, -5.0]),
        (CPO(), DirectionProblem([4.0, 0.0], [[0.0, 1.0]], metric=[4.0, 1.0], radius=2.0), [1.0, 0.0]),
        (PCPO(), DirectionProblem([3.0, 4.0], [[0.0, -1.0]], radius=5.0), [3.0, 0.0]),
        (PCPO(), DirectionProblem([3.0, 4.0], [[0.0, -1.0]], [4.0], radius=5.0), [3.0, -4.0]),
        (PCPO(), DirectionProblem([2.0, 0.0], [[-1.0, 1.0]], metric=[4.0, 1.0], radius=2.0), [0.8, 0.8]),
        (PCPO(projection="l2"), DirectionProblem([2.0, 0.0], [[-1.0, 1.0]], metric=[4.0, 1.0], radius=2.0), [0.5, 0.5]),
    ],
)
def test_a_value_worked_out_by_hand(method, problem, expected):
    np.testing.assert_allclose(value(method, problem), expected, rtol=0, atol=1e-12)


@FEW
@given(CONES)
def test_gem_is_the_cone_projection(problem):
    ours = SOLVERS["enumeration"].solve(problem)
    found = GEM().solve(problem)
    assert found.status == ours.status == Status.OPTIMAL
    np.testing.assert_allclose(found.value, ours.value, atol=1e-9)


@FEW
@given(CONES)
def test_a_gem_is_the_cone_projection_of_one_averaged_row(problem):
    mean = DirectionProblem(problem.gradient, problem.jacobian.mean(axis=0, keepdims=True))
    np.testing.assert_allclose(value(AGEM(), problem), SOLVERS["enumeration"].solve(mean).value, atol=1e-9)


@FEW
@given(CONES)
def test_upgrad_is_the_mean_of_the_projections_of_all_gradients(problem):
    tasks = np.vstack([problem.gradient, problem.jacobian])
    projected = [SOLVERS["active-set"].solve(DirectionProblem(task, tasks)).value for task in tasks]
    np.testing.assert_allclose(value(UPGrad(), problem), np.mean(projected, axis=0), atol=1e-9)


@FEW
@given(CONES)
def test_mgda_is_the_shortest_point_of_the_hull(problem):
    """‖d‖² ≤ ⟨d, gᵢ⟩ for all i, and d in the hull: then d is no longer than any of its points."""
    d, tasks = value(MGDA(), problem), np.vstack([problem.gradient, problem.jacobian])
    assert (tasks @ d >= d @ d - 1e-9).all()
    in_hull = np.vstack([tasks.T, np.ones(len(tasks))])
    _, distance = nnls(in_hull, np.append(d, 1.0))
    assert distance <= 1e-7


@FEW
@given(balls())
def test_cpo_is_the_trust_region(problem):
    ours, found = SOLVERS["active-set"].solve(problem), CPO().solve(problem)
    assert found.status == ours.status
    np.testing.assert_allclose(found.value, ours.value, atol=1e-9)
    assert found.status != Status.OPTIMAL or kkt_residuals(problem, found).worst <= 1e-9


@FEW
@given(balls())
def test_pcpo_and_cpo_coincide_where_the_step_without_the_constraint_is_feasible(problem):
    free = DirectionProblem(problem.gradient, np.zeros((0, problem.n)), metric=problem.metric, radius=problem.radius)
    step = value(CPO(), free)
    found = {name: PUBLISHED[name].solve(problem) for name in ("cpo", "pcpo")}
    if (problem.jacobian @ step >= problem.bound).all() and problem.gradient.any():
        np.testing.assert_allclose(found["pcpo"].value, step, atol=1e-12)
        np.testing.assert_allclose(found["cpo"].value, step, atol=1e-12)


def test_a_ball_that_touches_the_constraint_in_one_point_is_not_certified():
    touching = DirectionProblem([0.0, 1.0], [[1.0, 0.0]], [1.0], radius=1.0)
    found = CPO().solve(touching)
    assert found.status == Status.UNCERTIFIED
    np.testing.assert_array_equal(found.value, [1.0, 0.0])


@pytest.mark.parametrize("name", PUBLISHED)
def test_what_a_method_does_not_take_is_unsupported(name):
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0]], 1.0, True, metric=[1.0, 2.0])
    found = PUBLISHED[name].solve(problem)
    assert found.status == Status.UNSUPPORTED
    assert not found.value.any()


def test_switched_off_rows_are_no_tasks():
    problem = DirectionProblem([1.0, 0.0], [[-1.0, 1.0], [-1.0, 0.0]], [0.0, -np.inf])
    alone = DirectionProblem([1.0, 0.0], [[-1.0, 1.0]])
    for name in ("gem", "a-gem", "pcgrad", "mgda", "upgrad"):
        np.testing.assert_allclose(value(PUBLISHED[name], problem), value(PUBLISHED[name], alone), atol=1e-12)


def test_the_shortest_vector_is_found_where_scipys_nnls_stops_early():
    """Gradients of low rank, and the shortest vector of their hull among them (scipy issue 25389)."""
    rng = np.random.default_rng(397)
    n, m = int(rng.integers(3, 14)), int(rng.integers(4, 13))
    rank = int(rng.integers(2, min(n, m)))
    gradients = rng.integers(-1, 2, (m, rank)) @ rng.integers(-3, 4, (rank, n)).astype(float)
    gradients = np.vstack([shortest_of_hull(gradients)[0], gradients])
    d, weights = shortest_of_hull(gradients)
    assert (gradients @ d).min() >= d @ d - 1e-9
    np.testing.assert_allclose(weights @ gradients, d, atol=1e-9)
    np.testing.assert_allclose(weights.sum(), 1.0, atol=1e-12)
