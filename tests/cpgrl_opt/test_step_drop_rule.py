"""The drop rule obeys multipliers and not their rounding: λᵢ‖Jᵢ‖ counts as 0 below a part of ‖Δ¹‖, as PΔ¹ does."""

from dataclasses import dataclass
from itertools import permutations
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cpgrl_opt import SOLVERS, ConstrainedStep, Direction, DirectionProblem, Linearization
from cpgrl_opt.solvers import RosenDrop, is_installed

GEOMETRIES = [{}, {"metric": [2.0, 0.5, 1.0, 3.0]}, {"ridge": 1e-300}]


def opposed(seed: int) -> Linearization:
    """Two constraints violated by 1, and Δ¹ = −Δ²: the optimum on their face, λ = (−1, 0)."""
    rows = np.random.default_rng(seed).standard_normal((2, 4))
    return Linearization([0.0, -1.0, -1.0], [-rows[0], *rows])


@pytest.mark.parametrize("drop", ["stationary", "always"])
@pytest.mark.parametrize("settings", GEOMETRIES)
@pytest.mark.parametrize("raw", [False, True])
def test_a_multiplier_of_rounding_size_drops_no_constraint(drop, settings, raw):
    step = ConstrainedStep(step_size=1.0, restoration_rate=1.0, drop=drop, raw_multipliers=raw, **settings)
    for seed in range(12):
        linearization = opposed(seed)
        result = step(linearization, [0.0, 0.0])
        assert (result.counts["dropped"], bool(result.stationary)) == (0, True)
        np.testing.assert_allclose(linearization.jacobian @ result.change, [1.0, 1.0], rtol=1e-9)


def test_what_is_a_hundred_times_rounding_still_drops():
    """λ₂‖J₂‖ = 1e-8 ‖Δ¹‖, positive."""
    climbing = Linearization([0.0, -1.0, -1.0], [[-1.0, 1e-8], [1.0, 0.0], [0.0, 1.0]])
    result = ConstrainedStep()(climbing, [0.0, 0.0])
    assert (result.counts["dropped"], bool(result.stationary)) == (1, False)


def test_raw_multipliers_are_those_printed_whatever_rows_stand_beside():
    """λ₁ = 1 and λ₂ = 0.1, λ₂‖J₂‖ = 10; or a row of 1e-200, whose λ is 1e200."""
    ordinary, tiny = [[1.02, 10.2], [1.0, 0.2], [0.2, 100.0]], [[1.0, 1.0], [1e-200, 0.0], [0.0, 1.0]]
    step = ConstrainedStep(raw_multipliers=True, step_size=1.0, restoration_rate=0.0)
    values = np.array([0.0, -1.0, -1.0])
    together = step(Linearization([values, values], [ordinary, tiny]), [0.0, 0.0]).change
    np.testing.assert_array_equal(together[0], step(Linearization(values, ordinary), [0.0, 0.0]).change)
    np.testing.assert_allclose(together[1], [1.0, 0.0], atol=1e-15)  # λ = (1e200, 1): the first goes


def test_a_contradiction_that_is_dropped_is_counted_no_more():
    """Jv = t of two equal rows contradicts itself, and both rows leave."""
    climbing = Linearization([0.0, -1.0, -2.0], [[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    kept, dropped = (ConstrainedStep(drop=drop)(climbing, [0.0, 0.0]) for drop in ("never", "stationary"))
    assert (kept.counts["infeasible"], kept.counts["dropped"]) == (1, 0)
    assert (dropped.counts["infeasible"], dropped.counts["dropped"]) == (0, 2)
    assert (dropped.residuals <= 1e-15).all()


# μ = (½, 2, 0): a KKT point, at which other multipliers of the dependent rows have either sign.
KKT_GRADIENT, KKT_ROWS = np.array([2.0, -2.0]), np.array([[4.0, 0.0], [-2.0, 1.0], [0.0, -2.0]])
KKT_THRESHOLDS = np.array([2.0, 3.0, 3.0])


@pytest.mark.parametrize("solver", SOLVERS)
def test_at_a_kkt_point_nothing_is_dropped_whatever_the_solver_and_the_order(solver):
    if not is_installed(SOLVERS[solver]):
        pytest.skip(f"{solver} is not installed")
    orders = list(map(list, permutations(range(3))))
    some = orders if solver == "active-set" else orders[::3]
    for drop, order in (*(("stationary", each) for each in some), ("always", orders[3]), ("never", orders[4])):
        step = ConstrainedStep(solver=solver, drop=drop, step_size=1.0, restoration_rate=1.0)
        gradients = np.vstack([KKT_GRADIENT, KKT_ROWS[order]])
        result = step(Linearization(np.zeros(4), gradients), KKT_THRESHOLDS[order])
        np.testing.assert_allclose(result.change, [-0.6, -0.95], rtol=1e-6)
        assert (result.counts["dropped"], bool(result.stationary)) == (0, True)


@dataclass(frozen=True)
class Rounded:
    """A right solver of float32: it leaves 1e-8 of what should be 0, and its multipliers are as good."""

    tolerance: float = 1e-5
    takes_geometry: ClassVar[bool] = True

    def solve(self, problem):
        answer = SOLVERS["nnls"].solve(problem)
        value, multipliers = (np.float64(np.float32(each)) for each in (answer.value, answer.multipliers))
        return Direction(value, multipliers, answer.status)


def drawn(seed):
    """(Δ¹, J, t, settings): integers, so that rows repeat, oppose and sum to 0; mostly with PΔ¹ = 0."""
    rng = np.random.default_rng(seed)
    m, n = rng.integers(1, 5, size=2)
    J = rng.integers(-2, 3, size=(m, n)).astype(float)
    if m > 1 and rng.random() < 0.3:
        J[-1] = J[0] * rng.choice([1.0, 2.0, -1.0])
    if m > 2 and rng.random() < 0.3:
        J[-1] = -J[0] - J[1]
    if rng.random() < 0.3:
        J *= 10.0 ** rng.integers(-3, 4, size=(m, 1))
    norms = np.linalg.norm(J, axis=1)
    g = J.T @ (rng.integers(-2, 3, size=m) / np.where(norms > 0, norms, 1.0))
    if rng.random() < 0.2:
        g = rng.integers(-2, 3, size=n).astype(float)
    root = rng.integers(-1, 2, size=(n, n))
    metrics = {"metric": 1.0 + rng.integers(0, 3, size=n)}, {"metric": root @ root.T + np.eye(n)}
    more = ({}, {}, *metrics, {"ridge": 0.25})[rng.integers(5)]
    settings = {"drop": ("stationary", "always", "never")[rng.integers(3)], **more}
    settings |= {"raw_multipliers": bool(rng.random() < 0.3), "restoration_rate": float(rng.integers(2))}
    if rng.random() < 0.2:
        settings["radius"] = 0.5
    return g, J, rng.integers(0, 4, size=m).astype(float), settings, rng


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_the_step_depends_neither_on_the_order_of_the_constraints_nor_on_the_solver(seed):
    """The drop rule's decisions least of all; rows depend in most of these problems."""
    g, J, t, chosen, rng = drawn(seed)

    def taken(solver, order, lengths=1.0):
        step = ConstrainedStep(solver=solver, step_size=1.0, **chosen)
        rows, target = (np.broadcast_to(lengths, len(J))[:, None] * J)[order], (lengths * t)[order]
        return step(Linearization(np.concatenate([[0.0], -target]), np.vstack([g, rows])), np.zeros(len(J)))

    expected = taken("active-set", np.arange(len(J)))
    others = [taken(solver, rng.permutation(len(J))) for solver in ("active-set", "rosen", "nnls")]
    if not chosen["raw_multipliers"] and "ridge" not in chosen:
        others.append(taken("active-set", np.arange(len(J)), 2.0 ** rng.integers(-3, 4, size=len(J))))
    rounded = taken(Rounded(), rng.permutation(len(J)))
    size = max(1.0, float(np.abs(expected.change).max()))
    for other, tolerance in (*((each, 1e-9) for each in others), (rounded, 1e-4)):
        np.testing.assert_allclose(other.change, expected.change, atol=tolerance * size)
        assert other.counts["dropped"] == expected.counts["dropped"]
        assert other.stationary == expected.stationary


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_at_kkt_points_nothing_is_dropped(seed):
    """Δ¹ = −Jᵀμ with μ ≥ 0."""
    _, J, t, chosen, rng = drawn(seed)
    chosen.pop("ridge", None)
    norms = np.linalg.norm(J, axis=1)
    g = -J.T @ (rng.integers(0, 3, size=len(J)) / np.where(norms > 0, norms, 1.0))
    result = ConstrainedStep(**chosen)(Linearization(np.concatenate([[0.0], -t]), np.vstack([g, J])), 0.0 * t)
    assert (result.counts["dropped"], bool(result.stationary)) == (0, True)


@pytest.mark.parametrize("drop", ["stationary", "always"])
def test_constraints_that_tie_leave_together(drop):
    """Δ¹ = (1, 1) pulls at both rows alike: whichever left alone would be a matter of order."""
    step = ConstrainedStep(drop=drop, step_size=1.0, restoration_rate=1.0)
    for rows in ([[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [3.0, 0.0]]):
        result = step(Linearization([0.0, -1.0, -2.0], [[1.0, 1.0], *rows]), [0.0, 0.0])
        np.testing.assert_allclose(result.change, [1.0, 1.0], rtol=1e-12)
        assert result.counts["dropped"] == 2


@pytest.mark.parametrize("lengths", [[1e-170, 1.0, 1e170], [1e170, 1e-170, 1.0], [1e-300, 1e300, 1e-300]])
def test_rows_of_any_length_decide_alike(lengths):
    step = ConstrainedStep(step_size=1.0, restoration_rate=0.0)
    climbing = np.array([1.0, 1.0]), np.array([[1.0, 0.0], [2.0, 0.0], [0.0, 1.0]])  # λ̂ = (½, ½, 1)
    for (g, rows), dropped in (((KKT_GRADIENT, KKT_ROWS), 0), (climbing, 1)):
        for scale in (1.0, 1e-150, 1e150):
            gradients = np.vstack([scale * g, np.array(lengths)[:, None] * rows])
            result = step(Linearization(np.zeros(4), gradients), KKT_THRESHOLDS)
            assert (result.counts["dropped"], bool(result.stationary)) == (dropped, dropped == 0)


@pytest.mark.parametrize("angle", [1e-2, 1e-6, 1e-10])
def test_of_two_nearly_opposing_constraints_the_wrong_one_does_not_leave_with_the_right_one(angle):
    """λ₁ − λ₂ = ½ and λ₁ + λ₂ = 1/angle: nearly equal, but Δ¹ itself would break the second by ½."""
    rows = np.array([[1.0, angle], [-1.0, angle]])
    along_second = np.array([angle, 1.0]) / np.hypot(angle, 1.0)
    for order in ([0, 1], [1, 0]):
        gradients = np.vstack([[0.5, 1.0], rows[order]])
        result = ConstrainedStep(step_size=1.0, restoration_rate=0.0)(Linearization(np.zeros(3), gradients), [0.0, 0.0])
        assert result.counts["dropped"] == 1
        np.testing.assert_allclose(result.change, (gradients[0] @ along_second) * along_second, rtol=1e-12)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_rosens_drop_rule_does_not_depend_on_the_order_of_the_rows(seed):
    g, J, _, _, rng = drawn(seed)
    one = RosenDrop().solve(DirectionProblem(g, J))
    order = rng.permutation(len(J))
    other = RosenDrop().solve(DirectionProblem(g, J[order]))
    assert (one.status, one.iterations) == (other.status, other.iterations)
    np.testing.assert_allclose(other.value, one.value, atol=1e-12 * max(1.0, float(np.abs(g).max())))
