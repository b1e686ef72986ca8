"""float32 and bfloat16 in the compiled passes: sums of float64, d rounded once when it has been measured."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from cpgrl_opt.compensated import Pair
from cpgrl_opt.vectors import LeafVectors
from cpgrl_opt.vectors._bfloat16 import narrow, widen

DTYPES = {"float64": np.float64, "float32": np.float32, "bfloat16": np.uint16}
STORAGES = {
    "row by row": np.ascontiguousarray,
    "column by column": np.asfortranarray,
    "every second": lambda V: np.repeat(V, 2, axis=1)[:, ::2],
    "backwards": lambda V: np.ascontiguousarray(V[:, ::-1])[:, ::-1],
}


@dataclass(frozen=True, eq=False)
class Leaves(LeafVectors):
    """g's and J's parts, as they are."""

    leaves: Any = ()

    def rebuilt(self, parts: list[np.ndarray]) -> list[np.ndarray]:
        return parts

    def taken_apart(self, direction: list[np.ndarray], name: str = "") -> list[np.ndarray]:  # noqa: ARG002
        return direction


def held(V: np.ndarray, name: str) -> np.ndarray:
    """V in the dtype, which holds it exactly or rounds."""
    return narrow(V) if name == "bfloat16" else V.astype(DTYPES[name])


def read(part: np.ndarray) -> np.ndarray:
    return widen(part).astype(np.float64) if part.dtype == np.uint16 else part.astype(np.float64)


def integers(rng: np.random.Generator, m: int, n: int) -> np.ndarray:
    return rng.integers(-99, 100, (1 + m, n)).astype(np.float64)


@pytest.mark.parametrize("storage", STORAGES.values(), ids=STORAGES)
@pytest.mark.parametrize("name", ["float32", "bfloat16"])
@pytest.mark.parametrize("m", [0, 3, 5])
def test_sums_are_exact_and_d_is_rounded_once(name: str, m: int, storage: Any) -> None:
    rng = np.random.default_rng(m)
    V = integers(rng, m, 2100)
    W = storage(held(V, name))
    vectors = Leaves(((W[0], W[1:]),))
    np.testing.assert_array_equal(vectors.gramian(), V @ V.T)
    np.testing.assert_array_equal(vectors.gramian_in_pairs().rounded(), V @ V.T)
    np.testing.assert_array_equal(vectors.whole_gradient(), V[0])
    np.testing.assert_array_equal(vectors.whole_jacobian(), V[1:])
    w, mu = (rng.integers(-9, 10, k).astype(float) for k in (1 + m, m))
    d = w @ V
    for more in (np.zeros(1 + m), np.full(1 + m, 0.5)):
        [found], certificate = vectors.combine(Pair(w, more), mu)
        exact = (w + more) @ V
        np.testing.assert_array_equal(found, held(exact, name))
        np.testing.assert_array_equal(certificate.products, V[1:] @ exact)
        assert certificate.length == np.sqrt(exact @ exact)
    for given in (held(d, name), d):  # of its own dtype, or somebody's of float64
        again = vectors.certificate([given], mu)
        np.testing.assert_array_equal(again.products, V[1:] @ read(given))
        assert again.rest == np.linalg.norm(read(given) - V[0] - mu @ V[1:])


def test_leaves_of_every_dtype_are_summed_together() -> None:
    rng, m = np.random.default_rng(1), 4
    V = [integers(rng, m, n) for n in (700, 0, 1300, 40, 2000)]
    names = ["float32", "bfloat16", "float64", "float32", "bfloat16"]
    parts = [held(part, name) for part, name in zip(V, names, strict=True)]
    vectors, whole = Leaves(tuple((part[0], tuple(part[1:])) for part in parts)), np.concatenate(V, axis=1)
    np.testing.assert_array_equal(vectors.gramian(), whole @ whole.T)
    np.testing.assert_array_equal(vectors.gramian_in_pairs().rounded(), whole @ whole.T)
    w = np.array([1.0, 2.0, 0.0, -3.0, 1.0])
    found, certificate = vectors.combine(Pair(w, np.zeros(5)), w[1:])
    for part, of_leaf, name in zip(found, V, names, strict=True):
        np.testing.assert_array_equal(part, held(w @ of_leaf, name))
    np.testing.assert_array_equal(certificate.products, whole[1:] @ (w @ whole))
    assert certificate.rest == 0.0
    for part, again in zip(found, vectors.from_row(w @ whole), strict=True):
        np.testing.assert_array_equal(part, again)
    np.testing.assert_array_equal(vectors.row_of(found), np.concatenate([read(part) for part in found]))


def test_pairs_keep_what_single_sums_lose() -> None:
    V = np.array([[2.0**60, 1.0, -(2.0**60)], [1.0, 2.0**-40, 1.0]])
    for name in ("float32", "bfloat16"):
        W = held(V, name)
        K = Leaves(((W[0], W[1:]),)).gramian_in_pairs()
        assert K.hi[0, 1] + K.lo[0, 1] == 2.0**-40


def test_zero_and_not_finite_are_seen_in_bfloat16() -> None:
    V = np.array([[1.0, 2.0], [0.0, -0.0], [0.0, 1e-38]])
    W = held(V, "bfloat16")
    assert [Leaves(((W[0], W[1:]),)).is_zero(i) for i in range(3)] == [False, True, False]
    for bad in (np.inf, np.nan):
        W = held(np.array([[1.0, bad], [1.0, 2.0]]), "bfloat16")
        assert not Leaves(((W[0], W[1:]),)).are_finite()


def test_rows_of_a_leaf_have_one_dtype() -> None:
    with pytest.raises(ValueError, match="numbers of float64"):
        Leaves(((np.ones(3), np.ones((2, 3), np.float32)),)).gramian()


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


def test_what_leaves_bfloat16_is_infinite_and_nan_stays() -> None:
    x = np.array([np.inf, -np.inf, 3.4e38, -3.4e38, 1e39, np.nan, -0.0])
    with np.errstate(over="ignore"):
        found = widen(narrow(x))
    np.testing.assert_array_equal(found, np.array([np.inf, -np.inf, np.inf, -np.inf, np.inf, np.nan, -0.0], np.float32))
    assert np.signbit(found[-1])
    every = np.arange(65536, dtype=np.uint16)
    every = every[np.isfinite(widen(every))]
    np.testing.assert_array_equal(narrow(read(every)), every)
