"""Directions on the device with their certificate: residuals and a status, from products with the vectors themselves.

    OPTIMAL          the four residuals of `certify` are within the tolerance, and no rows contradict each other
    INFEASIBLE       y ≥ 0 with Ĵᵀy = 0 to rounding and b̂ᵀy > 0; d then violates least
    UNCERTIFIED      neither could be shown in this float; d = 0
    NUMERICAL_ERROR  a number was NaN or infinite, or d leaves its float; d = 0

One loop runs all stages, so that the projection is compiled once. Most problems need the first stage only; under
`vmap` a batch takes as long as its slowest problem.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from ..direction import Status
from ._projection import Projection, project
from ._rows import Leaves, Rows, add, choose, length, read_channels, rescale

# Of ‖Ĵᵀy‖, in eps Σy: rounding of unit rows, and of those that sum to zero but for their own rounding. With 4 the rows
# of the three-state MDP do not contradict each other, with 1e4 rows 1e-12 rad from opposing do, which can be met.
_ROUNDING = 64
_LEAST = 1e-9  # b̂ᵀy in units of Σ|b̂ᵢyᵢ|: a contradiction of less is none, as in `solvers.infeasibility`
_MOST_STEPS = 30  # of the search for the least violation: a few where rows are well apart
_ALLOWED = 1e-5  # most that rounding of μ is allowed of stationarity, see `certify`


class Answer(NamedTuple):
    """d in the leaves' dtypes, (m,) μ ≥ 0 or a Farkas vector, (4,) residuals and the status, both as floats."""

    d: Leaves
    multipliers: Any
    residuals: Any
    status: Any


class Stage(IntEnum):
    """What is projected: g; 0, which tells whether rows contradict each other; nearer to the least violation; g again.

    v = argmin ½‖v‖² s.t. Ĵ_V d + v ≥ b̂_V, Ĵ_S d ≥ b̂_S for some d, by proximal steps on d; then d with b̂ − v for b̂.
    Source: Rockafellar 1976, Monotone operators and the proximal point algorithm.
    """

    FIRST = 0
    PROBE = 1
    APPROACH = 2
    NEAREST = 3
    END = 4


class _Problem(NamedTuple):
    """g and b̂ in units of 2^unit; b̂ in those of the bounds alone, 2^own_unit; and which rows may give way."""

    rows: Rows
    g: Leaves
    asked: Any
    unit: Any
    named: Any
    own_unit: Any
    soft: Any
    tolerance: Any

    @property
    def eps(self) -> float:
        return float(jnp.finfo(self.asked.dtype).eps)

    @property
    def shift(self) -> Any:
        return self.own_unit - self.unit


class _Search(NamedTuple):
    """What the next stage projects, and what is known so far."""

    stage: Any
    base: Leaves
    bound: Any
    soft: Any
    count: Any
    d: Leaves
    multipliers: Any
    residuals: Any
    is_proven: Any
    violation: Any
    is_least: Any


def solve(leaves: Sequence[Any], bound: Any, *, tolerance: float, gives_met: bool) -> Answer:
    """min ½‖d − g‖² s.t. Jd ≥ b; each leaf is (1 + m, k), g first; b (m,), −∞ where a row is off.

    gives_met: whether rows with b ≤ 0 give way as well, where nothing meets all.
    """
    problem, is_finite = _read(leaves, bound, tolerance, gives_met)
    rows, g, no_row = problem.rows, problem.g, jnp.zeros_like(problem.asked)
    hopeless, never = jnp.full(4, jnp.inf, no_row.dtype), jnp.asarray(False)
    start = _Search(0, g, problem.asked, no_row, 0, g, no_row, hopeless, never, no_row, never)
    end = lax.while_loop(lambda s: s.stage < Stage.END, lambda s: _advance(problem, s), start)

    is_right = ~end.is_proven & (end.residuals.max() <= problem.tolerance)
    status = jnp.where(is_right, Status.OPTIMAL, Status.UNCERTIFIED)
    status = jnp.where(end.is_proven & end.is_least, Status.INFEASIBLE, status)
    d = [part.astype(leaf.dtype) for part, leaf in zip(rescale(end.d, problem.unit), leaves, strict=True)]
    mu = rows.original(end.multipliers, jnp.where(end.is_proven, 0, problem.unit))
    is_finite &= jnp.isfinite(mu).all() & jnp.stack([jnp.isfinite(leaf).all() for leaf in d]).all()
    status = jnp.where(is_finite, status, Status.NUMERICAL_ERROR)
    is_answer = status <= Status.INFEASIBLE
    residuals = jnp.where(is_finite & ~end.is_proven, end.residuals, jnp.inf)
    d = [jnp.where(is_answer, leaf, 0) for leaf in d]
    return Answer(d, jnp.where(is_answer, mu, 0.0), residuals, status.astype(mu.dtype))


def _read(leaves: Sequence[Any], bound: Any, tolerance: float, gives_met: bool) -> tuple[_Problem, Any]:
    """The problem in units in which its numbers are about 1, and whether all are finite."""
    g, exponent, rows, is_finite = read_channels(leaves)
    is_finite &= (bound < jnp.inf).all() & ~jnp.isnan(bound).any()
    own = rows.per_length(jnp.where(is_finite & rows.moves, bound, -jnp.inf), 0)
    asks = (own > 0.0).any()
    own_unit = jnp.frexp(jnp.where(own > 0.0, own, 0.0).max(initial=0.0))[1]
    unit = jnp.where(asks, jnp.maximum(exponent, own_unit), exponent)
    g, asked, named = rescale(g, exponent - unit), jnp.ldexp(own, -unit), jnp.ldexp(own, -own_unit)
    eps = float(jnp.finfo(own.dtype).eps)
    gives = (named > -jnp.inf) & (gives_met | (named > 0.0))
    # A weight w leaves w/(w + σ²) of an error along rows with the singular value σ, and eps/w in d.
    soft = jnp.where(gives, eps**0.2, 0.0)
    return _Problem(rows, g, asked, unit, named, own_unit, soft, max(tolerance, _ROUNDING * eps)), is_finite


def _advance(problem: _Problem, before: _Search) -> _Search:
    """One stage; each takes from `found` what is its own."""
    rows, stage = problem.rows, before.stage
    found = project(rows, before.base, before.bound, before.soft)
    is_first, is_probe, is_nearest = stage == Stage.FIRST, stage == Stage.PROBE, stage == Stage.NEAREST
    residuals, is_doubted = _judge(problem, found)
    is_open = is_doubted | ~(residuals.max() <= problem.tolerance)
    y, is_proof = lax.cond(is_probe, lambda: _read_proof(problem, found), lambda: (found.slack, jnp.asarray(False)))

    gives = problem.soft > 0.0
    violation = jnp.where(gives & (stage == Stage.APPROACH), before.soft * found.pivots.multipliers, 0.0)
    stays = jnp.abs(violation - before.violation).max(initial=0.0) <= 8 * problem.eps / problem.eps**0.2
    goes_on = ~stays & (before.count < _MOST_STEPS)
    # Rounding would else be all that rows which oppose each other ask for.
    given = problem.named - violation - _ROUNDING * problem.eps * (1.0 + found.length)
    given = jnp.ldexp(jnp.where(gives, given, problem.named), problem.shift)
    is_near = -jnp.where(before.bound > -jnp.inf, found.slack, 0.0).min(initial=0.0) <= problem.eps**0.75 * found.length

    end, probe, approach = int(Stage.END), int(Stage.PROBE), int(Stage.APPROACH)
    after_first = jnp.where(is_open & (problem.asked > 0.0).any(), probe, end)
    after_approach = jnp.where(goes_on, approach, int(Stage.NEAREST))
    nexts = jnp.stack([after_first, jnp.where(is_proof, approach, end), after_approach, jnp.asarray(end)])
    is_soft, is_approach = is_probe | goes_on, stage == Stage.APPROACH
    least = choose(is_approach, rescale(found.d, problem.shift), before.d)
    base = [jnp.where(is_probe, 0.0, jnp.where(goes_on, a, b)) for a, b in zip(found.d, problem.g, strict=True)]
    return _Search(
        nexts[stage],
        [jnp.where(is_first, 0.0, leaf) for leaf in base],
        jnp.where(is_first | is_soft, problem.named, given),
        jnp.where(is_soft & ~is_first, problem.soft, 0.0),
        before.count + 1,
        choose(is_first | (is_nearest & is_near), found.d, least),
        jnp.where(is_first, found.pivots.multipliers, jnp.where(is_probe, y, before.multipliers)),
        jnp.where(is_first, residuals, before.residuals),
        before.is_proven | (is_probe & is_proof),
        violation,
        before.is_least | (is_approach & stays),
    )


def _judge(problem: _Problem, found: Projection) -> tuple[Any, Any]:
    """The four residuals, and whether a row is missed by more than a part of the least that any asks for."""
    mu, asked = found.pivots.multipliers, problem.asked
    size = jnp.maximum(length(problem.g), found.length)
    unit = jnp.where(size > 0.0, size, 1.0)
    rest = length(add(found.d, [-leaf for leaf in add(problem.g, problem.rows.combine(mu))]))
    slack = jnp.where(asked > -jnp.inf, found.slack, jnp.inf)
    lack = -slack.min(initial=0.0)
    stationarity = rest - jnp.minimum(8 * problem.eps * jnp.abs(mu).sum(), _ALLOWED * unit)
    least = jnp.abs(jnp.minimum(mu, slack)).max(initial=0.0)
    residuals = jnp.stack([stationarity, lack, -mu.min(initial=0.0), least]) / unit
    asks = jnp.where(asked > 0.0, asked, jnp.inf).min(initial=jnp.inf)
    residuals = jnp.where(jnp.isnan(residuals), jnp.inf, jnp.maximum(residuals, 0.0))
    return residuals, lack > problem.tolerance * asks


def _read_proof(problem: _Problem, probe: Projection) -> tuple[Any, Any]:
    """y, after one step of refinement, and whether it proves that nothing meets the bounds."""
    rows, (_, active, table, y) = problem.rows, probe.pivots
    error = rows.products(rows.combine(y))
    y = jnp.maximum(y - jnp.where(active, table @ jnp.where(active, error, 0.0), 0.0), 0.0)
    gains = jnp.where(y > 0.0, problem.named, 0.0) * y
    is_null = length(rows.combine(y)) <= _ROUNDING * problem.eps * y.sum()
    return y, is_null & (gains.sum() > max(_LEAST, problem.tolerance) * jnp.abs(gains).sum())
