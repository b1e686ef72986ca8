"""Settings as plain values, by which a saved training tells whether it is handed what it was made with."""

import functools
import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from pathlib import PurePath
from typing import Any

import numpy as np

from .channels import event_key, layers

_SHORT = 32  # numbers of an array that are told one by one
_DEEP = 8  # dataclasses within each other
_PLAIN = (bool, int, float, str, type(None))
_SPOKEN = (complex, bytes, range, slice, Fraction, Decimal, PurePath, Enum)  # whose text says all


def describe(value: Any, depth: int = _DEEP) -> Any:
    """For JSON: numbers, texts as they are, arrays by value or digest, dataclasses and others by class and parts."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, _PLAIN):
        return value if type(value) in _PLAIN else f"{_name(value)}: {value}"
    if isinstance(value, _SPOKEN):
        return f"{_name(value)}: {value!s}"
    if isinstance(value, np.ndarray):
        return _array(value)
    if hasattr(value, "__qualname__"):
        return f"{value.__module__}.{value.__qualname__}"
    if depth == 0:  # an object that holds itself would never end
        return _name(value)
    if isinstance(value, (tuple, list)):
        return [describe(part, depth - 1) for part in value]
    if isinstance(value, (set, frozenset)):
        return sorted((describe(part, depth - 1) for part in value), key=json.dumps)
    if isinstance(value, Mapping):
        return {str(key): describe(part, depth - 1) for key, part in value.items()}
    if isinstance(value, functools.partial):
        value = {"function": value.func, "arguments": value.args, "named": value.keywords}
        return describe(value, depth)
    return {"class": _name(value), **{name: describe(part, depth - 1) for name, part in _settings(value).items()}}


def describe_policy(policy: Any) -> Any:
    """Without θ, which goes on from what is saved."""
    found = describe(policy)
    return {**{name: part for name, part in found.items() if name != "parameters"}, "n": np.size(policy.parameters)}


def describe_environment(environment: Any) -> Any:
    """Its classes, wrappers first, and what it declares: a finite MDP, kernels, Gymnasium's spec and spaces.

    Other attributes are not looked at: they change as the environment runs.
    """
    from envs.interface import continuous_kernels_of, finite_kernel_of  # Gymnasium loads with envs

    spec = getattr(environment, "spec", None)
    found = {
        "classes": [_name(layer) for layer in layers(environment)],
        "event_key": event_key(environment),
        "spec": None if spec is None else describe([getattr(spec, "id", ""), getattr(spec, "kwargs", {})]),
    }
    for name in ("observation_space", "action_space", "reward_space"):
        found[name] = repr(getattr(environment, name, None))
    kernel, kernels = finite_kernel_of(environment), continuous_kernels_of(environment)
    return {**found, "finite": describe(kernel), "kernels": describe(kernels)}


def first_difference(wanted: Any, found: Any, where: str) -> str | None:
    """In words, the first place in which two descriptions differ."""
    if isinstance(wanted, dict) and isinstance(found, dict) and wanted.get("class") == found.get("class"):
        keys = dict.fromkeys([*wanted, *found])
        parts = ((f"{where}.{key}" if where else key, wanted.get(key), found.get(key)) for key in keys)
    elif isinstance(wanted, list) and isinstance(found, list) and len(wanted) == len(found):
        parts = ((f"{where}[{k}]", *pair) for k, pair in enumerate(zip(wanted, found, strict=True)))
    elif wanted == found:
        return None
    else:
        return f"{where} should be {_in_words(wanted)}, as saved; found {_in_words(found)}"
    differences = (first_difference(own, other, place) for place, own, other in parts)
    return next((difference for difference in differences if difference is not None), None)


def _array(value: np.ndarray) -> Any:
    if value.size <= _SHORT and value.dtype.kind in "biuf":
        return value.tolist()
    digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()[:16]
    return {"dtype": str(value.dtype), "shape": list(value.shape), "sha256": digest}


def _settings(value: Any) -> dict[str, Any]:
    if is_dataclass(value):  # what it finds while it is used is no setting
        return {own.name: getattr(value, own.name, None) for own in fields(value) if own.init}
    public = {name: part for name, part in getattr(value, "__dict__", {}).items() if not name.startswith("_")}
    return {name: part for name, part in public.items() if isinstance(part, (*_PLAIN, np.ndarray, np.generic))}


def _name(value: Any) -> str:
    return f"{type(value).__module__}.{type(value).__qualname__}"


def _in_words(value: Any) -> str:
    return value["class"] if isinstance(value, dict) and "class" in value else json.dumps(value, ensure_ascii=False)
