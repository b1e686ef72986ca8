"""What goes from episode to episode, taken out and put back, by the names that each object lists in `carried`."""

from typing import Any

import numpy as np

_PLAIN = (bool, int, float, str, np.generic)


def state_of(part: Any) -> Any:
    """A copy: of arrays, numbers, random generators, lists of them, and objects' attributes named in `carried`.

    Raises ValueError for an object that names none.
    """
    if part is None or isinstance(part, _PLAIN):
        return part
    if isinstance(part, np.ndarray):
        return part.copy()
    if isinstance(part, np.random.Generator):
        return part.bit_generator.state
    if isinstance(part, list):
        return [state_of(each) for each in part]
    names = getattr(type(part), "carried", None)
    if names is None:
        raise ValueError(
            f"{type(part).__name__} should name the attributes that it carries from episode to episode, "
            'carried = ("…", …), so that a training can be saved; found no such class attribute'
        )
    return {name: state_of(getattr(part, name)) for name in names}


def outline(state: Any) -> Any:
    """What a state of `state_of` has in common with others of its part: names, kinds, lengths, shapes and dtypes."""
    if isinstance(state, np.ndarray):
        return f"{state.dtype}, {state.shape}"
    if isinstance(state, dict):
        return state.get("bit_generator") or {name: outline(own) for name, own in state.items()}
    if isinstance(state, list):
        return [outline(each) for each in state]
    is_number = isinstance(state, (int, float, np.number)) and not isinstance(state, bool)
    return "a number" if is_number else type(state).__name__  # a number may be Python's or NumPy's


def put_back(part: Any, state: Any) -> Any:
    """Such a part in that state: arrays, generators and objects in their place, whoever else holds them."""
    if isinstance(part, np.ndarray):
        part[...] = state
    elif isinstance(part, np.random.Generator):
        part.bit_generator.state = state
    elif isinstance(part, list):
        part[:] = [put_back(each, own) for each, own in zip(part, state, strict=True)]
    elif isinstance(state, dict):
        for name, own in state.items():
            setattr(part, name, put_back(getattr(part, name), own))
    else:
        return state
    return part
