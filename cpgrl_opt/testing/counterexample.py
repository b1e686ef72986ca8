"""A counterexample as a test that can be pasted, run, and checked by hand."""

from typing import Any

import numpy as np

from ..problem import DirectionProblem
from ..solvers.interface import DirectionSolver
from .laws import Law


def counterexample_code(law: Law, solver: DirectionSolver, arguments: dict[str, Any]) -> str:
    """Source of a pytest test with the arguments written out; `solver` is a name that the reader has to supply."""
    name = law.name.removeprefix("check_")
    lines = [
        "from cpgrl_opt import DirectionProblem",
        f"from cpgrl_opt.testing import {law.name}",
        "",
        "",
        f"def test_{name}_holds_here(solver):  # solver: {_one_line(repr(solver))}",
        f"    {law.name}(",
        "        solver,",
        *(f"        {name}={_source(value, 8)}," for name, value in arguments.items()),
        "    )",
    ]
    return "\n".join(lines) + "\n"


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
        return f"np.zeros({rows.shape})"
    return "[\n" + "".join(f"{' ' * (indent + 4)}{_source(row, 0)},\n" for row in rows) + f"{' ' * indent}]"


def _one_line(text: str) -> str:
    return " ".join(text.split())
