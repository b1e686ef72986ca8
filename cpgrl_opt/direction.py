"""The answer to a direction problem: a direction, its multipliers, and a status that is advice."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, NamedTuple, overload

import numpy as np

from .arrays import Bool, Float, Int, Multipliers
from .validation import read_only, real_values


class Status(IntEnum):
    """What a solver claims of its answer; `advice` says what to do about it. Only OPTIMAL is certified optimal."""

    OPTIMAL = 0
    INFEASIBLE = 1
    UNCERTIFIED = 2
    ITERATION_LIMIT = 3
    NUMERICAL_ERROR = 4
    UNSUPPORTED = 5

    @property
    def advice(self) -> str:
        """What the status means for the user, in a sentence or two."""
        return _ADVICE[self]

    def __str__(self) -> str:
        return f"{self.name}: {self.advice}"


_ADVICE = {
    Status.OPTIMAL: "the optimum; every KKT residual is within the solver's tolerance.",
    Status.INFEASIBLE: (
        "no direction meets all constraints, or none shorter than bᵀy/‖Jᵀy‖, usually 1e13 times the bounds. The value "
        "violates them least; the multipliers y prove it (Farkas). "
        "Lower the thresholds or the restoration rate, or drop a constraint."
    ),
    Status.UNCERTIFIED: (
        "the best direction found, but kkt_residuals rejects it at the solver's tolerance. "
        "Look at the residuals; try active-set, or a larger tolerance."
    ),
    Status.ITERATION_LIMIT: (
        "stopped at the iteration or time limit; kkt_residuals says how far off the value is. "
        "Raise the limit, or try active-set."
    ),
    Status.NUMERICAL_ERROR: "the back end broke down and gave no direction. Try active-set.",
    Status.UNSUPPORTED: (
        "this solver does not take such problems (see its supports()). Try active-set, or another formulation."
    ),
}


class KKTResiduals(NamedTuple):
    """Four relative residuals, each 0 at an exact optimum; infinite where an answer is not finite."""

    stationarity: float
    primal: float
    dual: float
    complementarity: float

    @property
    def worst(self) -> float:
        """The largest of the four; infinite where one is NaN, which `max` would hide."""
        total = sum(self)
        return max(self) if total == total else math.inf


class DirectionError(RuntimeError):
    """A direction was needed and the solver had no certified one."""


@dataclass(frozen=True, eq=False)
class Direction:
    """d = g + Jᵀμ with its multipliers μ (≥ 0 on inequalities) and what is claimed of it.

    In a metric Md = g + Jᵀμ, in a ball κMd = g + Jᵀμ. value: (n,), or in the
    form in which g came; multipliers: (m,), for INFEASIBLE a Farkas vector y
    (y ≥ 0 on I, Jᵀy = 0, bᵀy > 0; or bᵀy > radius ‖Jᵀy‖_M⁻¹ where the ball misses the constraints).
    iterations: as the method counts them; radius_multiplier κ ≥ 0: 0 where the ball is slack, or there is none;
    residuals: those that an OPTIMAL was granted on, else None; rung: how g and J were looked at, "gramian", "pairs"
    (see `reduction`) or "rows"; "" where the solver does not say.
    Source: §2.3 of the paper, where λ = −μ.
    """

    value: Any  # Vector, or what it stands for
    multipliers: Multipliers
    status: Status
    iterations: int = 0
    radius_multiplier: float = 0.0
    residuals: KKTResiduals | None = None
    rung: str = ""

    @classmethod
    def make(
        cls, value: Any, multipliers: Multipliers, status: Status, iterations: int, residuals: Any, rung: str
    ) -> "Direction":
        """A direction without a ball; five times faster than through the frozen dataclass's own constructor."""
        direction = object.__new__(cls)
        fields = vars(direction)
        fields["value"], fields["multipliers"], fields["status"] = value, multipliers, status
        fields["iterations"], fields["radius_multiplier"] = iterations, 0.0
        fields["residuals"], fields["rung"] = residuals, rung
        return direction

    @classmethod
    def nothing(cls, n: int, m: int, status: Status, iterations: int = 0) -> "Direction":
        """Zeros that claim nothing."""
        return cls(np.zeros(n), np.zeros(m), status, iterations)

    def raise_for_status(self) -> None:
        """DirectionError with the status' advice unless the direction is OPTIMAL."""
        if self.status != Status.OPTIMAL:
            raise DirectionError(str(Status(self.status)))


@dataclass(frozen=True, eq=False)
class DirectionBatch(Sequence[Direction]):
    """B directions as stacked arrays; reads as a sequence of `Direction`.

    value: (B, n), of `cpgrl_opt.torch` a tensor; multipliers: (B, m); status, iterations: (B,), statuses as their
    integers; radius_multiplier: (B,), None where all are 0; residuals: (B, 4) in the order of `KKTResiduals`, NaN for a
    direction that has none, None where none has any; rung: (B,) of str, None where no solver says.
    """

    value: Any  # Float[np.ndarray, "B n"], or a tensor
    multipliers: Float[np.ndarray, "B m"]
    status: Int[np.ndarray, "B"]
    iterations: Int[np.ndarray, "B"]
    radius_multiplier: Float[np.ndarray, "B"] | None = None
    residuals: Float[np.ndarray, "B 4"] | None = None
    rung: np.ndarray | None = None

    @classmethod
    def stack(cls, directions: Sequence[Direction]) -> "DirectionBatch":
        """The same directions in stacked float64 arrays; at least one."""

        def column(name: str, otherwise: object) -> np.ndarray:
            return np.array([getattr(direction, name, otherwise) for direction in directions])

        kappa, rungs = column("radius_multiplier", 0.0), column("rung", "")
        residuals = [getattr(direction, "residuals", None) for direction in directions]
        return cls(
            real_values("value of the answers", np.stack([direction.value for direction in directions])),
            real_values("multipliers of the answers", np.stack([direction.multipliers for direction in directions])),
            column("status", None).astype(np.int64),
            column("iterations", 0).astype(np.int64),
            kappa if kappa.any() else None,
            np.array([each or _NO_RESIDUALS for each in residuals]) if any(residuals) else None,
            rungs if (rungs != "").any() else None,
        )

    @classmethod
    def join(cls, batches: Sequence["DirectionBatch"]) -> "DirectionBatch":
        """The directions of batches one after the other; at least one batch."""
        if any(len({part is None for part in parts}) > 1 for parts in zip(*map(_parts, batches), strict=True)):
            return cls.stack([direction for batch in batches for direction in batch])
        columns = zip(*map(_parts, batches), strict=True)
        return cls(*(None if parts[0] is None else np.concatenate(parts) for parts in columns))  # type: ignore[arg-type]

    def replace_where(self, mask: Bool[np.ndarray, "B"], others: "DirectionBatch") -> "DirectionBatch":
        """A batch with `others`, in order, where the mask is True."""
        fresh = iter(others)
        return DirectionBatch.stack(
            [next(fresh) if new else each for each, new in zip(self, mask.tolist(), strict=True)]
        )

    def protect(self) -> "DirectionBatch":
        """The same answers in read-only views."""
        return self._each(read_only)

    def copy(self) -> "DirectionBatch":
        """A copy that can be written to."""
        return self._each(np.copy)

    def _each(self, changed: Callable[[np.ndarray], np.ndarray]) -> "DirectionBatch":
        """All arrays changed alike."""
        return DirectionBatch(*(None if part is None else changed(part) for part in _parts(self)))  # type: ignore[arg-type]

    def __len__(self) -> int:
        return len(self.value)

    @overload
    def __getitem__(self, index: int) -> Direction: ...
    @overload
    def __getitem__(self, index: slice) -> "DirectionBatch": ...
    def __getitem__(self, index: int | slice) -> "Direction | DirectionBatch":
        if isinstance(index, slice):
            return self._each(lambda part: part[index])
        known = None if self.residuals is None else self.residuals[index]
        residuals = None if known is None or np.isnan(known).any() else KKTResiduals(*known.tolist())
        kappa = 0.0 if self.radius_multiplier is None else float(self.radius_multiplier[index])
        rung = "" if self.rung is None else str(self.rung[index])
        status, iterations = Status(int(self.status[index])), int(self.iterations[index])
        return Direction(self.value[index], self.multipliers[index], status, iterations, kappa, residuals, rung)


def _parts(batch: DirectionBatch) -> list[np.ndarray | None]:
    return [getattr(batch, each.name) for each in fields(batch)]


_NO_RESIDUALS = (np.nan,) * 4
