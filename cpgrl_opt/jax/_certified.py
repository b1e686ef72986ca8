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
from ._rows import Leaves, Rows, Vector, read_channels, rescale

# Of ‖Ĵᵀy‖, in eps Σy: rounding of unit rows, and of those that sum to zero but for their own rounding. With 4 the rows
# of the three-state MDP do not contradict each other, with 1e4 rows 1e-12 rad from opposing do, which can be met.
_ROUNDING = 64
_LEAST = 1e-9  # b̂ᵀy in units of Σ|b̂ᵢyᵢ|: a contradiction of less is none, as in `solvers.infeasibility`
_MOST_STEPS = 30  # of the search for the least violation: a few where rows are well apart
_ALLOWED = 1e-5  # most that rounding of μ is allowed of stationarity, see `certify`


class Answer(NamedTuple):
    """d in the leaves' dtypes, (m,) μ ≥ 0 or a Farkas vector, (m,) J d, (4,) residuals and the status, as floats.

    J d is of d before it was rounded to these dtypes. What leaves a float is infinite with its sign, but not in d.
    """

    d: Leaves
    multipliers: Any
    gain: Any
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
    """b̂ in units of 2^unit, in which ĝ is `part` of itself; b̂ in those of the bounds alone, 2^own_unit.

    soft: of rows that may give way, else 0.
    """

    rows: Rows
    part: Any
    asked: Any
    unit: Any
    named: Any
    own_unit: Any
    soft: Any
    tolerance: Any

    @property
    def eps(self) -> float:
        return float(jnp.finfo(self.asked.dtype).eps)


class _Search(NamedTuple):
    """What the next stage projects, part · ĝ or d, and what is known so far: d in units of 2^unit."""

    stage: Any
    part: Any
    goes_on: Any
    bound: Any
    soft: Any
    count: Any
    d: Vector
    unit: Any
    multipliers: Any
    residuals: Any
    is_proven: Any
    violation: Any
    is_least: Any


def solve(
    leaves: Sequence[Any], bound: Any, *, signs: tuple[float, float], tolerance: float, gives_met: bool
) -> Answer:
    """min ½‖d − g‖² s.t. Jd ≥ b; each leaf is (1 + m, …), g first; b (m,), −∞ where a row is off.

    signs: of g and of the rows of J, as they count. gives_met: whether rows with b ≤ 0 give way as well, where nothing
    meets all.
    """
    problem, is_finite = _read(leaves, bound, signs, tolerance, gives_met)
    rows, no_row = problem.rows, jnp.zeros_like(problem.asked)
    zero, never = jnp.zeros((), no_row.dtype), jnp.asarray(False)
    hopeless, nothing = jnp.full(4, jnp.inf, no_row.dtype), Vector(rows.zero(), no_row, zero)
    first = problem.part, never, problem.asked, no_row, 0, nothing, problem.unit
    start = _Search(0, *first, no_row, hopeless, never, no_row, never)
    end = lax.while_loop(lambda s: s.stage < Stage.END, lambda s: _advance(problem, s), start)

    is_right = ~end.is_proven & (end.residuals.max() <= problem.tolerance)
    status = jnp.where(is_right, Status.OPTIMAL, Status.UNCERTIFIED)
    status = jnp.where(end.is_proven & end.is_least, Status.INFEASIBLE, status)
    d = [part.astype(leaf.dtype) for part, leaf in zip(rescale(end.d.leaves, end.unit), leaves, strict=True)]
    mu = rows.original(end.multipliers, jnp.where(end.is_proven, 0, problem.unit))
    is_finite &= ~jnp.isnan(mu).any() & jnp.stack([jnp.isfinite(leaf).all() for leaf in d]).all()
    status = jnp.where(is_finite, status, Status.NUMERICAL_ERROR)
    is_answer = status <= Status.INFEASIBLE
    residuals = jnp.where(is_finite & ~end.is_proven, end.residuals, jnp.inf)
    d = [jnp.where(is_answer, leaf, 0) for leaf in d]
    gain = jnp.where(is_answer, rows.lengthen(end.d.along, end.unit), 0.0)
    return Answer(d, jnp.where(is_answer, mu, 0.0), gain, residuals, status.astype(mu.dtype))


def _read(
    leaves: Sequence[Any], bound: Any, signs: tuple[float, float], tolerance: float, gives_met: bool
) -> tuple[_Problem, Any]:
    """The problem in units in which its numbers are about 1, and whether all are finite."""
    rows, is_finite = read_channels(leaves, signs)
    is_finite &= (bound < jnp.inf).all() & ~jnp.isnan(bound).any()
    own = rows.per_length(jnp.where(is_finite & rows.moves, bound, -jnp.inf), 0)
    asks = (own > 0.0).any()
    own_unit = jnp.frexp(jnp.where(own > 0.0, own, 0.0).max(initial=0.0))[1]
    unit = jnp.where(asks, jnp.maximum(rows.exponent, own_unit), rows.exponent)
    asked, named = jnp.ldexp(own, -unit), jnp.ldexp(own, -own_unit)
    part = jnp.ldexp(jnp.ones((), own.dtype), rows.exponent - unit)
    eps = float(jnp.finfo(own.dtype).eps)
    gives = (named > -jnp.inf) & (gives_met | (named > 0.0))
    # A weight w leaves w/(w + σ²) of an error along rows with the singular value σ, and eps/w in d.
    soft = jnp.where(gives, eps**0.2, 0.0)
    return _Problem(rows, part, asked, unit, named, own_unit, soft, tolerance_in(own.dtype, tolerance)), is_finite


def tolerance_in(dtype: Any, tolerance: float) -> float:
    """What residuals are held to: a solver's tolerance, or what the float can tell."""
    return max(tolerance, _ROUNDING * float(jnp.finfo(dtype).eps))


def _advance(problem: _Problem, before: _Search) -> _Search:
    """One stage; each takes from `found` what is its own."""
    stage = before.stage
    found = project(problem.rows, before.part, before.goes_on, before.d, before.bound, before.soft)
    is_first, is_probe, is_nearest = stage == Stage.FIRST, stage == Stage.PROBE, stage == Stage.NEAREST
    residuals, is_doubted = _judge(problem, found)
    is_open = is_doubted | ~(residuals.max() <= problem.tolerance)
    y, is_proof = lax.cond(is_probe, lambda: _read_proof(problem, found), lambda: (found.slack, jnp.asarray(False)))

    gives, size = problem.soft > 0.0, found.at.length
    violation = jnp.where(gives & (stage == Stage.APPROACH), before.soft * found.pivots.multipliers, 0.0)
    stays = jnp.abs(violation - before.violation).max(initial=0.0) <= 8 * problem.eps / problem.eps**0.2
    goes_on = ~stays & (before.count < _MOST_STEPS)
    # Rounding would else be all that rows which oppose each other ask for.
    given = problem.named - violation - _ROUNDING * problem.eps * (1.0 + size)
    given = jnp.ldexp(jnp.where(gives, given, problem.named), problem.own_unit - problem.unit)
    is_near = -jnp.where(before.bound > -jnp.inf, found.slack, 0.0).min(initial=0.0) <= problem.eps**0.75 * size

    end, probe, approach = int(Stage.END), int(Stage.PROBE), int(Stage.APPROACH)
    after_first = jnp.where(is_open & (problem.asked > 0.0).any(), probe, end)
    after_approach = jnp.where(goes_on, approach, int(Stage.NEAREST))
    nexts = jnp.stack([after_first, jnp.where(is_proof, approach, end), after_approach, jnp.asarray(end)])
    is_approach, is_last = stage == Stage.APPROACH, (stage == Stage.APPROACH) & ~goes_on
    is_kept = is_probe | (is_nearest & ~is_near)
    d = Vector(
        [jnp.where(is_kept, old, new) for old, new in zip(before.d.leaves, found.at.leaves, strict=True)],
        jnp.where(is_kept, before.d.along, found.at.along),
        jnp.where(is_kept, before.d.length, size),
    )
    return _Search(
        nexts[stage],
        jnp.where(is_last, problem.part, 0.0),
        is_approach & goes_on,
        jnp.where(is_last, given, problem.named),
        jnp.where(is_probe | (is_approach & goes_on), problem.soft, 0.0),
        before.count + 1,
        d,
        jnp.where(is_approach, problem.own_unit, jnp.where(is_kept, before.unit, problem.unit)),
        jnp.where(is_first, found.pivots.multipliers, jnp.where(is_probe, y, before.multipliers)),
        jnp.where(is_first, residuals, before.residuals),
        before.is_proven | (is_probe & is_proof),
        violation,
        before.is_least | (is_approach & stays),
    )


def _judge(problem: _Problem, found: Projection) -> tuple[Any, Any]:
    """The four residuals, and whether a row is missed by more than a part of the least that any asks for."""
    mu, asked = found.pivots.multipliers, problem.asked
    size = jnp.maximum(problem.part * problem.rows.length, found.at.length)
    unit = jnp.where(size > 0.0, size, 1.0)

    def measure() -> Any:
        return problem.rows.look(problem.rows.combine(-problem.part, -mu, found.at.leaves)).length

    rest = lax.cond(found.rounds > 1, measure, lambda: jnp.zeros_like(size))  # one round makes it of just these sums
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
    error = rows.look(rows.combine(0.0, y)).along
    y = jnp.maximum(y - jnp.where(active, table @ jnp.where(active, error, 0.0), 0.0), 0.0)
    gains = jnp.where(y > 0.0, problem.named, 0.0) * y
    is_null = rows.look(rows.combine(0.0, y)).length <= _ROUNDING * problem.eps * y.sum()
    return y, is_null & (gains.sum() > max(_LEAST, problem.tolerance) * jnp.abs(gains).sum())
