"""Which direction problems a solver takes, asked of the solver itself."""

from typing import Any

from cpgrl_opt import DirectionProblem
from cpgrl_opt.solvers import supports

# One problem as each formulation of a step makes them.
_EXAMPLES = {
    "equality": DirectionProblem([1.0, 1.0], [[-1.0, 0.0]], equality=[True]),
    "cone": DirectionProblem([1.0, 1.0], [[-1.0, 0.0]]),
    "restoring": DirectionProblem([1.0, 1.0], [[-1.0, 0.0]], bound=[0.5]),
    "linearized": DirectionProblem([1.0, 1.0], [[-1.0, 0.0]], bound=[-0.5]),
}


def cases(solver: Any) -> list[str]:
    """The formulations whose problems the solver takes; the others it hands to active-set."""
    return [name for name, problem in _EXAMPLES.items() if supports(solver, problem)]
