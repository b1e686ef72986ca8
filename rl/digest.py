"""A digest of whatever a training is made from: the same thing made anew, in another process too, has the same.

joblib hashes values, arrays and objects as pickle takes them apart. What pickle only names is looked into here where
somebody wrote it who did not install it: a function by its code, defaults, closure and the globals that its code
names, a class by its members. Whatever is met counts with the sources of its module, or with its package's version.
"""

import dis
import functools
import hashlib
import pickle
import sys
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from types import CodeType, FunctionType, MappingProxyType, ModuleType
from typing import Any

import numpy as np
from joblib.hashing import NumpyHasher

from cpgrl_opt.comparison.machine import versions
from cpgrl_opt.comparison.sources import Sources, sources_of

_OURS = ("cpgrl_opt", "envs", "rl")  # `sources_digest` tells of them
_INSTALLED = {"site-packages", "dist-packages"}
_CODE = (
    "co_code", "co_exceptiontable", "co_names", "co_varnames", "co_freevars", "co_cellvars", "co_flags", "co_argcount",
    "co_posonlyargcount", "co_kwonlyargcount",
)  # fmt: skip
# Of a class: what Python itself puts there, copyreg's memory among it, and what says nothing of what it does.
_OF_NO_MATTER = {
    "_abc_impl", "__annotate__", "__annotate_func__", "__annotations__", "__annotations_cache__",
    "__dict__", "__doc__", "__firstlineno__", "__module__", "__slotnames__", "__static_attributes__", "__weakref__",
}  # fmt: skip


def digest_of(value: Any, where: str, *, with_sources: bool = True) -> str:
    """A digest of what a value is made of.

    Parameters
    ----------
    value
        What can be pickled, functions, classes and modules.
    where
        The value's name, for the error.
    with_sources
        Whether the sources and versions of the modules that it comes from count, too.

    Returns
    -------
    str
        16 hexadecimal digits.

    Raises
    ------
    ValueError
        For what cannot be pickled.
    """
    hasher = _Hasher()
    try:
        found = hasher.hash(value)
    except Exception as error:  # of somebody's `__reduce__`, and of what cannot be pickled
        raise ValueError(
            f"{where} should be made of what can be pickled, so that its changes are seen; found {value!r:.200} "
            f"({type(error).__name__}: {error!s:.200}). Hand over what it is made from, and make it within the training"
        ) from error
    if not with_sources:
        return digest_of_text(found)
    sources = [_sources_of(module) for module in sorted(hasher.modules) if _is_own(module)]
    tops = {module.partition(".")[0] for module in hasher.modules if not _is_own(module)}
    installed = tops.union(*(own.installed for own in sources)) - {*_OURS, *sys.stdlib_module_names}
    return digest_of_text(found, *(own.digest for own in sources), str(versions(sorted(installed))))


def digest_of_text(*texts: str) -> str:
    """16 hexadecimal digits, which another division into texts does not have."""
    return hashlib.sha256(repr(texts).encode(errors="surrogatepass")).hexdigest()[:16]


def sources_digest() -> str:
    """Of all sources of this package."""
    digest = hashlib.sha256()
    for package in _OURS:
        for folder in getattr(find_spec(package), "submodule_search_locations", None) or ():
            for source in sorted(Path(folder).rglob("*.py")):
                digest.update(source.relative_to(folder).as_posix().encode() + b"\n" + source.read_bytes())
    return digest.hexdigest()


class _Hasher(NumpyHasher):  # type: ignore[misc]
    """modules: those that what was met comes from."""

    def __init__(self) -> None:
        super().__init__(hash_name="sha256")
        self.modules: set[str] = set()

    def reducer_override(self, value: Any) -> Any:
        """(maker, name, state), as pickle asks for it; what is in the state may hold the value itself."""
        kind = type(value)
        if kind in (dict, MappingProxyType):  # joblib would sort it
            return _made, ("dict",), list(value.items())
        if kind in (set, frozenset):  # whose order changes from process to process
            return _made, (kind.__name__,), sorted(map(self._hash_apart, value))
        if isinstance(value, ModuleType):
            self.modules.add(value.__name__)
            return _made, ("module", value.__name__)
        if hasattr(kind, "__dlpack__") and not isinstance(value, np.ndarray):  # pickles of PyTorch, JAX hold addresses
            on_host = value.detach().cpu() if hasattr(value, "detach") else value
            return _made, (kind, str(value.dtype), getattr(value, "requires_grad", None), np.asarray(on_host))
        if (parts := _wrapped(value)) is not None:
            return _made, (kind.__name__,), parts
        if not isinstance(value, FunctionType | type):
            return _without_remembered(value)
        self.modules.add(value.__module__ or "__main__")
        if _has_name(value):
            return NotImplemented
        return _made, (value.__qualname__,), self._function(value) if isinstance(value, FunctionType) else _class(value)

    def _hash_apart(self, value: Any) -> str:
        apart = _Hasher()
        found = str(apart.hash(value))
        self.modules |= apart.modules
        return found

    def _function(self, function: FunctionType) -> Any:
        """Its code, its defaults, what it encloses, and the globals that its code names."""
        codes = list(_codes(function.__code__))
        steps = [step for code in codes for step in dis.get_instructions(code)]
        named = [
            *((name, function.__globals__.get(name)) for name in _arguments(steps, "LOAD_GLOBAL", "LOAD_NAME")),
            *_enclosed(function),
        ]
        self.modules.update(_arguments(steps, "IMPORT_NAME"))
        attributes = sorted({name for code in codes for name in code.co_names})
        own = [part for _, part in named if isinstance(part, ModuleType) and _is_own(part.__name__)]
        # As they are, not only as they were written.
        looked_at = [(name, vars(module)[name]) for module in own for name in attributes if name in vars(module)]
        defaults = function.__defaults__, function.__kwdefaults__
        return list(map(_code, codes)), defaults, vars(function), named, looked_at


def _made(*_: Any) -> None:
    """Stands for the maker of a value in what is hashed; never called."""


def _without_remembered(value: Any) -> Any:
    """As pickle takes it apart, but for cached properties, which follow from the rest."""
    kept = getattr(value, "__dict__", {})
    remembered = {name for name in kept if isinstance(getattr(type(value), name, None), functools.cached_property)}
    if not remembered:
        return NotImplemented
    maker, arguments, state, *others = value.__reduce_ex__(4)
    lasting = {name: part for name, part in state.items() if name not in remembered} if state is kept else state
    return maker, arguments, lasting, *others


def _class(own: type) -> Any:
    members = sorted(name for name in vars(own) if name not in _OF_NO_MATTER)
    return type(own), own.__bases__, [(name, vars(own)[name]) for name in members]


def _codes(code: CodeType) -> Iterator[CodeType]:
    """It and all within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _code(code: CodeType) -> str:
    """All that it does, wherever it stands; code within it stands for itself."""
    constants = [_constant(value) for value in code.co_consts if not isinstance(value, CodeType)]
    return repr([*(getattr(code, name) for name in _CODE), constants])


def _constant(value: Any) -> str:
    return repr(sorted(map(repr, value))) if isinstance(value, frozenset) else repr(value)


def _arguments(steps: Iterable[dis.Instruction], *names: str) -> dict[str, None]:
    """What these instructions name, in order."""
    return dict.fromkeys(step.argval for step in steps if step.opname in names and step.argval)


def _enclosed(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Variables of the functions around it, but for those that have no value yet."""
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            yield name, cell.cell_contents
        except ValueError:
            continue


def _wrapped(value: Any) -> tuple[Any, ...] | None:
    """The functions within what pickle refuses, only names or numbers anew, or what remembers its calls."""
    if isinstance(value, staticmethod | classmethod | functools._lru_cache_wrapper):
        return (value.__wrapped__,)
    if isinstance(value, property):
        return value.fget, value.fset, value.fdel
    if isinstance(value, functools.cached_property):
        return (value.func,)
    if isinstance(value, FunctionType) and isinstance(getattr(value, "registry", None), MappingProxyType):
        return (value.registry,)  # type: ignore[attr-defined] # of functools.singledispatch
    if type(value).__module__.startswith("numba.") and hasattr(value, "py_func"):
        return value.py_func, value.targetoptions
    return None


def _has_name(value: Any) -> bool:
    """Whether it is Python's own, this package's or an installed one's, and found by its name."""
    try:
        return not _is_own(value.__module__) and bool(pickle.loads(pickle.dumps(value)) is value)
    except Exception:
        return False


def _is_own(module: str) -> bool:
    """Whether somebody made it who did not install it."""
    top = module.partition(".")[0]
    if top in sys.stdlib_module_names or top in _OURS:
        return False
    file = getattr(sys.modules.get(module) or sys.modules.get(top), "__file__", None)
    return file is None or not _INSTALLED & set(Path(file).parts)


@functools.cache
def _sources_of(module: str) -> Sources:
    return sources_of(module, apart=_OURS)
