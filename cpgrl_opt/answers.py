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

_PARTS = ("value", "multipliers", "status")


def as_direction(answer: Any, n: int, m: int) -> Direction:
    """The answer of `solve`, its status a `Status`, or the number or name of one."""
    what = f"solve should return a Direction (value ({n},), multipliers ({m},), status)"
    if not all(hasattr(answer, part) for part in _PARTS):
        raise ValueError(f"{what}; found {_shortened(answer)}")
    return Direction(
        _shaped(what, "value", answer.value, (n,)),
        _shaped(what, "multipliers", answer.multipliers, (m,)),
        status_of(answer.status, what),
        _whole(what, "iterations", getattr(answer, "iterations", 0)),
        float(_shaped(what, "radius_multiplier", getattr(answer, "radius_multiplier", 0.0), ())),
    )


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
    if not all(hasattr(answers, part) for part in _PARTS):
        raise ValueError(f"{what}; found {_shortened(answers)}")
    iterations = getattr(answers, "iterations", None)
    kappa = getattr(answers, "radius_multiplier", None)
    return DirectionBatch(
        _shaped(what, "value", answers.value, (count, n)),
        _shaped(what, "multipliers", answers.multipliers, (count, m)),
        _statuses(what, answers.status, count),
        np.zeros(count, np.int64) if iterations is None else _wholes(what, "iterations", iterations, count),
        None if kappa is None else _shaped(what, "radius_multiplier", kappa, (count,)),
    )


def status_of(status: Any, what: str = "status should be a Status, or the number or name of one") -> Status:
    """The `Status` that is meant; no truth values, and no numbers that are not whole."""
    if isinstance(status, Status):
        return status
    try:
        if isinstance(status, str):
            return Status[status.upper()]
        if not isinstance(status, bool | np.bool_):
            return Status(index(status))
    except (KeyError, TypeError, ValueError):
        pass
    raise ValueError(f"{what}; found the status {_shortened(status)}")


def _shaped(what: str, name: str, values: Any, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = real_values(name, values)
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error
    if array.shape != shape:
        raise ValueError(f"{what}; found {name} of shape {array.shape}")
    return array


def _whole(what: str, name: str, value: Any) -> int:
    return int(_wholes(what, name, value, None))


def _wholes(what: str, name: str, values: Any, count: int | None) -> np.ndarray:
    """(count,) or one number, as int64; a whole number in floating point is one."""
    numbers = _shaped(what, name, values, () if count is None else (count,))
    is_whole = np.asarray(values).dtype != np.bool_ and (numbers == np.floor(numbers)).all()
    if not (is_whole and (np.abs(numbers) < 2.0**63).all()):  # NaN fails both comparisons
        raise ValueError(f"{what}; found {name} that are no integers: {_shortened(values)}")
    return np.asarray(values).astype(np.int64)


def _statuses(what: str, values: Any, count: int) -> np.ndarray:
    numbers = np.asarray(values)
    if numbers.shape == (count,) and numbers.dtype.kind in "iu" and np.isin(numbers, list(Status)).all():
        return numbers.astype(np.int64)
    if numbers.shape == (count,) and numbers.dtype.kind not in "iu":
        return np.array([status_of(each, what) for each in numbers.tolist()], dtype=np.int64)
    raise ValueError(f"{what}; found the statuses {_shortened(values)}")


def _shortened(answer: Any) -> str:
    text = " ".join(repr(answer).split())
    return text if len(text) <= 100 else f"{text[:99]}…"
