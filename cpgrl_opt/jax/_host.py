"""The step itself, on the host: what `jit` calls back; under `vmap` once for the whole batch."""

import math
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from ..direction import Status
from ..linearization import Linearization
from ..step import ConstrainedStep
from ._certified import Answer


def solve_on_host(step: ConstrainedStep, leaves: Sequence[Any], slack: Any) -> Answer:
    """As `_certified.solve` answers, by `step`, of g and J in its signs."""
    vector = jax.ShapeDtypeStruct(slack.shape, slack.dtype)
    number, four = jax.ShapeDtypeStruct((), slack.dtype), jax.ShapeDtypeStruct((4,), slack.dtype)
    form = Answer([jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype) for leaf in leaves], vector, four, number)

    def run(leaves: Sequence[Any], slack: Any) -> Answer:
        return _take_step(step, [np.asarray(leaf) for leaf in leaves], np.asarray(slack))

    return jax.pure_callback(run, form, list(leaves), slack, vmap_method="broadcast_all")


def _take_step(step: ConstrainedStep, leaves: list[np.ndarray], slack: np.ndarray) -> Answer:
    """Of all runs in one call; leaves (…, 1 + m, k), slack (…, m)."""
    runs, m = slack.shape[:-1], slack.shape[-1]
    whole = np.concatenate([leaf.astype(np.float64) for leaf in leaves], axis=-1).reshape(-1, 1 + m, _count(leaves))
    flat = slack.reshape(math.prod(runs), m).astype(np.float64)
    is_finite = np.isfinite(whole).all(axis=(1, 2)) & np.isfinite(flat).all(axis=1)
    whole[~is_finite], flat[~is_finite] = 0.0, 0.0
    result = step(Linearization(np.insert(flat, 0, 0.0, axis=1), whole), np.zeros(m))
    status = np.where(result.counts["infeasible"] > 0, Status.INFEASIBLE, Status.OPTIMAL)
    status = np.where(result.counts["skipped"] > 0, Status.UNCERTIFIED, status)
    status = np.where(is_finite, status, Status.NUMERICAL_ERROR)
    assert result.multipliers is not None
    assert result.residuals is not None
    residuals = np.where(np.isnan(result.residuals), np.inf, result.residuals)
    parts = np.split(result.change / float(step.step_size), np.cumsum([leaf.shape[-1] for leaf in leaves])[:-1], axis=1)  # type: ignore[arg-type]
    d = [part.astype(leaf.dtype).reshape(*runs, -1) for part, leaf in zip(parts, leaves, strict=True)]
    rest = (result.multipliers, residuals, status)
    return Answer(d, *(each.astype(slack.dtype).reshape((*runs, *each.shape[1:])) for each in rest))


def _count(leaves: list[np.ndarray]) -> int:
    return sum(leaf.shape[-1] for leaf in leaves)
