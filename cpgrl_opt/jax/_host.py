"""The step itself, on the host: what `jit` calls back; under `vmap` once for the whole batch."""

import math
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from ..direction import Status
from ..linearization import Linearization
from ._certified import Answer
from ._settings import Settings


def solve_on_host(settings: Settings, leaves: Sequence[Any], slack: Any) -> Answer:
    """As `_certified.solve` answers, by the step."""
    vector = jax.ShapeDtypeStruct(slack.shape, slack.dtype)
    number, four = jax.ShapeDtypeStruct((), slack.dtype), jax.ShapeDtypeStruct((4,), slack.dtype)
    form = Answer([jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype) for leaf in leaves], vector, vector, four, number)

    def run(leaves: Sequence[Any], slack: Any) -> Answer:
        return _take_step(settings, [np.asarray(leaf) for leaf in leaves], np.asarray(slack))

    return jax.pure_callback(run, form, list(leaves), slack, vmap_method="broadcast_all")


def _take_step(settings: Settings, leaves: list[np.ndarray], slack: np.ndarray) -> Answer:
    """Of all runs in one call; leaves (…, 1 + m, …), slack (…, m)."""
    runs, m = slack.shape[:-1], slack.shape[-1]
    flat = slack.reshape(math.prod(runs), m).astype(np.float64)
    each = [leaf.astype(np.float64).reshape(len(flat), 1 + m, -1) for leaf in leaves]
    whole = np.concatenate(each, axis=-1) * np.repeat(settings.signs, [1, m])[:, None]
    is_finite = np.isfinite(whole).all(axis=(1, 2)) & np.isfinite(flat).all(axis=1)
    whole[~is_finite], flat[~is_finite] = 0.0, 0.0
    step_size = float(settings.step.step_size)  # type: ignore[arg-type]
    result = settings.step(Linearization(np.insert(flat, 0, 0.0, axis=1), whole), np.zeros(m))
    status = np.where(result.counts["infeasible"] > 0, Status.INFEASIBLE, Status.OPTIMAL)
    status = np.where(result.counts["skipped"] > 0, Status.UNCERTIFIED, status)
    assert result.multipliers is not None
    assert result.residuals is not None
    residuals = np.where(np.isnan(result.residuals), np.inf, result.residuals)
    parts = np.split(result.change / step_size, np.cumsum([part.shape[-1] for part in each])[:-1], axis=1)
    with np.errstate(over="ignore", invalid="ignore"):  # what leaves the caller's floats is infinite, and told below
        gain = np.einsum("rij,rj->ri", whole[:, 1:], result.change / step_size)
        d = [part.astype(leaf.dtype) for part, leaf in zip(parts, leaves, strict=True)]
        rest = [value.astype(slack.dtype) for value in (result.multipliers, gain, residuals)]
    is_finite &= np.all([np.isfinite(part.astype(np.float64)).all(axis=1) for part in d], axis=0)
    status = np.where(is_finite, status, Status.NUMERICAL_ERROR).astype(slack.dtype)
    d = [part.reshape(*runs, *leaf.shape[len(runs) + 1 :]) for part, leaf in zip(d, leaves, strict=True)]
    return Answer(d, *(value.reshape((*runs, *value.shape[1:])) for value in (*rest, status)))
