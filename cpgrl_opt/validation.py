"""The boundary: whatever a caller hands over becomes a read-only float64 array, or a ValueError says why not."""

import math
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def real_values(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """`values` as float64, not copied if they are; a ValueError for what is no array of real numbers."""
    if type(values) is np.ndarray and values.dtype == np.float64:
        return values
    given = _as_array(name, values)
    if given.dtype.kind not in "iuf":  # truth values are none: 0 and 1 would be a mask taken for numbers
        raise ValueError(f"{name} should be an array of real numbers; found dtype {given.dtype}")
    return np.asarray(given, dtype=np.float64)


def real_view(name: str, values: ArrayLike, ndim: int | None) -> NDArray[np.float64]:
    """A read-only float64 array with `ndim` axes (None: any), not copied if it is one: writes to `values` are seen.

    NaN is not looked for.
    """
    array = values if type(values) is np.ndarray and values.dtype == np.float64 else real_values(name, values)
    if ndim is not None and array.ndim != ndim:
        raise ValueError(f"{name} should have {ndim} axes; found shape {array.shape}")
    view = array.view()  # `read_only`, without a call: two of these stand in the way of every long problem
    view.setflags(False)  # type: ignore[call-arg]
    return view


def real_array(name: str, values: ArrayLike, ndim: int | None) -> NDArray[np.float64]:
    """`real_view` of a C-contiguous copy."""
    return freeze(np.array(real_view(name, values, ndim), order="C"))


def finite_array(name: str, values: ArrayLike, ndim: int) -> NDArray[np.float64]:
    """`real_array` without NaN and infinities."""
    array = real_array(name, values, ndim)
    require_finite(name, array)
    return array


def require_finite(name: str, array: NDArray[np.float64]) -> None:
    """ValueError for NaN and infinities."""
    if not is_finite(array):
        raise ValueError(f"{name} should be finite; found {array[~np.isfinite(array)].flat[0]}")


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


def freeze(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only view of an array that is ours, whose owner cannot be made writable through it."""
    array.setflags(False)  # type: ignore[call-arg]  # as in `read_only`
    return array.view()


class ReadOnlyArrays:
    """Base of what holds read-only arrays: copied and unpickled, where NumPy makes them writable, they are so again."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        frozen = {name: read_only(value) for name, value in state.items() if isinstance(value, np.ndarray)}
        vars(self).update({**state, **frozen})


def is_finite(array: NDArray[np.float64]) -> bool:
    """No NaN and no infinity. One dot product tells it of nearly all arrays; beyond 1e154 their squares overflow."""
    if array.ndim == 2 and not array.flags.c_contiguous:  # of which `vdot` would make a copy
        return is_finite(array.T) if array.flags.f_contiguous else all(map(is_finite, array))
    return math.isfinite(np.vdot(array, array)) or bool(np.isfinite(array).all())


def require_shape(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    """ValueError unless `array` has exactly this shape."""
    if array.shape != shape:
        raise ValueError(f"{name} should have shape {shape}; found {array.shape}")


def is_number(value: Any) -> bool:
    """Whether it is one real number: Python's, NumPy's or an array of no axes; no NaN, no truth value."""
    if isinstance(value, np.ndarray) and value.ndim == 0 and not hasattr(value, "mask"):
        value = value[()]
    is_real = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    try:
        return is_real and not math.isnan(value)
    except OverflowError:  # 10**400
        return False


def require_number(name: str, value: Any) -> None:
    """ValueError unless `value` is one real number."""
    if not is_number(value):
        raise ValueError(f"{name} should be a number; found {value!r}")


def require_nonnegative(name: str, value: Any, *, allow_infinite: bool = False) -> None:
    """ValueError unless `value` is a finite number ≥ 0 (or +inf, where that means "no limit")."""
    if not is_number(value) or not value >= 0 or (value == np.inf and not allow_infinite):
        raise ValueError(f"{name} should be a number ≥ 0; found {value!r}")


def require_positive(name: str, value: Any) -> None:
    """ValueError unless `value` is a finite number > 0."""
    if not is_number(value) or not 0 < value < np.inf:
        raise ValueError(f"{name} should be a finite number > 0; found {value!r}")


def require_within(name: str, value: Any, interval: str) -> None:
    """ValueError unless `value` is one number of the interval, written as [0, 1) or (0, inf)."""
    low, high = map(float, interval[1:-1].split(","))
    above = is_number(value) and (low < value or (low == value and interval[0] == "["))
    if not above or not (value < high or (value == high and interval[-1] == "]")):
        raise ValueError(f"{name} should be in {interval}; found {value!r}")


def require_count(name: str, value: Any, least: int = 1, most: int | None = None) -> None:
    """ValueError unless `value` is an integer ≥ least, and ≤ most if given."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} should be an integer ≥ {least}; found {value!r}")
    if most is not None and value > most:
        raise ValueError(f"{name} should be an integer ≤ {most}; found {value!r}")


def require_member(name: str, value: str, members: Collection[str]) -> None:
    """ValueError that lists the right names unless `value` is one of them."""
    if not isinstance(value, str) or value not in members:
        raise not_a_member(name, value, members)


def listed(text: str) -> list[str]:
    """Words with commas between them, one by one."""
    return [word.strip() for word in text.split(",") if word.strip()]


def not_a_member(name: str, value: object, members: Collection[str], others: str = "") -> ValueError:
    """What to raise for a name that is none of the members, nor of the others, in words; it tells the nearest one."""
    from difflib import get_close_matches  # which loads what only an error needs

    nearest = get_close_matches(str(value), members, n=1)
    hint = f"; the nearest is {nearest[0]!r}" if nearest else ""
    return ValueError(f"{name} should be one of {', '.join(members)}{others}; found {value!r}{hint}")


def _as_array(name: str, values: ArrayLike) -> NDArray[Any]:
    if type(values) is np.ndarray:
        return values
    values = _detached(values)
    if _has_masked(values):
        raise ValueError(f"{name} should have no masked entries, whose values nobody vouches for; found some")
    try:
        return np.asarray(values)
    except (TypeError, ValueError, RuntimeError) as error:  # ragged lists; tensors that need their library's own way
        raise ValueError(f"{name} should be a rectangular array of numbers; found {values!r} ({error})") from error


def _detached(values: Any) -> Any:
    """What NumPy can see of tensors of PyTorch, alone or in a list: without their graph, on the CPU, in float64."""
    if isinstance(values, list | tuple):
        return [*map(_detached, values)] if any(hasattr(each, "detach") for each in values) else values
    if not hasattr(values, "detach"):
        return values
    return (values.double() if values.is_floating_point() else values).detach().cpu().numpy()


def _has_masked(values: Any, axes: int = 64) -> bool:
    """Whether an entry is masked, in lists of lists too, down to the most axes that NumPy knows."""
    if isinstance(values, list | tuple):
        parts = (part for part in values if isinstance(part, list | tuple | np.ndarray))
        return axes > 0 and any(_has_masked(part, axes - 1) for part in parts)
    # By the attribute, for np.ma is imported late, and takes as long as ten thousand solves.
    return isinstance(values, np.ndarray) and bool(np.any(getattr(values, "mask", False)))
