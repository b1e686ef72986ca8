"""Named, seeded families of direction problems, each with the theorem or the reason for which it is there.

`generators` makes the problems; here they get their names. `FAMILIES[name].problem(number, seed)` is one of them.
"""

import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from types import MappingProxyType

import numpy as np

from ..problem import DirectionProblem
from . import generators as draw
from . import geometries as measured
from .recording import shipped_problem

Draw = Callable[[np.random.Generator], DirectionProblem]

ANGLES = tuple(10.0**-k for k in (2, 4, 6, 8, 10, 12))  # rad
_WELL_POSED_ANGLE = 1e-7  # rad; below it float64 does not determine the direction to eight digits


@dataclass(frozen=True)
class ProblemFamily:
    """A source of problems. draw(rng): one problem, a function of the generator alone.

    feasible: whether all its problems are; equality: whether constraints are equalities; well_posed: whether float64
    determines the direction, so that the distance from the exact one means something; is_large: n > 100, where
    fewer problems are drawn and back ends are not tried raw; feasibility: of one problem, where some are and some not.
    """

    name: str
    reason: str
    draw: Draw
    feasible: bool
    equality: bool
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


def _power(value: float) -> str:
    """10^k as in `1e-6`, `1e12`."""
    return f"1e{round(np.log10(value))}"


def _regular() -> Iterator[ProblemFamily]:
    ordinary = "Slater's condition holds and rows are independent: any correct solver must solve all of them"
    case = partial(ProblemFamily, feasible=True, well_posed=True)
    for suffix, bounds, equality, what in (
        ("", False, False, "cone"),
        ("-bounds", True, False, "bounds"),
        ("-equality", False, True, "the paper's tangent (eq. 9)"),
        ("-equality-bounds", True, True, "equalities with bounds"),
    ):
        make = partial(draw.well_conditioned, bounds=bounds, equality=equality)
        yield case(f"well-conditioned{suffix}", f"{ordinary}; {what}, 9 × 3", make, equality=equality)
    yield case("well-conditioned-mixed", f"{ordinary}; equalities among inequalities, 9 × 5", draw.mixed, equality=True)
    for n, m, bounds in ((80, 2, False), (80, 2, True), (1000, 5, False), (1000, 5, True), (100_000, 10, False)):
        make = partial(draw.well_conditioned, n=n, m=m, bounds=bounds)
        name = f"well-conditioned-{n}x{m}{'-bounds' if bounds else ''}"
        reason = f"{ordinary}; how time grows with the number of parameters"
        yield case(name, reason, make, equality=False, is_large=n > 100)
    yield case(
        "more-rows-than-parameters", "8 rows in ℝ³: most active sets are dependent",
        partial(draw.well_conditioned, n=3, m=8), equality=False,
    )  # fmt: skip
    yield case(
        "more-rows-than-parameters-bounds", "8 rows in ℝ³ around an interior point",
        partial(draw.well_conditioned, n=3, m=8, bounds=True), equality=False,
    )  # fmt: skip


def _angles() -> Iterator[ProblemFamily]:
    case = partial(ProblemFamily, feasible=True)
    parallel = "nearly parallel rows: one dominates in a cone, but a Gram matrix loses rank as θ²"
    opposing = "nearly opposing rows: a thin cone, multipliers of size 1/θ, cancellation in d = g + Jᵀμ"
    for angle in ANGLES:
        well_posed = angle > _WELL_POSED_ANGLE
        for name, is_opposing, reason in (("parallel", False, parallel), ("opposing", True, opposing)):
            make = partial(draw.angled, angle=angle, opposing=is_opposing)
            yield case(f"{name}-{_power(angle)}", reason, make, equality=False, well_posed=well_posed)
    for angle in (1e-4, 1e-6, 1e-8):
        make = partial(draw.angled, angle=angle, opposing=True, bounds=True)
        reason = f"{opposing}; a wedge that holds a point with slack"
        yield case(
            f"opposing-{_power(angle)}-bounds", reason, make, equality=False, well_posed=angle > _WELL_POSED_ANGLE
        )
    for angle in (1e-4, 1e-6, 1e-8):
        make = partial(draw.angled, angle=angle, opposing=False, equality=True)
        reason = "nearly parallel equalities: the tangent space loses θ, and pinv(JJᵀ) drops a row"
        well_posed = angle > _WELL_POSED_ANGLE
        yield case(f"parallel-{_power(angle)}-equality", reason, make, equality=True, well_posed=well_posed)


def _dependent() -> Iterator[ProblemFamily]:
    case = partial(ProblemFamily, feasible=True, well_posed=True)
    twice = "the same row twice: multipliers are not unique, the direction is; Gram matrices are singular"
    zero = "Δ² + Δ³ + Δ⁴ = 0, as in the paper's three-state MDP where r² + r³ + r⁴ = 0: rank 2 of 3"
    for suffix, bounds, equality in (("", False, False), ("-bounds", True, False), ("-equality", False, True)):
        make = partial(draw.duplicate, bounds=bounds, equality=equality)
        yield case(f"duplicate{suffix}", twice, make, equality=equality)
        make = partial(draw.sum_to_zero, bounds=bounds, equality=equality)
        yield case(f"sum-to-zero{suffix}", zero, make, equality=equality)
    for suffix, equality in (("", False), ("-equality", True)):
        reason = "a constraint without gradient (a policy that cannot influence it): 0ᵀd ≥ 0 asks for nothing"
        yield case(f"zero-rows{suffix}", reason, partial(draw.zero_rows, equality=equality), equality=equality)
    reason = "integer rows through one vertex: many active sets fit, a careless method cycles"
    yield case("degenerate-vertex", reason, draw.degenerate_vertex, equality=False)
    reason = (
        "Σ yᵢJᵢ = 0 with y > 0 and rank n (Gordan): only d = 0 is feasible, and a relative error must not divide by it"
    )
    yield case("cone-of-zero", reason, draw.cone_of_zero, equality=False)


def _scales() -> Iterator[ProblemFamily]:
    case = partial(ProblemFamily, feasible=True, well_posed=True, equality=False)
    reason = "rows in different units: scaling a row with its bound leaves the feasible set and so d unchanged"
    for decades in (6, 12):
        for suffix, bounds in (("", False), ("-bounds", True)):
            make = partial(draw.row_scales, decades=decades, bounds=bounds)
            yield case(f"row-scales-1e{decades}{suffix}", reason, make)
    reason = "(cg, cJ, c²b) has the answer c·d: absolute tolerances call anything solved, or nothing"
    for scale in (1e-12, 1e-4, 1e12):
        for suffix, bounds in (("", False), ("-bounds", True)):
            make = partial(draw.gradient_scale, scale=scale, bounds=bounds)
            yield case(f"gradients-{_power(scale)}{suffix}", reason, make)


def _special() -> Iterator[ProblemFamily]:
    case = partial(ProblemFamily, feasible=True, well_posed=True, equality=False)
    yield case("feasible-gradient", "g is feasible, so d = g: idempotence of a projection", draw.feasible_gradient)
    yield case("switched-off", "b = −∞ switches a row off; some libraries compute with it", draw.switched_off)
    yield case("far-bounds", "bounds that never bind must not set the scale of a tolerance", draw.far_bounds)


def _recorded() -> Iterator[ProblemFamily]:
    case = partial(ProblemFamily, feasible=True, well_posed=True)
    for name, experiment in (("three-state", "the three-state MDP"), ("arm", "the two-link arm")):
        for suffix, equality, what in (("", True, "as met"), ("-cone", False, "with inequalities for equalities")):
            make = partial(shipped_problem, name=name, equality=equality)
            reason = f"met while CPGRL was trained on {experiment}, {what}: what a solver is for"
            yield case(f"recorded-{name}{suffix}", reason, make, equality=equality)


def _infeasible() -> Iterator[ProblemFamily]:
    case = partial(ProblemFamily, feasible=False, well_posed=False)
    farkas = "Farkas: y ≥ 0, Jᵀy = 0, bᵀy > 0, so that no d has Jd ≥ b"
    weakly = f"{farkas}; each row asks only a little too much, within a loose tolerance"
    yield case(
        "infeasible", f"{farkas}; two opposing rows", partial(draw.infeasible, support=2, gap=0.3), equality=False
    )
    make = partial(draw.infeasible, support=4, gap=0.3)
    yield case("infeasible-four-rows", f"{farkas}; four rows that sum to zero", make, equality=False)
    make = partial(draw.infeasible, support=3, gap=0.3, equality=True)
    reason = "Fredholm: Jᵀy = 0 and bᵀy ≠ 0, so that no d has Jd = b"
    yield case("infeasible-equality", reason, make, equality=True)
    yield case("infeasible-zero-row", "0ᵀd ≥ b > 0", draw.infeasible_zero_row, equality=False)
    for gap in (1e-4, 1e-6, 1e-8):
        yield case(
            f"weakly-infeasible-{_power(gap)}", weakly, partial(draw.infeasible, support=2, gap=gap), equality=False
        )


def _geometries() -> Iterator[ProblemFamily]:
    case = partial(ProblemFamily, feasible=True, equality=False, well_posed=True)
    metric = "min ½dᵀMd − gᵀd: M⁻¹ is easily forgotten, or put twice"
    for name, how, what in (
        ("diagonal", measured.diagonal_metric, "weights from 1e-2 to 1e2, 9 × 3"),
        ("full", measured.full_metric, "condition 1e2, 9 × 3"),
        ("1e10", partial(measured.full_metric, decades=10), "condition 1e10, where whitening loses digits"),
    ):
        yield case(f"metric-{name}", f"{metric}; {what}", partial(measured.in_metric, metric=how))
    ball = "max gᵀd, dᵀMd ≤ radius², constrained policy optimization"
    yield case("ball", f"{ball}; a cone, whose projection only needs a length", partial(measured.in_ball, bounds=False))
    yield case("ball-bounds", f"{ball}; bounds, 1.5 times as far as the shortest direction", measured.in_ball)
    make = partial(measured.in_ball, metric=measured.full_metric)
    yield case("ball-metric-bounds", f"{ball}; bounds, in a full metric", make)
    missed = partial(case, feasible=False, well_posed=False)
    reason = "the ball ends half way to the constraints: the least violation in it, with a proof"
    yield missed("ball-out-of-reach", reason, measured.out_of_reach)
    reason = "rows contradict each other in a ball of 1e12, a word for none: as infeasible as without it"
    yield missed("ball-1e12-infeasible", reason, partial(measured.impossible_in_huge_ball, radius=1e12))


def _by_name(families: Iterable[ProblemFamily]) -> Mapping[str, ProblemFamily]:
    return MappingProxyType({family.name: family for family in families})


FAMILIES: Mapping[str, ProblemFamily] = _by_name(
    family
    for group in (_regular, _angles, _dependent, _scales, _special, _recorded, _infeasible, _geometries)
    for family in group()
)


def families_named(patterns: Iterable[str]) -> dict[str, ProblemFamily]:
    """The families whose names match (`opposing-*` matches many), in the order of FAMILIES.

    ValueError that lists the right names where a pattern matches none.
    """
    chosen: set[str] = set()
    for pattern in patterns:
        found = {name for name in FAMILIES if fnmatchcase(name, pattern)}
        if not found:
            raise ValueError(
                f"family should be one of {', '.join(FAMILIES)}, or a recording, FILE.npz; found {pattern!r}"
            )
        chosen |= found
    return {name: family for name, family in FAMILIES.items() if name in chosen}
