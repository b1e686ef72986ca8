"""A direction as a function of (g, J, b) that autograd differentiates, by one KKT solve on the active rows A.

    δd − Jᵀδμ = δg + δJᵀμ,   J δd = δb − δJ d        rows of A
    K = JJᵀ,   q = K⁻¹(Jv + w),   p = v − Jᵀq:   ∂g = p,   ∂b = q,   ∂J = μpᵀ − q dᵀ

for a loss with the derivatives v in d and w in μ. Where a row is met with μ = 0 the direction has a kink, and where
rows of A depend μ is not unique. What comes then is the derivative with A the rows that push, μ > 0, and K⁺ for K⁻¹,
and `is_differentiable` is False.
Source: Amos & Kolter 2017, OptNet, eq. 6.
"""

from dataclasses import dataclass
from typing import Any

import torch

from ..direction_problem import DirectionProblem
from ..solvers import solve

# Of unit rows, in units of the larger of ‖g‖ and ‖d‖. What the solver's rounding leaves of 0 is 1e-12; a decade or two
# up, multipliers that only are small would be called 0.
_ZERO = 1e-9
# Least eigenvalue of the unit rows' Gramian: with less, rows are within 1e-5 rad of dependence, and K⁻¹ is of no use.
_DEPENDENT = 1e-10


@dataclass(frozen=True, eq=False)
class DifferentiableDirection:
    """d and μ, with a graph; whether their derivatives exist."""

    value: Any
    multipliers: Any
    is_differentiable: bool


def solve_direction(gradient: Any, jacobian: Any, bound: Any, *, solver: Any = "active-set") -> DifferentiableDirection:
    """d = argmin ½‖d − g‖² s.t. Jd ≥ b, differentiable in all three; ascent gradients, as everywhere but in losses.

    Parameters
    ----------
    gradient, jacobian, bound : tensors (n,), (m, n), (m,) of one dtype and device.

    Raises
    ------
    ValueError
        For what does not fit. DirectionError where the direction is not OPTIMAL: nothing there has a derivative.
    """
    for name, each in (("gradient", gradient), ("jacobian", jacobian), ("bound", bound)):
        if not isinstance(each, torch.Tensor) or each.dtype != gradient.dtype or each.device != gradient.device:
            raise ValueError(f"{name} should be a tensor as gradient is; found {each!r}")
    d, mu, tells = _Solve.apply(gradient, jacobian, bound, solver)
    return DifferentiableDirection(d, mu, bool(tells))


class _Solve(torch.autograd.Function):  # type: ignore[misc]
    """The solve, and its KKT system transposed."""

    @staticmethod
    def forward(ctx: Any, g: Any, J: Any, b: Any, solver: Any) -> Any:
        answer = solve(DirectionProblem(g.detach(), J.detach(), b.detach().double().cpu().numpy()), solver)
        answer.raise_for_status()
        d, mu = answer.value.detach(), torch.as_tensor(answer.multipliers, dtype=g.dtype, device=g.device)
        lengths = torch.linalg.vector_norm(J, dim=1).clamp_min(torch.finfo(g.dtype).tiny)
        unit = max(float(torch.linalg.vector_norm(each)) for each in (g, d))
        zero = max(_ZERO, 8 * torch.finfo(g.dtype).eps) * unit
        pushes, is_met = mu * lengths > zero, (J @ d - b).abs() / lengths <= zero
        rows = (J[pushes] / lengths[pushes, None]).double()
        least = torch.linalg.eigvalsh(rows @ rows.T)[:1]
        tells = not bool((is_met & ~pushes & (J != 0).any(dim=1)).any()) and not bool((least < _DEPENDENT).any())
        ctx.save_for_backward(J, d, mu, pushes)
        ctx.set_materialize_grads(True)
        flag = torch.tensor(tells)
        ctx.mark_non_differentiable(flag)
        return d, mu, flag

    @staticmethod
    @torch.autograd.function.once_differentiable  # type: ignore[untyped-decorator,unused-ignore]
    def backward(ctx: Any, v: Any, w: Any, _: Any) -> Any:
        J, d, mu, pushes = ctx.saved_tensors
        rows = J[pushes].double()
        lengths = torch.linalg.vector_norm(rows, dim=1)
        unit = rows / lengths[:, None]
        asked = unit @ v.double() + w[pushes].double() / lengths
        q_unit = torch.linalg.pinv(unit @ unit.T, hermitian=True, rtol=_DEPENDENT) @ asked
        p = v.double() - unit.T @ q_unit
        q = torch.zeros_like(mu, dtype=torch.float64)
        q[pushes] = q_unit / lengths
        on_rows = torch.zeros_like(J)
        on_rows[pushes] = (torch.outer(mu[pushes].double(), p) - torch.outer(q[pushes], d.double())).to(J.dtype)
        return p.to(d.dtype), on_rows, q.to(mu.dtype), None
