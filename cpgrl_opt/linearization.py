"""Values and gradients of all reward channels at θ: what a gradient estimator hands to a step."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from .arrays import ArrayLike, Float
from .metric import Whitening
from .validation import is_finite, real_values, require_finite, require_shape
from .vectors import ArrayVectors, Vectors, channels_of, is_long


@dataclass(frozen=True, init=False, eq=False)
class Linearization:
    """gⁱ(θ + d) ≈ ρⁱ + (Δⁱ)ᵀd for every reward channel i = 1 … 1 + m.

    Channel 0 of the arrays is the objective r¹; channels 1 … m are the constraints r², r³, …. The arrays
    may carry leading axes, one linearization for each of many independent runs. Gradients are ascent gradients.

    values: (…, 1 + m), average rewards per step; gradients: (…, 1 + m, n), policy gradients of the same. Neither is
    copied if it is a float64 array already. Of one run the gradients may be a list of 1 + m trees of arrays, a tensor,
    an array of float32, one tree with the channels as first axis of every leaf, or an object of a kind of its own (see
    `vectors.VectorOperations`); then a step's change has that form too.
    Raises ValueError for NaN, infinities, shapes that do not belong together.
    Source: §2.1–2.2 of the paper (ρⁱ and Δⁱ).
    """

    values: Float[np.ndarray, "*runs channels"]
    gradients: Float[np.ndarray, "*runs channels n"]
    is_long: bool = field(init=False, repr=False)  # a step first reduces the gradients to their span
    is_tree: ClassVar[bool] = False  # where True, the gradients, and a step's change, are no arrays of float64

    def __init__(self, values: ArrayLike, gradients: ArrayLike | Vectors) -> None:
        # Not copied: an estimator makes fresh arrays for every episode, and a copy each would cost more than a step.
        if isinstance(gradients, Vectors):  # maybe of several processes
            gradients.agree(self._take_apart, values, gradients)
            return
        values = real_values("values", values)
        if type(gradients) is not np.ndarray or gradients.dtype != np.float64:
            try:  # a list may be one of runs else
                tree = channels_of(gradients, len(values)) if values.ndim == 1 else None
            except (TypeError, IndexError) as error:  # a leaf without channels
                raise ValueError(f"gradients should have the channels as axis of each leaf; found {error}") from error
            if tree is not None:
                self._take_apart(values, tree)
                return
            gradients = real_values("gradients", gradients)
        if gradients.ndim < 2:
            raise ValueError(f"gradients should have shape (…, 1 + m, n); found {gradients.shape}")
        require_finite("values", values)
        require_shape("values", values, gradients.shape[:-1])
        if values.shape[-1] == 0:
            raise ValueError("values should have at least the objective's channel; found none")
        long = is_long(gradients.shape[-2] - 1, gradients.shape[-1])
        vars(self).update(values=values, gradients=gradients, is_long=long)
        if not (long and all(vectors.are_finite() for vectors in self.vectors)):
            require_finite("gradients", gradients)

    def _take_apart(self, values: Any, tree: Vectors) -> tuple[Any]:
        values = real_values("values", values)
        require_finite("values", values)
        require_shape("values", values, (1 + tree.shape[0],))
        long = is_long(*tree.shape) or not tree.has_rows
        vars(self).update(values=values, vectors=(tree,), is_tree=True, is_long=long)
        if not tree.has_rows:
            vars(self).update(gradients=tree.channels())
        tree.require_finite()
        return (values,)

    if not TYPE_CHECKING:  # which would believe in any attribute

        def __getattr__(self, name: str) -> Any:
            # A tree is put together when somebody asks for it: a step on long gradients does not.
            if name != "gradients" or not self.is_tree:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            [tree] = self.vectors
            vars(self)["gradients"] = np.vstack([tree.whole_gradient(), tree.whole_jacobian()])
            return vars(self)["gradients"]

    def __reduce__(self) -> tuple[type["Linearization"], tuple[object, ...]]:
        # Without the vectors, which are the gradients once more.
        [tree, *_] = self.vectors if self.is_tree else (None,)
        given = self.gradients if tree is None else tree.channels()
        return Linearization, (self.values, given)

    def as_given(self, change: Any) -> Any:
        """A change (n,) of float64 in the form of the gradients."""
        is_row = self.is_tree and isinstance(change, np.ndarray) and change.dtype == np.float64
        given = self.vectors[0].from_row(change) if is_row else change
        if self.is_tree and not self.vectors[0].is_representable(given):
            raise FloatingPointError("the change of θ should be finite in the gradients' dtypes; found infinities")
        return given

    @cached_property
    def vectors(self) -> tuple[Any, ...]:  # Vectors, of arrays LeafVectors
        """The gradients of each run, in the order of their indices; they keep their inner products."""
        runs = np.ndindex(self.gradients.shape[:-2])
        return tuple(ArrayVectors(self.gradients[run][0], self.gradients[run][1:]) for run in runs)

    @property
    def n(self) -> int:
        """Number of parameters."""
        return int(self.vectors[0].shape[1] if self.is_tree else self.gradients.shape[-1])

    @property
    def objective_gradient(self) -> Float[np.ndarray, "*runs n"]:
        """Δ¹."""
        return self._rows()[..., 0, :]

    @property
    def jacobian(self) -> Float[np.ndarray, "*runs m n"]:
        """Constraint gradients Δ², Δ³, … as rows: Nᵀ of the paper."""
        return self._rows()[..., 1:, :]

    def _rows(self) -> Float[np.ndarray, "*runs channels n"]:
        """ValueError where the gradients are an object that shows no numbers."""
        if self.is_tree and not self.vectors[0].has_rows:
            raise ValueError(f"gradients should be an array, or trees of arrays; found {self.gradients!r}")
        return self.gradients

    def whiten(self, whitening: Whitening) -> "Linearization":
        """The same in the coordinates where M = LLᵀ is I, the gradients JL⁻ᵀ; ValueError where one overflows."""
        gradients = convert_runs(whitening.rows, self._rows(), 2)
        if not is_finite(gradients):
            raise ValueError("gradients should be finite where the metric is the identity; found one that overflows")
        return Linearization(self.values, gradients)

    def slack(self, thresholds: Float[np.ndarray, "m"]) -> Float[np.ndarray, "*runs m"]:
        """ρⁱ − Gⁱ of the constraints; ≥ 0 is feasible."""
        slack: np.ndarray = np.subtract(self.values[..., 1:], thresholds, order="C")
        return slack


def convert_runs(convert: Callable[[np.ndarray], np.ndarray], arrays: np.ndarray, axes: int) -> np.ndarray:
    """The array of each run, its last axes, in other coordinates; infinite where it overflows.

    Run by run, since the bits of many rows solved at once depend on their number.
    """
    converted = np.empty(arrays.shape)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        for run in np.ndindex(arrays.shape[:-axes]):
            converted[run] = convert(arrays[run])
    return converted
