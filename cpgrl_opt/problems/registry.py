"""The named families of direction problems, each with the reason it exists: what breaks solvers that look right.

A new family is a function in one of the files beside this one and a line here: users and the conformance kit then draw
from it.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np

from ..problem import DirectionProblem
from . import dependent, geometry, infeasible, regular, scales
from .case import ALL_CASES, SHIFTED_CASES, Case, members
from .source import RandomSource, Source


@dataclass(frozen=True)
class Family:
    """A source of problems. make: one of them from some choices, of a kind that is among `cases`.

    feasible: whether all its problems have a direction, None where some have; well_posed: whether float64 determines
    it. geometry: METRIC or RADIUS where all its problems are in one. several_rows: it is about how rows lie to each
    other. only: the limit of the solvers that it is for, None for all. weight: how often it comes up in the kit.
    """

    name: str
    reason: str
    make: Callable[[Source, Case], DirectionProblem]
    cases: tuple[Case, ...] = ALL_CASES
    feasible: bool | None = True
    well_posed: bool = True
    geometry: Case | None = None
    several_rows: bool = False
    only: Case | None = None
    weight: int = 1

    def draw(
        self, rng: np.random.Generator, case: Case | None = None, *, n: int | None = None, m: int | None = None
    ) -> DirectionProblem:
        """One problem, a function of the generator alone.

        Parameters
        ----------
        rng : numpy.random.Generator
        case : Case, optional
            The kind of constraints, one of `cases`; any of these by default.
        n, m : int, optional
            Parameters and constraints; 9 × 3 or so by default.

        Raises
        ------
        ValueError
            For a case that is not among the family's, and for a shape that it does not come in.
        """
        source = RandomSource(rng, n, m)
        kind = source.choice(self.cases) if case is None else members("case", (case,), self.cases)[0]
        return self.make(source, kind)

    def serves(self, cases: Collection[Case]) -> bool:
        """Whether solvers that take these cases may be given its problems."""
        if self.only is not None and self.only not in cases:
            return False
        if self.several_rows and Case.ONE_ROW in cases:
            return False
        if Case.BALL in cases:
            return self.geometry == Case.RADIUS
        if not any(case in ALL_CASES for case in cases):  # nothing but geometries is asked for
            return self.geometry in cases
        return self.geometry is None or self.geometry in cases


_CONE, _INEQUALITIES = (Case.CONE,), (Case.BOUNDS, Case.MIXED)
_several = partial(Family, several_rows=True)
_hostile = partial(Family, well_posed=False)
_in_ball = partial(Family, geometry=Case.RADIUS)
_opposing, _parallel = (partial(dependent.nearly_dependent, opposing=opposing) for opposing in (True, False))
_almost = partial(dependent.nearly_dependent, angle=(1e-12, 1e-7))
_extreme = partial(scales.gradient_scale, scale=(1e-100, 1e100))
_far = partial(regular.far_bounds, decades=(6.0, 15.0))
_weakly = partial(infeasible.infeasible, support=2, gap=(1e-4, 1e-6, 1e-8, 1e-10, 1e-12))
_zero_row = partial(infeasible.zero_row_asks, decades=(0.0, 0.0))
_touching = partial(geometry.out_of_reach, factors=geometry.TOUCHING)
_gradient_in_ball = partial(geometry.in_ball, of=regular.feasible_gradient)

_TABLE = (
    Family("ordinary", "rows as they come; in small integers ties and zeros come up often", regular.ordinary),
    Family("binding", "the optimum is planted with up to min(n, m) constraints tight", regular.binding),
    Family("conditioned", "σ₁/σₘ up to 1e6", regular.conditioned),
    _several("rank-deficient", "fewer independent rows than rows and parameters", dependent.rank_deficient),
    _several("duplicate rows", "multipliers are not unique, the direction is", dependent.duplicate),
    _several("opposing rows", "the cone has no interior", partial(dependent.duplicate, opposing=True)),
    _several("sum to zero", "the paper's own Δ² + Δ³ + Δ⁴ = 0", dependent.sum_to_zero),
    Family("zero rows", "nothing was learnt about a constraint", dependent.zero_rows),
    Family("row scales", "gradients of different rewards differ by 1e12 in length", scales.row_scales),
    Family("scaled", "policy gradients are small; absolute tolerances return g unchanged", scales.gradient_scale),
    _several("cone of zero", "the answer is 0 whatever g", dependent.cone_of_zero, _CONE),
    _several(
        "pinched", "one point is feasible, or a flat set: nothing has room, and yet it is not infeasible",
        dependent.pinched, SHIFTED_CASES, weight=3,
    ),
    _several("nearly opposing", "1e-7 … 1e-1 rad: the hard family", _opposing),
    _several("nearly parallel", "1e-7 … 1e-1 rad: a rank decision merges two rows", _parallel),
    _several("Kahan rows", "no pivot of a factorisation warns of the smallest singular value", dependent.kahan),
    _several(
        "degenerate vertex", "many active sets fit; a careless method cycles", regular.degenerate_vertex,
        SHIFTED_CASES,
    ),
    Family("no constraints", "m = 0: d = g", regular.no_constraints),
    Family("feasible gradient", "nothing to do: d = g", regular.feasible_gradient),
    Family(
        "switched off", "b = −∞ switches a row off; some libraries compute with it", regular.switched_off,
        _INEQUALITIES,
    ),
    Family("in a metric", "M⁻¹ is easily forgotten, or put twice", geometry.in_metric, geometry=Case.METRIC, weight=3),
    _in_ball("in a ball", "constrained policy optimization", geometry.in_ball, weight=3),
    _in_ball(
        "feasible gradient in a ball", "as a rule the constraints do not bind: d = radius g/‖g‖", _gradient_in_ball,
        only=Case.BALL, weight=2,
    ),
    _hostile("almost opposing", "1e-12 … 1e-7 rad: beyond what float64 certifies", _almost, several_rows=True),
    _hostile("extreme scales", "‖v‖² over- or underflows", _extreme),
    _hostile("far bounds", "a huge number that must not set the scale", _far, _INEQUALITIES),
    _hostile("weakly infeasible", "1e-12 … 1e-4 from feasible", _weakly, SHIFTED_CASES, False, several_rows=True),
    _hostile("infeasible", "rows that sum to zero all ask for something", infeasible.infeasible, SHIFTED_CASES, False),
    _hostile("zero row asks", "0ᵀd ≥ b > 0", _zero_row, SHIFTED_CASES, False),
    _hostile(
        "out of reach", "the ball misses the constraints", geometry.out_of_reach, SHIFTED_CASES, False,
        geometry=Case.RADIUS,
    ),
    _hostile(
        "touching", "the ball meets the constraints in one point, where no multiplier need be finite, or nearly so",
        _touching, SHIFTED_CASES, None, geometry=Case.RADIUS,
    ),
)  # fmt: skip
FAMILIES: Mapping[str, Family] = MappingProxyType({family.name: family for family in _TABLE})


def families() -> Mapping[str, Family]:
    """Name → family, in the order of the table."""
    return FAMILIES


def draw_problem(
    name: str, rng: np.random.Generator, case: Case | None = None, *, n: int | None = None, m: int | None = None
) -> DirectionProblem:
    """One problem of the family of that name.

    Parameters
    ----------
    name
        Of `FAMILIES`.
    rng
        Where all its numbers come from.
    case
        The kind of constraints; one of the family's by chance if None.
    n, m
        The shape; the family's own if None.

    Returns
    -------
    DirectionProblem

    Raises
    ------
    ValueError
        For a name that no family has, and as `Family.draw`.
    """
    return FAMILIES[members("name", (name,), tuple(FAMILIES))[0]].draw(rng, case, n=n, m=m)
