"""The direction problem: validated once, on construction; and its scaling to unit rows.

    min_d ½‖d − g‖²   s.t.   Jᵢ d ≥ bᵢ (i ∈ I),   Jᵢ d = bᵢ (i ∈ E)

With b = 0 its solution points the way of max_s gᵀs, ‖s‖ = 1, the problem of §2.3 of the paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from jaxtyping import Bool, Float

from .arrays import ArrayLike, Jacobian, Mask, Multipliers, Vector
from .validation import finite_array, mask_array, real_array, require_shape


@dataclass(frozen=True, init=False, eq=False)
class DirectionProblem:
    """min ½‖d − g‖² s.t. Jᵢd ≥ bᵢ, with equality where `equality` says so.

    gradient g: (n,), ascent gradient of the objective; jacobian J: (m, n), constraint gradients as rows;
    bound b: (m,) or one number for all, −inf switches an inequality off; equality: (m,) or one truth value
    for all. Arrays are copied and made read-only.
    Raises ValueError for NaN, infinities (but −inf in an inequality's bound), wrong shapes, non-numbers.
    """

    gradient: Vector
    jacobian: Jacobian
    bound: Multipliers
    equality: Mask

    def __init__(
        self,
        gradient: ArrayLike,
        jacobian: ArrayLike,
        bound: ArrayLike = 0.0,
        equality: ArrayLike = False,
    ) -> None:
        g = finite_array("gradient", gradient, 1)
        J = finite_array("jacobian", jacobian, 2)
        m, n = J.shape
        require_shape("gradient", g, (n,))
        if n == 0:
            raise ValueError("gradient should have at least one component; found none")
        b = real_array("bound", np.full(m, bound) if np.ndim(bound) == 0 else bound, 1)
        is_equality = mask_array("equality", np.full(m, equality) if np.ndim(equality) == 0 else equality)
        require_shape("bound", b, (m,))
        require_shape("equality", is_equality, (m,))
        _require_bounds(b, is_equality)
        _set_fields(self, g, J, b, is_equality)

    @property
    def n(self) -> int:
        """Number of parameters."""
        return int(self.jacobian.shape[1])

    @property
    def m(self) -> int:
        """Number of constraints."""
        return int(self.jacobian.shape[0])


@dataclass(frozen=True, init=False, eq=False)
class ProblemBatch(Sequence[DirectionProblem]):
    """B direction problems of one shape, stacked; reads as a sequence of `DirectionProblem`.

    gradient: (B, n); jacobian: (B, m, n); bound, equality: (B, m). Inside a batch, a constraint that is
    not in one problem's active set has bound −inf and equality False there. Raises as `DirectionProblem`.
    """

    gradient: Float[np.ndarray, "B n"]
    jacobian: Float[np.ndarray, "B m n"]
    bound: Float[np.ndarray, "B m"]
    equality: Bool[np.ndarray, "B m"]

    def __init__(self, gradient: ArrayLike, jacobian: ArrayLike, bound: ArrayLike, equality: ArrayLike) -> None:
        g, J, b = (np.ascontiguousarray(array, dtype=np.float64) for array in (gradient, jacobian, bound))
        is_equality = np.ascontiguousarray(equality, dtype=np.bool_)
        if J.ndim != 3 or J.shape[2] == 0:
            raise ValueError(f"jacobian should have shape (B, m, n) with n ≥ 1; found {J.shape}")
        runs, m, n = J.shape
        require_shape("gradient", g, (runs, n))
        require_shape("bound", b, (runs, m))
        require_shape("equality", is_equality, (runs, m))
        if not (np.isfinite(g).all() and np.isfinite(J).all()):
            raise ValueError("gradient and jacobian should be finite; found NaN or infinity")
        _require_bounds(b, is_equality)
        _set_fields(self, g, J, b, is_equality)

    @classmethod
    def trusted(
        cls,
        gradient: Float[np.ndarray, "B n"],
        jacobian: Float[np.ndarray, "B m n"],
        bound: Float[np.ndarray, "B m"],
        equality: Bool[np.ndarray, "B m"],
    ) -> "ProblemBatch":
        """A batch of C-contiguous float64 and bool arrays that were checked before: no copies, no checks."""
        batch = object.__new__(cls)
        _set_fields(batch, gradient, jacobian, bound, equality)
        return batch

    @classmethod
    def stack(cls, problems: Sequence[DirectionProblem]) -> "ProblemBatch":
        """The same problems in stacked arrays; ValueError unless there is at least one and all have one shape."""
        if isinstance(problems, cls):
            return problems
        shapes = {problem.jacobian.shape for problem in problems}
        if len(shapes) != 1:
            raise ValueError(f"problems should have one shape; found {sorted(shapes) or 'no problem'}")
        return cls(
            np.stack([problem.gradient for problem in problems]),
            np.stack([problem.jacobian for problem in problems]),
            np.stack([problem.bound for problem in problems]),
            np.stack([problem.equality for problem in problems]),
        )

    def chosen(self, mask: Bool[np.ndarray, "B"]) -> "ProblemBatch":
        """The problems where the mask is True."""
        return ProblemBatch(self.gradient[mask], self.jacobian[mask], self.bound[mask], self.equality[mask])

    def __len__(self) -> int:
        return len(self.gradient)

    @overload
    def __getitem__(self, index: int) -> DirectionProblem: ...
    @overload
    def __getitem__(self, index: slice) -> "ProblemBatch": ...
    def __getitem__(self, index: int | slice) -> "DirectionProblem | ProblemBatch":
        parts = (self.gradient[index], self.jacobian[index], self.bound[index], self.equality[index])
        return ProblemBatch(*parts) if isinstance(index, slice) else DirectionProblem(*parts)


def _set_fields(frozen: object, g: np.ndarray, J: np.ndarray, b: np.ndarray, is_equality: np.ndarray) -> None:
    object.__setattr__(frozen, "gradient", g)
    object.__setattr__(frozen, "jacobian", J)
    object.__setattr__(frozen, "bound", b)
    object.__setattr__(frozen, "equality", is_equality)


def _require_bounds(bound: Float[np.ndarray, "..."], equality: Bool[np.ndarray, "..."]) -> None:
    if not (bound < np.inf).all():  # NaN fails the comparison too
        raise ValueError("bound should be finite, or −inf on an inequality; found NaN or +inf")
    if (equality & (bound == -np.inf)).any():
        raise ValueError("bound should be finite on an equality; found −inf")


@dataclass(frozen=True, eq=False)
class UnitRows:
    """Ĵᵢ = Jᵢ/‖Jᵢ‖ and the lengths ‖Jᵢ‖ = largest · relative, kept as two factors so that neither overflows.

    jacobian: (m, n), rows of length 1, or 0 where Jᵢ = 0; largest: max |Jᵢⱼ|; relative: ‖Jᵢ/largest‖ ≥ 1.
    """

    jacobian: Jacobian
    largest: Multipliers
    relative: Multipliers

    def per_length(self, values: Multipliers) -> Multipliers:
        """valuesᵢ / ‖Jᵢ‖; on zero rows ±inf with the sign of the value, 0 stays 0."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            quotient = values / self.largest / self.relative
        return np.where(values == 0, 0.0, quotient)

    def times_length(self, values: Multipliers, scale: float = 1.0) -> Multipliers:
        """valuesᵢ · ‖Jᵢ‖ / scale, the division first."""
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            product = values * (self.largest / scale) * self.relative
        return np.where(values == 0, 0.0, product)


def unit_rows(jacobian: Jacobian) -> UnitRows:
    """Ĵ with unit rows: scaled by the largest entry first, so that rows of 1e±170 neither over- nor underflow."""
    rows, largest, relative = _largest_first(jacobian)
    return UnitRows(rows / relative[:, None], largest, relative)


def lengths(vectors: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch"]:
    """‖v‖₂ along the last axis, by the largest entry first: 1e±170 neither over- nor underflows."""
    _, largest, relative = _largest_first(vectors)
    with np.errstate(over="ignore"):  # infinite beyond 1.8e308: callers refuse it
        return np.asarray(largest * relative)


def _largest_first(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """v/max|v|, max|v| and ‖v/max|v|‖ along the last axis; v, 0 and 1 where v = 0."""
    largest = np.abs(vectors).max(axis=-1, initial=0.0)
    scaled = vectors / np.where(largest > 0, largest, 1.0)[..., None]
    relative = np.where(largest > 0, np.sqrt(np.einsum("...i,...i->...", scaled, scaled)), 1.0)
    return scaled, np.asarray(largest), np.asarray(relative)
