"""Vectors spread over processes, each of which holds its own part of g and of every row of J.

    K = Σ K_p,   d_p = V_pᵀw,   [r·r, J d, d·d] = Σ [r_p·r_p, J_p d_p, d_p·d_p]       p = 0, 1, …: ranks

Every process solves the same small problem and forms its own part of d. No vector travels, but O(m²) numbers for K, for
K in pairs, and for each d that is formed or measured. They are gathered, and added up in pairs by every process itself:
all go on from the same bits. With its numbers each process says what they are of, and whether it failed; so an error on
one is an error on all. A process that is no longer there is for the library that gathers to see.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..arrays import Float
from ..compensated import Pair
from ..validation import real_view, require_shape
from ._kinds import kind_of
from ._numpy import ArrayVectors
from ._torch import gather_by_torch
from .interface import Sums, Vectors

Gather = Callable[[np.ndarray], Sequence[np.ndarray]]
_GRAMIAN, _PAIRS, _FORM, _MEASURE, _IS_ZERO = range(5)
# Weights of processes on unlike processors may differ by rounding; what differs by more comes of unlike bounds.
_SAME = 1e-9


class Sharded(Vectors):
    """The part of g and J that this process holds, of any kind, and a way to all parts.

    gather: numbers of this process → those of all, in the order of their ranks, as `MPI.COMM_WORLD.allgather` of mpi4py
    does; by default `torch.distributed` over its default group, another by `partial(gather_by_torch, group=group)`.
    Each process makes the same calls with the same bounds; d is its own part, in the form of its g. Raises ValueError
    on all where one part does not fit or numbers of rows differ.
    """

    jacobian = None  # it is in the parts

    def __init__(self, gradient: Any, jacobian: Any = None, *, gather: Gather = gather_by_torch) -> None:
        self._gather, failure, (m, n), is_finite, has_pairs = gather, None, (0, 0), True, True
        try:
            self.part = _part_of(gradient, jacobian)
            (m, n), is_finite, has_pairs = self.part.shape, self.part.are_finite(), self.part.has_pairs
        except Exception as error:  # raised when the others know
            failure = error
        said = np.array(gather(np.array([failure is not None, m, n, not is_finite, has_pairs], np.float64)))
        _require_success(failure, said[:, 0])
        if len({*said[:, 1]}) > 1:
            raise ValueError(f"all ranks should have one number of rows; found {said[:, 1].astype(int).tolist()}")
        if not said[:, 2].any():
            raise ValueError("gradient should have at least one component; found none on any rank")
        self._not_finite = np.flatnonzero(said[:, 3])
        self._shape, self._has_pairs = (m, int(said[:, 2].sum())), bool(said[:, 4].all())

    @property
    def gradient(self) -> Any:
        """As `DirectionProblem` takes it."""
        return self

    def channels(self) -> Any:
        """It is they."""
        return self

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n) of all parts together."""
        return self._shape

    def are_finite(self) -> bool:
        """On all ranks."""
        return not self._not_finite.size

    def require_finite(self) -> None:
        """ValueError on all ranks."""
        if self._not_finite.size:
            raise ValueError(
                f"gradient and jacobian should be finite; found NaN or infinity on rank {self._not_finite}"
            )

    def is_zero(self, index: int) -> bool:
        """On all ranks."""
        nothing = self._sum(_IS_ZERO, [index], 1, lambda: [not self.part.is_zero(index)])
        return not nothing.hi[0]

    def find_gramian(self) -> Float[np.ndarray, "channels channels"]:
        """The sum of those of all parts."""
        count = 1 + self._shape[0]
        return self._sum(_GRAMIAN, [], count**2, lambda: self.part.gramian().ravel()).hi.reshape(count, count)

    @property
    def has_pairs(self) -> bool:
        """Where all parts have."""
        return self._has_pairs

    def gramian_in_pairs(self) -> Pair:
        """The same in pairs."""
        count = 1 + self._shape[0]
        sums = self._sum(_PAIRS, [], 2 * count**2, lambda: np.ravel(self.part.gramian_in_pairs()))
        hi, lo = (part.reshape(2, count, count) for part in sums)
        return Pair(hi[0], lo[0]).plus(Pair(hi[1], lo[1]))

    def form(self, weights: Pair, forces: Float[np.ndarray, "channels"]) -> tuple[Any, Sums]:
        """The part of d on this rank; the sums are NaN where a part is not finite in its dtype."""
        formed = []

        def find() -> np.ndarray:
            d, sums = self.part.form(weights, forces)
            formed.append(d)
            return sums if self.part.is_representable(d) else np.full(len(sums), np.nan)

        sums = self._sum(_FORM, np.concatenate([*weights, forces]), 1 + len(forces), find).hi
        return formed[0], sums

    def measure(self, direction: Any, forces: Float[np.ndarray, "channels"]) -> Sums:
        """Of the d whose part on this rank it is."""
        return self._sum(_MEASURE, forces, 1 + len(forces), lambda: self.part.measure(direction, forces)).hi

    def _sum(self, what: int, asked: Any, count: int, find: Callable[[], Any]) -> Pair:
        """The sum over all ranks of what each finds; ValueError on all where they ask for different things."""
        channels = 1 + self._shape[0]
        message, failure, end = np.zeros(2 + 3 * channels + 2 * channels**2), None, 2 + len(asked)
        message[0], message[2:end] = what, asked
        try:
            message[end : end + count] = find()
        except Exception as error:  # raised when the others know
            failure = error
        message[1] = failure is not None
        said = np.array(self._gather(message))
        _require_success(failure, said[:, 1])
        apart = np.abs(said[:, 2:end] - message[2:end]).max(initial=0.0)
        if (said[:, 0] != what).any() or not apart <= _SAME * np.abs(message[2:end]).max(initial=0.0):
            raise ValueError("all ranks should solve the same problem; found bounds or calls that differ")
        with np.errstate(invalid="ignore", over="ignore"):
            numbers = np.ascontiguousarray(said[:, end : end + count].T)
            return Pair(numbers, np.zeros_like(numbers)).sums()


def _part_of(gradient: Any, jacobian: Any) -> Vectors:
    """The part of this process, of any kind."""
    vectors = kind_of(gradient, jacobian)
    if vectors is not None:
        return vectors
    g, J = real_view("gradient", gradient, 1), real_view("jacobian", jacobian, 2)
    require_shape("gradient", g, (J.shape[1],))
    return ArrayVectors(g, J)


def _require_success(failure: Exception | None, failed: np.ndarray) -> None:
    """The error of this rank; or ValueError that says on which rank there is one."""
    if failure is not None:
        raise failure
    if failed.any():
        raise ValueError(f"all ranks should bring their part; found an error on rank {np.flatnonzero(failed)}")
