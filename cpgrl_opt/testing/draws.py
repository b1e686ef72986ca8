"""Whole arrays drawn at once: small integers, options, orders, and the shapes of problems.

A number of a small array is a byte that shrinks on its own; a large array comes from a random generator whose seed is
drawn, and from the share of its entries that are not the simplest, which shrinks to few.
"""

import math
from collections.abc import Collection, Hashable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import Any, TypeVar

import numpy as np
from hypothesis import strategies as st

from ..arrays import Float, Int

T = TypeVar("T")

LARGEST_ENTRY = 9
# Shapes (n, m) and how often they come up; Hypothesis shrinks to the first. Two rows, few parameters and as many rows
# as parameters are what solvers have closed forms for, long and wide ones what they have other algorithms for. 12 rows
# are the most that `enumeration` takes.
_TIMES = {
    (2, 1): 2,
    (1, 1): 2,
    (2, 2): 3,
    (1, 2): 1,
    (3, 2): 4,
    (2, 3): 2,
    (3, 3): 1,
    (9, 2): 1,
    (9, 3): 3,
    (3, 5): 2,
    (4, 4): 1,
    (7, 4): 1,
    (5, 5): 2,
    (8, 6): 1,
    (6, 9): 1,
    (12, 8): 1,
    (3, 12): 1,
    (200, 3): 1,
    (40, 12): 1,
}
SHAPES = tuple(_TIMES)
_SMALL = 3
MOST_PARAMETERS, MOST_ROWS = 60, 12
# A fault at a shape that is not listed is found too: one problem out of so many has any.
_ANY_SHAPE = 6

# Each array is one draw of so many bytes, whatever its shape: where Hypothesis tries a smaller shape, all other arrays
# stay what they are. All draws are of one size, for where it copies one over another of another size it puts zeros.
_BLOCK_SIZE = 16
_STRIDE = 4  # of the rows of small matrices, so that a smaller shape is a corner of the larger
_only_small: ContextVar[bool] = ContextVar("only_small", default=False)
_only_these: ContextVar[tuple[tuple[int, int], ...]] = ContextVar("only_these", default=())
_BLOCK = st.binary(min_size=_BLOCK_SIZE, max_size=_BLOCK_SIZE)
_THREE_BYTES = st.binary(min_size=3, max_size=3)


@cache  # a strategy is examined by Hypothesis when it is first drawn from, which takes longer than the draw
def _any_of(options: tuple[Hashable, ...]) -> st.SearchStrategy[Any]:
    return st.sampled_from(options)


def any_of(options: Sequence[T]) -> st.SearchStrategy[T]:
    """One of the options, the first being the simplest."""
    return _any_of(tuple(options))


@cache
def between(lowest: int, highest: int) -> st.SearchStrategy[int]:
    """An integer, the one nearest to 0 being the simplest."""
    return st.integers(lowest, highest)


def shape(
    draw: st.DrawFn, *, least_rows: int = 1, least_parameters: int = 1, most_rows: int = MOST_ROWS
) -> tuple[int, int]:
    """(n, m), often one of `SHAPES`, else any up to (60, 12); small ones first, or alone within `small_shapes`."""
    choice, n, m = draw(_THREE_BYTES)
    these = [(n, m) for n, m in _only_these.get() if n >= least_parameters and least_rows <= m <= most_rows]
    often = these or _listed(least_rows, least_parameters, most_rows, are_small())
    listed = often[choice % len(often)]
    parameters, rows = MOST_PARAMETERS - least_parameters + 1, most_rows - least_rows + 1
    return listed or (least_parameters + n % parameters, least_rows + m % rows)


@cache
def _listed(
    least_rows: int, least_parameters: int, most_rows: int, is_small: bool
) -> tuple[tuple[int, int] | None, ...]:
    """The listed shapes as often as they should come up; None for any other."""
    listed = [(n, min(m, most_rows)) for (n, m), times in _TIMES.items() for _ in range(times)]
    listed = [(n, m) for n, m in listed if n >= least_parameters and m >= least_rows]
    if is_small:
        return tuple((n, m) for n, m in dict.fromkeys(listed) if max(n, m) <= _SMALL)
    return (*listed, *[None] * (len(listed) // (_ANY_SHAPE - 1) + 1))


def are_small() -> bool:
    """Whether `small_shapes` is in force."""
    return _only_small.get()


@contextmanager
def small_shapes() -> Iterator[None]:
    """Inside, no shape is larger than (3, 3), and no batch longer than four: for a counterexample checked by hand."""
    token = _only_small.set(True)
    try:
        yield
    finally:
        _only_small.reset(token)


@contextmanager
def only_shapes(these: Collection[tuple[int, int]]) -> Iterator[None]:
    """Inside, shapes are of these, if there are any: a solver of a shape that is seldom drawn takes no others."""
    token = _only_these.set(tuple(these))
    try:
        yield
    finally:
        _only_these.reset(token)


def parts(draw: st.DrawFn, count: int, length: int) -> list[st.DrawFn]:
    """Up to four arrays of one length in a single block where they are short: each stands for a `draw` of its own.

    A choice costs Hypothesis more than its bytes. For what is 0 in most counterexamples, since they shrink together.
    """
    if length > _STRIDE:
        return [draw] * count
    block = draw(_BLOCK)

    def part(k: int) -> Any:
        return lambda _: block[k * _STRIDE : (k + 1) * _STRIDE].ljust(_BLOCK_SIZE, b"\0")

    return [part(k) for k in range(count)]


def integers(
    draw: st.DrawFn, *shape: int, lowest: int = -LARGEST_ENTRY, largest: int = LARGEST_ENTRY
) -> Float[np.ndarray, "..."]:
    """Integers lowest … largest as floats: 0 (or lowest ≥ 0) first, then 1, −1, 2, −2 …"""
    return _pick(draw(_BLOCK), shape, _by_size(lowest, largest))


def picks(draw: st.DrawFn, count: int, options: Sequence[float]) -> Float[np.ndarray, "count"]:
    """`count` of the options, the first being the simplest."""
    return _pick(draw(_BLOCK), (count,), _array(tuple(options)))


def orders(draw: st.DrawFn, count: int) -> Int[np.ndarray, "count"]:
    """A permutation of 0 … count − 1 ≤ 15, the identity being the simplest."""
    order: np.ndarray = np.argsort(np.frombuffer(draw(_BLOCK), dtype=np.uint8)[:count], kind="stable")
    return order


@cache
def _by_size(lowest: int, largest: int) -> Float[np.ndarray, "..."]:
    if lowest < 0:
        return _array((0.0, *(float(sign * k) for k in range(1, largest + 1) for sign in (1, -1))))
    return _array(tuple(float(k) for k in range(lowest, largest + 1)))


@cache
def _array(options: tuple[float, ...]) -> Float[np.ndarray, "..."]:
    return np.array(options, dtype=np.float64)


def _pick(block: bytes, shape: tuple[int, ...], values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """One value for each byte; a larger array by a generator that the block seeds, its first byte saying how full."""
    drawn = np.frombuffer(block, dtype=np.uint8)
    count, (rows, columns) = math.prod(shape), (1, *shape)[-2:]
    if columns <= _STRIDE and rows <= _BLOCK_SIZE // _STRIDE:
        drawn = drawn.reshape(-1, _STRIDE)[:rows, :columns]
    elif count > _BLOCK_SIZE:
        rng = np.random.default_rng(drawn)
        full = min(float(drawn[0]) / 128.0, 1.0)  # half of all are
        return np.where(rng.random(shape) < full, rng.choice(values, shape), values[0])
    else:
        drawn = drawn[:count]
    picked: np.ndarray = values[drawn % len(values)].reshape(shape)
    return picked
