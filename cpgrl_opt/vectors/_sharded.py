"""Vectors spread over processes, each of which holds its own part of g and of every row of J.

    K = Σ K_p,   d_p = V_pᵀw,   [r·r, J d, d·d] = Σ [r_p·r_p, J_p d_p, d_p·d_p]       p = 0, 1, …: ranks

Every process solves the same small problem and forms its own part of d. No vector travels, but O(m²) numbers for K, for
K in pairs, and for each d that is formed or measured. They are gathered, and added up in pairs by every process itself:
all go on from the same bits. With its numbers each process says what they are of, and whether it failed; so an error on
one is an error on all, in what it was called with too. A process that is no longer there is for the library that
gathers to see.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NoReturn

import numpy as np

from ..arrays import Float
from ..compensated import Pair
from ..validation import real_view, require_shape
from ._kinds import kind_of
from ._numpy import REPRESENTABLE, ArrayVectors
from ._torch import gather_by_torch
from .interface import Sums, Vectors

Gather = Callable[[np.ndarray], Sequence[np.ndarray]]
_CALLS = 6  # of which a message may be
_GRAMIAN, _PAIRS, _FORM, _MEASURE, _IS_ZERO, _AGREE = range(_CALLS)
# Weights of processes on unlike processors may differ by rounding, 1e-16 times what rows 1e-2 rad from dependence make
# of it, or 1e-12; what differs by more comes of unlike bounds, which a larger part would hide as far as it reaches.
_SAME = 1e-9
_TEXT = 512  # bytes of an error's message that the other ranks are told


class Sharded(Vectors):
    """The part of g and J that this process holds, of any kind, and a way to all parts.

    gather: numbers of this process → those of all, in the order of their ranks, as `MPI.COMM_WORLD.allgather` of mpi4py
    does; by default `torch.distributed` over its default group, another by `partial(gather_by_torch, group=group)`.
    Each process makes the same calls with the same bounds; d is its own part, in the form of its g. Raises ValueError
    on all where one part does not fit or numbers of rows differ.
    """

    def __init__(self, gradient: Any, jacobian: Any = None, *, gather: Gather = gather_by_torch) -> None:
        if not callable(gather):
            raise ValueError(f"gather should be a function of an array of numbers; found {gather!r}")
        self._gather = gather
        self._known: Exception | None = None  # the last error of which all ranks know

        def find() -> list[Any]:
            self.part = _part_of(gradient, jacobian)
            if self.part.shape[1] > 0:  # there may be none here
                self.part.require_finite()
            return [*self.part.shape, self.part.has_pairs]

        m, n, has_pairs = self._meet(4, find).T
        if len({*m}) > 1:
            raise ValueError(f"all ranks should have one number of rows; found {m.astype(int).tolist()}")
        if not n.any():
            raise ValueError("gradient should have at least one component; found none on any rank")
        self._shape, self.has_pairs = (int(m[0]), int(n.sum())), bool(has_pairs.all())

    @property
    def gradient(self) -> Any:  # an attribute would be a circle, and parts would live on
        """It is they."""
        return self

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n) of all parts together."""
        return self._shape

    def are_finite(self) -> bool:
        """Else it would not be here."""
        return True

    def agree(self, work: Callable[..., Any], *arguments: Any) -> Any:
        """ValueError on all ranks, too, where they return unlike numbers."""
        found: list[Any] = []

        def find() -> tuple[np.ndarray, Any]:
            found.extend(work(*arguments))
            return np.concatenate([np.ravel(each) for each in found if each is not None]), ()

        self._sum(_AGREE, find)
        return found

    def attempt(self, work: Callable[..., Any], *arguments: Any) -> Any:
        """An error that is no answer to what another rank said is told to them."""
        try:
            return work(*arguments)
        except Exception as error:
            if error is not self._known:
                self._sum(_AGREE, partial(_raise, error))
            raise

    def is_zero(self, index: int) -> bool:
        """On all ranks."""
        return not self._sum(_IS_ZERO, lambda: ([index], [not self.part.is_zero(index)])).hi[0]

    def find_gramian(self) -> Float[np.ndarray, "channels channels"]:
        """The sum of those of all parts."""
        count = 1 + self._shape[0]
        return self._sum(_GRAMIAN, lambda: ([], self.part.gramian())).hi.reshape(count, count)

    def gramian_in_pairs(self) -> Pair:
        """The same in pairs."""
        count = 1 + self._shape[0]
        sums = self._sum(_PAIRS, lambda: ([], self.part.gramian_in_pairs()))
        hi, lo = (part.reshape(2, count, count) for part in sums)
        return Pair(hi[0], lo[0]).plus(Pair(hi[1], lo[1]))

    def form(self, weights: Pair, forces: Float[np.ndarray, "channels"]) -> tuple[Any, Sums]:
        """The part of d on this rank; the sums are NaN where a part is not finite in its dtype."""
        formed = []

        def find() -> tuple[Any, Sums]:
            d, sums = self.part.form(weights, forces)
            formed.append(d)
            is_finite = sums[-1] <= REPRESENTABLE or self.part.is_representable(d)
            return [*weights, forces], sums if is_finite else np.nan * sums

        sums = self._sum(_FORM, find).hi
        return formed[0], sums

    def measure(self, direction: Any, forces: Float[np.ndarray, "channels"]) -> Sums:
        """Of the d whose part on this rank it is."""
        return self._sum(_MEASURE, lambda: (forces, self.part.measure(direction, forces))).hi

    def _sum(self, what: int, find: Callable[[], tuple[Any, Any]]) -> Pair:
        """The sum over all ranks of the numbers, the second, that each finds.

        ValueError on all where the call, or the first, which they are asked of, are not the same on all.
        """
        channels, parts = 1 + self._shape[0], list[np.ndarray]()

        def message() -> np.ndarray:
            parts.extend(map(np.ravel, find()))
            return np.concatenate([[what + _CALLS * len(parts[0])], *parts])

        said = self._meet(2 + 3 * channels + 2 * channels**2, message)
        ends = np.cumsum([1, *map(len, parts)])
        call, asked, numbers, _ = np.split(said, ends, axis=1)
        size = _SAME * np.abs(asked[np.isfinite(asked)]).max(initial=0.0)
        with np.errstate(invalid="ignore", over="ignore"):  # beside rank 0, so that all ranks come to the same end
            is_same = (asked == asked[0]) | (np.abs(asked - asked[0]) <= size)
            if not ((call == call[0]).all() and is_same.all()):
                self._known = ValueError("all ranks should solve the same problem; found bounds or calls that differ")
                raise self._known
            numbers = np.ascontiguousarray(numbers.T)
            return Pair(numbers, np.zeros_like(numbers)).sums()

    def _meet(self, size: int, find: Callable[[], Any]) -> np.ndarray:
        """(ranks, size − 1): the numbers that each finds. An error on one is raised there, and is a ValueError on all.

        All messages but the first are of one size: so whatever the others are about, they learn of an error.
        """
        message, failure = np.zeros(size), None
        try:
            found = np.ravel(find())
            message[1 : 1 + len(found)] = found
        except Exception as error:  # raised when the others know
            failure, message[0] = error, 1.0
        try:
            said = np.array(self._gather(message))
            failed = np.flatnonzero(said[:, 0])
            if failed.size:
                texts = self._gather(_encode(str(failure)))
                told = "; ".join(f"rank {k}: {_decode(texts[k])}" for k in failed.tolist())
                raise failure or ValueError(f"all ranks should bring what is asked of them; found on {told}")
        except Exception as error:
            self._known = error
            raise
        return said[:, 1:]


def _part_of(gradient: Any, jacobian: Any) -> Vectors:
    """The part of this process, of any kind."""
    vectors = kind_of(gradient, jacobian)
    if vectors is not None:
        return vectors
    g, J = real_view("gradient", gradient, 1), real_view("jacobian", jacobian, 2)
    require_shape("gradient", g, (J.shape[1],))
    return ArrayVectors(g, J)


def _encode(text: str) -> np.ndarray:
    """A text as so many numbers, which all ways of gathering know."""
    return np.frombuffer(text.encode()[:_TEXT].ljust(_TEXT), np.uint8).astype(np.float64)


def _decode(numbers: np.ndarray) -> str:
    return bytes(np.asarray(numbers).astype(np.uint8)).decode(errors="ignore").rstrip()


def _raise(error: Exception) -> NoReturn:
    raise error
