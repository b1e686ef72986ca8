"""The kinds of direction problems: five of constraints, two of geometry, and two limits of those who take them."""

from collections.abc import Collection
from enum import StrEnum
from typing import TypeVar

T = TypeVar("T")


class Case(StrEnum):
    """What solvers differ in: five kinds of constraints, two geometries that go with any of them, and two limits.

    A solver without `supports` is taken to handle the five; the geometries only where it has `takes_geometry`. A limit
    is what all problems of a solver have in common where `supports` takes no others.
    """

    CONE = "J d ≥ 0"
    BOUNDS = "J d ≥ b"
    TANGENT = "J d = 0"
    AFFINE = "J d = b"
    MIXED = "J d ≥ b, = b in some rows"
    METRIC = "½dᵀMd for ½‖d‖²"
    RADIUS = "max gᵀd, dᵀMd ≤ radius²"
    ONE_ROW = "one constraint at most"
    BALL = "never without a radius"

    @property
    def is_geometry(self) -> bool:
        """Whether it says how directions are measured, and nothing about constraints."""
        return self in (Case.METRIC, Case.RADIUS)

    @property
    def is_limit(self) -> bool:
        """Whether it says what the problems of a solver never are."""
        return self in (Case.ONE_ROW, Case.BALL)

    @property
    def is_shifted(self) -> bool:
        """Whether b ≠ 0."""
        return self in (Case.BOUNDS, Case.AFFINE, Case.MIXED)


ALL_CASES = tuple(case for case in Case if not case.is_geometry and not case.is_limit)  # of constraints
GEOMETRIES = tuple(case for case in Case if case.is_geometry)
SHIFTED_CASES = tuple(case for case in Case if case.is_shifted)
LIMITS = tuple(case for case in Case if case.is_limit)


def members(name: str, cases: Collection[T], possible: Collection[T]) -> tuple[T, ...]:
    """The possible ones of the cases in one order, so that draws are reproducible; ValueError where there is none."""
    both = tuple(case for case in possible if case in cases)
    if not both:
        known, found = (", ".join(map(str, names)) for names in (possible, cases))
        raise ValueError(f"{name} should include one of {known}; found {found or 'none'}")
    return both
