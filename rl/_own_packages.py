"""`envs` is a common name: another distribution, or a folder of the user's, may stand in the way of ours."""

import warnings
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path


def warn_of_foreign(name: str, mark: str) -> None:
    """Warns where the package that Python finds by this name is not ours.

    Ours lies beside this one, and its file has the mark: where another distribution wrote into our folder it has not.
    """
    ours, origin = Path(__file__).resolve().parents[1] / name, ""
    with suppress(ValueError):  # of a module that was put there by hand, and has no spec
        found = find_spec(name)
        origin = str(found.origin) if found is not None else ""
    with suppress(OSError):
        if Path(origin).resolve().parent == ours and mark in Path(origin).read_text("utf-8", "replace"):
            return
    warnings.warn(
        f"the package {name} should be that of cpgrl-opt, {ours}; found {origin or 'none'}, which is not: imports will "
        "fail. Rename that one or start elsewhere; where a distribution brought it, uninstall that and install "
        "cpgrl-opt anew.",
        stacklevel=2,
    )


warn_of_foreign("envs", mark="cpgrl/ThreeState-v0")  # as `rl` is imported; the mark: an environment that it registers
