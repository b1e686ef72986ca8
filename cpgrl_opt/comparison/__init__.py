"""Solvers compared on the same problems: accuracy beside time, raw back ends beside prepared ones.

`load(folder)` is the table of what `cpgrl compare --out folder` measured.
"""

from .table import load

__all__ = ["load"]
