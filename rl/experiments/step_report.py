"""What steps counted and handed over during training, in words."""

from collections.abc import Mapping
from typing import Any

from .solver_cases import cases

# What a step counts (cpgrl_opt.StepResult).
_EVENTS = {
    "infeasible": "subproblems that no direction meets (least violation taken)",
    "fallback": "subproblems handed to active-set",
    "skipped": "updates left out for want of a certified direction",
    "dropped": "constraints dropped (§2.3)",
    "capped": "restorations shortened",
    "softened": "updates whose constraints the ridge softened",
    "flat": "active constraints without gradient, left out",
    "long": "changes that a restoration made longer than the radius",
}
# What is the rule, or told elsewhere.
_EXPECTED = ("constrained", "objective", "uncertified")


def in_words(counts: Mapping[str, int]) -> str:
    """Each event that happened, with its number; a name without words of its own stands for itself.

    Parameters
    ----------
    counts
        Of all runs, by event.

    Returns
    -------
    str
        Events with commas between them.
    """
    told = ((name, count) for name, count in counts.items() if count and name not in _EXPECTED)
    return ", ".join(f"{count} {_EVENTS.get(name, name)}" for name, count in told)


def handing_over(name: str, solver: Any, formulation: str) -> list[str]:
    """One sentence if the solver of this name does not take the formulation, none otherwise.

    Parameters
    ----------
    name
        The solver's.
    solver
        Itself.
    formulation
        Of the step.

    Returns
    -------
    list of str
        One sentence or none.
    """
    if formulation in cases(solver):
        return []
    return [
        f"The solver {name} does not take the formulation {formulation}: active-set solved every subproblem instead."
    ]
