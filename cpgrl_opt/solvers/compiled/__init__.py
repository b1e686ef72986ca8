"""Compiled kernels of the exact core, `exact_core`: projections onto cones and tangent faces.

    min_d ½‖d − g‖²   s.t.   Jᵢ d ≥ bᵢ (i ∈ I),   Jᵢ d = bᵢ (i ∈ E)

A process's first sixteen problems are interpreted if they are small, batches and all later ones compiled, to the same
bits; compiled kernels are cached on disk. How a problem is solved, by file:

    _entry_point        one source in two forms, interpreted and compiled
    _direct             rows well apart: one short pass by the Gram matrix; what it does not finish goes on to
    _projection         the thorough kernel: scales, solves, judges as the referee does, or proves infeasibility
    _scaling            rows of length ½ to 1 and numbers near 1, by powers of two: nothing is rounded
    _dual_active_set    Goldfarb & Idnani's method
    _basis              projections by an orthonormal basis of the active rows, refined where they nearly depend
"""

from pathlib import Path

from ._cache import forget_outdated_kernels

forget_outdated_kernels(Path(__file__).parent)  # before any of them is loaded
