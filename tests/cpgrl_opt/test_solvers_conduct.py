"""What every solver must not do: remember, touch its input, treat a batch as more than a loop."""

import dataclasses
import importlib
import importlib.util
import pickle
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import solvers
from cpgrl_opt.comparison.export import MissingExportError
from cpgrl_opt.direction import DirectionBatch, Status
from cpgrl_opt.problem import DirectionProblem, ProblemBatch
from cpgrl_opt.solvers import (
    OSQP,
    SOLVERS,
    DirectionSolver,
    MissingPackageError,
    UnusablePackageError,
    is_installed,
    solve_batch,
    solver_named,
    supports,
    tolerance_of,
)

NAMES = [name for name, solver in SOLVERS.items() if is_installed(solver)]
OPTIONAL = ("quadprog", "daqp", "piqp", "proxqp", "clarabel", "highs", "scs")


def cone(seed: int, m: int = 4, n: int = 5) -> DirectionProblem:
    rng = np.random.default_rng(seed)
    return DirectionProblem(rng.normal(size=n), rng.normal(size=(m, n)))


def tangent(seed: int) -> DirectionProblem:
    problem = cone(seed)
    return DirectionProblem(problem.gradient, problem.jacobian, 0, True)


def taken(solver: DirectionSolver, seed: int) -> DirectionProblem:
    return cone(seed) if supports(solver, cone(seed)) else tangent(seed)


@pytest.mark.parametrize("name", NAMES)
def test_a_batch_is_a_loop(name: str) -> None:
    solver = SOLVERS[name]
    problems = [taken(solver, seed) for seed in range(4)]
    if name != "rosen":  # one with a row off, one that opposes itself
        rows = problems[0].jacobian
        off = [-np.inf, 0, 0, 0]
        problems.append(DirectionProblem(problems[0].gradient, rows, off))
        problems.append(DirectionProblem(problems[0].gradient, np.vstack([rows[:2], -rows[:2]])))
    for given in (problems, ProblemBatch.stack(problems)):
        batch = solve_batch(solver, given)
        assert isinstance(batch, DirectionBatch)
        for problem, member in zip(problems, batch, strict=True):
            alone = solver.solve(problem)
            assert alone.status == member.status == Status.OPTIMAL
            np.testing.assert_allclose(member.value, alone.value, rtol=0, atol=1e-12)
            np.testing.assert_allclose(member.multipliers, alone.multipliers, rtol=0, atol=1e-7)


def test_a_cold_session_forgets_and_a_warm_one_agrees() -> None:
    problems = [cone(seed) for seed in range(6)]
    cold, warm = OSQP().session(5, 4), OSQP().session(5, 4, warm_start=True)
    for problem in problems:
        alone, kept, remembered = OSQP().solve(problem), cold.solve(problem), warm.solve(problem)
        assert alone.status == kept.status == remembered.status == Status.OPTIMAL
        np.testing.assert_allclose(kept.value, alone.value, atol=1e-10)
        assert kept.iterations == alone.iterations
        np.testing.assert_allclose(remembered.value, alone.value, atol=1e-10)
    turned = cone(2)
    warm.solve(turned)
    assert 0 < warm.solve(turned).iterations < OSQP().solve(turned).iterations


@pytest.mark.parametrize("name", SOLVERS)
def test_a_solver_is_a_frozen_dataclass_with_a_table_line(name: str) -> None:
    solver = solver_named(name)
    assert isinstance(solver, DirectionSolver)
    assert dataclasses.is_dataclass(solver)
    with pytest.raises(dataclasses.FrozenInstanceError):
        solver.tolerance = 1.0  # type: ignore[misc]
    assert tolerance_of(solver) <= (1e-9 if name in ("rosen", "active-set", "nnls", "enumeration") else 1e-8)
    for line in (solver.source, solver.guarantee):
        assert line
        assert "\n" not in line
    assert solver == type(solver)(**{f.name: getattr(solver, f.name) for f in dataclasses.fields(solver)})
    assert isinstance(hash(solver), int)
    assert pickle.loads(pickle.dumps(solver)) == solver  # other processes get it this way


def test_the_old_name_of_the_referee_is_deprecated() -> None:
    with pytest.warns(DeprecationWarning, match="refereed is now cpgrl_opt.solvers.referee"):
        assert solvers.refereed is solvers.referee


def forget_in_qpsolvers(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """As qpsolvers does on any ImportError; old versions solve by a table in a module of its own."""
    for module in ("qpsolvers.solvers", "qpsolvers._internals"):
        if importlib.util.find_spec(module):
            table = getattr(importlib.import_module(module), "solve_function", {})
            monkeypatch.delitem(table, name, raising=False)


@pytest.mark.parametrize("geometry", [{}, {"metric": 2 * np.eye(5), "radius": 0.5}], ids=["plain", "ball"])
@pytest.mark.parametrize("name", [*OPTIONAL, "osqp", "cvxpy"])
def test_a_missing_package_is_answered_with_what_to_type(
    name: str, geometry: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    solver, problem = SOLVERS[name], cone(0)
    monkeypatch.setitem(sys.modules, solver.package, None)  # type: ignore[arg-type]  # Python's word for missing
    forget_in_qpsolvers(name, monkeypatch)
    assert not is_installed(solver)
    extra = "gpl" if name == "quadprog" else "solvers"
    problem = DirectionProblem(problem.gradient, problem.jacobian, problem.bound, **geometry)
    for solve_it in (solver.solve, lambda each: solver.solve_batch([each, each])):
        with pytest.raises(MissingPackageError, match=rf"{name}.*pip install 'cpgrl-opt\[{extra}\]'"):
            solve_it(problem)


MISSING = [
    MissingPackageError("daqp", "daqp", "solvers"),
    UnusablePackageError("proxqp", "proxsuite", ImportError("libgomp.so.1")),
    MissingExportError(),
]


@pytest.mark.parametrize("error", MISSING, ids=lambda error: type(error).__name__)
def test_a_missing_package_is_told_by_worker_processes_too(error: MissingPackageError) -> None:
    error.add_note("in a worker process")
    arrived = pickle.loads(pickle.dumps(error))
    assert type(arrived) is type(error)
    assert arrived.__notes__ == ["in a worker process"]
    assert str(arrived) == str(error) != ""


HEAVY = ("numba", "scipy", "qpsolvers", "cvxpy", "matplotlib", "jaxtyping", "torch", "jax", "osqp", *OPTIONAL)
FIRST_PROBLEMS = f"""
import sys
import numpy as np
import cpgrl_opt, cpgrl_opt.solvers, cpgrl_opt.vectors
from cpgrl_opt import SOLVERS, DirectionProblem, Status
from cpgrl_opt.arrays import Vector
assert Vector is np.ndarray  # without jaxtyping, shapes are no types
assert [name for name in {(*HEAVY, "proxsuite", "highspy")} if name in sys.modules] == []
for name in ("active-set", "rosen"):
    assert SOLVERS[name].solve(DirectionProblem([1.0, 1.0], [[-1.0, 0.0]], equality=True)).status == Status.OPTIMAL
opposing = DirectionProblem([1.0, 2.0], [[1.0, 0.0], [-1.0, 0.0]], [1.0, 1.0])
assert SOLVERS["active-set"].solve(opposing).status == Status.INFEASIBLE
assert "numba" not in sys.modules
"""


def test_importing_is_light_and_the_first_problems_of_a_process_need_no_compiler() -> None:
    subprocess.run([sys.executable, "-c", FIRST_PROBLEMS], check=True)
