"""Direction problems, one or many: see `direction_problem` for what they are."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, overload

import numpy as np

from ._gate import check_arrays, check_metrics, check_radii
from .arrays import ArrayLike, Bool, Float, Number
from .direction import Direction, Status
from .direction_problem import Arrays, copy_metric
from .direction_problem import DirectionProblem as DirectionProblem
from .direction_problem import require_rows as require_rows
from .metric import Whitening, check_metric
from .metric_operator import ITERATIONS, TOLERANCE
from .validation import ReadOnlyArrays, read_only
from .vectors import REPRESENTABLE


@dataclass(frozen=True, init=False, eq=False)
class ProblemBatch(Arrays, ReadOnlyArrays, Sequence[DirectionProblem]):
    """B direction problems of one shape, stacked; reads as a sequence of `DirectionProblem`.

    gradient: (B, n); jacobian: (B, m, n); bound, equality: (B, m). Inside a batch, a constraint that is
    not in one problem's active set has bound −inf and equality False there; one number or truth value is for all.
    metric: (B, n) or (B, n, n) one each; (n,), (1, n, n) or a function v ↦ Mv one for all; None for identities;
    radius: (B,) or one number, or None for problems without. Copies, refuses and
    raises as `DirectionProblem`.
    """

    gradient: Float[np.ndarray, "B n"]
    jacobian: Float[np.ndarray, "B m n"]
    bound: Float[np.ndarray, "B m"]
    equality: Bool[np.ndarray, "B m"]
    metric: Any = None  # (B, n), (B, n, n), or a function
    radius: Float[np.ndarray, "B"] | None = None
    whitening: tuple[Any, ...] | None = field(default=None, repr=False)  # of each metric, set with it

    def __init__(
        self,
        gradient: ArrayLike,
        jacobian: ArrayLike,
        bound: ArrayLike = 0.0,
        equality: ArrayLike = False,
        metric: ArrayLike | Callable[[Any], Any] | None = None,
        radius: ArrayLike | None = None,
        *,
        metric_tolerance: Number = TOLERANCE,
        metric_iterations: Number = ITERATIONS,
    ) -> None:
        g, J, b, E = check_arrays(gradient, jacobian, bound, equality, 2)
        vars(self).update(gradient=g, jacobian=J, bound=b, equality=E)
        if metric is not None:
            _set_metrics(self, check_metrics(metric, *g.shape, metric_tolerance, metric_iterations))
        if radius is not None:
            vars(self).update(radius=check_radii(radius, len(g)))

    @classmethod
    def stack(cls, problems: Sequence[DirectionProblem]) -> "ProblemBatch":
        """The same problems in stacked arrays; ValueError unless there is at least one and all have one shape."""
        if isinstance(problems, cls):
            return problems
        try:
            problems = list(problems)
        except TypeError as error:
            raise ValueError(f"problems should be a batch or a sequence of problems; found {problems!r}") from error
        problems = [require_problem(problem) for problem in problems]
        shapes = {np.shape(problem.jacobian) for problem in problems}
        if len(shapes) != 1 or () in shapes:  # of objects that show no arrays
            raise ValueError(f"problems should have one shape; found {sorted(shapes) or 'no problem'}")
        g, J, b, E = map(np.stack, zip(*(problem.arrays() for problem in problems), strict=True))
        batch = cls.trusted(g, J, b, E)
        if any(problem.metric is not None for problem in problems):
            _set_metrics(batch, _metrics_of(problems))
        radii = [problem.radius for problem in problems if problem.radius is not None]
        if radii:
            if len(radii) < len(problems):
                raise ValueError(f"problems should all have a radius, or none; found {len(radii)} of {len(problems)}")
            vars(batch).update(radius=read_only(np.array(radii)))
        return batch

    def in_geometry(self, metric: ArrayLike | Callable[[Any], Any] | None, radius: Number | None) -> "ProblemBatch":
        """The same problems, all in one metric, (n,), (n, n) or a function, and in balls of one radius."""
        batch = ProblemBatch.trusted(*self.arrays(), None if radius is None else check_radii(radius, len(self)))
        if metric is not None:
            _set_metrics(batch, [check_metric(metric, self.gradient.shape[1])] * len(self))
        return batch

    def copied(self) -> "ProblemBatch":
        """The same numbers in arrays of its own: whatever is done to them, these here stay as they are."""
        batch = self.select(np.arange(len(self)))
        if self.whitening is not None:
            pairs = [self._metric_at(k) for k in range(len(self))]
            own = {id(L): copy_metric(M, L) for M, L in pairs}  # one for all stays one
            _set_metrics(batch, [own[id(L)] for _, L in pairs])
        return batch

    def select(self, index: Any) -> "ProblemBatch":
        """The problems where a mask is True, of a slice, or of these numbers."""
        radii = None if self.radius is None else read_only(self.radius[index])
        g, J, b, E = (np.ascontiguousarray(array[index]) for array in self.arrays())
        part = ProblemBatch.trusted(g, J, b, E, radii)
        if self.whitening is not None:
            _set_metrics(part, [self._metric_at(k) for k in np.arange(len(self))[index]])
        return part

    def _metric_at(self, index: Any) -> tuple[Any, Any]:
        """(M, L) of one problem."""
        whitening: Any = self.whitening
        return self.metric if callable(self.metric) else self.metric[index], whitening[index]

    def __len__(self) -> int:
        return len(self.gradient)

    @overload
    def __getitem__(self, index: int) -> DirectionProblem: ...
    @overload
    def __getitem__(self, index: slice) -> "ProblemBatch": ...
    def __getitem__(self, index: int | slice) -> "DirectionProblem | ProblemBatch":
        if isinstance(index, slice):
            return self.select(index)
        g, J, b, E = (array[index] for array in self.arrays())
        problem = DirectionProblem.trusted(g, J, b, E, None if self.radius is None else float(self.radius[index]))
        if self.whitening is not None:
            problem.set_metric(*self._metric_at(index))
        return problem


def _set_metrics(batch: ProblemBatch, pairs: Sequence[tuple[Any, Any]]) -> None:
    """One (M, L) for each problem; stacked without copies where all are the same."""
    metrics, whitenings = tuple(zip(*pairs, strict=True)) or ((), ())
    if not pairs:
        stacked: Any = np.zeros(batch.gradient.shape)
    elif callable(metrics[0]):
        stacked = metrics[0]
    elif len(set(map(id, whitenings))) == 1:
        stacked = np.broadcast_to(metrics[0], (len(pairs), *metrics[0].shape))
    else:
        stacked = np.stack(metrics)
    batch.set_metric(stacked, whitenings)


def _metrics_of(problems: Sequence[DirectionProblem]) -> list[tuple[Any, Any]]:
    """(M, L) of each problem, all (n,) or all (n, n), the identity where one has none; or one function."""
    metrics = [problem.metric for problem in problems]
    if any(map(callable, metrics)):
        if len(set(map(id, metrics))) > 1:
            raise ValueError("problems should all have one and the same function as metric; found several metrics")
        return [(problems[0].metric, problems[0].whitening)] * len(problems)
    full, ones = any(np.ndim(M) == 2 for M in metrics), np.ones(problems[0].n)
    pairs = [(ones, Whitening(ones)) if each.metric is None else (each.metric, each.whitening) for each in problems]
    return [(np.diag(M) if full and M.ndim == 1 else M, L) for M, L in pairs]


def require_problem(problem: Any) -> DirectionProblem:
    """The problem; ValueError for what is none."""
    if not isinstance(problem, DirectionProblem):
        raise ValueError(f"problem should be a DirectionProblem; found {problem!r}")
    return problem


def nothing(problem: DirectionProblem, status: Status, iterations: int = 0) -> Direction:
    """Zeros in the form of g that claim nothing."""
    value = problem.vectors.zero() if problem.is_tree else np.zeros(problem.n)
    return Direction(value, np.zeros(problem.m), status, iterations)


def convert_answer(problem: DirectionProblem, found: Direction, **changes: Any) -> Direction:
    """An answer in one array of float64 in the form of g; NUMERICAL_ERROR where d leaves the dtypes of g's leaves."""
    row = problem.row_of(found.value)
    value = problem.as_given(row)
    if np.vdot(row, row) <= REPRESENTABLE or problem.is_representable(value):
        return replace(found, value=value, **changes)
    return nothing(problem, Status.NUMERICAL_ERROR)


def without_geometry(problem: DirectionProblem) -> DirectionProblem:
    """The same numbers, C-contiguous, Euclidean and without a ball."""
    g, J = np.ascontiguousarray(problem.gradient), np.ascontiguousarray(problem.jacobian)
    return DirectionProblem.trusted(g, J, problem.bound, problem.equality)
