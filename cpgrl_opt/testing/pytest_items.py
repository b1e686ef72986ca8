"""One pytest item for each (solver, law)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from hypothesis import settings

from ..solvers.interface import DirectionSolver
from ..validation import require_member
from .domain import domain_of
from .law import LawError
from .laws import LAWS, Law
from .verdict import CheckResult, check_law


@dataclass(frozen=True)
class SolverCheck:
    """Calling it with the solver puts one law to it: LawError where the law breaks, pytest.skip if unsupported.

    LawError, too, for a solver that takes no law's problems: its items would all be skipped. reason: why the law is
    bound to break; pytest.xfail then where it does.
    """

    law: Law
    reason: str = ""
    max_examples: int | None = None
    seed: int = 0

    def __call__(self, solver: DirectionSolver) -> CheckResult:
        """The result, where it passed."""
        import pytest

        examples = self.max_examples or settings().max_examples
        result = check_law(self.law, solver, reason=self.reason, max_examples=examples, seed=self.seed)
        if not result.supported and not domain_of(solver).cases:
            raise LawError(f"{solver!r} should take some of the laws' problems; found that `supports` takes none")
        if not result.supported:
            pytest.skip(f"{self.law.name}: the solver declares no such cases, or has no method for them")
        if result.problem and result.passed:
            pytest.xfail(self.reason)
        result.raise_for_failure()
        return result


def parametrize_with_checks(
    solvers: Mapping[str, DirectionSolver],
    *,
    expected_failures: Mapping[str, Mapping[str, str]] | None = None,
    max_examples: int | Mapping[str, int] | None = None,
    seed: int = 0,
) -> Callable[[Callable[..., Any]], Any]:
    """Decorates `def test(solver, check): check(solver)` into one item for each solver, by name, and law.

    Parameters
    ----------
    solvers
        By name.
    expected_failures
        Solver name → {check: reason}. Where these laws break the item is xfailed, where they hold it passes: a rare
        failure need not show among few problems.
    max_examples
        For all, or by solver name; else the Hypothesis profile's.
    seed
        The same seed draws the same problems.

    Returns
    -------
    callable
        The decorator.

    Raises
    ------
    ValueError
        For names of solvers or checks that do not exist.
    """
    import pytest

    expected = expected_failures or {}
    for name, reasons in expected.items():
        require_member("solver in expected_failures", name, tuple(solvers))
        for check in reasons:
            require_member("check in expected_failures", check, tuple(LAWS))
    items = []
    for law in LAWS.values():  # law by law: all solvers are given the problems that were drawn for the first
        for name, solver in solvers.items():
            examples = max_examples.get(name) if isinstance(max_examples, Mapping) else max_examples
            item = SolverCheck(law, expected.get(name, {}).get(law.name, ""), examples, seed)
            items.append(pytest.param(solver, item, id=f"{name}-{law.name.removeprefix('check_')}"))
    return pytest.mark.parametrize(("solver", "check"), items)
