"""What numba's disk cache does not see: a change in a file other than the entry point's."""

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path


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
