"""B direction problems of one shape as tensors on one device, in batched operations there.

    K = V Vᵀ ──host──▶ (1, μ) ──▶ d = Vᵀ(1, μ), Jd, ‖d‖ ──host──▶ residuals        V = [g; J], each of B

K and the sums of the certificate are of float64, whatever the tensors are: O(B m²) numbers leave the device. The
compiled search for the active set is that of one long problem. What it leaves open, rows that nearly depend or
contradict each other, is solved as NumPy's batch, or where vectors are long one problem after another on the device.
So is all on the CPU, where PyTorch's operations take 3 to 15 times as long as the compiled pass over the rows.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from .._gate import check_bounds
from ..direction import Direction, DirectionBatch, Status
from ..problem import DirectionProblem, ProblemBatch
from ..reduction import EXACT
from ..solvers import find_solver, solve, tolerance_of
from ..solvers import solve_batch as solve_arrays
from ..solvers.span import weigh_problems
from ..vectors import is_long
from ..vectors._torch import detach, is_apart, is_float
from .tracing import run_uncompiled

# Of the vectors, in float64, at a time: 256 MB beside the tensors.
_NUMBERS = 1 << 25


@run_uncompiled
def solve_batch(
    gradient: Any, jacobian: Any, bound: Any = 0.0, equality: Any = False, *, solver: Any = "active-set"
) -> DirectionBatch:
    """d = argmin ½‖d − g‖² s.t. Jᵢd ≥ bᵢ, or = bᵢ where `equality` says so, of B problems; ascent gradients.

    Parameters
    ----------
    gradient, jacobian : tensors (B, n) and (B, m, n) of one dtype, float64, float32 or bfloat16, and one device.
    bound, equality : (B, m), tensors or arrays, or one number and one truth value for all.
    solver : one of `SOLVERS`, or its name. "active-set" alone has the batched way; the others solve NumPy's batch.

    Returns
    -------
    DirectionBatch : `value` is a tensor as gradient is, without a graph; multipliers, statuses and residuals are
        arrays, of d before it is rounded to its dtype. Statuses are those of `cpgrl_opt.solve_batch` of the same
        numbers in float64; NUMERICAL_ERROR where d leaves the dtype.

    Raises
    ------
    ValueError
        For what does not fit, and for NaN and infinities.
    """
    g, J = _read(gradient, jacobian)
    b, E = check_bounds(_as_array(bound), _as_array(equality), tuple(J.shape[:2]))
    solver = find_solver(solver)
    if is_apart(g) and getattr(solver, "tangent", None) is False:  # of the exact core for all constraints
        return _solve_where_they_lie(solver, g, J, b, E)
    return _solve_ordinarily(solver, g, J, b, E)


def _solve_where_they_lie(solver: Any, g: Any, J: Any, b: np.ndarray, E: np.ndarray) -> DirectionBatch:
    """By Gramians; what these leave open by the ordinary way."""
    found = weigh_problems(_find_gramians(g, J), b, E)
    weights = np.where(found.changes[:, None] < 0, 0.0, found.weights)
    value, sums = _combine(g, J, weights)
    residuals, multipliers, status, iterations = found.judge(sums), weights[:, 1:], 0 * found.changes, found.changes
    is_right = (iterations >= 0) & (residuals.max(axis=1) <= min(tolerance_of(solver), EXACT))
    left = np.flatnonzero(~is_right | _are_lost(value))
    rung = np.full(len(g), "gramian")
    if left.size:
        where = torch.from_numpy(left).to(g.device)
        others = _solve_ordinarily(solver, g[where], J[where], b[left], E[left])
        value[where] = others.value
        multipliers[left], status[left], iterations[left] = others.multipliers, others.status, others.iterations
        residuals[left] = np.nan if others.residuals is None else others.residuals
        rung[left] = "" if others.rung is None else others.rung
    return DirectionBatch(value, multipliers, status, iterations, None, residuals, rung)


def _solve_ordinarily(solver: Any, g: Any, J: Any, b: np.ndarray, E: np.ndarray) -> DirectionBatch:
    """As NumPy's batch, or where vectors are long one problem after the other."""
    if is_long(*J.shape[1:]) and len(g):
        answers = [solve(DirectionProblem(*given), solver) for given in zip(g, J, b, E, strict=True)]
        rows = DirectionBatch.stack([replace(each, value=np.zeros(0)) for each in answers])
        return replace(rows, value=torch.stack([each.value for each in answers]))
    found = solve_arrays(solver, ProblemBatch(g.double().cpu().numpy(), J.double().cpu().numpy(), b, E))
    value = torch.from_numpy(found.value).to(g)
    if (lost := _are_lost(value)).any():
        value[torch.from_numpy(lost).to(g.device)] = 0.0
        nothing = Direction.nothing(J.shape[2], J.shape[1], Status.NUMERICAL_ERROR)
        found = found.replace_where(lost, DirectionBatch.stack([nothing] * int(lost.sum())))
    return replace(found, value=value)


def _are_lost(value: Any) -> np.ndarray:
    """Which directions leave the dtype."""
    return np.asarray(~torch.isfinite(value).all(dim=1).cpu().numpy())


def _find_gramians(g: Any, J: Any) -> np.ndarray:
    """(B, 1 + m, 1 + m); ValueError for NaN and infinities."""
    found = _join([(V @ V.mT).cpu() for _, V in _channels(g, J)], (0, 1 + J.shape[1], 1 + J.shape[1]))
    if not np.isfinite(found).all():  # a square may leave float64
        for name, each in (("gradient", g), ("jacobian", J)):
            if not bool(torch.isfinite(each).all()):
                raise ValueError(f"{name} should be finite; found NaN or infinity")
    return found


def _read(gradient: Any, jacobian: Any) -> tuple[Any, Any]:
    """Without their graphs; ValueError for what does not fit."""
    for name, each, axes in (("gradient", gradient, 2), ("jacobian", jacobian, 3)):
        if not isinstance(each, torch.Tensor) or not is_float(each) or each.ndim != axes:
            found = f"{each.dtype} of shape {tuple(each.shape)}" if isinstance(each, torch.Tensor) else repr(each)
            raise ValueError(f"{name} should be a tensor of {axes} axes, float64, float32 or bfloat16; found {found}")
    g, J = detach(gradient), detach(jacobian)
    if J.dtype != g.dtype or J.device != g.device:
        raise ValueError(f"jacobian should be {g.dtype} on {g.device} as gradient is; found {J.dtype} on {J.device}")
    if J.shape != (len(g), J.shape[1], g.shape[1]):
        raise ValueError(f"jacobian should be (B, m, n), gradient being {tuple(g.shape)}; found {tuple(J.shape)}")
    if g.shape[1] == 0:
        raise ValueError("gradient should have at least one component; found none")
    return g, J


def _channels(g: Any, J: Any) -> Iterator[tuple[slice, Any]]:
    """V of some problems at a time, in float64."""
    count = max(1, _NUMBERS // ((1 + J.shape[1]) * g.shape[1]))
    for start in range(0, len(g), count):
        part = slice(start, start + count)
        yield part, torch.cat([g[part, None], J[part]], dim=1).double()


def _combine(g: Any, J: Any, weights: np.ndarray) -> tuple[Any, np.ndarray]:
    """d in g's dtype, and [r·r, J d …, d·d] of what it was before it was rounded to that; r = d − g − Jᵀμ."""
    value, sums, w = torch.empty_like(g), [], torch.from_numpy(weights).to(g.device)
    for part, V in _channels(g, J):
        d = (w[part, None] @ V)[:, 0]
        rest = torch.baddbmm(d[:, None] - V[:, :1], w[part, None, 1:], V[:, 1:], alpha=-1.0)[:, 0]
        squares = torch.stack([rest.square().sum(dim=1), d.square().sum(dim=1)], dim=1)
        sums.append(torch.cat([squares[:, :1], (V[:, 1:] @ d[:, :, None])[..., 0], squares[:, 1:]], dim=1).cpu())
        value[part] = d
    return value, _join(sums, (0, 2 + J.shape[1]))


def _as_array(given: Any) -> Any:
    if not isinstance(given, torch.Tensor):
        return given
    given = given.detach()
    return (given.double() if given.is_floating_point() else given).cpu().numpy()


def _join(parts: list[Any], empty: tuple[int, ...]) -> np.ndarray:
    return np.asarray(torch.cat(parts).numpy()) if parts else np.empty(empty)
