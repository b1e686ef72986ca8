"""What a training is made with: a digest decides whether a saved one is handed the same, words tell what differs."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from .channels import event_key, layers

_LONG = 500  # letters of a setting that are told
_TOLD = (bool, int, float, str, np.ndarray, np.generic)  # attributes that are settings, of what is no dataclass


def words_of(name: str, value: Any) -> dict[str, str]:
    """Settings in words, by their places in `value`.

    Parameters
    ----------
    name
        Of the value, the first part of each place.
    value
        A dataclass, whose fields are looked into; any other object, whose public attributes are told if they are
        numbers, texts or arrays; or what its `repr` tells of.

    Returns
    -------
    dict of str
        The same in another process too: no addresses.
    """
    parts = _settings_of(value)
    if not parts:
        text = repr(value)
        return {name: _class(value) if " at 0x" in text else text[:_LONG]}
    inner = [words_of(f"{name}.{own}", part) for own, part in parts.items()]
    return {name: _class(value), **{place: words for own in inner for place, words in own.items()}}


def describe(name: str, value: Any) -> dict[str, str]:
    """`words_of` a value, and its digest where it has one: what cannot be pickled is known by the words alone."""
    from .digest import digest_of  # joblib loads with it

    try:
        return {**words_of(name, value), f"digest of {name}": digest_of(value, name, with_sources=False)}
    except RecursionError:  # an object that holds itself
        return {name: _class(value)}
    except ValueError:
        return words_of(name, value)


def describe_policy(policy: Any) -> dict[str, str]:
    """Without θ, which goes on from what is saved."""
    return describe("policy", policy.with_parameters(np.zeros(np.shape(policy.parameters))))


def describe_environment(environment: Any) -> dict[str, str]:
    """Its classes, wrappers first, and what it declares: a finite MDP, kernels, Gymnasium's spec and spaces.

    Other attributes are not looked at: they change as the environment runs.
    """
    from envs.interface import continuous_kernels_of, finite_kernel_of  # Gymnasium loads with envs

    spec = getattr(environment, "spec", None)
    spaces = ("observation_space", "action_space", "reward_space")
    declared = {
        "classes": ", ".join(_class(layer) for layer in layers(environment)),
        "event_key": event_key(environment),
        "spec": None if spec is None else [getattr(spec, "id", ""), getattr(spec, "kwargs", {})],
        **{name: repr(getattr(environment, name, None)) for name in spaces},
        "finite": finite_kernel_of(environment),
        "kernels": continuous_kernels_of(environment),
    }
    described = [describe(f"environment.{name}", part) for name, part in declared.items()]
    return {place: words for own in described for place, words in own.items()}


def first_difference(wanted: Any, found: Mapping[str, str]) -> str | None:
    """Where a description is not the one that was saved, in words; None if nowhere."""
    saved = wanted if isinstance(wanted, dict) else {"settings": wanted}
    for name in dict.fromkeys([*saved, *found]):
        if saved.get(name) != found.get(name):
            return f"{name} should be {saved.get(name)}, as saved; found {found.get(name)}"
    return None


def _settings_of(value: Any) -> dict[str, Any]:
    if isinstance(value, type):
        return {}
    if is_dataclass(value):  # what it finds while it is used is no setting
        return {own.name: getattr(value, own.name, None) for own in fields(value) if own.init}
    public = {name: part for name, part in getattr(value, "__dict__", {}).items() if not name.startswith("_")}
    return {name: part for name, part in public.items() if isinstance(part, _TOLD)}


def _class(value: Any) -> str:
    """Of a function or a class, its own name."""
    kind = value if hasattr(value, "__qualname__") else type(value)
    return f"{kind.__module__}.{kind.__qualname__}"
