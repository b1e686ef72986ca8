"""A direction as a function of (g, J, b) that autograd differentiates, by one KKT solve on the active rows A.

    δd − Jᵀδμ = δg + δJᵀμ,   J δd = δb − δJ d        rows of A
    K = JJᵀ,   q = K⁻¹(Jv + w),   p = v − Jᵀq:   ∂g = p,   ∂b = q,   ∂J = μpᵀ − q dᵀ

for a loss with the derivatives v in d and w in μ; second derivatives are those of this formula. Where a row is met
with μ = 0 the direction has a kink, and where rows of A depend μ is not unique. What comes then is the derivative with
A the rows that push, μ > 0, and K⁺ for K⁻¹, and `is_differentiable` is False.
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
        d, multipliers = answer.value.detach(), torch.as_tensor(answer.multipliers, device=g.device)
        mu = multipliers.to(g.dtype)  # where g is far smaller than a row, 0
        unit_rows, lengths = _normalize(J)
        unit = max(float(_normalize(each[None])[1]) for each in (g, d))
        zero = max(_ZERO, 8 * torch.finfo(g.dtype).eps) * unit
        pushes = multipliers * lengths > zero
        is_met = (unit_rows @ d.double() - b.double() / lengths).abs() <= zero
        rows = unit_rows[pushes]
        least = torch.linalg.eigvalsh(rows @ rows.T)[:1]
        tells = not bool((is_met & ~pushes & (J != 0).any(dim=1)).any()) and not bool((least < _DEPENDENT).any())
        ctx.save_for_backward(J, d, mu, pushes)
        ctx.set_materialize_grads(True)
        flag = torch.tensor(tells)
        ctx.mark_non_differentiable(flag)
        return d, mu, flag

    @staticmethod
    def backward(ctx: Any, v: Any, w: Any, _: Any) -> Any:
        J, d, mu, pushes = ctx.saved_tensors
        unit, lengths = _normalize(J[pushes])
        asked = unit @ v.double() + w[pushes].double() / lengths
        q_unit = torch.linalg.pinv(unit @ unit.T, hermitian=True, rtol=_DEPENDENT) @ asked
        p = v.double() - unit.T @ q_unit
        q = torch.zeros_like(mu, dtype=torch.float64)
        q[pushes] = q_unit / lengths
        on_rows = torch.zeros_like(J)
        on_rows[pushes] = (torch.outer(mu[pushes].double(), p) - torch.outer(q[pushes], d.double())).to(J.dtype)
        return p.to(d.dtype), on_rows, q.to(mu.dtype), None


def _normalize(rows: Any) -> tuple[Any, Any]:
    """Unit rows and lengths > 0 in float64; of rows of 1e±200 too, whose squares are no numbers."""
    given = rows.double()
    largest = given.detach().abs().amax(dim=1, keepdim=True) if rows.shape[1] else given.new_zeros(len(rows), 1)
    largest = torch.where(largest > 0.0, largest, torch.ones_like(largest))
    scaled = given / largest
    lengths = torch.linalg.vector_norm(scaled, dim=1, keepdim=True)
    lengths = torch.where(lengths > 0.0, lengths, torch.ones_like(lengths))
    return scaled / lengths, (lengths * largest)[:, 0]
