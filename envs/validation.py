"""The boundary: a caller's numbers become read-only float64 arrays, or a ValueError says why not."""

import operator

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Rows that were normalised in float64 miss 1 by a few ulp, 1e-15; ones that were rounded to print by 1e-7 or more.
SUM_TOLERANCE = 1e-9
_LARGEST_COUNT = 10**9  # arrays of more entries along an axis fit no memory


def real_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """A read-only, C-contiguous float64 copy of `values`, which may hold infinities but no NaN."""
    try:
        given = np.asarray(values)
    except ValueError as error:  # ragged lists
        raise ValueError(f"{name} should be a rectangular array of numbers; found {values!r}") from error
    if given.dtype.kind not in "biuf" and given.size > 0:
        raise ValueError(f"{name} should be an array of real numbers; found dtype {given.dtype}")
    array = np.array(given, dtype=np.float64, order="C")
    if np.isnan(array).any():
        raise ValueError(f"{name} should have no NaN; found {int(np.isnan(array).sum())} of {array.size}")
    array.flags.writeable = False
    return array


def finite_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """`real_array` without infinities."""
    array = real_array(name, values)
    if np.isinf(array).any():
        raise ValueError(f"{name} should be finite; found {array[np.isinf(array)][0]}")
    return array


def require_probabilities(name: str, array: NDArray[np.float64]) -> None:
    """ValueError unless `array` is ≥ 0 and sums to 1 along its last axis, within `SUM_TOLERANCE`."""
    if array.size > 0 and array.min() < 0:
        raise ValueError(f"{name} should hold probabilities ≥ 0; found {array.min()}")
    sums = array.sum(axis=-1)
    wrong = np.abs(sums - 1) > SUM_TOLERANCE
    if wrong.any():
        where = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise ValueError(f"{name} should sum to 1 along the last axis; found {sums[where]} at {list(where)}")


def index_below(name: str, value: int, size: int) -> int:
    """`value` as an int in 0 … size − 1."""
    try:
        index = operator.index(value)
    except TypeError as error:
        raise ValueError(f"{name} should be an integer; found {value!r}") from error
    if not 0 <= index < size:
        raise ValueError(f"{name} should be in 0 … {size - 1}; found {index}")
    return index


def positive_integer(name: str, value: int) -> int:
    """`value` as an int ≥ 1."""
    try:
        number = 0 if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = 0
    if number < 1:
        raise ValueError(f"{name} should be an integer ≥ 1; found {value!r}")
    if number > _LARGEST_COUNT:
        raise ValueError(f"{name} should be an integer ≤ {_LARGEST_COUNT}; found {value!r}")
    return number


def number_between(name: str, value: float, least: float, most: float) -> float:
    """`value` as a float in [least, most]."""
    is_number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not is_number or not least <= value <= most:
        raise ValueError(f"{name} should be a number in [{least:g}, {most:g}]; found {value!r}")
    return float(value)
