"""`solve_direction`: its derivatives are those of finite differences; where there are none it says so."""

from fractions import Fraction

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from cpgrl_opt import DirectionError, DirectionProblem  # noqa: E402
from cpgrl_opt.exact import exact_answer  # noqa: E402
from cpgrl_opt.exact.rational import fractions_of, solve  # noqa: E402
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
    assert torch.autograd.gradgradcheck(both, tensors, eps=1e-6, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize(("dtype", "least", "most"), [("float32", 1e-30, 1e20), ("float64", 1e-200, 1e100)])
def test_no_scale_of_gradient_or_rows_takes_the_derivative_away(dtype: str, least: float, most: float) -> None:
    for of_gradient in (1.0, least, most):
        for of_rows in (1.0, least, most):
            g = torch.tensor([of_gradient, -of_gradient], dtype=getattr(torch, dtype), requires_grad=True)
            J = torch.tensor([[0.0, of_rows]], dtype=g.dtype, requires_grad=True)
            found = solve_direction(g, J, torch.zeros(1, dtype=g.dtype))
            found.value.sum().backward()
            assert found.is_differentiable
            np.testing.assert_array_equal(g.grad, [1.0, 0.0])


def exact_derivatives(problem: DirectionProblem) -> np.ndarray:
    """∂(d, μ)/∂(g, J, b), (n + m, n + m n + m): of the KKT system of the rows that push, solved in fractions."""
    n, m = problem.n, problem.m
    on = np.flatnonzero(exact_answer(problem).multipliers).tolist()
    g, b = fractions_of(problem.gradient), fractions_of(problem.bound)
    J = [fractions_of(row) for row in problem.jacobian]
    system = [[Fraction(int(i == k)) for k in range(n)] + [-J[a][i] for a in on] for i in range(n)]
    system += [J[a] + [Fraction(0)] * len(on) for a in on]
    found = solve(system, g + [b[a] for a in on])
    assert found is not None
    d, mu = found[:n], dict(zip(on, found[n:], strict=True))
    columns = []
    for index in range(n + m * n + m):
        right = [Fraction(0)] * (n + len(on))  # δg + δJᵀμ, then δb − δJ d
        i, k = divmod(index - n, n)
        if index < n:
            right[index] += 1
        elif index < n + m * n and i in on:
            right[k] += mu[i]
            right[n + on.index(i)] -= d[k]
        elif index >= n + m * n and index - n - m * n in on:
            right[n + on.index(index - n - m * n)] += 1
        change = solve(system, right)
        assert change is not None
        pushes = dict(zip(on, change[n:], strict=True))
        columns.append([float(each) for each in change[:n]] + [float(pushes.get(i, 0)) for i in range(m)])
    return np.array(columns).T


@pytest.mark.parametrize("angle", [1.0, 1e-3])
@pytest.mark.parametrize("seed", range(3))
def test_derivatives_are_those_of_rational_arithmetic(seed: int, angle: float) -> None:
    """With rows `angle` from each other too, where finite differences have half of the digits."""
    rng = np.random.default_rng(seed)
    g, J, b = rng.normal(size=4), rng.normal(size=(3, 4)), rng.normal(size=3)
    J[1] = J[0] + angle * J[1]
    b[1] = b[0] + angle * b[1]
    given = [torch.tensor(each) for each in (g, J, b)]
    assert solve_direction(*given).is_differentiable

    def both(*tensors):
        again = solve_direction(*tensors)
        return torch.cat([again.value, again.multipliers])

    parts = torch.autograd.functional.jacobian(both, tuple(given))
    found = torch.cat([part.reshape(7, -1) for part in parts], dim=1).numpy()
    expected = exact_derivatives(DirectionProblem(g, J, b))
    assert (expected[4:] != 0.0).any()
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13 / angle**2 * np.abs(expected).max())


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
