"""What numba's disk cache does not see: a change in a file other than the entry point's."""

from contextlib import suppress
from pathlib import Path


def forget_outdated_kernels(folder: Path) -> None:
    """Deletes cached kernels older than any source in the folder.

    numba compares a cached entry point with its own file only, though the machine code holds the helpers of the
    other files too; without this, a change in a helper would not take effect where a cache is left. A read-only
    installation keeps its cache, whose sources do not change either.
    """
    newest = max(source.stat().st_mtime_ns for source in folder.glob("*.py"))
    for cached in (folder / "__pycache__").glob("*.nbi"):
        with suppress(OSError):  # not ours to delete, or another process that starts now was faster
            if cached.stat().st_mtime_ns < newest:
                cached.unlink()
