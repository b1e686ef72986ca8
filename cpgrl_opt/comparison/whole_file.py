"""A file that is whole under its name, whatever ends the process that writes it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_SHORT = 40  # of up to 255 bytes that a file's name may have


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Where to write instead: a file beside `path` that takes its place at the end, or is removed on an exception.

    What is no file, such as /dev/stdout, is written to as it is.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    beside = path.with_name(f"{path.name[:_SHORT]}.{os.getpid()}.part")
    try:
        yield beside
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
