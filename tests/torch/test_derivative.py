"""`solve_direction`: its derivatives are those of finite differences; where there are none it says so."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from cpgrl_opt import DirectionError  # noqa: E402
from cpgrl_opt.torch import solve_direction  # noqa: E402


@pytest.mark.parametrize("seed", range(8))
def test_derivatives_are_those_of_finite_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given = [
        rng.normal(size=5),
        rng.normal(size=(3, 5)) * [[1.0], [30.0], [0.1]],
        rng.normal(size=3) * [0.5, 9.0, 0.05],
    ]
    tensors = [torch.tensor(each, requires_grad=True) for each in given]
    found = solve_direction(*tensors)
    assert found.is_differentiable

    def both(*tensors):
        again = solve_direction(*tensors)
        return again.value, again.multipliers

    assert torch.autograd.gradcheck(both, tensors, eps=1e-6, atol=1e-5, rtol=1e-5)


KINKS = {
    "met with μ = 0": ([0.0, 1.0], [[1.0, 0.0]], [0.0]),
    "a row twice": ([-1.0, 1.0], [[1.0, 0.0], [1.0, 0.0]], [0.0, 0.0]),
    "three rows in a plane": ([-1.0, -1.0], [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [0.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("name", KINKS)
def test_where_there_is_a_kink_it_says_so_and_gives_numbers(name: str) -> None:
    g, J, b = (torch.tensor(each, dtype=torch.float64, requires_grad=True) for each in KINKS[name])
    found = solve_direction(g, J, b)
    assert not found.is_differentiable
    (found.value.sum() + found.multipliers.sum()).backward()
    assert all(bool(torch.isfinite(each.grad).all()) for each in (g, J, b))


def test_rows_that_are_zero_or_off_do_not_matter_and_float32_is_all_right() -> None:
    g = torch.tensor([-1.0, 2.0], requires_grad=True)
    J, b = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), torch.tensor([-1.0, 0.0, -9.0])
    found = solve_direction(g, J, b)
    assert found.is_differentiable
    found.value.sum().backward()
    torch.testing.assert_close(g.grad, torch.tensor([0.0, 1.0]))


def test_what_has_no_direction_has_no_derivative() -> None:
    g, J = torch.ones(1, dtype=torch.float64), torch.tensor([[1.0], [-1.0]], dtype=torch.float64)
    with pytest.raises(DirectionError, match="INFEASIBLE"):
        solve_direction(g, J, torch.ones(2, dtype=torch.float64))
    with pytest.raises(ValueError, match="bound should be a tensor as gradient is"):
        solve_direction(g, J, torch.ones(2))
