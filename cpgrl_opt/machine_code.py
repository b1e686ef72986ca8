"""Machine code of functions, cached on disk where there is a folder for it. Calling it imports numba."""

import warnings
from collections.abc import Iterable
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np


def compile_function(signature: str, function: FunctionType, **options: bool) -> Any:
    """numba's function for the signature; division by zero gives an infinity or NaN.

    Warns, and compiles for this process alone, where numba can keep no cache. Under NUMBA_DISABLE_JIT the function
    itself, silent about overflow as machine code is.
    """
    from numba import njit

    settings: dict[str, Any] = {"error_model": "numpy", "nogil": True, **options}  # other threads go on meanwhile
    try:
        machine_code = njit(cache=True, **settings)(function)
        if machine_code is function:
            return np.errstate(all="ignore")(function)
        _load_or_compile(machine_code, signature)
    except (RuntimeError, OSError) as error:
        if isinstance(error, RuntimeError) and "no locator" not in str(error):
            raise
        warnings.warn(
            f"{function.__name__} is compiled for this process alone, some seconds: numba cannot write its cache "
            f"({error}). Set NUMBA_CACHE_DIR to a folder with room.",
            RuntimeWarning,
            stacklevel=2,
        )
        return njit(signature, **settings)(function)
    machine_code.disable_compile()
    return machine_code


def _load_or_compile(machine_code: Any, signature: str) -> None:
    """From the cache; one that is damaged, as by a full disk, is emptied. What else is wrong comes again."""
    try:
        machine_code.compile(signature)
    except Exception:  # a damaged pickle raises anything
        machine_code._cache.flush()
        machine_code.compile(signature)


class CompiledLate:
    """A function that is compiled for the signature, or loaded from the cache, when it is first called."""

    def __init__(self, signature: str, function: FunctionType) -> None:
        self.signature, self.function = signature, function

    @cached_property
    def machine_code(self) -> Any:
        """The compiled function itself."""
        return compile_function(self.signature, self.function)

    def __call__(self, *arguments: Any) -> Any:
        """As the function."""
        return self.machine_code(*arguments)


def forget_outdated_kernels(folder: Path, pattern: str = "*", sources: Iterable[Path] = ()) -> None:
    """Deletes cached kernels of the folder older than any of the sources, or of those in the folder.

    pattern: of the kernels' file names. numba compares a cached entry point with its own file only, though the machine
    code holds the helpers of the other files too; without this, a change in a helper would not take effect where a
    cache is left. A read-only installation keeps its cache, whose sources do not change either.
    """
    newest = max(source.stat().st_mtime_ns for source in (list(sources) or folder.glob("*.py")))
    for cached in (folder / "__pycache__").glob(f"{pattern}.nbi"):
        with suppress(OSError):  # not ours to delete, or another process that starts now was faster
            if cached.stat().st_mtime_ns < newest:
                cached.unlink()
