"""The compiled passes: of small integers every sum is exact, in any order, storage and dtype; d is rounded once."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from cpgrl_opt.compensated import Pair
from cpgrl_opt.vectors import ArrayVectors, LeafVectors
from cpgrl_opt.vectors._bfloat16 import narrow, widen

from .long import STORAGES

# Parts of threes of rows, of a block of columns, and of what is copied at a time.
SHAPES = [(0, 5), (1, 1), (2, 1024), (3, 1025), (4, 2047), (5, 67_000), (7, 15_001), (31, 13_000)]


@dataclass(frozen=True, eq=False)
class Leaves(LeafVectors):
    """g's and J's parts, as they are."""

    leaves: Any = ()

    def rebuild(self, parts: list[np.ndarray]) -> list[np.ndarray]:
        return parts

    def take_apart(self, direction: list[np.ndarray], name: str = "") -> list[np.ndarray]:  # noqa: ARG002
        return direction


def held(V: np.ndarray, dtype: str) -> np.ndarray:
    """V in the dtype, which holds it exactly or rounds."""
    return narrow(V) if dtype == "bfloat16" else V.astype(dtype)


def read(part: np.ndarray) -> np.ndarray:
    return (widen(part) if part.dtype == np.uint16 else part).astype(np.float64)


def draw(m: int, n: int) -> tuple[np.random.Generator, np.ndarray]:
    rng = np.random.default_rng([m, n])
    return rng, rng.integers(-99, 100, (1 + m, n)).astype(np.float64)


def require_exact_sums(vectors: Any, V: np.ndarray, weights: list[tuple[np.ndarray, ...]], dtype: str) -> None:
    """K, K in pairs, d and its certificate; in one array of float64, d is the one number, elsewhere a list of one."""
    np.testing.assert_array_equal(vectors.gramian(), V @ V.T)
    np.testing.assert_array_equal(vectors.gramian_in_pairs().rounded(), V @ V.T)
    for w, more, mu in weights:
        d, certificate = vectors.combine(Pair(w, more), mu)
        exact = (w + more) @ V
        np.testing.assert_array_equal(d[0] if isinstance(d, list) else d, held(exact, dtype))
        np.testing.assert_array_equal(certificate.products, V[1:] @ exact)
        rest = exact - V[0] - mu @ V[1:]
        assert (certificate.length, certificate.rest) == (np.sqrt(exact @ exact), np.sqrt(rest @ rest))
        again = vectors.certificate(d, mu)
        given = read(d[0]) if isinstance(d, list) else d
        np.testing.assert_array_equal(again.products, V[1:] @ given)
        assert again.rest == np.linalg.norm(given - V[0] - mu @ V[1:])


@pytest.mark.parametrize("storage", STORAGES.values(), ids=STORAGES)
@pytest.mark.parametrize(("m", "n"), SHAPES)
def test_sums_over_arrays_are_exact_in_any_storage(m: int, n: int, storage: Any) -> None:
    rng, V = draw(m, n)
    weights = []
    for off in (0.0, 0.5, 1.0):
        w, mu = (rng.integers(-9, 10, k) * (rng.random(k) >= off) for k in (1 + m, m))
        for more in (np.zeros(1 + m), 0.5 * rng.integers(1, 3, 1 + m)):
            weights.append((w.astype(float), more, mu.astype(float)))
    J = storage(V[1:])
    vectors = ArrayVectors(storage(V[:1])[0], tuple(J) if isinstance(J, list) else J)
    require_exact_sums(vectors, V, weights, "float64")


@pytest.mark.parametrize("storage", [*STORAGES][:4])
@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
@pytest.mark.parametrize("m", [0, 3, 5])
def test_sums_over_short_numbers_are_exact_and_d_is_rounded_once(dtype: str, m: int, storage: str) -> None:
    rng, V = draw(m, 2100)
    W = STORAGES[storage](held(V, dtype))
    vectors = Leaves(((W[0], W[1:]),))
    w, mu = (rng.integers(-9, 10, k).astype(float) for k in (1 + m, m))
    require_exact_sums(vectors, V, [(w, more, mu) for more in (np.zeros(1 + m), np.full(1 + m, 0.5))], dtype)
    np.testing.assert_array_equal(vectors.whole_gradient(), V[0])
    np.testing.assert_array_equal(vectors.whole_jacobian(), V[1:])
    somebodys = vectors.certificate([w @ V], mu)  # d of float64
    np.testing.assert_array_equal(somebodys.products, V[1:] @ (w @ V))


def test_leaves_of_every_dtype_are_summed_together() -> None:
    V = [draw(4, n)[1] for n in (700, 0, 1300, 40, 2000)]
    dtypes = ["float32", "bfloat16", "float64", "float32", "bfloat16"]
    parts = [held(part, dtype) for part, dtype in zip(V, dtypes, strict=True)]
    vectors, whole = Leaves(tuple((part[0], tuple(part[1:])) for part in parts)), np.concatenate(V, axis=1)
    np.testing.assert_array_equal(vectors.gramian(), whole @ whole.T)
    np.testing.assert_array_equal(vectors.gramian_in_pairs().rounded(), whole @ whole.T)
    w = np.array([1.0, 2.0, 0.0, -3.0, 1.0])
    found, certificate = vectors.combine(Pair(w, np.zeros(5)), w[1:])
    for part, of_leaf, dtype in zip(found, V, dtypes, strict=True):
        np.testing.assert_array_equal(part, held(w @ of_leaf, dtype))
    np.testing.assert_array_equal(certificate.products, whole[1:] @ (w @ whole))
    assert certificate.rest == 0.0
    for part, again in zip(found, vectors.from_row(w @ whole), strict=True):
        np.testing.assert_array_equal(part, again)
    np.testing.assert_array_equal(vectors.row_of(found), np.concatenate([read(part) for part in found]))


def test_what_no_weight_asks_for_is_left_out_of_d() -> None:
    V = np.ones((3, 2000))
    V[2] = 1e300  # times anything but 0 it would be seen
    d, certificate = ArrayVectors(V[0], V[1:]).combine(Pair(np.array([1.0, 2.0, 0.0]), np.zeros(3)), np.array([2.0, 0]))
    np.testing.assert_array_equal(d, np.full(2000, 3.0))
    assert certificate.rest == 0.0


@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
def test_pairs_keep_what_single_sums_lose_and_zero_and_not_finite_are_seen(dtype: str) -> None:
    W = held(np.array([[2.0**60, 1.0, -(2.0**60)], [1.0, 2.0**-40, 1.0]]), dtype)
    K = Leaves(((W[0], W[1:]),)).gramian_in_pairs()
    assert K.hi[0, 1] + K.lo[0, 1] == 2.0**-40
    W = held(np.array([[1.0, 2.0], [0.0, -0.0], [0.0, 1e-38]]), dtype)
    assert [Leaves(((W[0], W[1:]),)).is_zero(i) for i in range(3)] == [False, True, False]
    for bad in (np.inf, np.nan):
        W = held(np.array([[1.0, bad], [1.0, 2.0]]), dtype)
        assert not Leaves(((W[0], W[1:]),)).are_finite()


def test_the_nearest_bfloat16_is_found_and_of_two_the_even_one() -> None:
    rng = np.random.default_rng(0)
    x = rng.standard_normal(100_000) * 10.0 ** rng.integers(-42, 38, 100_000)
    x[:3] = 1 + 2.0**-8 + 2.0**-40, 1 + 2.0**-8, 1 + 3 * 2.0**-8  # by way of float32 the first would be half way
    bits = narrow(x)
    assert widen(bits[:3]).tolist() == [1 + 2.0**-7, 1.0, 1 + 2.0**-6]
    error = np.abs(read(bits) - x)
    for step in (-1, 1):  # its neighbours on both sides
        beside = (bits + np.uint16(step % 65536)).astype(np.uint16)
        assert not (error > np.abs(read(beside) - x)).any()  # beside 0 is NaN
    every = np.arange(65536, dtype=np.uint16)
    every = every[np.isfinite(widen(every))]
    np.testing.assert_array_equal(narrow(read(every)), every)


def test_what_leaves_bfloat16_is_infinite_and_nan_stays() -> None:
    x = np.array([np.inf, -np.inf, 3.4e38, -3.4e38, 1e39, np.nan, -0.0])
    with np.errstate(over="ignore"):
        found = widen(narrow(x))
    np.testing.assert_array_equal(found, np.array([np.inf, -np.inf, np.inf, -np.inf, np.inf, np.nan, -0.0], np.float32))
    assert np.signbit(found[-1])
