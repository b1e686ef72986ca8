"""The comparison's families: those of `problems` at settings of their own, each with the reason for which it is there.

`FAMILIES[name].problem(number, seed)` is one of its problems; what was measured on them stays valid only while these
are, bit for bit, the same.
"""

import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from ..problem import DirectionProblem
from ..problems import RandomSource, Source, dependent, geometry, infeasible, regular, scales
from ..problems.assembly import vary
from ..problems.case import Case
from .recording import shipped_problem

Draw = Callable[[np.random.Generator], DirectionProblem]

ANGLES = tuple(10.0**-k for k in (2, 4, 6, 8, 10, 12))  # rad
_WELL_POSED_ANGLE = 1e-7  # rad; below it float64 does not determine the direction to eight digits
_SUFFIXES = {Case.CONE: "", Case.BOUNDS: "-bounds", Case.TANGENT: "-equality", Case.AFFINE: "-equality-bounds"}


@dataclass(frozen=True)
class ProblemFamily:
    """A source of problems. draw(rng): one problem, a function of the generator alone.

    feasible: whether all its problems are; well_posed: whether float64 determines the direction, so that the distance
    from the exact one means something; is_large: n > 100, where fewer problems are drawn and back ends are not tried
    raw; feasibility: of one problem, where some are and some not.
    """

    name: str
    reason: str
    draw: Draw
    feasible: bool
    well_posed: bool
    is_large: bool = False
    feasibility: Callable[[DirectionProblem], bool] | None = None

    def is_feasible(self, problem: DirectionProblem) -> bool:
        """Whether this problem of the family is."""
        return self.feasible if self.feasibility is None else self.feasibility(problem)

    def problem(self, number: int, seed: int) -> DirectionProblem:
        """Problem `number` of the family: bit for bit the same for a seed, whatever was drawn before."""
        name = self.name.encode(errors="surrogateescape")  # of a file, in whatever locale
        return self.draw(np.random.default_rng([seed, zlib.crc32(name), number]))


def _family(
    name: str, reason: str, make: Callable[..., DirectionProblem], case: Case = Case.CONE, *,
    feasible: bool = True, well_posed: bool | None = None, is_large: bool = False, **settings: Any,
) -> ProblemFamily:  # fmt: skip
    """A family of `problems` of one kind, at some settings; its name gets the kind's suffix."""

    def draw(rng: np.random.Generator) -> DirectionProblem:
        return make(RandomSource(rng), case, **settings)

    determined = feasible if well_posed is None else well_posed
    return ProblemFamily(name, reason, draw, feasible, determined, is_large)


def _kinds(name: str, reason: str, make: Any, *cases: Case, **settings: Any) -> Iterator[ProblemFamily]:
    """One family for each kind of constraints."""
    for case in cases:
        yield _family(f"{name}{_SUFFIXES[case]}", reason, make, case, **settings)


def _power(value: float) -> str:
    """10^k as in `1e-6`, `1e12`."""
    return f"1e{round(np.log10(value))}"


_CONE_AND_BOUNDS = (Case.CONE, Case.BOUNDS)
_WITH_TANGENT = (*_CONE_AND_BOUNDS, Case.TANGENT)


def _regular() -> Iterator[ProblemFamily]:
    usual = "Slater's condition holds and rows are independent: any correct solver must solve all of them"
    for case, what in (
        (Case.CONE, "cone"),
        (Case.BOUNDS, "bounds"),
        (Case.TANGENT, "the paper's tangent (eq. 9)"),
        (Case.AFFINE, "equalities with bounds"),
    ):
        yield from _kinds("well-conditioned", f"{usual}; {what}, 9 × 3", regular.ordinary, case)
    mixed = f"{usual}; equalities among inequalities, 9 × 5"
    yield _family("well-conditioned-mixed", mixed, regular.ordinary, Case.MIXED, m=5)
    for n, m, cases in ((80, 2, _CONE_AND_BOUNDS), (1000, 5, _CONE_AND_BOUNDS), (100_000, 10, (Case.CONE,))):
        reason = f"{usual}; how time grows with the number of parameters"
        name = f"well-conditioned-{n}x{m}"
        yield from _kinds(name, reason, regular.ordinary, *cases, n=n, m=m, is_large=n > 100)
    for case, reason in ((Case.CONE, "most active sets are dependent"), (Case.BOUNDS, "around an interior point")):
        separator = ":" if case == Case.CONE else ""
        told = f"8 rows in ℝ³{separator} {reason}"
        yield from _kinds("more-rows-than-parameters", told, regular.ordinary, case, n=3, m=8)


def _angles() -> Iterator[ProblemFamily]:
    parallel = "nearly parallel rows: one dominates in a cone, but a Gram matrix loses rank as θ²"
    opposing = "nearly opposing rows: a thin cone, multipliers of size 1/θ, cancellation in d = g + Jᵀμ"
    wedge = f"{opposing}; a wedge that holds a point with slack"
    tangent = "nearly parallel equalities: the tangent space loses θ, and pinv(JJᵀ) drops a row"
    listed = [(kind, angle, Case.CONE) for angle in ANGLES for kind in ("parallel", "opposing")]
    listed += [("opposing", angle, Case.BOUNDS) for angle in (1e-4, 1e-6, 1e-8)]
    listed += [("parallel", angle, Case.TANGENT) for angle in (1e-4, 1e-6, 1e-8)]
    reasons = {("parallel", Case.CONE): parallel, ("opposing", Case.CONE): opposing}
    reasons |= {("opposing", Case.BOUNDS): wedge, ("parallel", Case.TANGENT): tangent}
    for kind, angle, case in listed:
        yield _family(
            f"{kind}-{_power(angle)}{_SUFFIXES[case]}", reasons[kind, case], dependent.nearly_dependent, case,
            well_posed=angle > _WELL_POSED_ANGLE, angle=angle, opposing=kind == "opposing",
        )  # fmt: skip


def _dependent() -> Iterator[ProblemFamily]:
    twice = "the same row twice: multipliers are not unique, the direction is; Gram matrices are singular"
    zero = "Δ² + Δ³ + Δ⁴ = 0, as in the paper's three-state MDP where r² + r³ + r⁴ = 0: rank 2 of 3"
    for case in _WITH_TANGENT:
        yield from _kinds("duplicate", twice, dependent.duplicate, case)
        yield from _kinds("sum-to-zero", zero, dependent.sum_to_zero, case)
    reason = "a constraint without gradient (a policy that cannot influence it): 0ᵀd ≥ 0 asks for nothing"
    yield from _kinds("zero-rows", reason, dependent.zero_rows, Case.CONE, Case.TANGENT)
    reason = "integer rows through one vertex: many active sets fit, a careless method cycles"
    yield _family("degenerate-vertex", reason, regular.degenerate_vertex)
    reason = (
        "Σ yᵢJᵢ = 0 with y > 0 and rank n (Gordan): only d = 0 is feasible, and a relative error must not divide by it"
    )
    yield _family("cone-of-zero", reason, dependent.cone_of_zero)


def _scales() -> Iterator[ProblemFamily]:
    reason = "rows in different units: scaling a row with its bound leaves the feasible set and so d unchanged"
    for decades in (6, 12):
        yield from _kinds(f"row-scales-1e{decades}", reason, scales.row_scales, *_CONE_AND_BOUNDS, decades=decades)
    reason = "(cg, cJ, c²b) has the answer c·d: absolute tolerances call anything solved, or nothing"
    for scale in (1e-12, 1e-4, 1e12):
        name = f"gradients-{_power(scale)}"
        yield from _kinds(name, reason, scales.gradient_scale, *_CONE_AND_BOUNDS, scale=scale)


def _special() -> Iterator[ProblemFamily]:
    bounds = partial(_family, case=Case.BOUNDS)
    yield bounds("feasible-gradient", "g is feasible, so d = g: idempotence of a projection", regular.feasible_gradient)
    yield bounds("switched-off", "b = −∞ switches a row off; some libraries compute with it", regular.switched_off)
    yield bounds("far-bounds", "bounds that never bind must not set the scale of a tolerance", regular.far_bounds)


def _recorded() -> Iterator[ProblemFamily]:
    case = partial(ProblemFamily, feasible=True, well_posed=True)
    for name, experiment in (("three-state", "the three-state MDP"), ("arm", "the two-link arm")):
        for suffix, equality, what in (("", True, "as met"), ("-cone", False, "with inequalities for equalities")):
            make = partial(shipped_problem, name=name, equality=equality)
            reason = f"met while CPGRL was trained on {experiment}, {what}: what a solver is for"
            yield case(f"recorded-{name}{suffix}", reason, make)


def _infeasible() -> Iterator[ProblemFamily]:
    case = partial(_family, make=infeasible.infeasible, case=Case.BOUNDS, feasible=False)
    farkas = "Farkas: y ≥ 0, Jᵀy = 0, bᵀy > 0, so that no d has Jd ≥ b"
    yield case("infeasible", f"{farkas}; two opposing rows", support=2, gap=0.3)
    yield case("infeasible-four-rows", f"{farkas}; four rows that sum to zero", support=4, gap=0.3)
    reason = "Fredholm: Jᵀy = 0 and bᵀy ≠ 0, so that no d has Jd = b"
    which = (True, True, True, False)
    yield case("infeasible-equality", reason, case=Case.MIXED, support=3, gap=0.3, equality=which)
    yield case("infeasible-zero-row", "0ᵀd ≥ b > 0", make=infeasible.zero_row_asks)
    weakly = f"{farkas}; each row asks only a little too much, within a loose tolerance"
    for gap in (1e-4, 1e-6, 1e-8):
        yield case(f"weakly-infeasible-{_power(gap)}", weakly, support=2, gap=gap)


def _geometries() -> Iterator[ProblemFamily]:
    metric = "min ½dᵀMd − gᵀd: M⁻¹ is easily forgotten, or put twice"
    bounds = partial(_family, case=Case.BOUNDS)
    for name, settings, what in (
        ("diagonal", {"is_full": False}, "weights from 1e-2 to 1e2, 9 × 3"),
        ("full", {"is_full": True}, "condition 1e2, 9 × 3"),
        ("1e10", {"is_full": True, "decades": 10}, "condition 1e10, where whitening loses digits"),
    ):
        yield bounds(f"metric-{name}", f"{metric}; {what}", _in_metric, **settings)
    ball = "max gᵀd, dᵀMd ≤ radius², constrained policy optimization"
    yield _family("ball", f"{ball}; a cone, whose projection only needs a length", _ball_around_0)
    yield bounds("ball-bounds", f"{ball}; bounds, 1.5 times as far as the shortest direction", _ball)
    yield bounds("ball-metric-bounds", f"{ball}; bounds, in a full metric", _ball, is_full=True)
    reason = "the ball ends half way to the constraints: the least violation in it, with a proof"
    yield bounds("ball-out-of-reach", reason, _ball, feasible=False, is_full=False, factor=0.5)
    reason = "rows contradict each other in a ball of 1e12, a word for none: as infeasible as without it"
    yield bounds(
        "ball-1e12-infeasible", reason, geometry.infeasible_in_huge_ball, feasible=False, support=4, gap=0.3
    )  # fmt: skip


def _in_metric(source: Source, case: Case, *, is_full: bool, decades: int = 2) -> DirectionProblem:
    problem = regular.ordinary(source, case)
    return vary(problem, metric=source.metric(problem.n, is_full=is_full, decades=decades))


def _ball_around_0(source: Source, case: Case) -> DirectionProblem:
    return vary(regular.ordinary(source, case), radius=float(10.0 ** source.uniform(-3, 3)))


def _ball(source: Source, case: Case, *, is_full: bool | None = None, factor: float = 1.5) -> DirectionProblem:
    """A ball of `factor` times what the shortest direction needs, where it needs something."""
    shortest: float | None = None
    while not shortest:
        problem = regular.ordinary(source, case)
        if is_full is not None:
            problem = vary(problem, metric=source.metric(problem.n, is_full=is_full))
        shortest = source.shortest(problem)
    return vary(problem, radius=factor * shortest)


FAMILIES: Mapping[str, ProblemFamily] = MappingProxyType(
    {
        family.name: family
        for group in (_regular, _angles, _dependent, _scales, _special, _recorded, _infeasible, _geometries)
        for family in group()
    }
)
