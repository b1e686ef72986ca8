"""Solvers compared on the same problems: accuracy beside time, raw back ends beside prepared ones."""
