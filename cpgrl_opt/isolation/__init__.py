"""Code that may hang, crash, fork, print or eat memory, run in a process that takes nothing else along.

>>> from cpgrl_opt import SOLVERS, DirectionProblem
>>> from cpgrl_opt.isolation import Isolated, apply, call
>>> with Isolated(SOLVERS["nnls"], time_limit=10.0) as solver:
...     solver.solve(DirectionProblem([1.0, 2.0], [[0.0, 1.0]])).status.name
'OPTIMAL'
>>> call(sum, [1, 2, 3], time_limit=10.0)
6
"""

from ._worker import output_size
from .errors import AnswerError, CrashError, HangError, IsolationError, MemoryLimitError
from .isolated import Isolated, apply, call
from .process_group import ProcessGroup, exit_on_termination

__all__ = [
    "AnswerError",
    "CrashError",
    "HangError",
    "Isolated",
    "IsolationError",
    "MemoryLimitError",
    "ProcessGroup",
    "apply",
    "call",
    "exit_on_termination",
    "output_size",
]
