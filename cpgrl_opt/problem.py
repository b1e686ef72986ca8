"""The direction problem: validated once, on construction.

    min_d ½ dᵀM d − gᵀd   s.t.   Jᵢ d ≥ bᵢ (i ∈ I),   Jᵢ d = bᵢ (i ∈ E)                     without a radius
    max_d gᵀd             s.t.   the same,   dᵀM d ≤ radius²   (of several, the shortest)   the trust region

M = I, so min ½‖d − g‖², where no metric is given. With b = 0 the first points the way of max_s gᵀs, sᵀMs = 1, the
problem of §2.3 of the paper. The second, with b = −slack, is that of constrained policy optimization (Achiam et al.
2017, eq. 10).
"""

from collections.abc import Callable, Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, overload

import numpy as np

from ._gate import check_arrays, check_bounds, check_metric, check_metrics, check_radii, metric_of_rows, view_vectors
from .arrays import ArrayLike, Bool, Float, Jacobian, Mask, Multipliers, Number, Vector
from .direction import Direction, Status
from .metric import Whitening
from .metric_operator import ITERATIONS, TOLERANCE, OperatorMetric
from .validation import ReadOnlyArrays, freeze, read_only, real_values, require_positive, require_shape
from .vectors import REPRESENTABLE, ArrayVectors, is_long

_Kind = TypeVar("_Kind")


class _Arrays:
    """What a problem and a batch of problems have in common."""

    @classmethod
    def trusted(cls: type[_Kind], gradient: Any, jacobian: Any, bound: Any, equality: Any, radius: Any = None) -> _Kind:
        """Of C-contiguous float64 and bool arrays that were checked before: no copies, no checks."""
        made = object.__new__(cls)
        # In the way of every update of a training, so without a call for each array.
        arrays = g, J, b, E = gradient.view(), jacobian.view(), bound.view(), equality.view()
        for array in arrays:
            array.setflags(False)  # as in `read_only`
        long = J.shape[-1] > 64 and is_long(*J.shape[-2:])  # in so few parameters no problem is
        vars(made).update(gradient=g, jacobian=J, bound=b, equality=E, radius=radius, is_long=long)
        return made


@dataclass(frozen=True, init=False, eq=False)
class DirectionProblem(_Arrays):
    """min ½dᵀMd − gᵀd, or max gᵀd in a ball, s.t. Jᵢd ≥ bᵢ, with equality where `equality` says so.

    g may be a tree (list, tuple, dict, nested) of arrays too, a PyTorch tensor on the CPU, a JAX array, or of float32;
    J then is one such tree with the constraints as first axis of every leaf, or a list of them, one a row. They are
    looked at where they lie, and the direction comes back in g's form. Or g is one object that has J in it (see
    `vectors.VectorOperations`), and no jacobian is given.

    gradient g: (n,), ascent gradient of the objective; jacobian J: (m, n), constraint gradients as rows;
    bound b: (m,) or one number for all, −inf switches an inequality off; equality: (m,) or one truth value
    for all; metric M: (n,) a positive diagonal or (n, n) symmetric positive definite, a function v ↦ Mv or a
    LinearOperator of SciPy, None for the identity; radius: > 0, in the unit of √(dᵀMd), or None. metric_tolerance,
    metric_iterations: ‖Mx − v‖/‖v‖ of x = M⁻¹v by conjugate gradients, where M is a function, and the most products for
    one x; a solver to which this is not enough says UNCERTIFIED. Arrays are copied and made read-only; but trees, and
    long g and J, with n (1 + m) max(10, 1 + m) ≥ 10⁶, are looked at where they lie, J as one array or a list of its
    rows: leave them alone as long as the problem is in use.
    Raises ValueError for NaN, infinities (but −inf in an inequality's bound), wrong shapes, no numbers, masked entries.
    """

    gradient: Vector
    jacobian: Jacobian
    bound: Multipliers
    equality: Mask
    metric: Any = None  # Metric, or a function
    radius: float | None = None
    whitening: Any = field(
        default=None, init=False, repr=False
    )  # where M = I: a `Whitening` or an `OperatorMetric`, set with M
    is_long: bool = field(init=False, repr=False)  # worth the way by inner products
    is_tree: ClassVar[bool] = False  # where True, d comes back as g came, and not as an array of float64

    def __init__(
        self,
        gradient: ArrayLike,
        jacobian: ArrayLike | None = None,
        bound: ArrayLike = 0.0,
        equality: ArrayLike = False,
        metric: ArrayLike | Callable[[Any], Any] | None = None,
        radius: Number | None = None,
        *,
        metric_tolerance: Number = TOLERANCE,
        metric_iterations: Number = ITERATIONS,
    ) -> None:
        vectors = view_vectors(gradient, jacobian)
        if vectors is None:
            g, J, b, E = check_arrays(gradient, jacobian, bound, equality, 1)
            long = type(jacobian) is not np.ndarray and is_long(*J.shape)
            vars(self).update(gradient=g, jacobian=J, bound=b, equality=E, is_long=long)
            n = len(g)
        else:
            n, look = vectors.shape[1], partial(self._look_at, vectors, bound, equality, metric, radius)
            metric = vectors.agree(look)[-1]
        if metric is not None:
            _set_metric(self, *check_metric(metric, n, metric_tolerance, metric_iterations))
        if radius is not None:
            require_positive("radius", radius)
            vars(self).update(radius=float(radius))

    def __reduce__(self) -> tuple[Any, tuple[object, ...]]:
        # Through the constructor, so that a copy or an unpickled problem is read-only too.
        given: Any = self.vectors if self.is_tree else self
        metric = vars(self).get("_given_metric", self.metric)
        arguments = (given.gradient, given.jacobian, self.bound, self.equality, metric, self.radius)
        M = self.whitening
        if not isinstance(M, OperatorMetric):
            return DirectionProblem, arguments
        made = partial(DirectionProblem, metric_tolerance=M.tolerance, metric_iterations=M.iterations)
        return made, arguments

    def _look_at(self, vectors: Any, bound: Any, equality: Any, metric: Any, radius: Any) -> tuple[Any, ...]:
        """What processes, where there are several, should have alike, and at the end the metric of rows."""
        b, E = check_bounds(bound, equality, vectors.shape[:1])
        vectors.require_finite()
        if radius is not None:
            require_positive("radius", radius)
        vars(self).update(bound=b, equality=E, is_long=True, _vectors=vectors, _given_metric=metric)
        vars(self).update(is_tree=not isinstance(vectors, ArrayVectors))
        if isinstance(vectors, ArrayVectors) or not vectors.has_rows:
            vars(self).update(gradient=vectors.gradient)
            if not isinstance(vectors.jacobian, tuple):
                vars(self).update(jacobian=vectors.jacobian)
        return b, E, radius, metric_of_rows(vectors, metric)

    if not TYPE_CHECKING:  # which would believe in any attribute

        def __getattr__(self, name: str) -> Any:
            # Rows apart and trees are put together when somebody asks for them: a solve does not.
            if name not in ("gradient", "jacobian") or "_vectors" not in vars(self):
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            array = freeze(getattr(self._vectors, f"whole_{name}")())
            vars(self)[name] = array
            return array

    def row_of(self, direction: Any) -> Any:
        """d as an array of float64, (n,), ValueError for what has not the form of g; as it is where g is an object."""
        if self.is_tree:
            return self.vectors.row_of(direction)
        row = real_values("direction.value", direction)
        require_shape("direction.value", row, (self.n,))
        return row

    def as_given(self, row: Vector) -> Any:
        """d in the form of g, rounded to its dtypes; infinite where it leaves them."""
        return self.vectors.from_row(row) if self.is_tree else row

    def is_representable(self, direction: Any) -> bool:
        """Whether d in the form of g is finite: float32 ends at 3e38."""
        return not self.is_tree or self.vectors.is_representable(direction)

    def copied(self) -> "DirectionProblem":
        """The same numbers in arrays of its own: whatever is done to them, these here stay as they are."""
        require_rows(self)
        g, J, b, E = (array.copy() for array in _arrays(self))
        problem = DirectionProblem.trusted(g, J, b, E, self.radius)
        if self.metric is not None:
            _set_metric(problem, *_copy_pair(self.metric, self.whitening))
        return problem

    @property
    def vectors(self) -> Any:  # Vectors, of arrays LeafVectors
        """g and the rows, as the reduction to their span looks at them; keeps their inner products."""
        if "_vectors" not in vars(self):
            vars(self)["_vectors"] = ArrayVectors(self.gradient, self.jacobian)
        return vars(self)["_vectors"]

    @property
    def n(self) -> int:
        """Number of parameters."""
        return int(self.vectors.shape[1]) if self.is_tree else len(self.gradient)

    @property
    def m(self) -> int:
        """Number of constraints."""
        return len(self.bound)


def require_problem(problem: Any) -> DirectionProblem:
    """The problem; ValueError for what is none."""
    if not isinstance(problem, DirectionProblem):
        raise ValueError(f"problem should be a DirectionProblem; found {problem!r}")
    return problem


def require_rows(problem: DirectionProblem) -> None:
    """ValueError where g and J are an object that shows no numbers: nothing that looks at rows can be asked of it."""
    if problem.is_tree and not problem.vectors.has_rows:
        raise ValueError(f"problem should have g and J as arrays, or in trees of arrays; found {problem.gradient!r}")


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


@dataclass(frozen=True, init=False, eq=False)
class ProblemBatch(_Arrays, ReadOnlyArrays, Sequence[DirectionProblem]):
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
        if not isinstance(problems, Iterable):
            raise ValueError(f"problems should be a batch or a sequence of problems; found {problems!r}")
        problems = [require_problem(problem) for problem in problems]
        shapes = {np.shape(problem.jacobian) for problem in problems}
        if len(shapes) != 1 or () in shapes:  # of objects that show no arrays
            raise ValueError(f"problems should have one shape; found {sorted(shapes) or 'no problem'}")
        g, J, b, E = map(np.stack, zip(*map(_arrays, problems), strict=True))
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
        batch = ProblemBatch.trusted(*_arrays(self), None if radius is None else check_radii(radius, len(self)))
        if metric is not None:
            _set_metrics(batch, [check_metric(metric, self.gradient.shape[1])] * len(self))
        return batch

    def copied(self) -> "ProblemBatch":
        """The same numbers in arrays of its own: whatever is done to them, these here stay as they are."""
        batch = self.chosen(np.arange(len(self)))
        if self.whitening is not None:
            pairs = [self._metric_at(k) for k in range(len(self))]
            own = {id(L): _copy_pair(M, L) for M, L in pairs}  # one for all stays one
            _set_metrics(batch, [own[id(L)] for _, L in pairs])
        return batch

    def chosen(self, index: Any) -> "ProblemBatch":
        """The problems where a mask is True, of a slice, or of these numbers."""
        radii = None if self.radius is None else read_only(self.radius[index])
        g, J, b, E = (np.ascontiguousarray(array[index]) for array in _arrays(self))
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
            return self.chosen(index)
        g, J, b, E = (array[index] for array in _arrays(self))
        problem = DirectionProblem.trusted(g, J, b, E, None if self.radius is None else float(self.radius[index]))
        if self.whitening is not None:
            _set_metric(problem, *self._metric_at(index))
        return problem


def _arrays(of: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return of.gradient, of.jacobian, of.bound, of.equality


def _set_metric(problem: Any, metric: Any, whitening: Any) -> None:
    vars(problem).update(metric=metric if callable(metric) else read_only(metric), whitening=whitening)


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
    _set_metric(batch, stacked, whitenings)


def _copy_pair(metric: Any, whitening: Any) -> tuple[Any, Any]:
    return (metric, whitening) if callable(metric) else deepcopy((metric, whitening))


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
