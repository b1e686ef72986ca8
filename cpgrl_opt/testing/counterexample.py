"""A counterexample as a test that can be pasted, run, and checked by hand."""

from typing import Any

import numpy as np

from ..problem import DirectionProblem
from ..solvers.interface import DirectionSolver
from .laws import Law


def counterexample_code(
    law: Law,
    solver: DirectionSolver | None,
    arguments: dict[str, Any],
    *,
    imports: tuple[str, ...] = (),
    spelled: str = "",
    remark: str = "",
) -> str:
    """Source of a pytest test with the arguments written out.

    imports, spelled: statements and the expression that give the solver; without them `solver` is an argument of the
    test, which the reader has to supply. remark: a comment beside the test's name.
    """
    name = law.name.removeprefix("check_")
    parameter = "" if spelled else "solver"
    remark = remark or ("" if spelled else f"solver: {_one_line(repr(solver))}")
    comment = f"  # {_one_line(remark)}" if remark else ""
    call = [
        f"def test_{name}_holds_here({parameter}):{comment}",
        f"    {law.name}(",
        f"        {spelled or 'solver'},",
        *(f"        {name}={_source(value, 8)}," for name, value in arguments.items()),
        "    )",
    ]
    with_numpy = ["from numpy import zeros"] if "zeros(" in "\n".join(call[3:]) else []
    problem = ["from cpgrl_opt import DirectionProblem"]
    names = [*problem, f"from cpgrl_opt.testing import {law.name}", *with_numpy, *imports]
    return "\n".join([*names, "", "", *call]) + "\n"


def _source(value: Any, indent: int) -> str:
    """Python that evaluates to the value."""
    inner, outer = " " * (indent + 4), " " * indent
    if isinstance(value, DirectionProblem):
        parts = [
            f"gradient={_source(value.gradient, indent + 4)}",
            f"jacobian={_matrix(value.jacobian, indent + 4)}",
            f"bound={_source(value.bound, indent + 4)}",
            f"equality={value.equality.tolist()}",
        ]
        parts += [f"metric={_source(value.metric, indent + 4)}"] if value.metric is not None else []
        parts += [f"radius={value.radius!r}"] if value.radius is not None else []
        return "DirectionProblem(\n" + "".join(f"{inner}{part},\n" for part in parts) + f"{outer})"
    if isinstance(value, list | tuple):
        return "[\n" + "".join(f"{inner}{_source(item, indent + 4)},\n" for item in value) + f"{outer}]"
    if isinstance(value, np.ndarray) and value.ndim == 2:
        return _matrix(value, indent)
    if isinstance(value, np.ndarray):
        return f"[{', '.join(_source(item, indent) for item in value.tolist())}]"
    return repr(value) if np.all(np.isfinite(value) if isinstance(value, float) else True) else f'float("{value}")'


def _matrix(rows: np.ndarray, indent: int) -> str:
    """One row a line; an empty matrix needs its number of columns."""
    if len(rows) == 0:
        return f"zeros({rows.shape})"
    return "[\n" + "".join(f"{' ' * (indent + 4)}{_source(row, 0)},\n" for row in rows) + f"{' ' * indent}]"


def _one_line(text: str) -> str:
    return " ".join(text.split())
