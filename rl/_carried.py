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
    wanted, found = _outline(state, where), _outline(state_of(part), where)
    for place in {**wanted, **found}:
        if wanted.get(place) != found.get(place):
            raise ValueError(f"{place} should be as saved, {wanted.get(place)}; found {found.get(place)}")


def _outline(state: Any, where: str) -> dict[str, str]:
    """By place what a state has in common with others of its part. A number may be Python's or NumPy's."""
    if isinstance(state, dict) and "bit_generator" not in state:
        return {at: kind for name, own in state.items() for at, kind in _outline(own, f"{where}.{name}").items()}
    if isinstance(state, list):
        return {at: kind for k, own in enumerate(state) for at, kind in _outline(own, f"{where}[{k}]").items()}
    if isinstance(state, np.ndarray):
        return {where: f"{state.dtype}, {state.shape}"}
    if isinstance(state, dict):
        return {where: str(state["bit_generator"])}
    is_number = isinstance(state, (int, float, np.number)) and not isinstance(state, bool)
    return {where: "a number" if is_number else type(state).__name__}


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
