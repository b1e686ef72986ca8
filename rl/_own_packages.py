"""`envs` is a common name: another distribution, or a folder of the user's, may stand in the way of ours."""

import warnings
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path


def warn_of_foreign(name: str) -> None:
    """Warns where the package that Python finds by this name is not the one beside this one."""
    ours, origin = Path(__file__).resolve().parents[1] / name, None
    with suppress(ValueError):  # of a module that was put there by hand, and has no spec
        found = find_spec(name)
        origin = None if found is None else found.origin
    if origin is None or Path(origin).resolve().parent != ours:
        warnings.warn(
            f"the package {name} should be that of cpgrl-opt, {ours}; found {origin}: imports will fail. Rename "
            "that one or start elsewhere; where a distribution brought it, uninstall that and install cpgrl-opt anew.",
            stacklevel=2,
        )


warn_of_foreign("envs")  # as `rl` is imported
