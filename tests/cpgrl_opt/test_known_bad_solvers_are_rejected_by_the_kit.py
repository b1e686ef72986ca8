"""Mutation evidence: known-bad solvers fail the kit, at the right law, with a counterexample for a check by hand."""

import os
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import qr

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status
from cpgrl_opt.testing import LawBroken, check_direction_solver

CORRECT = SOLVERS["active-set"]


def claimed(value, multipliers, status=Status.OPTIMAL):
    return Direction(np.asarray(value, dtype=float), np.asarray(multipliers, dtype=float), status)


def on_the_face(g, rows, bound):
    """(d, μ) where all rows bind: d = g + J⁺(b − J g)."""
    inverse = np.linalg.pinv(rows, rcond=1e-12)
    d = g + inverse @ (bound - rows @ g)
    return d, inverse.T @ (d - g)


def flipped_sign_of_the_gradient(problem):
    """ν = max(λc − r, 0)/s with g of the reward where the derivation has g of the loss: the multipliers of −g."""
    flipped = DirectionProblem(-problem.gradient, problem.jacobian, problem.bound, problem.equality)
    mu = CORRECT.solve(flipped).multipliers
    return claimed(problem.gradient + mu @ problem.jacobian, mu)


def unit_length(problem):
    answer = CORRECT.solve(problem)
    size = np.linalg.norm(answer.value)
    return claimed(answer.value / (size or 1.0), answer.multipliers, answer.status)


def ridge(problem):
    """P with (J Jᵀ + 1e-4 I)⁻¹ on the rows that bind."""
    answer = CORRECT.solve(problem)
    face = problem.equality | (answer.multipliers > 0)
    rows, bound = problem.jacobian[face], problem.bound[face]
    mu = np.zeros(problem.m)
    mu[face] = np.linalg.solve(rows @ rows.T + 1e-4 * np.eye(len(rows)), bound - rows @ problem.gradient)
    return claimed(problem.gradient + mu @ problem.jacobian, mu, answer.status)


def printed_stop_rule(problem):
    """§2.3 as printed: stop when λ has no *negative* component, else drop the largest λ."""
    active = np.ones(problem.m, dtype=bool)
    while True:
        d, weights = on_the_face(problem.gradient, problem.jacobian[active], np.zeros(active.sum()))
        lam = np.full(problem.m, -np.inf)
        lam[active] = -weights
        if not (lam[active] < 0).any():
            return claimed(d, np.where(active, -lam, 0.0))
        active[lam.argmax()] = False


def gram_without_row_scaling(problem):
    """The right active set, then pinv(J Jᵀ) of the raw rows."""
    answer = CORRECT.solve(problem)
    if answer.status != Status.OPTIMAL:
        return answer
    face = problem.equality | (answer.multipliers > 0)
    rows, mu = problem.jacobian[face], np.zeros(problem.m)
    mu[face] = np.linalg.pinv(rows @ rows.T) @ (problem.bound[face] - rows @ problem.gradient)
    return claimed(problem.gradient + mu @ problem.jacobian, mu)


def every_row_an_equality(problem):
    answer = CORRECT.solve(DirectionProblem(problem.gradient, problem.jacobian, 0.0, True))
    return claimed(answer.value, answer.multipliers)


def always_declines(problem):
    return claimed(np.zeros(problem.n), np.zeros(problem.m), Status.UNCERTIFIED)


def always_zero(problem):
    return claimed(np.zeros(problem.n), np.zeros(problem.m))


def always_infeasible(problem):
    return claimed(np.zeros(problem.n), np.ones(problem.m), Status.INFEASIBLE)


def never_infeasible(problem):
    answer = CORRECT.solve(problem)
    return claimed(answer.value, answer.multipliers)


def infeasible_without_proof(problem):
    answer = CORRECT.solve(problem)
    if answer.status == Status.INFEASIBLE:
        return claimed(problem.gradient, np.ones(problem.m), Status.INFEASIBLE)
    return answer


def infeasible_with_proof_and_the_gradient(problem):
    answer = CORRECT.solve(problem)
    if answer.status == Status.INFEASIBLE:
        return claimed(problem.gradient, answer.multipliers, Status.INFEASIBLE)
    return answer


def not_a_number(problem):
    return claimed(np.full(problem.n, np.nan), np.zeros(problem.m))


def writes_from_c(problem):
    os.write(2, b" ** On entry to DLASCL parameter number 4 had an illegal value\n")
    return CORRECT.solve(problem)


def warns(problem):
    warnings.warn("inaccurate", RuntimeWarning, stacklevel=2)
    return CORRECT.solve(problem)


def normalises_in_place(problem):
    answer = CORRECT.solve(problem)
    if problem.m and problem.jacobian.flags.writeable:
        problem.jacobian[:] /= np.maximum(np.linalg.norm(problem.jacobian, axis=1, keepdims=True), 1e-300)
    return answer


def swallows_nan(problem):
    """Comparisons with NaN are false, so no constraint looks violated."""
    g, rows = problem.gradient, problem.jacobian
    if not (rows @ g < problem.bound).any() and not problem.equality.any():
        return claimed(g, np.zeros(problem.m))
    return CORRECT.solve(problem)


def raises(problem):
    if np.linalg.matrix_rank(problem.jacobian) < problem.m:
        raise np.linalg.LinAlgError("Singular matrix")
    return CORRECT.solve(problem)


def forgets_the_last_row(problem):
    fewer = DirectionProblem(problem.gradient, problem.jacobian[:-1], problem.bound[:-1], problem.equality[:-1])
    answer = CORRECT.solve(fewer)
    return claimed(answer.value, [*answer.multipliers, *np.zeros(problem.m - fewer.m)], answer.status)


def metric_forgotten(problem):
    """The projection in another metric than the one asked for."""
    weights = 1.0 + np.arange(problem.n)
    answer = CORRECT.solve(
        DirectionProblem(problem.gradient * weights, problem.jacobian / weights, problem.bound, problem.equality)
    )
    return claimed(answer.value / weights, answer.multipliers, answer.status)


def inverse_metric_forgotten(problem):
    """d = g + M⁻¹Jᵀν for M⁻¹(g + Jᵀμ): it meets the constraints, which is why such a step looks right."""
    M = np.eye(problem.n) if problem.metric is None else problem.metric
    g = M * problem.gradient if M.ndim == 1 else M @ problem.gradient
    return CORRECT.solve(DirectionProblem(g, problem.jacobian, problem.bound, problem.equality, problem.metric))


def basic_restoration(problem):
    """Of J v = b the solution with fewest entries for the shortest."""
    if problem.gradient.any() or not problem.m:
        return CORRECT.solve(problem)
    columns = qr(problem.jacobian, mode="r", pivoting=True)[1][: np.linalg.matrix_rank(problem.jacobian)]
    v = np.zeros(problem.n)
    v[columns] = np.linalg.lstsq(problem.jacobian[:, columns], problem.bound, rcond=None)[0]
    return claimed(v, np.zeros(problem.m))


class StaleActiveSet:
    """Keeps the active set of the last problem of the same size."""

    def __init__(self):
        self.faces = {}

    def __call__(self, problem):
        answer = CORRECT.solve(problem)
        face = self.faces.get(problem.m, answer.multipliers > 0)
        self.faces[problem.m] = answer.multipliers > 0
        d, weights = on_the_face(problem.gradient, problem.jacobian[face], problem.bound[face])
        mu = np.zeros(problem.m)
        mu[face] = weights
        return claimed(d, mu, answer.status)


class OwnRandomness:
    def __init__(self):
        self.rng = np.random.default_rng(0)

    def __call__(self, problem):
        answer = CORRECT.solve(problem)
        return claimed(answer.value * (1 + 1e-12 * self.rng.random()), answer.multipliers, answer.status)


class AnswersOfABatchMixedUp:
    """Each problem of a batch gets the answer of the next, and the last that of the first."""

    def __call__(self, problem):
        return CORRECT.solve(problem)

    def solve_batch(self, problems):
        answers = [CORRECT.solve(problem) for problem in problems]
        return [*answers[1:], *answers[:1]]


class WarmStartThatKeepsTheFace:
    """Its sessions never leave the active set that they found first."""

    def __call__(self, problem):
        return CORRECT.solve(problem)

    def session(self, _n, _m, *, warm_start=False):
        return SimpleNamespace(solve=StaleActiveSet() if warm_start else CORRECT.solve)


def every_case(problem):
    return True


def cone_only(problem):
    return not problem.equality.any() and not problem.bound.any()


def inequalities_only(problem):
    return not problem.equality.any()


def equalities_only(problem):
    return problem.equality.all()


def metrics(problem):
    return problem.radius is None


# mutant → a law that names what is wrong with it, and the problems it takes
MUTANTS = {
    flipped_sign_of_the_gradient: ("check_complementarity", inequalities_only),
    unit_length: ("check_scaling", every_case),
    ridge: ("check_primal_feasibility", every_case),
    printed_stop_rule: ("check_dual_feasibility", cone_only),
    gram_without_row_scaling: ("check_row_scaling", every_case),
    every_row_an_equality: ("check_gradient_kept_when_feasible", cone_only),
    metric_forgotten: ("check_symmetry", every_case),
    inverse_metric_forgotten: ("check_idempotence", metrics),
    basic_restoration: ("check_restoration_is_normal", equalities_only),
    forgets_the_last_row: ("check_permutation", every_case),
    always_declines: ("check_stationarity", every_case),
    always_zero: ("check_zero_only_when_optimal", every_case),
    always_infeasible: ("check_feasible_is_not_called_infeasible", every_case),
    never_infeasible: ("check_claims_are_certified", every_case),
    infeasible_without_proof: ("check_infeasible_is_called_infeasible", every_case),
    infeasible_with_proof_and_the_gradient: ("check_least_violation", every_case),
    not_a_number: ("check_stationarity", every_case),
    swallows_nan: ("check_non_finite_is_refused", every_case),
    raises: ("check_duplicate_row", every_case),
    writes_from_c: ("check_silence", every_case),
    warns: ("check_silence", every_case),
    normalises_in_place: ("check_input_is_unchanged", every_case),
    StaleActiveSet: ("check_answers_repeat", inequalities_only),
    OwnRandomness: ("check_answers_repeat", every_case),
    AnswersOfABatchMixedUp: ("check_batch_is_loop", every_case),
    WarmStartThatKeepsTheFace: ("check_warm_start_is_cold_start", inequalities_only),
}
WITH_A_MEMORY = (StaleActiveSet, OwnRandomness)
# Rows that nearly oppose, of other lengths, bounds that nearly meet, or sets of rows that change.
AT_SOME_SCALE = (
    printed_stop_rule, gram_without_row_scaling, never_infeasible, StaleActiveSet, WarmStartThatKeepsTheFace
)  # fmt: skip


def as_solver(mutant):
    method, takes = mutant() if isinstance(mutant, type) else mutant, MUTANTS[mutant][1]
    more = {name: getattr(method, name) for name in ("solve_batch", "session") if hasattr(method, name)}
    return SimpleNamespace(solve=method, supports=takes, takes_geometry=takes is metrics, **more)


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.__name__)
def test_a_known_bad_solver_is_rejected_with_a_small_counterexample_that_runs(mutant):
    law, _ = MUTANTS[mutant]
    verdict = check_direction_solver(as_solver(mutant), checks=[law], max_examples=40)
    assert not verdict.passed
    result = verdict[law]
    assert result.problem
    if mutant is always_declines:
        assert result.declined > 0.05 * result.run
        return
    assert result.failed > 0
    name = f"test_{law.removeprefix('check_')}_holds_here"
    assert f"def {name}(solver)" in result.counterexample
    scope = {}
    exec(result.counterexample, scope)
    if mutant not in WITH_A_MEMORY:  # those need not fail twice in a row
        with pytest.raises(LawBroken):
            scope[name](as_solver(mutant))
    scope[name](CORRECT)
    arguments = {}
    scope[law] = lambda _, **given: arguments.update(given)
    scope[name](None)
    assert_small(arguments, mutant)


def assert_small(arguments, mutant):
    """n, m ≤ 3 and integers of two digits at most; where the fault is at some scale, few numbers at least."""
    problems = arguments["problems"] if "problems" in arguments else [arguments["problem"]]
    assert len(problems) <= 2
    parts = [(each.gradient, each.jacobian, each.bound, each.metric) for each in problems]
    numbers = np.concatenate([np.ravel(part) for each in parts for part in each if part is not None])
    assert np.count_nonzero(numbers) <= 7
    if mutant not in AT_SOME_SCALE:
        assert max(problems[0].n, problems[0].m) <= 3
        assert np.abs(numbers).max() <= 99
        np.testing.assert_array_equal(numbers, np.round(numbers))
