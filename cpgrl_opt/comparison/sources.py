"""What a module is made of: its own source and that of all it imports, found by reading, without running any of it.

Of what is installed, and of Python itself, only the package's name is kept: its version says what it is. What a module
loads by other means than an import (a data file, a name put together at run time) is not seen.
"""

import ast
import hashlib
import sys
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

_INSTALLED = ("site-packages", "dist-packages")
_BINARY = ("so", "pyd")


@dataclass(frozen=True)
class Sources:
    """digest: SHA-256 of all sources with their names.

    modules: names of what was read; installed: top-level names of the packages imported.
    """

    digest: str
    modules: tuple[str, ...]
    installed: tuple[str, ...]


def sources_of(module: str, *, apart: Collection[str] = ()) -> Sources:
    """Sources of a module that can be imported. apart: top-level names that are left out, with all they import."""
    own, found, installed = _top(module), dict[str, bytes](), set[str]()
    waiting, seen = list(_with_parents(module)), set[str]()
    while waiting:
        name = waiting.pop()
        base = None if name in seen or _top(name) in apart else _base(_top(name))
        seen.add(name)
        if base is None:
            continue
        if _top(name) != own and set(_INSTALLED) & set(base.parts):
            installed.add(_top(name))
            continue
        path = _file(base, name)
        if path is not None:
            found[name] = path.read_bytes()
            waiting += _imported(name, path, found[name])
    digest = hashlib.sha256()
    for name, content in sorted(found.items()):
        digest.update(f"{name} {len(content)}\n".encode(errors="surrogateescape") + content)
    return Sources(digest.hexdigest(), tuple(sorted(found)), tuple(sorted(installed)))


def _top(name: str) -> str:
    return name.partition(".")[0]


def _with_parents(name: str) -> Iterator[str]:
    """a, a.b and a.b.c of a.b.c: an import runs them all."""
    parts = name.split(".")
    return (".".join(parts[:count]) for count in range(1, len(parts) + 1))


def _base(top: str) -> Path | None:
    """The folder that a top-level module or package lies in; None for what is Python's own, or not there."""
    if top in sys.stdlib_module_names:
        return None
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):  # a module without a spec, as __main__
        return None
    if spec is None:
        return None
    if spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations))).parent
    return Path(spec.origin).parent if spec.has_location and spec.origin else None


def _file(base: Path, name: str) -> Path | None:
    """The file of a module; None where no file has that name: it is a function's, say, or a bare folder's."""
    place = base.joinpath(*name.split("."))
    binaries = (path for suffix in _BINARY for path in sorted(place.parent.glob(f"{place.name}.*{suffix}")))
    candidates = (place.with_name(f"{place.name}.py"), place / "__init__.py", *binaries)
    return next((path for path in candidates if path.is_file()), None)


def _imported(name: str, path: Path, content: bytes) -> Iterator[str]:
    """Whatever may be a module of those that a source imports, within functions too."""
    try:
        tree = ast.parse(content)
    except (SyntaxError, ValueError):  # a binary, or nothing that could be imported
        return
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from _with_parents(alias.name)
        elif isinstance(node, ast.Call) and node.args and _is_import(node.func):
            named = node.args[0]
            if isinstance(named, ast.Constant) and isinstance(named.value, str):
                yield from _with_parents(named.value if named.value[:1] != "." else package + named.value)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            origin = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                yield from _with_parents(f"{origin}.{alias.name}".strip("."))


def _is_import(function: ast.expr) -> bool:
    """Of `import_module(…)`, `importlib.import_module(…)` and `__import__(…)`."""
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", None)
    return name in ("import_module", "__import__")
