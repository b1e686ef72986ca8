"""The gate that problems, batches and steps pass: what comes in is checked once, or a ValueError says why not."""

from functools import lru_cache
from math import isfinite
from typing import Any

import numpy as np

from .arrays import ArrayLike, Float
from .metric import check_metric
from .validation import (
    boolean_array,
    finite_array,
    freeze,
    is_finite,
    is_number,
    read_only,
    real_array,
    real_values,
    real_view,
    require_shape,
)
from .vectors import ArrayVectors, TreeVectors, Vectors, is_long, kind_of
from .vectors._trees import is_tree

_FLOAT64 = np.dtype(np.float64)


def check_arrays(
    gradient: ArrayLike, jacobian: Any, bound: ArrayLike, equality: ArrayLike, axes: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """g (…, n), J (…, m, n), b and E (…, m), copied and read-only; axes: of g, 1 for a problem and 2 for a batch."""
    packed = _pack(gradient, jacobian, bound, axes)
    if packed is not None:
        g, J, b = packed
        return g, J, b, _check_equality(equality, b.shape)
    if axes == 1:
        _require_kind_of(gradient, jacobian)
    g, J = finite_array("gradient", gradient, axes), finite_array("jacobian", jacobian, axes + 1)
    require_shape("gradient", g, (*J.shape[:-2], J.shape[-1]))
    if g.shape[-1] == 0:
        raise ValueError("gradient should have at least one component; found none")
    return g, J, *check_bounds(bound, equality, J.shape[:-1])


def _require_kind_of(gradient: Any, jacobian: Any) -> None:
    """ValueError for tensors, or arrays of float32, beside a g of float64: d would come back as none of them."""
    for row in jacobian if isinstance(jacobian, list | tuple) else [jacobian]:
        is_numpy = isinstance(row, np.ndarray)
        if is_tree(row) and not (is_numpy and type(gradient) is not np.ndarray):
            found = row.dtype if is_numpy else f"{type(row).__module__}.{type(row).__qualname__}"
            raise ValueError(f"jacobian should be of the gradient's kind, arrays of float64; found {found}")


def _pack(gradient: Any, jacobian: Any, bound: Any, axes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """g, J and b in one copy, if they are arrays of float64 that fit, with finite squares; None for all else.

    To judge all else takes as long as a solve. A view of a read-only copy cannot be made writable.
    """
    if type(gradient) is not np.ndarray or type(jacobian) is not np.ndarray or jacobian.ndim != axes + 1:
        return None
    shape = jacobian.shape
    if type(bound) is float:
        bound = _spread(bound, shape[:-1])
    if type(bound) is not np.ndarray or not (gradient.dtype is jacobian.dtype is bound.dtype is _FLOAT64):
        return None
    if gradient.shape != (*shape[:-2], shape[-1]) or bound.shape != shape[:-1] or shape[-1] == 0:
        return None
    rows = jacobian.ravel()
    packed = np.concatenate((gradient, rows, bound) if axes == 1 else (gradient.ravel(), rows, bound.ravel()))
    if not isfinite(np.vdot(packed, packed)):  # which warns of no overflow, as `dot` does
        return None
    packed.setflags(False)  # type: ignore[call-arg]  # as in `read_only`
    start, end = gradient.size, gradient.size + jacobian.size
    g, J, b = packed[:start], packed[start:end].reshape(shape), packed[end:]
    return (g, J, b) if axes == 1 else (g.reshape(gradient.shape), J, b.reshape(bound.shape))


def view_vectors(gradient: Any, jacobian: Any) -> Vectors | None:
    """g and J where they lie: a tree, a tensor, float32; long arrays of float64, J one or a list of rows; or an object.

    None for all else.
    """
    if type(gradient) is not np.ndarray or gradient.dtype is not _FLOAT64:
        vectors = kind_of(gradient, jacobian)
        if vectors is not None:
            return vectors
    rows: Any = jacobian
    if type(rows) is not np.ndarray:
        rows = tuple(map(_in_memory, rows)) if isinstance(rows, list | tuple) else _in_memory(rows)
    if type(rows) is np.ndarray:
        shape = rows.shape
    elif isinstance(rows, tuple) and rows and all(map(_is_vector, rows)) and len({len(row) for row in rows}) == 1:
        shape = len(rows), len(rows[0])
    else:
        return None
    if len(shape) != 2 or not is_long(*shape):
        return None
    rows = tuple(map(read_only, rows)) if isinstance(rows, tuple) else real_view("jacobian", rows, 2)
    g = real_view("gradient", gradient, 1)
    if len(g) != shape[1]:
        require_shape("gradient", g, shape[1:])
    return ArrayVectors(g, rows)


def _in_memory(value: Any) -> Any:
    """A file that is mapped into memory as the array that it is."""
    return value.view(np.ndarray) if type(value) is np.memmap else value


def _is_vector(row: object) -> bool:
    return type(row) is np.ndarray and row.ndim == 1 and row.dtype == np.float64


def check_metrics(metric: Any, count: int, n: int, *limits: Any) -> list[tuple[Any, Any]]:
    """(M, L) of each problem of a batch; one for all is factorized once."""
    if callable(metric):
        return [check_metric(metric, n, *limits)] * count
    given = real_values("metric", metric)
    is_one = given.ndim == 1 or (given.ndim == 3 and len(given) == 1)
    if given.ndim not in (1, 2, 3) or not (is_one or len(given) == count):
        raise ValueError(f"metric should have one entry a problem, {count}, or be one for all; found {given.shape}")
    pairs = [check_metric(each, n, *limits) for each in (given[None] if given.ndim == 1 else given)]
    return pairs * count if is_one else pairs


def metric_of_rows(vectors: Vectors, metric: Any) -> Any:
    """A metric of the caller's kind as one of arrays of float64: a tree of positive numbers, or a function of trees.

    The function is handed v in float64, since M⁻¹ is sought to 1e-12.
    """
    require_no_metric(vectors, metric)
    if metric is None or not isinstance(vectors, TreeVectors):
        return metric
    if callable(metric) and not isinstance(metric, type):
        return lambda row: vectors.row_of(metric(vectors.in_float64(row)), "what metric returns")
    is_matrix = hasattr(metric, "ndim") and metric.ndim == 2 and vectors.shape[1] == len(metric)
    return metric if is_matrix else vectors.row_of(metric, "metric")


def require_no_metric(vectors: Vectors, metric: Any) -> None:
    """ValueError for a metric beside an object that has its own."""
    if metric is not None and not vectors.has_rows:
        raise ValueError("metric should be None where gradient is an object: its `gramian` is the inner product")


def check_radii(radius: ArrayLike, count: int) -> Float[np.ndarray, "B"]:
    """The radius of each problem of a batch, or one for all; ValueError unless they are so many, finite and > 0."""
    radii = finite_array("radius", np.full(count, radius) if is_number(radius) else radius, 1)
    require_shape("radius", radii, (count,))
    if not (radii > 0).all():
        raise ValueError(f"radius should be > 0; found {radii.min()}")
    return radii


def check_bounds(bound: Any, equality: Any, shape: tuple[Any, ...]) -> tuple[np.ndarray, np.ndarray]:
    """b and E, of each row or one for all."""
    is_equality = _check_equality(equality, shape)
    if (
        type(bound) is np.ndarray
        and bound.dtype is _FLOAT64
        and bound.shape == shape
        and isfinite(np.vdot(bound, bound))
    ):
        return freeze(bound.copy()), is_equality
    if type(bound) is float and isfinite(bound):
        return _spread(bound, shape), is_equality
    b = _fill("bound", real_array("bound", bound, None), shape)
    if not is_finite(b):
        if not (b < np.inf).all():  # NaN fails the comparison too
            raise ValueError("bound should be finite, or −inf on an inequality; found NaN or +inf")
        if (is_equality & (b == -np.inf)).any():
            raise ValueError("bound should be finite on an equality; found −inf")
    return b, is_equality


def _check_equality(equality: Any, shape: tuple[Any, ...]) -> np.ndarray:
    if type(equality) is bool:
        return _spread(equality, shape)
    return _fill("equality", freeze(np.array(boolean_array("equality", equality), order="C")), shape)


@lru_cache(maxsize=32, typed=True)  # 0.0 is not False
def _spread(value: float | bool, shape: tuple[Any, ...]) -> np.ndarray:
    """One value for all, made once: np.full takes as long as a solve, and nobody can write to it."""
    return freeze(np.full(shape, value))


def _fill(name: str, array: np.ndarray, shape: tuple[Any, ...]) -> np.ndarray:
    """The array, or the one number for all that it is."""
    array = freeze(np.full(shape, array)) if array.ndim == 0 else array
    require_shape(name, array, shape)
    return array
