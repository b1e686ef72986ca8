"""Policies and Gymnasium's spaces: whether they fit, and how an action is handed over."""

import copy
from collections.abc import Mapping
from typing import Any, TypeGuard, TypeVar

import numpy as np

from .policies import LinearGaussian, LinearSoftmax, NormalizedGaussianNetwork, Policy, SoftmaxTable

P = TypeVar("P")

_OURS = (SoftmaxTable, LinearSoftmax, LinearGaussian, NormalizedGaussianNetwork)
_AS_WRITTEN: dict[type, dict[str, Any]] = {
    kind: {name: code for name in dir(kind) if not name.startswith("__") and callable(code := getattr(kind, name))}
    for kind in _OURS
}
_IMMUTABLE = (int, float, str, bool, type(None))


def own_copy(value: Any) -> Any:
    """A copy of an observation or action of any kind, through dictionaries, tuples and other people's objects."""
    if type(value) is np.ndarray and not value.dtype.hasobject:
        return value.copy()
    return value if isinstance(value, np.generic) or type(value) in _IMMUTABLE else copy.deepcopy(value)


def hand_over(action: Any, space: Any) -> Any:
    """The environment's own copy of an action, in the dtype of its space, as `space.sample()` has it.

    Numbers are rounded to floats of the space, never clipped; what its dtype cannot hold, 1e300 in float32 or 300 in
    uint8, goes over in the dtype it has. Elements of a Discrete space are as the policy gives them.
    """
    dtype, shape = getattr(space, "dtype", None), getattr(space, "shape", None)
    if type(action) is np.ndarray and action.dtype == dtype:
        return own_copy(action)
    parts = getattr(space, "spaces", None)  # of a Dict or a Tuple
    if isinstance(parts, Mapping) and isinstance(action, Mapping):
        return {name: hand_over(part, parts.get(name)) for name, part in action.items()}
    if isinstance(parts, tuple) and isinstance(action, tuple) and len(parts) == len(action):
        return tuple(hand_over(part, inner) for part, inner in zip(action, parts, strict=True))
    if isinstance(dtype, np.dtype) and (dtype.kind == "f" or (dtype.kind in "iu" and shape)):
        given = np.asarray(action)
        if given.dtype.kind in "biu" + dtype.kind:
            with np.errstate(over="ignore"):
                own = given.astype(dtype)
            if np.isfinite(own).all() if dtype.kind == "f" else np.array_equal(own, given):
                return own
    return own_copy(action)


def behaves_as(policy: object, kind: type[P]) -> TypeGuard[P]:
    """Whether a policy is a `kind` that samples and scores as that class does: compiled code may stand for it."""
    from envs.interface import list_overrides  # Gymnasium loads with envs

    if not isinstance(policy, kind) or list_overrides(policy, kind):
        return False
    return all(getattr(kind, name) is code for name, code in _AS_WRITTEN.get(kind, {}).items())  # unless patched


def require_fitting(environment: Any, policy: Policy) -> None:
    """ValueError unless a policy of ours fits the environment's spaces.

    Whatever says no size is let through, and so is a subclass with code of its own, which may read observations
    and make actions of another kind.
    """
    from gymnasium.spaces import Box, Discrete

    states, actions = (getattr(environment, f"{name}_space", None) for name in ("observation", "action"))
    if not any(behaves_as(policy, kind) for kind in _OURS):
        return
    if isinstance(policy, SoftmaxTable):
        _require_space(policy, "observation", states, Discrete, "states", policy.states)
    if isinstance(policy, (SoftmaxTable, LinearSoftmax)):
        _require_space(policy, "action", actions, Discrete, "actions", policy.actions)
    if isinstance(policy, NormalizedGaussianNetwork):
        _require_space(policy, "observation", states, Box, "components of an observation", len(policy.counts))
    if isinstance(policy, (LinearGaussian, NormalizedGaussianNetwork)):
        _require_space(policy, "action", actions, Box, "components of an action", policy.dimensions)


def _require_space(policy: Policy, name: str, space: Any, kind: type, what: str, found: int) -> None:
    if space is None:
        return
    if not isinstance(space, kind):
        raise ValueError(
            f"policy should have {name}s from {space}; found {type(policy).__name__}, which has them from a "
            f"{kind.__name__}"
        )
    wanted = _count(space) if hasattr(space, "n") else _shape(space)
    if found != wanted:
        raise ValueError(f"policy should have {wanted} {what}, as the environment's {space}; found {found}")


def _count(space: Any) -> int | str:
    """How many elements 0, 1, … a Discrete space has."""
    return int(space.n) if space.start == 0 else f"{space.n} (from {space.start}, where a policy counts from 0)"


def _shape(space: Any) -> int | str:
    """How many components a Box has, if it is a box of vectors; else its shape, which no number equals."""
    return int(space.shape[0]) if len(space.shape) == 1 else str(space.shape)
