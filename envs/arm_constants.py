"""What the two-link arm is made of: its objects, and what its constants may be."""

from collections.abc import Iterable
from dataclasses import dataclass

from .validation import number_between

Pair = tuple[float, float]

NONE = "none"  # what is touched when nothing is
# Of lengths and times. Squares of distances and their quotients then stay within 1e±40, far from where float64 ends.
LEAST, MOST = 1e-9, 1e9


def pair_between(name: str, values: Iterable[float], least: float, most: float) -> Pair:
    """`values` as two floats, each in [least, most]."""
    try:
        first, second = values
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} should be a pair of numbers; found {values!r}") from error
    return number_between(name, first, least, most), number_between(name, second, least, most)


@dataclass(frozen=True)
class ArmObject:
    """Something fixed in the plane that ends the episode when touched.

    Parameters
    ----------
    name
        Not empty, not "none".
    position
        (x, y), m.
    reward
        r³ of the step that touches it.

    Raises
    ------
    ValueError
        For other names and for numbers that are not finite.
    """

    name: str
    position: Pair
    reward: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or self.name in ("", NONE):
            raise ValueError(f"the name of an object should be a string, not empty, not {NONE!r}; found {self.name!r}")
        object.__setattr__(self, "position", pair_between(f"position of {self.name}", self.position, -MOST, MOST))
        object.__setattr__(self, "reward", number_between(f"reward of {self.name}", self.reward, -MOST, MOST))


# The paper shows them in Fig. 6 (a) without numbers; these are ours (docs/reproduction.md §3).
OBJECTS = (
    ArmObject("circle", (-0.69, 0.87)),
    ArmObject("star", (-0.04, 1.11), -1.0),
    ArmObject("square", (0.58, 1.56), 1.0),
    ArmObject("triangle", (-0.45, 1.60)),
)


def angle_box(rows: Iterable[Iterable[float]]) -> tuple[Pair, Pair]:
    """`rows` as ((least φ₁, greatest φ₁), (least φ₂, greatest φ₂)), rad."""
    try:
        first, second = rows
    except (TypeError, ValueError) as error:
        raise ValueError(f"box should be two pairs of angles, of φ₁ and of φ₂; found {rows!r}") from error
    pairs = pair_between("box of φ₁", first, -MOST, MOST), pair_between("box of φ₂", second, -MOST, MOST)
    for low, high in pairs:
        if not high - low >= LEAST:
            raise ValueError(f"box should hold (least, greatest) angles, {LEAST:g} apart or more; found {(low, high)}")
    return pairs


def distinct_objects(objects: Iterable[ArmObject]) -> tuple[ArmObject, ...]:
    """`objects` as a tuple of one object or more, whose names differ."""
    try:
        things = tuple(objects)
    except TypeError as error:
        raise ValueError(f"objects should be a sequence of ArmObject; found {objects!r}") from error
    if not things or not all(isinstance(thing, ArmObject) for thing in things):
        raise ValueError(f"objects should be one ArmObject or more; found {things!r}")
    names = [thing.name for thing in things]
    if len(set(names)) < len(names):
        raise ValueError(f"objects should have different names; found {names}")
    return things
