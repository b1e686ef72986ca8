"""Families by what a user types: names of FAMILIES and of `cpgrl_opt.problems`, and paths of recordings."""

import hashlib
from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from functools import lru_cache
from pathlib import Path

from .. import problems
from ..exact import exact_answer
from ..validation import not_a_member
from .families import FAMILIES, ProblemFamily
from .recorded_family import make_recorded_family
from .recording import load_recording

_SUFFIX = ".npz"


# Those of the conformance kit and of users, at the settings that these draw; FAMILIES has the same at fixed ones.
REGISTERED: Mapping[str, ProblemFamily] = {
    name: ProblemFamily(
        name, family.reason, family.draw, family.feasible is True, family.well_posed,
        feasibility=(lambda problem: exact_answer(problem).feasible) if family.feasible is None else None,
    )
    for name, family in problems.FAMILIES.items() if name not in FAMILIES
}  # fmt: skip
_NAMED = {**FAMILIES, **REGISTERED}


def family_named(name: str) -> ProblemFamily:
    """The family of that name, or of the recording at the path `name`. ValueError for a file that is none."""
    return _NAMED[name] if name in _NAMED else _read_family(name, _stamp(Path(name)))


def families_asked(names: Iterable[str]) -> dict[str, ProblemFamily]:
    """The families of FAMILIES that a pattern matches (`opposing-*` matches many), in its order.

    Then those of `cpgrl_opt.problems` by their names, and the recordings `path/to/subproblems.npz`.
    ValueError that lists the right names where one matches nothing, or that says what is wrong with a file.
    """
    chosen: set[str] = set()
    paths: list[str] = []
    for typed in names:
        if typed.endswith(_SUFFIX):
            paths.append(str(Path(typed)))
            continue
        found = {name for name in FAMILIES if fnmatchcase(name, typed)} or {typed} & REGISTERED.keys()
        if not found:
            raise not_a_member("family", typed, _NAMED, ", or a recording, FILE.npz")
        chosen |= found
    return {name: _NAMED[name] for name in _NAMED if name in chosen} | {path: family_named(path) for path in paths}


def digests(names: Iterable[str]) -> dict[str, str]:
    """SHA-256 of the recordings among the names: another recording at the same path is another family."""
    return {name: hashlib.sha256(Path(name).read_bytes()).hexdigest() for name in names if name not in _NAMED}


@lru_cache(maxsize=8)
def _read_family(name: str, stamp: tuple[int, int]) -> ProblemFamily:  # noqa: ARG001 - what is read again when it changes
    recording = load_recording(name)
    if not len(recording):
        raise ValueError(f"{name} should hold at least one problem to be a family; found none")
    return make_recorded_family(recording, name)


def _stamp(path: Path) -> tuple[int, int]:
    """When the file changed and its size; zeros where there is none, which `load_recording` says in its words."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size
