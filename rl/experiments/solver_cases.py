"""Which direction problems a solver takes, asked of the solver itself."""

from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from cpgrl_opt import SOLVERS, DirectionProblem
from cpgrl_opt.solvers import obstacle, supports

# One problem as each formulation of a step makes them.
_EXAMPLES = {
    "equality": DirectionProblem([1.0, 1.0], [[-1.0, 0.0]], equality=[True]),
    "cone": DirectionProblem([1.0, 1.0], [[-1.0, 0.0]]),
    "restoring": DirectionProblem([1.0, 1.0], [[-1.0, 0.0]], bound=[0.5]),
    "linearized": DirectionProblem([1.0, 1.0], [[-1.0, 0.0]], bound=[-0.5]),
}


def cases(solver: Any) -> list[str]:
    """The formulations whose problems the solver takes; the others it hands to active-set.

    Parameters
    ----------
    solver
        Any object with `solve`.

    Returns
    -------
    list of str
        Names of formulations.
    """
    return [name for name, problem in _EXAMPLES.items() if supports(solver, problem)]


def print_solvers() -> None:
    """A row for each of SOLVERS: what is installed, what each takes and guarantees."""
    table = Table("solver", "installed", "formulations", "guarantee", "source")
    for name, solver in SOLVERS.items():
        why_not = obstacle(solver).replace("not installed", "no")
        installed = f"[red]{escape(why_not)}[/red]" if why_not else "[green]yes[/green]"
        facts = (getattr(solver, fact, "") for fact in ("guarantee", "source"))
        table.add_row(f"[bold]{name}[/bold]", installed, ", ".join(cases(solver)), *facts)
    Console().print(table)
