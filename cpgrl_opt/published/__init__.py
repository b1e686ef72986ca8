"""Published update directions under their own names."""

from .adapter import FunctionSolver

__all__ = ["FunctionSolver"]
