"""The direction problem: validated once, on construction.

    min_d ½ dᵀM d − gᵀd   s.t.   Jᵢ d ≥ bᵢ (i ∈ I),   Jᵢ d = bᵢ (i ∈ E)                     without a radius
    max_d gᵀd             s.t.   the same,   dᵀM d ≤ radius²   (of several, the shortest)   the trust region

M = I, so min ½‖d − g‖², where no metric is given. With b = 0 the first points the way of max_s gᵀs, sᵀMs = 1, the
problem of §2.3 of the paper. The second, with b = −slack, is that of constrained policy optimization (Achiam et al.
2017, eq. 10).
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np

from ._gate import check_arrays, check_bounds, metric_of_rows, view_vectors
from .arrays import ArrayLike, Jacobian, Mask, Multipliers, Number, Vector
from .metric import check_metric
from .metric_operator import ITERATIONS, TOLERANCE, OperatorMetric
from .validation import freeze, read_only, real_values, require_positive, require_shape
from .vectors import ArrayVectors, is_long

_Kind = TypeVar("_Kind")


class Arrays:
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

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """g, J, b and E."""
        of: Any = self
        return of.gradient, of.jacobian, of.bound, of.equality

    def set_metric(self, metric: Any, whitening: Any) -> None:
        """M and L, checked before."""
        vars(self).update(metric=metric if callable(metric) else read_only(metric), whitening=whitening)


@dataclass(frozen=True, init=False, eq=False)
class DirectionProblem(Arrays):
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
        else:
            given, is_array = (vectors, bound, equality, metric, radius), isinstance(vectors, ArrayVectors)
            metric = (self._look_at(*given) if is_array else vectors.agree(self._look_at, *given))[-1]
        if metric is not None:
            self.set_metric(*check_metric(metric, self.n, metric_tolerance, metric_iterations))
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
        own, is_array = vars(self), isinstance(vectors, ArrayVectors)
        own.update(bound=b, equality=E, is_long=True, _vectors=vectors, _given_metric=metric, is_tree=not is_array)
        if is_array or not vectors.has_rows:
            own["gradient"] = vectors.gradient
            if not isinstance(vectors.jacobian, tuple):
                own["jacobian"] = vectors.jacobian
        if metric is not None:
            metric = metric_of_rows(vectors, metric)
        return b, E, radius, metric

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

    def __copy__(self) -> "DirectionProblem":
        made, arguments = self.__reduce__()
        problem: DirectionProblem = made(*arguments) if self.is_tree else self.copied()
        return problem

    def copied(self) -> "DirectionProblem":
        """The same numbers in arrays of its own: whatever is done to them, these here stay as they are."""
        require_rows(self)
        g, J, b, E = (array.copy() for array in self.arrays())
        problem = DirectionProblem.trusted(g, J, b, E, self.radius)
        if self.metric is not None:
            problem.set_metric(*copy_metric(self.metric, self.whitening))
        return problem

    @property
    def vectors(self) -> Any:  # Vectors, of arrays LeafVectors
        """g and the rows, as the reduction to their span looks at them; keeps their inner products."""
        own = vars(self)
        known = own.get("_vectors")
        if type(known) is ArrayVectors:  # others may have been put in place of its arrays; not there: rows apart
            is_same = known.gradient is own["gradient"] and known.jacobian is own.get("jacobian", known.jacobian)
            known = known if is_same or type(known.jacobian) is tuple else None
        if known is None:
            known = own["_vectors"] = ArrayVectors(self.gradient, self.jacobian)
        return known

    @property
    def n(self) -> int:
        """Number of parameters."""
        return int(self.vectors.shape[1]) if self.is_tree else len(self.gradient)

    @property
    def m(self) -> int:
        """Number of constraints."""
        return len(self.bound)


def require_rows(problem: DirectionProblem) -> None:
    """ValueError where g and J are an object that shows no numbers: nothing that looks at rows can be asked of it."""
    if problem.is_tree and not problem.vectors.has_rows:
        raise ValueError(f"problem should have g and J as arrays, or in trees of arrays; found {problem.gradient!r}")


def copy_metric(metric: Any, whitening: Any) -> tuple[Any, Any]:
    """The same M and L in arrays of their own."""
    return (metric, whitening) if callable(metric) else deepcopy((metric, whitening))
