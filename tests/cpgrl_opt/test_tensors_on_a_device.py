"""The way of tensors that NumPy cannot see, taken with tensors that it can: the answers of the compiled passes."""

import importlib.util
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, ConstrainedStep, DirectionProblem, Linearization, Status
from cpgrl_opt.compensated import Pair
from cpgrl_opt.vectors import TreeVectors, _torch
from cpgrl_opt.vectors._tensors import TensorVectors

from .kinds import draw

if importlib.util.find_spec("torch") is None:
    pytest.skip("PyTorch is not installed", allow_module_level=True)
import torch

ACTIVE_SET, SHORT, LONG = SOLVERS["active-set"], 12, 60_000
DTYPES = {torch.float64: 1e-12, torch.float32: 2.0**-23, torch.bfloat16: 2.0**-7}


def tree(v: np.ndarray, dtype: torch.dtype) -> Any:
    k = v.shape[-1] // 2
    half = torch.from_numpy(v[..., :k].copy()).to(dtype).reshape(*v.shape[:-1], 2, -1).requires_grad_()
    return {"half": half, "none": half[..., :0, 0], "rest": torch.from_numpy(v[..., k:].copy())}


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("stacked", [True, False])
@pytest.mark.parametrize("lanes", [7, 1 << 15])
def test_sums_are_those_of_the_compiled_passes(
    dtype: torch.dtype, stacked: bool, lanes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_torch, "_BLOCK", 50)
    monkeypatch.setattr(_torch, "_LANES", lanes)
    V = draw(0, 1000) * np.where(np.arange(1000) % 3, 2.0**30, 1.0)
    given = tree(V[0], dtype), tree(V[1:], dtype) if stacked else [tree(row, dtype) for row in V[1:]]
    ours, others = TensorVectors(*given), TreeVectors(*given)
    np.testing.assert_allclose(ours.gramian(), others.gramian(), rtol=1e-13)
    for part, other in zip(ours.gramian_in_pairs(), others.gramian_in_pairs(), strict=True):
        np.testing.assert_array_equal(part, other)
    for lo in (np.zeros(4), np.full(4, 1e-17)):
        weights, mu = Pair(np.array([1.0, 0.5, 0.0, -2.0 / 3.0]), lo), np.array([0.5, 0.0, -0.6])
        (d, found), (e, expected) = ours.combine(weights, mu), others.combine(weights, mu)
        for name in d:
            assert d[name].dtype == e[name].dtype
            close = {"rtol": DTYPES[d[name].dtype], "atol": 1e-15 * 2.0**33}
            np.testing.assert_allclose(d[name].double(), e[name].double(), **close)
        for measured in (found, ours.certificate(e, mu)):
            expected = expected if measured is found else others.certificate(e, mu)
            np.testing.assert_allclose(measured.products, expected.products, atol=1e-12 * expected.length**2)
            np.testing.assert_allclose([measured.rest, measured.length], [expected.rest, expected.length], rtol=1e-12)
    np.testing.assert_array_equal(ours.whole_jacobian(), V[1:])
    assert [ours.is_zero(i) for i in range(4)] == [False] * 4


@pytest.mark.parametrize("n", [SHORT, LONG])
def test_steps_and_metrics_of_functions_are_those_of_one_array(n: int) -> None:
    V, values, sizes = draw(0, n), np.array([0.0, -0.5, 0.25, -1.0]), torch.linspace(0.5, 2.0, n, dtype=torch.float64)
    given = TensorVectors(tree(V[0], torch.float32), tree(V[1:], torch.float32))

    def product(v: Any) -> Any:
        whole = torch.cat([part.reshape(-1) for part in v.values()]) * sizes
        return {"half": whole[: n // 2].reshape(2, -1), "none": v["none"], "rest": whole[n // 2 :]}

    for metric in (None, product):
        step = ConstrainedStep(metric=metric)
        flat = ConstrainedStep(metric=None if metric is None else sizes.numpy())
        found = step(Linearization(values, given), np.zeros(3)).change
        expected = flat(Linearization(values, V), np.zeros(3)).change
        np.testing.assert_allclose(given.row_of(found), expected, atol=1e-6 * float(np.abs(expected).max()))


def test_what_is_not_finite_is_refused_or_no_answer() -> None:
    one = torch.ones(3)
    with pytest.raises(ValueError, match="gradient should be finite; found inf"):
        DirectionProblem(TensorVectors(one / 0.0, [one]))
    g, J = torch.full((2,), 3e38), torch.tensor([[-1.0, 1.0]])
    assert ACTIVE_SET.solve(DirectionProblem(TensorVectors(g, J), bound=1e39)).status == Status.NUMERICAL_ERROR


def test_other_devices_take_this_way_and_leave_it_where_there_is_no_float64() -> None:
    from cpgrl_opt.vectors import kind_of

    assert type(kind_of(torch.ones(3, device="meta"), [])) is TensorVectors
    assert type(kind_of(torch.ones(3), [])) is TreeVectors
