"""A digest of all that a training is made from: values by what they are, functions by their code and what it reaches.

The same thing made twice, in another process too, has the same digest; of what none can be made is a ValueError. What
a worker process would be handed counts, as pickling takes objects apart: their state, but for cached properties, which
follow from it. Python's own names, those of this package and of what is installed stand for what they name (whoever
keeps the digest keeps their versions); somebody's own functions, classes and modules are looked into.
"""

import copyreg
import dis
import functools
import hashlib
import sys
import types
from collections.abc import Iterable, Iterator
from functools import cache
from operator import itemgetter
from pathlib import Path
from types import CodeType, FunctionType, MappingProxyType, MethodType, ModuleType
from typing import Any

import numpy as np

from cpgrl_opt.comparison.machine import version_of
from cpgrl_opt.comparison.sources import Sources, sources_of

_OURS = ("cpgrl_opt", "envs", "rl")  # `sources_digest` tells of them
_INSTALLED = {"site-packages", "dist-packages"}
_DESCRIPTORS = (
    types.WrapperDescriptorType, types.MethodDescriptorType, types.ClassMethodDescriptorType,
    types.GetSetDescriptorType, types.MemberDescriptorType,
)  # fmt: skip
# Of a class: what Python itself puts there, and what says nothing of what it does.
_OF_NO_MATTER = {
    "_abc_impl", "__annotate__", "__annotate_func__", "__annotations__", "__annotations_cache__",
    "__dict__", "__doc__", "__firstlineno__", "__module__", "__static_attributes__", "__weakref__",
}  # fmt: skip


def digest_of(value: Any, where: str) -> str:
    """Of whatever the value is made of, in 16 hexadecimal digits; `where` names it in a ValueError."""
    found = _Digest({})
    try:
        found.add(value, where)
    except RecursionError:
        raise _indescribable(where, "what holds others within each other without end") from None
    for top in sorted(found.packages):
        found.put(top, _version_of(top))
    return found.hash.hexdigest()[:16]


def _indescribable(where: str, found: str) -> ValueError:
    return ValueError(
        f"{where} should be made of what can be pickled, so that a sweep sees whether it has changed; found {found}. "
        "Hand over what it is made from, and make it within the training"
    )


class _Digest:
    """A digest under way.

    seen: id → (number, object) of each object met so far, in order; holding the object keeps its id from being reused.
    """

    def __init__(self, seen: dict[int, tuple[int, Any]]) -> None:
        self.hash, self.seen = hashlib.sha256(), seen
        self.packages: set[str] = set()

    def put(self, *words: str | bytes) -> None:
        """Each with its length, so that two never read as another two."""
        for word in words:
            content = word.encode(errors="surrogatepass") if isinstance(word, str) else word
            self.hash.update(b"%d:" % len(content) + content)

    def add(self, value: Any, where: str) -> None:
        """A value of any kind."""
        kind = type(value)
        if kind in _BY_VALUE:
            self.put(kind.__name__, _BY_VALUE[kind](value))
        elif kind is tuple:
            self._each("tuple", value, where)
        elif isinstance(value, (np.ndarray, np.generic)) and kind.__module__ == "numpy" and not value.dtype.hasobject:
            order = "F" if np.isfortran(np.asarray(value)) else "C"
            self.put(kind.__name__, str(value.dtype), str(value.shape), order, value.tobytes())
        elif kind is CodeType:
            self._code(value, where)
        elif kind in _DESCRIPTORS:
            self.put(kind.__name__, value.__qualname__)
        elif kind is MethodType:
            self._named("method", (("__func__", value.__func__), ("__self__", value.__self__)), where)
        elif _has_name(value):
            self.put("name", value.__module__, value.__qualname__)
            self.packages |= {value.__module__.partition(".")[0]} - {*_OURS, *sys.stdlib_module_names}
        elif id(value) in self.seen:
            self.put("seen", str(self.seen[id(value)][0]))
        else:
            self.seen[id(value)] = len(self.seen), value
            self._look_into(value, where)

    def _each(self, kind: str, parts: Iterable[Any], where: str) -> None:
        listed = list(parts)
        self.put(kind, str(len(listed)))
        for position, part in enumerate(listed):
            self.add(part, f"{where}[{position}]" if kind in ("list", "tuple") else where)

    def _named(self, kind: str, parts: Iterable[tuple[str, Any]], where: str) -> None:
        listed = sorted(parts, key=itemgetter(0))
        self.put(kind, str(len(listed)))
        for name, part in listed:
            self.put(name)
            self.add(part, f"{where}.{name}")

    def _look_into(self, value: Any, where: str) -> None:
        if type(value) is list:
            self._each("list", value, where)
        elif type(value) in (dict, MappingProxyType):
            self._each("dict", (part for item in value.items() for part in item), where)
        elif isinstance(value, (set, frozenset)):
            self._set(value, where)
        elif isinstance(value, ModuleType):
            self.put("module", value.__name__)
            self._sources(value.__name__)
        elif (parts := _parts_of_wrapper(value)) is not None:
            self._each(type(value).__name__, parts, where)
        elif isinstance(value, FunctionType):
            self._function(value, where)
        elif isinstance(value, type):
            self._class(value, where)
        elif hasattr(type(value), "__dlpack__") and not isinstance(value, np.ndarray):
            self._foreign_array(value, where)
        else:
            self._object(value, where)

    def _set(self, value: Any, where: str) -> None:
        """In an order of their digests: its own changes from process to process."""
        digests = []
        for part in value:
            apart = _Digest(dict(self.seen))
            apart.add(part, where)
            self.packages |= apart.packages
            digests.append(apart.hash.hexdigest())
        self.put(type(value).__qualname__, *sorted(digests))
        self._named("state", getattr(value, "__dict__", {}).items(), where)

    def _code(self, code: CodeType, where: str) -> None:
        counts = code.co_flags, code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount
        self.put("code", code.co_code, code.co_exceptiontable, repr(counts))
        self.put(*(repr(names) for names in (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)))
        self._each("constants", code.co_consts, where)

    def _function(self, function: FunctionType, where: str) -> None:
        """Its code, its defaults, what it encloses, and the globals and modules that its code names."""
        self.put("function", function.__qualname__)
        self._code(function.__code__, where)
        self._each("defaults", (function.__defaults__, function.__kwdefaults__), where)
        self._named("attributes", vars(function).items(), where)
        self._sources(function.__module__)
        enclosed = dict(_enclosed(function))
        found, modules, attributes = _globals_of(function)
        for module in modules:
            self._sources(module)
        for named in (enclosed, found):
            self._named("named", named.items(), where)
            for name, part in sorted(named.items()):
                if isinstance(part, ModuleType) and _is_own(part.__name__):  # as it is, not only as it was written
                    looked_at = ((own, vars(part)[own]) for own in attributes & vars(part).keys())
                    self._named("module", looked_at, f"{where}.{name}")

    def _class(self, own: type, where: str) -> None:
        self.put("class", own.__qualname__)
        self._each("bases", (type(own), *own.__bases__), where)
        self._sources(own.__module__)
        self._named("members", ((name, part) for name, part in vars(own).items() if name not in _OF_NO_MATTER), where)

    def _sources(self, module: str | None) -> None:
        """Of somebody's own module and all that it imports; of an installed one its version."""
        top = (module or "__main__").partition(".")[0]
        if _is_own(module or "__main__"):
            sources = _sources_of(module or "__main__")
            self.put("sources", sources.digest)
            self.packages |= set(sources.installed)
        elif top not in (*_OURS, *sys.stdlib_module_names):
            self.packages.add(top)

    def _foreign_array(self, value: Any, where: str) -> None:
        """Of PyTorch, JAX …, whose pickles hold addresses."""
        on_host = value.detach().cpu() if hasattr(value, "detach") else value
        self.add(type(value), where)
        self.put(str(value.dtype), str(getattr(value, "requires_grad", "")))
        try:
            self.add(np.asarray(on_host), where)
        except Exception as error:
            raise _indescribable(where, f"{type(value).__name__} ({error})") from error

    def _object(self, value: Any, where: str) -> None:
        """As pickling takes it apart: what makes it, of what, and its state."""
        try:
            take_apart = copyreg.dispatch_table.get(type(value))
            found: Any = value.__reduce_ex__(4) if take_apart is None else take_apart(value)  # 4: slots too
        except Exception as error:
            raise _indescribable(where, f"{type(value).__name__} ({error})") from error
        self.add(type(value), where)
        if isinstance(found, str):
            self.put("global", str(getattr(value, "__module__", "")), found)
            return
        maker, arguments, state, items, pairs = [*found, None, None, None][:5]
        self._each("made by", (maker, arguments), where)
        self._each("items", items or (), where)
        self._each("pairs", pairs or (), where)
        for part in state if isinstance(state, tuple) else (state,):
            if type(part) is dict and all(type(name) is str for name in part):
                lasting = ((name, own) for name, own in part.items() if not _is_cached(type(value), name))
                self._named("state", lasting, where)
            else:
                self.add(part, where)


def _text(value: str) -> bytes:
    return value.encode(errors="surrogatepass")


_BY_VALUE: dict[type, Any] = {
    bool: repr, type(None): repr, type(...): repr, type(NotImplemented): repr, complex: repr, float: float.hex,
    int: hex, str: _text, bytes: bytes,
}  # fmt: skip


def _enclosed(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Variables of the functions around it, but for those that have no value yet."""
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            yield name, cell.cell_contents
        except ValueError:
            continue


def _globals_of(function: FunctionType) -> tuple[dict[str, Any], list[str], set[str]]:
    """What its code names: globals with their values, modules that it imports itself, names and attributes."""
    found, modules, names = dict[str, Any](), list[str](), set[str]()
    for code in _codes(function.__code__):
        names |= set(code.co_names)
        for step in dis.get_instructions(code):
            if step.opname in ("LOAD_GLOBAL", "LOAD_NAME") and step.argval in function.__globals__:
                found[step.argval] = function.__globals__[step.argval]
            elif step.opname == "IMPORT_NAME" and step.argval:
                modules.append(step.argval)
    return found, modules, names


def _codes(code: CodeType) -> Iterator[CodeType]:
    """It and all within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _parts_of_wrapper(value: Any) -> tuple[Any, ...] | None:
    """The functions within what pickling would name only, or number anew, or what remembers its calls."""
    if isinstance(value, (staticmethod, classmethod)):
        return (value.__func__,)
    if isinstance(value, property):
        return value.fget, value.fset, value.fdel
    if isinstance(value, functools.cached_property):
        return (value.func,)
    if isinstance(value, FunctionType) and isinstance(getattr(value, "registry", None), MappingProxyType):
        return (value.registry,)  # type: ignore[attr-defined] # of functools.singledispatch
    if isinstance(value, functools._lru_cache_wrapper):
        return value.__wrapped__, value.cache_parameters()
    if type(value).__module__.startswith("numba.") and hasattr(value, "py_func"):
        return value.py_func, getattr(value, "targetoptions", None)
    return None


def _has_name(value: Any) -> bool:
    """Whether it is Python's own, this package's or an installed one's, and found by its name."""
    module, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    if not isinstance(module, str) or not isinstance(name, str) or _is_own(module):
        return False
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    return found is value or (isinstance(value, type) and not value.__flags__ & _MADE_BY_PYTHON)


_MADE_BY_PYTHON = 1 << 9  # Py_TPFLAGS_HEAPTYPE; the others are made in C, once, and some have no name to be found by


def _is_own(module: str) -> bool:
    """Whether somebody made it who did not install it."""
    top = module.partition(".")[0]
    if top in sys.stdlib_module_names or top in _OURS:
        return False
    file = getattr(sys.modules.get(module) or sys.modules.get(top), "__file__", None)
    return file is None or not _INSTALLED & set(Path(file).parts)


@cache
def _sources_of(module: str) -> Sources:
    return sources_of(module, apart=_OURS)


@cache
def _version_of(package: str) -> str:
    return version_of(package)


def _is_cached(kind: type, name: str) -> bool:
    return isinstance(getattr(kind, name, None), functools.cached_property)
