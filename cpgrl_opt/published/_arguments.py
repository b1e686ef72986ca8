"""Which of g, J and b a user's function takes, and how: told by the names and by what has no default."""

from collections.abc import Callable
from functools import partial
from inspect import Parameter, signature
from typing import Any

_GRADIENTS = ("g", "grad", "gradient")
_JACOBIANS = ("J", "jac", "jacobian")
_BOUNDS = ("b", "bound", "bounds")
_OTHERS = ("E", "equality", "equalities", "M", "metric", "radius", "m", "n")  # what a third argument might be instead
_POSITIONAL = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)


def bound_argument(function: Callable[..., Any]) -> int | str | None:
    """2 if b is the third argument, its name if it is handed over by that, None if the function takes g and J only.

    b is the argument named b, bound or bounds, with or without a default; else the third, if that has no default. So
    a third argument such as `iterations=50` keeps its default. What `functools.partial` has set stays.

    Raises
    ------
    ValueError
        If that does not settle it: other arguments without a default, another order, `*args`, or a compiled function
        that does not name its arguments.
    """
    if not callable(function):
        raise ValueError(f"function should be callable; found {function!r}")
    try:
        found = signature(function)
    except (TypeError, ValueError):
        raise _unclear(function, "arguments that it does not name") from None
    fixed = function.keywords if isinstance(function, partial) else {}
    parameters = [each for each in found.parameters.values() if each.name not in fixed]
    positional = [each for each in parameters if each.kind in _POSITIONAL]
    named = [each for each in parameters if each.name in _BOUNDS and each.kind != Parameter.VAR_POSITIONAL]
    third = [each for each in positional[2:] if each.default is Parameter.empty]
    bound = named or third
    needed = [each for each in parameters if each.kind == Parameter.KEYWORD_ONLY and each.default is Parameter.empty]
    is_clear = (
        len(positional) >= 2
        and positional[0].name not in (*_JACOBIANS, *_BOUNDS, *_OTHERS)
        and positional[1].name not in (*_GRADIENTS, *_BOUNDS, *_OTHERS)
        and len(bound) <= 1
        and all(each in bound and each.name not in (*_GRADIENTS, *_JACOBIANS, *_OTHERS) for each in (*third, *needed))
        and (bound or all(each.kind != Parameter.VAR_POSITIONAL for each in parameters))
    )
    if not is_clear:
        raise _unclear(function, f"the arguments {found}")
    if not bound:
        return None
    return 2 if bound[0] in positional[2:3] else bound[0].name


def name_of(function: Callable[..., Any]) -> str:
    """The function's name; that of its type if it has none."""
    return str(getattr(function, "__qualname__", type(function).__name__))


def _unclear(function: Callable[..., Any], found: str) -> ValueError:
    name = name_of(function)
    return ValueError(
        f"function should take (gradient, jacobian, bound) or (gradient, jacobian), and have defaults for the rest; "
        f"found {name} with {found}. Wrap it: def direction(g, J, b): return {name}(…)"
    )
