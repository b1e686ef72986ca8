"""Whether compiled code may stand for an object: only while nothing below the class that declares it has other code.

A kernel restates code, the `step` of an environment or the `sample` of a policy. Whoever overrides that code means the
override, so compiled code may then no longer take its place. Data needs no such rule: kernels are handed data.
"""

from typing import Any, TypeVar

# Code that no kernel restates: pictures, and exact answers.
_BESIDE = {
    "render", "close", "average_rewards", "policy_gradients", "discounted_score_gradients", "constrained_optimum",
}  # fmt: skip
# Code that every kernel restates, whether its class has it or not.
_DYNAMICS = ("reset", "step")
_NOTHING = object()
_AS_WRITTEN: dict[type, dict[str, Any]] = {}
Class = TypeVar("Class", bound=type)


def register_code(owner: Class) -> Class:
    """Decorates a class whose code kernels restate: what is patched into it later, by `mock` say, is other code."""
    _AS_WRITTEN[owner] = dict(vars(owner))
    return owner


def declaring_class(instance: object, name: str) -> type | None:
    """The class whose `name` an instance has, or None: attributes made up by `__getattr__` do not count."""
    return next((base for base in type(instance).__mro__ if name in vars(base)), None)


def list_overrides(instance: object, owner: type, names: tuple[str, ...] | None = None) -> list[str]:
    """Names of code of `owner` that is other code on `instance`, sorted; empty where `owner` still speaks for it.

    The rule: every method and property that `owner` has, `reset` and `step` too, must be found on the instance as it
    is found on `owner` itself, whether a subclass, another base class or the instance's own attributes changed it.
    Left out are special methods, an override of `__init__` among them, pictures and exact answers.
    names: only these, in place of all code of `owner`. Code that is patched into `owner` itself is seen where `owner`
    was decorated with `register_code`.
    """
    code = {name for base in owner.__mro__[:-1] for name, value in vars(base).items() if _is_code(name, value)}
    looked_at = code - _BESIDE | set(_DYNAMICS) if names is None else set(names)
    return sorted(name for name in looked_at if _find(instance, name) is not _as_written(owner, name))


def _is_code(name: str, value: object) -> bool:
    special = name.startswith("__") and name.endswith("__")
    return not special and (callable(value) or hasattr(value, "__get__"))


def _in_class(owner: type, name: str) -> Any:
    return next((vars(base)[name] for base in owner.__mro__ if name in vars(base)), _NOTHING)


def _as_written(owner: type, name: str) -> Any:
    bodies = (_AS_WRITTEN.get(base, vars(base)) for base in owner.__mro__)
    return next((body[name] for body in bodies if name in body), _NOTHING)


def _find(instance: object, name: str) -> Any:
    """What the instance has under a name; its own attribute first, unless that is a cached property's value."""
    by_class = _in_class(type(instance), name)
    own = getattr(instance, "__dict__", {})
    return own[name] if name in own and (by_class is _NOTHING or callable(by_class)) else by_class
