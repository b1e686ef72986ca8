"""Published update directions under their own names, each from its paper's formulas, as direction solvers.

    >>> from cpgrl_opt import DirectionProblem
    >>> from cpgrl_opt.published import PUBLISHED
    >>> PUBLISHED["mgda"].solve(DirectionProblem([6.0, 1.0, 1.0], [[-4.0, 1.0, 1.0]])).value.round(12)
    array([0., 1., 1.])

Each says OPTIMAL of what it returns, that being its claim, the direction to take; CPO and GEM, which solve problems of
ours, only where `kkt_residuals` agrees. Methods without multipliers get those that suit it best: `function_solver`.
`declaration` tells which laws of `cpgrl_opt.testing` a method breaks, and why; the table of all, `docs/published.md`,
is written by `python -m cpgrl_opt.testing.published_table`.
"""

from collections.abc import Mapping
from types import MappingProxyType

from ._a_gem import AGEM
from ._cpo import CPO
from ._crpo import CRPO
from ._gem import GEM
from ._mgda import MGDA
from ._pcgrad import PCGrad
from ._pcpo import PCPO
from ._upgrad import UPGrad
from .function_solver import FunctionSolver, claimed_direction
from .interface import Declaration, PublishedMethod

PUBLISHED: Mapping[str, PublishedMethod] = MappingProxyType(
    {
        "cpo": CPO(),
        "pcpo": PCPO(),
        "crpo": CRPO(),
        "gem": GEM(),
        "a-gem": AGEM(),
        "pcgrad": PCGrad(),
        "mgda": MGDA(),
        "upgrad": UPGrad(),
    }
)

__all__ = [
    "AGEM",
    "CPO",
    "CRPO",
    "GEM",
    "MGDA",
    "PCPO",
    "PUBLISHED",
    "Declaration",
    "FunctionSolver",
    "PCGrad",
    "PublishedMethod",
    "UPGrad",
    "claimed_direction",
]
