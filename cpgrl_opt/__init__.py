"""Direction solvers that carry proof, for constrained policy-gradient reinforcement learning.

>>> from cpgrl_opt import SOLVERS, DirectionProblem, kkt_residuals
>>> problem = DirectionProblem(gradient=[1.0, 1.0], jacobian=[[-1.0, 0.0]])  # climb, but not along +x
>>> direction = SOLVERS["active-set"].solve(problem)
>>> direction.value
array([0., 1.])
>>> kkt_residuals(problem, direction).worst <= 1e-12
True
"""

from .active_set import ACTIVE_SET_RULES, ActiveSetRule, hysteresis, violated
from .certify import KKTResiduals, farkas_residual, kkt_residuals
from .direction import Direction, DirectionBatch, DirectionError, Status
from .formulation import FORMULATIONS
from .linearization import Linearization
from .problem import DirectionProblem, ProblemBatch
from .projection import project_onto_tangent, projection_matrix, restoration_move, tangent_multipliers
from .solvers import SOLVERS, DirectionSolver, MissingPackageError, WithGeometry, solve, solve_batch
from .step import ConstrainedStep, StepResult

__all__ = [
    "ACTIVE_SET_RULES", "FORMULATIONS", "SOLVERS", "ActiveSetRule", "ConstrainedStep", "Direction", "DirectionBatch",
    "DirectionError", "DirectionProblem", "DirectionSolver", "KKTResiduals", "Linearization", "MissingPackageError",
    "ProblemBatch", "Status", "StepResult", "WithGeometry", "farkas_residual", "hysteresis", "kkt_residuals",
    "project_onto_tangent", "projection_matrix", "restoration_move", "solve", "solve_batch", "tangent_multipliers",
    "violated",
]  # fmt: skip
