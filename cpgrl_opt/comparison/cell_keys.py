"""A key for what a cell of the comparison was measured on. Where the key has changed, the cell is measured anew.

It depends on the solver (its settings; of somebody's own its source, see `sources`; the versions of the packages it
stands on), of the problems (the recording's bytes), and of this package's sources that draw, solve and judge them.
"""

import hashlib
import json
import re
from collections.abc import Iterable
from functools import cache
from importlib.metadata import packages_distributions
from typing import Any

from ..solvers import SOLVERS, facts_of
from .checkpoint import CellKey
from .contestants import solver_of
from .machine import version_of
from .named_families import digests
from .recording import SHIPPED, shipped_path
from .sources import sources_of

_ADDRESS = re.compile(r" at 0x[0-9A-Fa-f]+")
_PLAIN = (bool, int, float, str, bytes, type(None))


def cell_keys(cells: Iterable[CellKey]) -> dict[CellKey, str]:
    """The key of each cell; solvers and recordings should be there."""
    listed = list(cells)
    ours = _ours()
    solvers = {name: _solver(name) for name in dict.fromkeys(solver for solver, _, _ in listed)}
    recordings = digests(dict.fromkeys(family for *_, family in listed))
    return {
        (solver, variant, family): _word([ours, solvers[solver], recordings.get(family)])
        for solver, variant, family in listed
    }


def _solver(name: str) -> dict[str, Any]:
    solver = solver_of(name)
    facts: dict[str, Any] = {"settings": settings_of(solver)}
    packages = set(facts_of(solver).packages[:1])
    if name not in SOLVERS:
        sources = sources_of(name.partition(":")[0], apart=[__name__.partition(".")[0]])
        distributions = packages_distributions() if sources.installed else {}
        facts["source"] = sources.digest
        packages |= {own for top in sources.installed for own in distributions.get(top, [top])}
    facts["packages"] = {package: version_of(package) for package in sorted(map(str, packages))}
    return facts


def settings_of(solver: object) -> list[str]:
    """What a solver says of itself, without addresses; its plain attributes where it says nothing but its class."""
    try:
        told = repr(solver)
    except Exception:  # of a third party: what it is called still tells something
        told = object.__repr__(solver)
    if not _ADDRESS.search(told):
        return [told]
    own = getattr(solver, "__dict__", {})
    plain = [f"{name} = {value!r}" for name, value in sorted(own.items()) if isinstance(value, _PLAIN)]
    return [_ADDRESS.sub("", told), *plain]


@cache
def _ours() -> str:
    shipped = [hashlib.sha256(shipped_path(name).read_bytes()).hexdigest() for name in SHIPPED]
    return _word([sources_of(f"{__package__}.bench").digest, *shipped])


def _word(facts: object) -> str:
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]
