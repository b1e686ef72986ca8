"""A step in the coordinates of long gradients is the step on the rows: the same change, counts and observations."""

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, ConstrainedStep, DirectionError, Linearization
from cpgrl_opt import step_in_span as step_module
from cpgrl_opt.direction import Direction, Status

from .long import least_products
from .steps import FORMULATIONS, drawn, require_same

SETTINGS = {
    "plain": {},
    "never drop": {"drop": "never"},
    "always drop": {"drop": "always"},
    "raw multipliers": {"drop": "always", "raw_multipliers": True},
    "ridge": {"ridge": 0.1},
    "short restoration": {"max_restoration": 0.01},
    "closed form": {"solver": "rosen"},
    "by a QP": {"solver": "quadprog", "on_failure": "skip"},
}


STEPS = [
    (formulation, name, kind)
    for formulation in FORMULATIONS
    for name in SETTINGS
    for kind in ("generic", "stationary", "sum", "flat", "in the span", "nearly opposing")
    if name == "plain" or kind in ("generic", "stationary", "nearly opposing")
    if (formulation, name) != ("linearized", "ridge")
]


def linearizations(kind="generic"):
    """One run, three, and none but its axes: (…, 1 + m, n)."""
    for seed, (runs, m) in enumerate([((), 2), ((), 4), ((3,), 3), ((2, 2), 2), ((0,), 2)]):
        given = drawn(seed, m, 120, kind, runs=runs)
        yield given.values, given.gradients, np.zeros(m)


def take_step(products, settings, values, V, thresholds, **more):
    with least_products(products):
        return ConstrainedStep(**settings)(Linearization(values, V), thresholds, **more)


def require_as_on_the_rows(settings, values, V, thresholds, *, error=1e-9):
    inside, outside = (take_step(products, settings, values, V, thresholds) for products in (0, 10**18))
    unit = np.abs(outside.change).max(initial=0.0) + 0.02 * np.abs(V[..., 0, :]).max(initial=0.0) + 1e-300
    require_same(inside, outside, atol=error * unit)
    return inside


@pytest.mark.parametrize(("formulation", "settings", "kind"), STEPS)
def test_a_step_in_the_span_is_the_step_on_the_rows(formulation, settings, kind):
    for given in list(linearizations(kind))[slice(None) if settings == "plain" else slice(2, 3)]:
        # On the rows quadprog is off by 2e-9 where these are 1e-6 rad from opposing.
        error = 1e-8 if settings == "by a QP" else 1e-9
        require_as_on_the_rows({"formulation": formulation, **SETTINGS[settings]}, *given, error=error)


@pytest.mark.parametrize("scale", [1e-160, 1e-100, 1e100, 1e160])
def test_scales_whose_squares_leave_float64_step_as_on_the_rows(scale):
    for values, V, thresholds in linearizations():
        require_as_on_the_rows({"formulation": "cone"}, values, scale * V, thresholds)


def test_only_nearly_dependent_rows_step_on_the_rows(monkeypatch):
    """The coordinates of rows at θ are tilted by eps/θ in float64, which no multipliers mend."""
    seen = []
    rungs = {}
    usual = step_module.coordinates

    def watched(vectors, on, rung, **more):
        small = usual(vectors, on, rung, **more)
        seen.append(rung if small is not None else "")
        return small

    monkeypatch.setattr(step_module, "coordinates", watched)
    for theta in (1.0, 1e-3, 1e-5):
        V = np.random.default_rng(0).standard_normal((3, 120))
        V[2] = -V[1] + theta * V[2]
        seen.clear()
        take_step(0, {}, -np.ones(3), V, np.zeros(2))
        rungs[theta] = list(seen)
    assert rungs == {1.0: ["gramian"], 1e-3: ["", "pairs"], 1e-5: ["", ""]}


def test_observers_see_every_subproblem_once_and_in_coordinates():
    for values, V, thresholds in list(linearizations())[:4]:
        seen = []
        for products in (0, 10**18):
            pairs = []
            settings, observe = {"formulation": "cone"}, lambda *pair, pairs=pairs: pairs.append(pair)
            take_step(products, settings, values, V, thresholds, observe=observe)
            seen.append(sorted(np.concatenate([answers.status for _, answers in pairs]).tolist()))
            assert all(problems.gradient.shape[1] == V.shape[-1 if products else -2] for problems, _ in pairs)
        assert seen[0] == seen[1]


class Failing:
    """Answers nothing in up to `most` coordinates; elsewhere as active-set does."""

    tolerance = 1e-9

    def __init__(self, most):
        self.most = most

    def solve(self, problem):
        if problem.n <= self.most:
            return Direction(np.zeros(problem.n), np.zeros(problem.m), Status.NUMERICAL_ERROR)
        return SOLVERS["active-set"].solve(problem)


@pytest.mark.parametrize("on_failure", ["skip", "fallback", "raise"])
def test_what_fails_in_coordinates_is_tried_on_the_rows_and_handled_as_there(on_failure):
    given = next(linearizations())
    few, all_of_them = ({"solver": Failing(most), "on_failure": on_failure} for most in (3, 1000))
    if on_failure != "fallback":
        assert require_as_on_the_rows({**few, "formulation": "cone"}, *given).change.any()
    if on_failure == "raise":
        with pytest.raises(DirectionError):
            take_step(0, all_of_them, *given)
    else:
        result = require_as_on_the_rows(all_of_them, *given)
        assert result.counts["skipped" if on_failure == "skip" else "fallback"] > 0


def test_gradients_are_read_where_they_lie_and_left_as_they_are_and_as_they_are_then():
    """Inner products are of the old ones; J and the change that it makes are compared in both."""
    values, V, thresholds = list(linearizations())[1]
    stored = np.asfortranarray(V)
    with least_products(0):
        linearization, step = Linearization(-np.abs(values), stored), ConstrainedStep()
        step(linearization, thresholds).change[:] = 0.0
        np.testing.assert_array_equal(stored, V)
        stored[2] = stored[3] + stored[4] * np.arange(120)
        found = step(linearization, thresholds)
    require_same(found, take_step(10**18, {}, -np.abs(values), stored, thresholds), atol=1e-9)
