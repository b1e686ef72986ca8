"""What numba's disk cache does not see: a change in a file other than the entry point's."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any


def forget_outdated_kernels(folders: Iterable[Path], sources: Sequence[Path]) -> None:
    """Deletes the cached kernels in the folders' __pycache__ that are older than the newest of the sources.

    numba compares a cached entry point with its own file only, though the machine code holds the helpers of other
    files too; without this, a change in a helper would not take effect where a cache is left. sources: files that any
    of the kernels may hold code of. Where nothing can be read or deleted, as in a read-only installation, whose
    sources do not change either, the cache is used as it is.
    """
    with suppress(OSError):
        newest = max(source.stat().st_mtime_ns for source in sources)
        for folder in folders:
            for cached in (folder / "__pycache__").glob("*.nbi"):
                if cached.stat().st_mtime_ns < newest:
                    cached.unlink(missing_ok=True)


def compile_and_cache(signature: Any, **options: bool) -> Any:
    """Decorates what numba compiles for the signature, or loads from its disk cache; without one that is damaged."""
    from numba import njit

    def compiled(function: Any) -> Any:
        try:
            return njit(signature, cache=True, **options)(function)
        except Exception:  # of a damaged pickle anything; what is wrong with the function comes again
            return njit(signature, **options)(function)

    return compiled
