"""The compiled passes over long vectors: of small integers every sum is exact, in any order and any storage."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cpgrl_opt.compensated import Pair
from cpgrl_opt.vectors import ArrayVectors, is_long

STORAGES: dict[str, Callable[[np.ndarray], np.ndarray | tuple[np.ndarray, ...]]] = {
    "row by row": np.ascontiguousarray,
    "column by column": np.asfortranarray,
    "every second column": lambda J: np.repeat(J, 2, axis=1)[:, ::2],
    "backwards": lambda J: np.ascontiguousarray(J[::-1, ::-1])[::-1, ::-1],
    "rows apart": lambda J: tuple(row.copy() for row in J),
    "rows apart, backwards": lambda J: tuple(row[::-1].copy()[::-1] for row in J),
    "between other numbers": lambda J: np.rec.fromarrays([J, J.astype(np.float32)], names="wanted,other")["wanted"],
    "columns backwards": lambda J: np.asfortranarray(J[:, ::-1])[:, ::-1],
}
# Parts of threes of rows, of a block of columns, and of what is copied at a time.
SHAPES = [(0, 5), (1, 1), (2, 1024), (3, 1025), (4, 2047), (5, 67_000), (7, 15_001), (31, 13_000)]


def drawn(m: int, n: int) -> tuple[np.random.Generator, np.ndarray]:
    rng = np.random.default_rng([m, n])
    return rng, rng.integers(-99, 100, (1 + m, n)).astype(np.float64)


@pytest.mark.parametrize("storage", STORAGES.values(), ids=STORAGES)
@pytest.mark.parametrize(("m", "n"), SHAPES)
def test_inner_products_are_exact(
    m: int, n: int, storage: Callable[[np.ndarray], np.ndarray | tuple[np.ndarray, ...]]
) -> None:
    _, V = drawn(m, n)
    vectors = ArrayVectors(storage(V[:1])[0], storage(V[1:]))
    np.testing.assert_array_equal(vectors.gramian(), V @ V.T)
    np.testing.assert_array_equal(vectors.gramian_in_pairs().rounded(), V @ V.T)


@pytest.mark.parametrize("storage", STORAGES.values(), ids=STORAGES)
@pytest.mark.parametrize(("m", "n"), SHAPES)
@pytest.mark.parametrize("in_pairs", [False, True])
@pytest.mark.parametrize("off", [0.0, 0.5, 1.0])
def test_a_combination_and_its_measures_are_exact(
    m: int, n: int, storage: Callable[[np.ndarray], np.ndarray | tuple[np.ndarray, ...]], in_pairs: bool, off: float
) -> None:
    rng, V = drawn(m, n)
    vectors = ArrayVectors(storage(V[:1])[0], storage(V[1:]))
    w, mu = (rng.integers(-9, 10, k) * (rng.random(k) >= off) for k in (1 + m, m))
    more = 0.5 * rng.integers(1, 3, 1 + m) * in_pairs
    d, certificate = vectors.combine(Pair(w.astype(float), more), mu.astype(float))
    expected = (w + more) @ V
    np.testing.assert_array_equal(d, expected)
    np.testing.assert_array_equal(certificate.products, V[1:] @ expected)
    rest = expected - V[0] - mu @ V[1:]
    assert (certificate.length, certificate.rest) == (np.sqrt(expected @ expected), np.sqrt(rest @ rest))
    again = vectors.certificate(d, mu.astype(float))
    np.testing.assert_array_equal(again.products, certificate.products)
    assert (again.length, again.rest) == (certificate.length, certificate.rest)


def test_what_no_weight_asks_for_is_left_out_of_d() -> None:
    V = np.ones((3, 2000))
    V[2] = 1e300  # times anything but 0 it would be seen
    d, certificate = ArrayVectors(V[0], V[1:]).combine(Pair(np.array([1.0, 2.0, 0.0]), np.zeros(3)), np.array([2.0, 0]))
    np.testing.assert_array_equal(d, np.full(2000, 3.0))
    assert certificate.rest == 0.0


@pytest.mark.parametrize("again", [copy.deepcopy, lambda vectors: pickle.loads(pickle.dumps(vectors))])
def test_a_copy_looks_at_its_own_arrays(again: Callable[[ArrayVectors], ArrayVectors]) -> None:
    vectors = ArrayVectors(np.ones(9), np.ones((2, 9)))
    vectors.gramian()
    copied = again(vectors)
    vectors.gradient[:], vectors.jacobian[0][:] = 5.0, 7.0
    np.testing.assert_array_equal(copied.gramian(), np.full((3, 3), 9.0))


@pytest.mark.parametrize("dtype", [np.float16, np.int64, ">f8"])
def test_only_floats_of_one_length_are_looked_at(dtype: Any) -> None:
    g, J = np.ones(9), np.ones((2, 9))
    for given in (
        (g.astype(dtype), J),
        (g, J.astype(dtype)),
        (g, (J[0], J[1].astype(dtype))),
        (g[:8], J),
        (g, (J[0], J[1, :8])),
    ):
        with pytest.raises(ValueError, match="vectors should be of"):
            ArrayVectors(*given)


@pytest.mark.parametrize(
    ("m", "n", "is_it"),
    [(1, 49_999, False), (1, 50_000, True), (5, 16_666, False), (5, 16_667, True), (50, 384, False), (50, 385, True)],
)
def test_a_problem_is_long_where_it_is_solved_faster_in_coordinates(m: int, n: int, is_it: bool) -> None:
    assert is_long(m, n) == is_it


def test_what_has_nearly_as_many_rows_as_parameters_is_never_long() -> None:
    assert not is_long(5000, 20_004)
    assert is_long(5000, 20_005)
