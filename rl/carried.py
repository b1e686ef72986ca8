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


def require_like(part: Any, state: Any, where: str) -> None:
    """ValueError unless the state is one of such a part: same names, kinds, lengths, shapes and dtypes."""
    own = state_of(part)
    wanted: object
    found: object
    if isinstance(part, np.ndarray):
        wanted, found = _array_in_words(part), _array_in_words(state)
    elif isinstance(part, np.random.Generator):
        wanted, found = own["bit_generator"], state.get("bit_generator") if isinstance(state, dict) else None
    elif isinstance(own, dict):
        wanted, found = list(own), list(state) if isinstance(state, dict) else None
    elif isinstance(own, list):
        wanted, found = len(own), len(state) if isinstance(state, list) else None
    else:
        wanted, found = _kind_of(own), _kind_of(state)
    if wanted != found:
        raise ValueError(f"{where} should be as saved, {found}; found {wanted}")
    if isinstance(part, list):
        for k, each in enumerate(part):
            require_like(each, state[k], f"{where}[{k}]")
    elif isinstance(own, dict) and not isinstance(part, np.random.Generator):
        for name in own:
            require_like(getattr(part, name), state[name], f"{where}.{name}")


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


def _kind_of(value: Any) -> str:
    """A number may be Python's or NumPy's."""
    is_number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    return "a number" if is_number else type(value).__name__


def _array_in_words(value: Any) -> str:
    return f"{value.dtype}, {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
