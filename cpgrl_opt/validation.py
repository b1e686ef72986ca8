"""The boundary: whatever a caller hands over becomes a read-only float64 array, or a ValueError says why not."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def real_values(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """`values` as float64, not copied if they are; a ValueError for what is no array of real numbers."""
    given = _as_array(name, values)
    if given.dtype.kind not in "biuf":
        raise ValueError(f"{name} should be an array of real numbers; found dtype {given.dtype}")
    return np.asarray(given, dtype=np.float64)


def real_array(name: str, values: ArrayLike, ndim: int) -> NDArray[np.float64]:
    """A read-only, C-contiguous float64 copy of `values` with `ndim` axes and no NaN."""
    given = _as_array(name, values)
    if given.dtype.kind not in "biuf":
        raise ValueError(f"{name} should be an array of real numbers; found dtype {given.dtype}")
    array = np.array(given, dtype=np.float64, order="C", copy=True)
    if array.ndim != ndim:
        raise ValueError(f"{name} should have {ndim} axes; found shape {array.shape}")
    if np.isnan(array).any():
        raise ValueError(f"{name} should have no NaN; found {int(np.isnan(array).sum())} of {array.size}")
    array.flags.writeable = False
    return array


def finite_array(name: str, values: ArrayLike, ndim: int) -> NDArray[np.float64]:
    """`real_array` without infinities."""
    array = real_array(name, values, ndim)
    if not is_finite(array):
        raise ValueError(f"{name} should be finite; found {array[~np.isfinite(array)][0]}")
    return array


def mask_array(name: str, values: ArrayLike) -> NDArray[np.bool_]:
    """A read-only, C-contiguous copy of booleans."""
    array = np.array(boolean_array(name, values), order="C")
    array.flags.writeable = False
    return array


def boolean_array(name: str, values: ArrayLike) -> NDArray[np.bool_]:
    """`values` in a read-only view if they are booleans; numbers are refused, since 0/1 may be an index list."""
    given = _as_array(name, values)
    if given.dtype != np.bool_:
        if given.size > 0:
            raise ValueError(f"{name} should be an array of booleans; found dtype {given.dtype}")
        given = given.astype(np.bool_)
    return read_only(given)


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """A view that cannot be written to, nor made writable where `array` itself cannot."""
    view = array.view()
    view.setflags(False)  # type: ignore[call-arg]  # by its name, write, it takes five times as long
    return view


def is_finite(array: NDArray[np.float64]) -> bool:
    """No NaN and no infinity. One dot product tells it of nearly all arrays; beyond 1e154 their squares overflow."""
    return math.isfinite(np.vdot(array, array)) or bool(np.isfinite(array).all())


def require_shape(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    """ValueError unless `array` has exactly this shape."""
    if array.shape != shape:
        raise ValueError(f"{name} should have shape {shape}; found {array.shape}")


def require_nonnegative(name: str, value: float, *, allow_infinite: bool = False) -> None:
    """ValueError unless `value` is a finite number ≥ 0 (or +inf, where that means "no limit")."""
    is_number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not is_number or not value >= 0 or (value == np.inf and not allow_infinite):
        raise ValueError(f"{name} should be a number ≥ 0; found {value!r}")


def require_positive(name: str, value: float) -> None:
    """ValueError unless `value` is a finite number > 0."""
    is_number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not is_number or not 0 < value < np.inf:
        raise ValueError(f"{name} should be a finite number > 0; found {value!r}")


def require_member(name: str, value: str, members: tuple[str, ...]) -> None:
    """ValueError that lists the right names unless `value` is one of them."""
    if value not in members:
        raise ValueError(f"{name} should be one of {', '.join(members)}; found {value!r}")


def _as_array(name: str, values: ArrayLike) -> NDArray[Any]:
    try:
        return np.asarray(values)
    except ValueError as error:  # ragged lists
        raise ValueError(f"{name} should be a rectangular array of numbers; found {values!r}") from error
