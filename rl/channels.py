"""What a Gymnasium environment declares beyond Gymnasium: channels of its reward, and events that end an episode."""

from collections.abc import Iterator, Mapping
from operator import index
from typing import Any

import numpy as np

EVENT_KEY = "cpgrl_event"  # a name that no other library's info has


def layers(environment: Any) -> Iterator[Any]:
    """The environment's wrappers, the outermost first, then the environment itself."""
    seen: list[Any] = []
    layer = environment
    while layer is not None and all(layer is not other for other in seen):
        yield layer
        seen.append(layer)
        inner = getattr(layer, "env", None)
        layer = inner if callable(getattr(inner, "step", None)) else getattr(layer, "unwrapped", None)


def find_declaration(environment: Any, name: str) -> Any:
    """An attribute of the outermost layer that has it, so that a wrapper's own wins; None if none has."""
    return next((found for layer in layers(environment) if (found := getattr(layer, name, None)) is not None), None)


def reward_channels(environment: Any) -> int:
    """1 + m of a Gymnasium environment with a vector reward.

    Read from `reward_channels` (envs.interface) or the shape of `reward_space` (MO-Gymnasium) of the outermost layer
    that has one of them: a wrapper that makes channels, of a cost in `info` say, or leaves some out declares its own.

    Raises
    ------
    ValueError
        For anything else.
    """
    if not (callable(getattr(environment, "reset", None)) and callable(getattr(environment, "step", None))):
        raise ValueError(
            "environment should be a Gymnasium environment (reset, step), or a finite MDP (finite_kernel) with a "
            f"SoftmaxTable, no subclass with its own code; found {type(environment).__name__}"
        )
    for layer in layers(environment):
        channels = _channels(layer)
        if channels is not None:
            return channels
    raise ValueError(
        "environment should have a reward_space of shape (1 + m,), as in MO-Gymnasium; found none in "
        f"{name_of(environment)}. Where the reward is one number, write a gymnasium.Wrapper whose step returns "
        "np.array([reward, -cost]) and whose reward_space is a Box of that shape"
    )


def _channels(layer: Any) -> int | None:
    """What one layer declares, None for nothing."""
    stated, space = getattr(layer, "reward_channels", None), getattr(layer, "reward_space", None)
    if space is None:
        return None if stated is None else int(stated)
    shape = getattr(space, "shape", None)
    if shape is None or len(shape) != 1 or shape[0] < 1:
        raise ValueError(
            "environment should have a reward_space of shape (1 + m,), as in MO-Gymnasium; found "
            f"{shape} in {type(layer).__name__}"
        )
    if stated is not None and int(stated) != shape[0]:
        raise ValueError(
            f"reward_channels and reward_space of {type(layer).__name__} should say the same; found {stated} and "
            f"shape {shape}"
        )
    return int(shape[0])


def event_key(environment: Any) -> str:
    """Where `info` says how an episode ended: the environment's own `event_key`, else EVENT_KEY."""
    key = find_declaration(environment, "event_key")
    return key if isinstance(key, str) else EVENT_KEY


def event_of(info: Any, key: str, *, terminated: bool) -> int:
    """0 while an episode goes on or time ran out; after a termination info[key], if it is an integer ≥ 1, else 1.

    A termination never counts as 0: estimators would bootstrap from its last state as from one at a time limit.
    """
    if not terminated:
        return 0
    event = info.get(key) if isinstance(info, Mapping) else None
    if isinstance(event, bool | np.bool_):
        return 1
    try:
        return max(index(event), 1)  # type: ignore[arg-type]
    except TypeError:  # no integer, or an array of them
        return 1


def name_of(environment: Any) -> str:
    """The class of the environment within its wrappers."""
    return type(getattr(environment, "unwrapped", environment)).__name__
