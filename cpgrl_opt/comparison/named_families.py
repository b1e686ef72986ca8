"""Families by what a user types: the names of FAMILIES, and the paths of recordings, a family each."""

import hashlib
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from .families import FAMILIES, ProblemFamily, families_named
from .recording import load_recording
from .replay import recorded_family

_SUFFIX = ".npz"


def family_named(name: str) -> ProblemFamily:
    """FAMILIES[name], or the problems of the recording at the path `name`. ValueError for a file that is none."""
    return FAMILIES[name] if name in FAMILIES else _recorded(name, _stamp(Path(name)))


def families_asked(names: Iterable[str]) -> dict[str, ProblemFamily]:
    """The families of FAMILIES whose names match, in its order, then the recordings `path/to/subproblems.npz`.

    ValueError that lists the right names where one matches nothing, or that says what is wrong with a file.
    """
    typed = list(names)
    paths = [name for name in typed if name.endswith(_SUFFIX)]
    found = families_named(name for name in typed if name not in paths)
    return found | {str(Path(path)): family_named(str(Path(path))) for path in paths}


def digests(names: Iterable[str]) -> dict[str, str]:
    """SHA-256 of the recordings among the names: another recording at the same path is another family."""
    return {name: hashlib.sha256(Path(name).read_bytes()).hexdigest() for name in names if name not in FAMILIES}


@lru_cache(maxsize=8)
def _recorded(name: str, stamp: tuple[int, int]) -> ProblemFamily:  # noqa: ARG001 - what is read again when it changes
    recording = load_recording(name)
    if not len(recording):
        raise ValueError(f"{name} should hold at least one problem to be a family; found none")
    return recorded_family(recording, name)


def _stamp(path: Path) -> tuple[int, int]:
    """When the file changed and its size; zeros where there is none, which `load_recording` says in its words."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size
