"""Metric and radius of a step: which of its problems they belong to, and what is a length.

tangent s      in the metric and, where a radius is set, in the ball sᵀMs ≤ radius²
restoration v  in the metric, never in the ball: it is the shortest move that restores, and `max_restoration` limits it
"""

from dataclasses import dataclass, replace

import numpy as np

from .arrays import ArrayLike, Float, Number
from .metric import Metric, Whitening, validated_metric
from .problem import ProblemBatch
from .scaling import lengths
from .validation import ReadOnlyArrays, require_positive, require_shape


@dataclass(frozen=True, eq=False)
class StepGeometry(ReadOnlyArrays):
    """M with its factor, (n,) or (n, n), None for the identity; radius > 0, None for no ball."""

    metric: Metric | None = None
    whitening: Whitening | None = None
    radius: float | None = None

    @classmethod
    def of(cls, metric: ArrayLike | None, radius: Number | None) -> "StepGeometry | None":
        """None where there is nothing; ValueError for what is no metric or no radius."""
        if radius is not None:
            require_positive("radius", radius)
        if metric is None:
            return None if radius is None else cls(radius=float(radius))
        M, whitening = validated_metric(metric, len(np.atleast_1d(np.asarray(metric))))
        return cls(M, whitening, None if radius is None else float(radius))

    def for_parameters(self, n: int, more: int) -> "StepGeometry":
        """The same, with `more` coordinates (a ridge's) where M is the identity; ValueError where M is not (n, n)."""
        if self.metric is None or self.whitening is None:
            return self
        require_shape("metric", self.metric, (n,) * self.metric.ndim)
        if more == 0:
            return self
        metric: np.ndarray = np.append(self.metric, np.ones(more)) if self.metric.ndim == 1 else np.eye(n + more)
        if metric.ndim == 2:
            metric[:n, :n] = self.metric
        return replace(self, metric=metric, whitening=self.whitening.extended(more))

    def tangent(self, problems: ProblemBatch) -> ProblemBatch:
        """The problems of s."""
        return problems.in_geometry(self.metric, self.radius, self.whitening)

    def restoration(self, problems: ProblemBatch) -> ProblemBatch:
        """The problems of v."""
        return problems.in_geometry(self.metric, None, self.whitening)

    def lengths(self, directions: Float[np.ndarray, "B n"]) -> Float[np.ndarray, "B"]:
        """√(dᵀMd)."""
        if self.whitening is None:
            return lengths(directions)
        return lengths(np.array([self.whitening.direction(d) for d in directions]).reshape(directions.shape))

    def gradient_lengths(self, gradients: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch"]:
        """√(gᵀM⁻¹g)."""
        if self.whitening is None:
            return lengths(gradients)
        rows = np.ascontiguousarray(gradients).reshape(-1, gradients.shape[-1])
        return lengths(self.whitening.rows(rows).reshape(gradients.shape))

    def vanishing(
        self, tangent: Float[np.ndarray, "B n"], gradients: Float[np.ndarray, "B n"], relative: float
    ) -> np.ndarray:
        """Whether s = 0 up to rounding, relative to Δ¹; in a ball, whose solvers round s themselves, exactly."""
        if self.radius is not None:
            return np.asarray(~tangent.any(axis=1))
        return np.asarray(self.lengths(tangent) <= relative * self.gradient_lengths(gradients))
