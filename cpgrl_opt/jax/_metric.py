"""The metric in which an optimiser's own step is the steepest: what it divides its gradient by, but for its rate.

    Δ ∝ −H⁻¹ĝ        SGD: H = 1     Adam and its like: √v̂ + eps     RMSprop: √v + eps     Adagrad: √Σĝ²

ĝ is the gradient as the optimiser sees it, with momentum and decay. The state does not tell eps and β₂. β₂ is in H a
factor of all of it, but for eps.
"""

from typing import Any

import jax
import jax.numpy as jnp

_LEAST = 1e-15  # entry of H, of a parameter whose gradient was 0 up to now


def metric_of(state: Any, proposed: Any, b2: float, eps: float) -> list[Any]:
    """H of each leaf, after the optimiser's update; 1 where the state has no second moments.

    ValueError where it has several, or not of all parameters: whose H it is, is then the caller's to say.
    """
    records, form = _records(state), jax.tree.structure(proposed)
    if not records:
        return [jnp.ones_like(part) for part in jax.tree.leaves(proposed)]
    found = [_denominator(record, b2, eps) for record in records]
    if len(found) > 1 or jax.tree.structure(found[0]) != form:
        what = f"{len(found)}" if len(found) > 1 else "one of some of them"
        raise ValueError(
            "optimizer should have one state with second moments, of all parameters, or metric should be given; found "
            + what
        )
    return [jnp.maximum(part, _LEAST) for part in jax.tree.leaves(found[0])]


def _denominator(record: Any, b2: float, eps: float) -> Any:
    if hasattr(record, "sum_of_squares"):
        return jax.tree.map(jnp.sqrt, record.sum_of_squares)
    squares = record.nu_max if hasattr(record, "nu_max") else record.nu
    correction = 1.0 - b2**record.count if "count" in record._fields else 1.0
    return jax.tree.map(lambda v: (jnp.sqrt(v / correction) + eps).astype(v.dtype), squares)


def _records(state: Any) -> list[Any]:
    """The named tuples in a state that have fields of optimisers."""
    if hasattr(state, "_fields") and {"nu", "sum_of_squares"} & {*state._fields}:
        return [state]
    parts = state.values() if isinstance(state, dict) else state if isinstance(state, tuple | list) else ()
    return [record for part in parts for record in _records(part)]
