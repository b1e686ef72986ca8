"""Trees of arrays, float32, tensors: the directions and steps of one array of float64, in the form in which g came."""

import copy
import pickle
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import (
    SOLVERS,
    ConstrainedStep,
    Direction,
    DirectionProblem,
    Linearization,
    Status,
    WithGeometry,
    kkt_residuals,
    solve,
)

from .kinds import FORMS, ROUNDING, as_dict, as_problem, draw

ACTIVE_SET = SOLVERS["active-set"]
SHORT, LONG = 12, 60_000


Kind = Callable[[np.ndarray], Any]
parametrize_kinds = pytest.mark.parametrize(
    ("kind", "rounding"), [(form, ROUNDING[dtype]) for form, dtype in FORMS.values()], ids=FORMS
)


def problem_of(seed: int, n: int) -> dict[str, Any]:
    V = draw(seed, n)
    bound = np.random.default_rng(seed).integers(-2, 3, 3) / 4.0 * (seed % 2)
    return {"gradient": V[0], "jacobian": V[1:], "bound": bound}


def of_kind(kind: Kind, arguments: dict[str, Any], *, stacked: bool = True) -> DirectionProblem:
    V = np.vstack([arguments["gradient"], arguments["jacobian"]])
    rest = {name: value for name, value in arguments.items() if name not in ("gradient", "jacobian")}
    return as_problem(kind, V, stacked=stacked, **rest)


def same_form(found: Any, given: Any) -> bool:
    if isinstance(given, dict):
        return list(found) == list(given) and all(same_form(found[key], given[key]) for key in given)
    if isinstance(given, list | tuple):
        return type(found) is type(given) and all(map(same_form, found, given))
    return type(found) is type(given) and found.dtype == given.dtype and tuple(found.shape) == tuple(given.shape)


@parametrize_kinds
@pytest.mark.parametrize("n", [SHORT, LONG])
@pytest.mark.parametrize("seed", range(4))
def test_directions_are_those_of_one_array(kind: Kind, rounding: float, n: int, seed: int) -> None:
    for radius in (None, 2.0):
        arguments = {**problem_of(seed, n), "radius": radius}
        expected = ACTIVE_SET.solve(DirectionProblem(**arguments))
        for stacked in (True, False):
            problem = of_kind(kind, arguments, stacked=stacked)
            answer = ACTIVE_SET.solve(problem)
            assert answer.status == expected.status
            if n == LONG:
                assert answer.rung == expected.rung
            assert same_form(answer.value, kind(arguments["gradient"]))
            size = max(float(np.abs(expected.value).max()), 1.0)
            np.testing.assert_allclose(problem.row_of(answer.value), expected.value, atol=4 * rounding * size)
            if answer.status == Status.OPTIMAL:
                assert answer.residuals is not None
                assert answer.residuals.worst <= 1e-9  # before it was rounded
                assert kkt_residuals(problem, answer).worst <= max(1e-9, 4 * rounding)


class Foreign:
    """Somebody's solver, which knows NumPy only."""

    def solve(self, problem: DirectionProblem) -> Direction:
        assert type(problem.gradient) is np.ndarray
        return ACTIVE_SET.solve(problem)


def test_a_third_partys_solver_sees_arrays_and_its_answer_has_the_form_of_g() -> None:
    arguments = problem_of(0, SHORT)
    problem = of_kind(as_dict, arguments)
    for answer in (solve(problem, Foreign()), solve(problem), WithGeometry(Foreign()).solve(problem)):
        assert answer.status == Status.OPTIMAL
        assert same_form(answer.value, as_dict(arguments["gradient"]))


@pytest.mark.parametrize("n", [SHORT, LONG])
def test_a_metric_comes_in_the_form_of_g_too(n: int) -> None:
    arguments, sizes = problem_of(0, n), np.random.default_rng(0).uniform(0.5, 2.0, n)
    expected = ACTIVE_SET.solve(DirectionProblem(**arguments, metric=sizes))
    tree = as_dict(sizes)

    def weighed(v: Any) -> Any:
        return {"w": v["w"] * tree["w"], "rest": [v["rest"][0] * tree["rest"][0], v["rest"][1]]}

    for metric in (tree, weighed):
        problem = of_kind(as_dict, {**arguments, "metric": metric})
        answer = ACTIVE_SET.solve(problem)
        assert answer.status == Status.OPTIMAL
        assert same_form(answer.value, as_dict(arguments["gradient"]))
        np.testing.assert_allclose(problem.row_of(answer.value), expected.value, atol=1e-9)


@parametrize_kinds
@pytest.mark.parametrize("n", [SHORT, LONG])
@pytest.mark.parametrize("formulation", ["equality", "cone", "restoring", "linearized"])
def test_steps_are_those_of_one_array(kind: Kind, rounding: float, n: int, formulation: str) -> None:
    rng = np.random.default_rng(5)
    gradients, values = rng.integers(-9, 10, (4, n)) / 8.0, np.array([0.0, -0.5, 0.25, -1.0])
    for settings in ({}, {"radius": 0.5}, {"metric": rng.uniform(0.5, 2.0, n)}):
        step = ConstrainedStep(formulation=formulation, **settings)
        expected = step(Linearization(values, gradients), np.zeros(3))
        listed = Linearization(values, [kind(each) for each in gradients])
        result = step(listed, np.zeros(3))
        assert same_form(result.change, kind(gradients[0]))
        atol = 4 * rounding * max(float(np.abs(expected.change).max()), 1.0)
        np.testing.assert_allclose(listed.vectors[0].row_of(result.change), expected.change, atol=atol)
        np.testing.assert_array_equal(result.active, expected.active)
        for part in ("multipliers", "predicted_slack"):
            np.testing.assert_allclose(getattr(result, part), getattr(expected, part), atol=1e-9 * n)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_memory_mapped_arrays_are_read_where_they_lie(tmp_path: Any, dtype: Any) -> None:
    arguments = problem_of(0, LONG)
    for name in ("gradient", "jacobian"):
        np.save(tmp_path / f"{name}.npy", arguments[name].astype(dtype))
    g, J = (np.load(tmp_path / f"{name}.npy", mmap_mode="r") for name in ("gradient", "jacobian"))
    expected = ACTIVE_SET.solve(DirectionProblem(**arguments)).value
    for rows in (J, list(J)):
        problem = DirectionProblem(g, rows, arguments["bound"])
        found = problem.row_of(ACTIVE_SET.solve(problem).value)
        np.testing.assert_allclose(found, expected, atol=1e-5 if dtype is np.float32 else 0.0)
        own_g, own_rows = problem.vectors.leaves[0]
        assert np.shares_memory(own_g, g)
        assert all(map(np.shares_memory, own_rows, rows))


ONE = {"a": np.ones(2)}


def metric_of(metric: Any, rows: Any) -> Any:
    return ConstrainedStep(metric=metric)(Linearization([0.0, -1.0], rows), [0.0])


FLAT, SINGLE = np.ones(2), np.ones((2, 4), np.float32)
REFUSED = [
    ("jacobian should be a list of rows with the structure of gradient", lambda: DirectionProblem(ONE, {"b": FLAT})),
    (r"jacobian\[0\]\['a'\] should have shape \(2,\)", lambda: DirectionProblem(ONE, [{"a": np.ones(3)}])),
    (r"jacobian\['a'\] should have shape \(m, 2\)", lambda: DirectionProblem(ONE, {"a": np.ones((1, 3))})),
    (
        r"jacobian should have one number of rows in all leaves; found \[2, 3\]",
        lambda: DirectionProblem({"a": FLAT, "b": FLAT}, {"a": np.ones((2, 2)), "b": np.ones((3, 2))}),
    ),
    (
        "jacobian.* should have no masked entries",
        lambda: DirectionProblem([np.ones((2, 3))], [np.ma.array(np.ones((1, 2, 3)), mask=True)]),
    ),
    (r"gradient\['a'\] should be an array of float64", lambda: DirectionProblem({"a": np.ones(2, int)}, [])),
    ("gradient should be finite; found nan", lambda: DirectionProblem({"a": np.array([np.nan, 1.0])}, [])),
    ("jacobian should be finite; found inf", lambda: DirectionProblem(ONE, {"a": np.array([[np.inf, 1.0]])})),
    ("gradient should have at least one component", lambda: DirectionProblem({}, {})),
    ("jacobian should be of the gradient's kind", lambda: DirectionProblem(np.ones(4), SINGLE)),
    ("metric should have the structure of gradient", lambda: DirectionProblem(ONE, [ONE], metric={"b": FLAT})),
    (r"metric.* should have", lambda: metric_of({"c": FLAT}, [ONE, ONE])),
    ("no tree; found a tree", lambda: metric_of(ONE, np.ones((2, 2)))),
    (
        "what metric returns should be an array of real numbers",
        lambda: DirectionProblem([1.0, 2.0], [[1.0, 0.0]], metric=lambda v: v + 1j),
    ),
    (
        r"direction\.value should have the structure of gradient",
        lambda: kkt_residuals(DirectionProblem(ONE, []), Direction({"w": np.ones(3)}, np.zeros(0), Status.OPTIMAL)),
    ),
]


@pytest.mark.parametrize(("message", "make"), REFUSED)
def test_what_does_not_fit_is_refused_by_name(message: str, make: Callable[[], Any]) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_tensors_that_are_not_for_us_are_refused_by_name() -> None:
    torch = pytest.importorskip("torch")
    one, three = torch.ones(2), "an array of float64, float32 or bfloat16; found"
    for gradient, rows, message in (
        (np.ones(2), [one], "jacobian should be of the gradient's kind"),
        ([1.0, 1.0], torch.ones(1, 2, dtype=torch.float64), "jacobian should be of the gradient's kind"),
        (one, [np.ones(2, np.float32)], r"jacobian\[0\] should be of torch as gradient is; found numpy"),
        (one, [one.double()], r"jacobian\[0\] should be of torch.float32 as gradient is there; found torch"),
        (one.half(), [one.half()], f"gradient should be {three} Ten"),
        ({"a": np.ones(2, np.uint16)}, [], f"should be {three} ndarray of uint16"),  # might be the bits of bfloat16
        (one.to_sparse(), [one], r"tensors should be dense and on a device .*; found torch\.sparse_coo"),
        (one, [one.to("meta")], r"should be dense and on a device that has float64; found .* on meta"),
    ):
        with pytest.raises(ValueError, match=message):
            DirectionProblem(gradient, rows)


def test_numbers_of_a_conjugate_are_read_as_they_are() -> None:
    torch = pytest.importorskip("torch")
    g = torch.tensor([1.0 + 2.0j, 3.0 - 1.0j]).conj().imag
    assert g.is_neg()
    assert ACTIVE_SET.solve(DirectionProblem(g, [g.clone()])).value.tolist() == [-2.0, 1.0]


def test_the_referee_copies_no_tree() -> None:
    draws = [np.random.default_rng(seed).standard_normal(100_000) for seed in range(3)]
    g, *rows = ({"a": each, "b": each.astype(np.float32)} for each in draws)
    problem = DirectionProblem(g, rows)
    answer = ACTIVE_SET.solve(problem)
    kkt_residuals(problem, answer)  # compiles
    tracemalloc.start()
    try:
        kkt_residuals(problem, answer)
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


def test_copies_and_pickles_are_of_the_same_form() -> None:
    arguments = problem_of(0, SHORT)
    plain, metric = of_kind(as_dict, arguments), of_kind(as_dict, {**arguments, "metric": as_dict(np.ones(SHORT))})
    by_product = of_kind(as_dict, {**arguments, "metric": lambda v: v})
    pickled = (pickle.loads(pickle.dumps(each)) for each in (plain, metric))
    for again in (*pickled, copy.copy(metric), copy.deepcopy(metric), copy.copy(by_product), copy.deepcopy(by_product)):
        answer = ACTIVE_SET.solve(again)
        assert answer.status == Status.OPTIMAL
        assert same_form(answer.value, as_dict(arguments["gradient"]))
    linearization = Linearization(np.zeros(3), [as_dict(each) for each in arguments["jacobian"]])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(linearization)).gradients, arguments["jacobian"])


def test_lists_of_rows_and_of_runs_are_no_trees() -> None:
    rows = [np.ones(2), np.array([1.0, 0.0])]
    assert type(Linearization([0.0, -1.0], rows).gradients) is np.ndarray
    assert Linearization([[0.0, -1.0]], [rows]).gradients.shape == (1, 2, 2)
    assert type(DirectionProblem([1.0, 2.0], [rows[0]]).gradient) is np.ndarray
    assert DirectionProblem(np.ones(2, ">f8"), np.ones((1, 2), int)).gradient.dtype == np.float64
    for plain in (Linearization([0.0, -1.0], rows), Linearization([0.0, -1.0], [[1.0, 2.0], [1.0, 0.0]])):
        assert type(ConstrainedStep()(plain, [0.0]).change) is np.ndarray


def test_leaves_belong_together_by_their_keys_and_not_by_their_order() -> None:
    g = {"x": {"a": np.array([1.0, 2.0]), "b": np.array([3.0, 4.0])}}
    rows = {"x": {"a": np.array([[1.0, 0.0]]), "b": np.array([[0.0, 0.0]])}}
    turned = {"x": {"b": rows["x"]["b"], "a": rows["x"]["a"]}}
    listed = [{"x": {"b": np.zeros(2), "a": np.array([1.0, 0.0])}}]
    for jacobian in (rows, turned, listed):
        problem = DirectionProblem(g, jacobian, 5.0)
        np.testing.assert_array_equal(problem.jacobian, [[1.0, 0.0, 0.0, 0.0]])
        answer = ACTIVE_SET.solve(problem)
        np.testing.assert_array_equal(answer.value["x"]["a"], [5.0, 2.0])
        back = {"x": {"b": answer.value["x"]["b"], "a": answer.value["x"]["a"]}}
        assert kkt_residuals(problem, Direction(back, answer.multipliers, Status.OPTIMAL)).worst == 0.0
    change = ConstrainedStep()(Linearization([0.0, -1.0], [g, turned["x"] and listed[0]]), [0.0]).change
    assert list(change["x"]) == ["a", "b"]


@pytest.mark.parametrize("n", [2, LONG])
def test_what_leaves_float32_is_no_answer(n: int) -> None:
    g, J = np.full(n, 3e38, np.float32), np.zeros((3, n), np.float32)
    J[:, 0], J[0, 1] = -1.0, 1.0
    answer = ACTIVE_SET.solve(DirectionProblem(g, J, [1e39, -np.inf, -np.inf]))
    assert answer.status == Status.NUMERICAL_ERROR
    assert np.isfinite(answer.value).all()
    with pytest.raises(FloatingPointError, match="the change of θ should be finite in the gradients' dtypes"):
        ConstrainedStep(step_size=10)(Linearization([1.0], g[None]), [])


def test_traced_arrays_of_jax_are_refused_by_name() -> None:
    jax = pytest.importorskip("jax")
    with pytest.raises(ValueError, match="arrays of JAX should have numbers, outside of jit, vmap and grad; found"):
        jax.jit(lambda g: ACTIVE_SET.solve(DirectionProblem(g, g[None])).value)(jax.numpy.ones(3))


@pytest.mark.parametrize("n", [SHORT, LONG])
def test_traced_tensors_are_refused_by_name(n: int) -> None:
    torch = pytest.importorskip("torch")
    with pytest.raises(ValueError, match=r"tensors should have numbers, outside of torch\.func; found none"):
        torch.func.grad(lambda g: ACTIVE_SET.solve(DirectionProblem(g, [g, g])).value.sum())(torch.ones(n))


def test_values_and_bounds_are_detached() -> None:
    torch = pytest.importorskip("torch")
    numbers, g = torch.ones(2, requires_grad=True), torch.ones(3)
    for given in (numbers, numbers.to(torch.bfloat16), [numbers[0], numbers[1]]):
        np.testing.assert_array_equal(DirectionProblem(g, [g, g], given).bound, np.ones(2))
        np.testing.assert_array_equal(Linearization(given, [g, g]).values, np.ones(2))
    assert DirectionProblem(g, [g, g], 0.0, torch.tensor([True, False])).equality.tolist() == [True, False]


def test_a_list_is_one_of_channels_where_it_has_as_many_as_there_are_values() -> None:
    values, whole = np.array([0.0, -0.5, 0.25]), np.random.default_rng(3).standard_normal((3, 6)).astype(np.float32)
    leaves = [whole[:, :2], whole[:, 2:]]
    found = ConstrainedStep()(Linearization(values, leaves), np.zeros(2)).change
    expected = ConstrainedStep()(Linearization(values, [[row[:2], row[2:]] for row in whole]), np.zeros(2)).change
    for part, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(part, other)


@pytest.mark.parametrize("kind", [np.asarray, as_dict])
def test_a_function_as_metric_may_return_one_buffer_again_and_again(kind: Kind) -> None:
    arguments, sizes, buffer = problem_of(0, SHORT), np.linspace(0.5, 2.0, SHORT), np.empty(SHORT)

    def weighed(v: Any) -> Any:
        whole = v if kind is np.asarray else np.concatenate([v["w"].ravel(), *v["rest"]])
        return kind(np.multiply(sizes, whole, out=buffer))

    answer = ACTIVE_SET.solve(of_kind(kind, {**arguments, "metric": weighed}))
    expected = ACTIVE_SET.solve(of_kind(kind, {**arguments, "metric": kind(sizes)}))
    assert answer.status == Status.OPTIMAL
    np.testing.assert_allclose(answer.multipliers, expected.multipliers, atol=1e-9)


def test_a_steps_metric_as_a_tree_is_matched_by_its_keys() -> None:
    g, other = {"a": np.array([1.0, 2.0]), "b": np.array([3.0, 4.0])}, {"a": np.array([1.0, 0.0]), "b": np.zeros(2)}
    given = Linearization([0.0, 1.0], [g, other])
    expected = ConstrainedStep(metric=lambda v: {"a": v["a"], "b": 100.0 * v["b"]})(given, [0.0]).change
    for metric in ({"a": np.ones(2), "b": np.full(2, 100.0)}, {"b": np.full(2, 100.0), "a": np.ones(2)}):
        found = ConstrainedStep(metric=metric)(given, [0.0]).change
        for name in g:
            np.testing.assert_allclose(found[name], expected[name], rtol=1e-12)
