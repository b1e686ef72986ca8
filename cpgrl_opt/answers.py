"""What somebody else's solver returned, as our types; or a ValueError that says what should come.

A direction is whatever has value (n,), multipliers (m,) and a status; iterations and radius_multiplier where there are
any. Whether the numbers are right, or finite, is the referee's question.
"""

from collections.abc import Sequence
from operator import index
from typing import Any

import numpy as np

from .direction import Direction, DirectionBatch, Status
from .validation import real_values


def as_direction(answer: Any, n: int, m: int) -> Direction:
    """The answer of `solve`, its status a `Status`, or the number or name of one."""
    what = f"solve should return a Direction (value ({n},), multipliers ({m},), status)"
    value, multipliers, status, iterations, kappa = _parts(what, answer, (), n, m)
    return Direction(value, multipliers, Status(int(status)), int(iterations), float(kappa))


def as_directions(answers: Any, count: int, n: int, m: int) -> DirectionBatch:
    """The answer of `solve_batch` to `count` > 0 problems: stacked arrays, or a sequence of directions."""
    what = (
        f"solve_batch should return a DirectionBatch (value ({count}, {n}), multipliers ({count}, {m}), "
        f"status ({count},)), or {count} directions"
    )
    if isinstance(answers, Sequence) and not isinstance(answers, DirectionBatch | str):
        if len(answers) != count:
            raise ValueError(f"{what}; found {len(answers)}")
        return DirectionBatch.stack([as_direction(answer, n, m) for answer in answers])
    return DirectionBatch(*_parts(what, answers, (count,), n, m))


def _parts(what: str, answer: Any, shape: tuple[Any, ...], n: int, m: int) -> tuple[np.ndarray, ...]:
    """Value, multipliers, statuses, iterations and κ of one answer, shape (), or of several, (count,)."""
    if not all(hasattr(answer, part) for part in ("value", "multipliers", "status")):
        raise ValueError(f"{what}; found {_shorten(answer)}")
    value = _numbers(what, "value", answer.value, (*shape, n))
    multipliers = _numbers(what, "multipliers", answer.multipliers, (*shape, m))
    given, kappa = getattr(answer, "iterations", None), getattr(answer, "radius_multiplier", None)
    iterations = _numbers(what, "iterations", np.zeros(shape) if given is None else given, shape)
    is_whole = np.asarray(given).dtype != np.bool_ and (iterations == np.floor(iterations)).all()
    if not (is_whole and (np.abs(iterations) < 2.0**63).all()):  # NaN fails both comparisons
        raise ValueError(f"{what}; found iterations that are no integers: {_shorten(given)}")
    kappa = _numbers(what, "radius_multiplier", np.zeros(shape) if kappa is None else kappa, shape)
    return value, multipliers, _statuses(what, answer.status, shape), iterations.astype(np.int64), kappa


def _numbers(what: str, name: str, values: Any, shape: tuple[Any, ...]) -> np.ndarray:
    try:
        array = real_values(name, values)
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error
    if array.shape != shape:
        raise ValueError(f"{what}; found {name} of shape {array.shape}")
    return array


def status_of(status: Any, what: str = "status should be a Status, or the number or name of one") -> Status:
    """The `Status` that is meant; no truth values, and no numbers that are not whole."""
    try:
        if isinstance(status, str):
            return Status[status.upper()]
        if not isinstance(status, bool | np.bool_):
            return Status(index(status))
    except (KeyError, TypeError, ValueError):
        pass
    raise ValueError(f"{what}; found the status {_shorten(status)}")


def _statuses(what: str, values: Any, shape: tuple[Any, ...]) -> np.ndarray:
    given = np.asarray(values)
    if given.shape != shape:
        raise ValueError(f"{what}; found the statuses {_shorten(values)}")
    each = [values] if shape == () else given.tolist()  # as it came: an array of one would lose its type
    return np.array([status_of(one, what) for one in each], np.int64).reshape(shape)


def _shorten(answer: Any) -> str:
    text = " ".join(repr(answer).split())
    return text if len(text) <= 100 else f"{text[:99]}…"
