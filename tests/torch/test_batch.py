"""Batches of tensors: what NumPy's batch says of the same numbers, on the way of the CPU and on that of a device."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from cpgrl_opt import ProblemBatch, Status  # noqa: E402
from cpgrl_opt import solve_batch as solve_arrays  # noqa: E402
from cpgrl_opt.problems import families  # noqa: E402
from cpgrl_opt.torch import batch as module  # noqa: E402
from cpgrl_opt.torch import solve_batch  # noqa: E402

COUNT, SCALES = 4, (1.0, 1e-4, 1e-8)
FAMILIES = [name for name, family in families().items() if family.geometry is None]


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its way, taken with tensors that NumPy can see; in blocks of a few problems."""
    monkeypatch.setattr(module, "is_apart", lambda _: True)
    monkeypatch.setattr(module, "_NUMBERS", 100)


@pytest.fixture(params=["cpu", "device"])
def way(request: pytest.FixtureRequest) -> str:
    if request.param == "device":
        request.getfixturevalue("device")
    return str(request.param)


def draw(name: str) -> Iterator[ProblemBatch]:
    """Batches of each kind of constraints that the family has, and of the shapes that it comes in."""
    family, rng = families()[name], np.random.default_rng(0)
    for case in family.cases:
        for n, m in ((9, 3), (20, 6)):
            try:
                problems = [family.draw(rng, case, n=n, m=m) for _ in range(COUNT)]
            except ValueError:  # a family of one shape
                problems = [family.draw(rng, case) for _ in range(COUNT)]
            shapes = {each.jacobian.shape for each in problems}
            yield from (ProblemBatch.stack([each for each in problems if each.jacobian.shape == one]) for one in shapes)


def tensors(problems: ProblemBatch, dtype: Any) -> tuple[list[Any], ProblemBatch]:
    """g, J, b and E; and the problems that they are, rounded to the dtype."""
    given = [torch.from_numpy(each.copy()) for each in problems.arrays()]
    given[:2] = [each.to(dtype) for each in given[:2]]
    rounded = [each.double().numpy() for each in given[:2]]
    return given, ProblemBatch(*rounded, *problems.arrays()[2:])


def distances(found: Any, problems: ProblemBatch, expected: Any) -> np.ndarray:
    """Of the directions, in units of the longer of g and d."""
    sizes = [np.linalg.norm(each, axis=1) for each in (problems.gradient, expected.value)]
    apart = np.abs(found.value.double().numpy() - expected.value).max(axis=1)
    return np.asarray(apart / np.maximum(*sizes).clip(1e-300))


@pytest.mark.parametrize("name", FAMILIES)
def test_answers_are_those_of_numpys_batch(name: str, device: None) -> None:
    for drawn in draw(name):
        g, J, b, E = drawn.arrays()
        scaled = [np.concatenate([c * g for c in SCALES]), np.concatenate([c * J for c in SCALES])]
        given, problems = tensors(
            ProblemBatch(*scaled, np.concatenate([c**2 * b for c in SCALES]), np.tile(E, (3, 1))), torch.float64
        )
        found, expected = solve_batch(*given), solve_arrays("active-set", problems)
        np.testing.assert_array_equal(found.status, expected.status)
        assert (distances(found, problems, expected) <= 1e-12).all()
        lengths = np.linalg.norm(problems.jacobian, axis=2)
        zero = 1e-12 * np.linalg.norm(problems.gradient, axis=1)[:, None]
        pushes = [(np.abs(each.multipliers) * lengths > zero)[found.status == 0] for each in (found, expected)]
        np.testing.assert_array_equal(*pushes)


@pytest.mark.parametrize("name", ["ordinary", "switched off", "infeasible", "no constraints"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_short_floats_are_solved_in_float64_and_rounded_once(name: str, dtype: Any, way: str) -> None:
    for drawn in draw(name):
        given, problems = tensors(drawn, dtype)
        found, expected = solve_batch(*given), solve_arrays("active-set", problems)
        assert found.value.dtype == dtype
        np.testing.assert_array_equal(found.status, expected.status)
        assert (distances(found, problems, expected) <= 4 * torch.finfo(dtype).eps).all()
        assert found.residuals is not None
        assert found.residuals[found.status == 0].max(initial=0.0) <= 1e-9  # of float64


def test_usual_problems_are_answered_by_their_gramians(way: str) -> None:
    rng = np.random.default_rng(0)
    g, J = (torch.from_numpy(rng.normal(size=size)) for size in ((50, 40), (50, 3, 40)))
    J[7, 1] = J[7, 0]
    found = solve_batch(g.requires_grad_(), J, torch.zeros(50, 3), torch.tensor([[True, False, False]] * 50))
    assert not found.value.requires_grad
    rungs = ["gramian" if way == "device" and k != 7 else "rows" for k in range(50)]
    assert [each.rung for each in found] == rungs
    assert {each.status for each in found} == {Status.OPTIMAL}
    np.testing.assert_allclose((J[:, 0] * found.value).sum(dim=1), 0.0, atol=1e-13)


@pytest.mark.parametrize("shape", [(0, 4, 3), (1, 4, 3), (3, 4, 0), (0, 4, 0)])
def test_no_problem_one_problem_and_no_constraint(shape: tuple[int, ...], way: str) -> None:
    B, n, m = shape
    g, J = torch.ones(B, n), -torch.ones(B, m, n)
    found = solve_batch(g, J)
    assert found.value.shape == (B, n)
    assert found.multipliers.shape == (B, m)
    assert len(found) == B
    assert (found.status == Status.OPTIMAL).all()
    np.testing.assert_allclose(found.value, torch.zeros(B, n) if m else g, atol=1e-6)


def test_long_problems_that_are_not_usual_stay_on_the_device(way: str) -> None:
    rng = np.random.default_rng(0)
    g, J = (torch.from_numpy(rng.normal(size=size)) for size in ((3, 40_000), (3, 2, 40_000)))
    J[1, 1] = 2.0 * J[1, 0]
    J[2, 1] = -J[2, 0]
    found = solve_batch(g, J, torch.tensor([[0.0, 0.0], [1.0, 2.0], [1.0, 1.0]]))
    assert [each.status.name for each in found] == ["OPTIMAL", "OPTIMAL", "INFEASIBLE"]
    assert found[0].rung == "gramian"
    assert isinstance(found[1].value, torch.Tensor)
    assert float(J[1, 0] @ found[1].value) >= 1.0 - 1e-12


def test_any_solver_answers_as_numpys_batch_by_it(way: str) -> None:
    given, problems = tensors(next(draw("ordinary")), torch.float64)
    expected = solve_arrays("nnls", problems)
    np.testing.assert_array_equal(solve_batch(*given, solver="nnls").value, expected.value)


def test_a_direction_beyond_its_dtype_is_no_number(way: str) -> None:
    g = torch.tensor([[3e38, 3e38], [1.0, 1.0]])
    found = solve_batch(g, torch.tensor([[[-1.0, 1.0]]] * 2), torch.tensor([[3e38], [0.5]]))
    assert [each.status for each in found] == [Status.NUMERICAL_ERROR, Status.OPTIMAL]
    assert not found.value[0].any()


def test_what_does_not_fit_is_refused(way: str) -> None:
    g, J = torch.ones(2, 3), torch.ones(2, 1, 3)
    for given, said in (
        ((np.ones((2, 3)), J), "gradient should be a tensor of 2 axes"),
        ((g.int(), J), "gradient should be a tensor of 2 axes, float64.*int32"),
        ((g, J[0]), "jacobian should be a tensor of 3 axes"),
        ((g, J.double()), "jacobian should be torch.float32 on cpu as gradient is"),
        ((g, torch.ones(2, 1, 4)), "jacobian should be .B, m, n., gradient being"),
        ((g[:, :0], J[:, :, :0]), "gradient should have at least one component"),
        ((g, J / 0.0), "jacobian should be finite"),
        ((g * torch.nan, J), "gradient should be finite"),
        ((g, J, torch.ones(2, 2)), "bound should have shape"),
        ((g, J, torch.nan), "bound should be finite"),
        ((g, J, 0.0, torch.ones(2, 1)), "equality should be"),
    ):
        with pytest.raises(ValueError, match=said):
            solve_batch(*given)
