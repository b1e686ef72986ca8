"""Vectors of every kind for the tests: numbers in many forms, objects of the caller's, threads as processes."""

import threading
from collections import namedtuple
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import DirectionProblem
from cpgrl_opt.compensated import Pair
from cpgrl_opt.vectors import ArrayVectors


def draw(seed: int, n: int = 40, m: int = 3) -> np.ndarray:
    """[g; J] of numbers that bfloat16 holds: rows apart, opposing, dependent, or g in the span of −J."""
    V = np.random.default_rng(seed).integers(-9, 10, (1 + m, n)) / 8.0
    if seed % 4 == 1:
        V[2] = -V[1]
    if seed % 4 == 2:
        V[3] = 2.0 * V[2]
    if seed % 4 == 3:
        V[0] = -(V[1:].T @ [1.0, 0.0, 2.0])
    return V


Layer = namedtuple("Layer", ["weight", "bias"])


def as_dict(v: np.ndarray) -> Any:
    """Leaves along the last axis: of two axes, of one, of none at all; nested."""
    k = v.shape[-1] // 3
    lead = v.shape[:-1]
    return {"w": v[..., : 2 * k].reshape(*lead, 2, k), "rest": [v[..., 2 * k :], v[..., :0]]}


def as_named(v: np.ndarray) -> Any:
    k = v.shape[-1] // 4
    return (Layer(v[..., :k], v[..., k : 2 * k]), Layer(v[..., 2 * k : 3 * k], v[..., 3 * k :]))


def single(v: np.ndarray) -> Any:
    return v.astype(np.float32)


def mixed(v: np.ndarray) -> Any:
    k = v.shape[-1] // 2
    return {"half": single(v[..., :k]), "whole": v[..., k:]}


def tensors(v: np.ndarray) -> Any:
    torch, k = pytest.importorskip("torch"), v.shape[-1] // 2
    return [torch.from_numpy(single(v[..., :k])).requires_grad_(), torch.from_numpy(v[..., k:].copy())]


def short_and_long(v: np.ndarray) -> Any:
    torch, k = pytest.importorskip("torch"), v.shape[-1] // 3
    parts = (torch.from_numpy(part.copy()) for part in (v[..., :k], v[..., k : 2 * k], v[..., 2 * k :]))
    a, b, c = parts
    return {"a": a.to(torch.bfloat16), "b": (b.to(torch.float32), c)}


def of_jax(v: np.ndarray) -> Any:
    array = pytest.importorskip("jax").numpy.asarray
    return [array(v[..., :5], dtype="bfloat16"), array(v[..., 5:], dtype="float32")]


def on_a_device(v: np.ndarray) -> Any:
    """As tensors that NumPy cannot see are taken."""
    return tensors(v)


# Forms of a vector, or of rows along the last axis, with the shortest dtype in each.
FORMS: dict[str, tuple[Callable[[np.ndarray], Any], str]] = {
    "tree": (as_dict, "float64"),
    "named": (as_named, "float64"),
    "float32": (single, "float32"),
    "float32 and float64": (mixed, "float32"),
    "tensors": (tensors, "float32"),
    "tensors on a device": (on_a_device, "float32"),
    "tensors and bfloat16": (short_and_long, "bfloat16"),
    "JAX": (of_jax, "bfloat16"),
}
# From one number of a dtype to the next; of float64 what solvers leave.
ROUNDING = {"float64": 1e-12, "float32": 2.0**-23, "bfloat16": 2.0**-7}


def as_problem(
    form: Callable[[np.ndarray], Any], V: np.ndarray, *, stacked: bool = True, **rest: Any
) -> DirectionProblem:
    """[g; J] in this form; stacked: rows in one, not each."""
    g, rows = form(V[0]), form(V[1:]) if stacked else [*map(form, V[1:])]
    if form is on_a_device:
        from cpgrl_opt.vectors._tensors import TensorVectors

        return DirectionProblem(TensorVectors(g, rows), **rest)
    return DirectionProblem(g, rows, **rest)


class Kept:
    """Vectors in memory, in an object; `n` is told."""

    def __init__(self, V: np.ndarray) -> None:
        self.V, self.n, self.vectors = V, V.shape[1], ArrayVectors(V[0], V[1:])

    def gramian(self) -> np.ndarray:
        return self.vectors.find_gramian()

    def lincomb(self, weights: np.ndarray) -> Any:
        return weights @ self.V

    def extended(self, *vectors: Any) -> "Kept":
        return type(self)(np.vstack([self.V, *vectors]))


class InPairs(Kept):
    """One that offers pairs too."""

    def gramian_in_pairs(self) -> Pair:
        return self.vectors.gramian_in_pairs()

    def lincomb_in_pairs(self, hi: np.ndarray, lo: np.ndarray) -> Any:
        return self.vectors.form(Pair(hi, lo), hi)[0]


class Ranks:
    """Threads that stand for processes; what they send is counted."""

    def __init__(self, count: int) -> None:
        self.count, self.sent, self.slots = count, [list[int]() for _ in range(count)], [np.empty(0)] * count
        self.meeting = threading.Barrier(count, timeout=20.0)  # s; a rank that waits longer would wait for ever

    def run(self, work: Callable[[int, Any], Any]) -> list[Any]:
        """work(rank, gather) on each rank: what it returns or raises."""
        found: list[Any] = [None] * self.count

        def try_work(rank: int) -> None:
            try:
                found[rank] = work(rank, lambda numbers: self.gather(rank, numbers))
            except Exception as error:
                found[rank] = error

        threads = [threading.Thread(target=try_work, args=(rank,)) for rank in range(self.count)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return found

    def gather(self, rank: int, numbers: np.ndarray) -> list[np.ndarray]:
        self.slots[rank] = numbers.copy()
        self.sent[rank].append(numbers.nbytes)
        self.meeting.wait()
        gathered = list(self.slots)
        self.meeting.wait()
        return gathered
