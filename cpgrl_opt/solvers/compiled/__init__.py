"""Compiled kernels of the exact core, `exact_core`: projections onto cones and tangent faces.

    min_d ½‖d − g‖²   s.t.   Jᵢ d ≥ bᵢ (i ∈ I),   Jᵢ d = bᵢ (i ∈ E)

A process's first sixteen problems are interpreted if they are small, batches and all later ones compiled, to the same
bits; compiled kernels are cached on disk. How a problem is solved, by file:

    _entry_point        one source in two forms, interpreted and compiled
    _direct             rows well apart: one short pass by the Gram matrix; what it does not finish goes on to
    _projection         the thorough kernel: scales, solves, judges as the referee does, or proves infeasibility
    _exchange           the direct pass's active set, from the Gram matrix alone
    _trust_region       the direct pass in a ball
    _gramian_core       the usual long problem, by its Gramian alone
    _scaling            rows of length ½ to 1 and numbers near 1, by powers of two: nothing is rounded
    _dual_active_set    Goldfarb & Idnani's method
    _basis              projections by an orthonormal basis of the active rows, refined where they nearly depend
    _arithmetic, _workspace: what they all use

Names mean the same in all of them, and numba knows their types from the signatures of the entry points. Of B problems,
one after the other: gradient, value (B, n), jacobian (B m, n), bound, equality (B m,); problem: the number of one,
first: of its first row. Of the direct pass gram, factor (m, m), small (8 or more, m), rows see `_exchange`; state,
order (m,) of integers; size: of 𝒜, the first rows in `order`; rest (1, n); parts (4,), residuals in the order of
`KKTResiduals`. Of the thorough kernel space, small and index: see `_workspace`.
"""

from pathlib import Path

from ...machine_code import forget_outdated_kernels

_FOLDER = Path(__file__).parent
# Before any of them is loaded.
forget_outdated_kernels(_FOLDER, sources=[*_FOLDER.glob("*.py"), _FOLDER.parents[1] / "compensated.py"])
