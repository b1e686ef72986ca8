"""A step in the coordinates of long gradients is the step on the rows: the same change, counts and observations."""

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, ConstrainedStep, DirectionError, Linearization
from cpgrl_opt import step_in_span as step_module
from cpgrl_opt.direction import Direction, Status

from .long import least_products

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


def generic(V):
    return V


def sum_to_zero(V):
    V[..., -1, :] = -V[..., 1:-1, :].sum(axis=-2)
    return V


def with_flat_row(V):
    V[..., 1, :] = 0.0
    return V


def stationary(V):
    V[..., 0, :] = -V[..., 1:, :].sum(axis=-2)
    return V


def in_the_span(V):
    V[..., 0, :] = V[..., 1:, :].sum(axis=-2)
    return V


def nearly_opposing(V):
    V[..., -1, :] = -V[..., 1, :] + 1e-6 * V[..., -1, :]
    return V


FORMULATIONS = ("equality", "cone", "restoring", "linearized")
STEPS = [(each, name) for each in FORMULATIONS for name in SETTINGS if (each, name) != ("linearized", "ridge")]
KINDS = (generic, sum_to_zero, with_flat_row, stationary, in_the_span, nearly_opposing)


def linearizations(kind):
    """One run, three, and none but its axes: (…, 1 + m, n)."""
    for seed, (runs, m) in enumerate([((), 2), ((), 4), ((3,), 3), ((2, 2), 2), ((0,), 2)]):
        rng = np.random.default_rng(seed)
        V = kind(rng.standard_normal((*runs, 1 + m, 120)))
        yield rng.standard_normal((*runs, 1 + m)), V, np.zeros(m)


def taken(products, settings, values, V, thresholds, **more):
    with least_products(products):
        return ConstrainedStep(**settings)(Linearization(values, V), thresholds, **more)


def require_same(inside, outside, V, *, error=1e-9):
    unit = np.abs(outside.change).max(initial=0.0) + 0.02 * np.abs(V[..., 0, :]).max(initial=0.0) + 1e-300
    assert inside.change.shape == outside.change.shape
    assert np.abs(inside.change - outside.change).max(initial=0.0) <= error * unit
    assert (inside.stationary == outside.stationary).all()
    assert (inside.active == outside.active).all()
    for name, counted in outside.counts.items():
        assert inside.counts[name].shape == counted.shape
        assert (inside.counts[name] == counted).all(), name


@pytest.mark.parametrize(("formulation", "settings"), STEPS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_step_in_the_span_is_the_step_on_the_rows(kind, formulation, settings):
    for values, V, thresholds in list(linearizations(kind))[slice(None) if settings == "plain" else slice(2, 3)]:
        chosen = {"formulation": formulation, **SETTINGS[settings]}
        inside, outside = (taken(products, chosen, values, V, thresholds) for products in (0, 10**18))
        # On the rows quadprog is off by 2e-9 where these are 1e-6 rad from opposing.
        require_same(inside, outside, V, error=1e-8 if settings == "by a QP" else 1e-9)


@pytest.mark.parametrize("scale", [1e-160, 1e-100, 1e100, 1e160])
def test_scales_whose_squares_leave_float64_step_as_on_the_rows(scale):
    for values, V, thresholds in linearizations(generic):
        inside, outside = (
            taken(products, {"formulation": "cone"}, values, scale * V, thresholds) for products in (0, 10**18)
        )
        require_same(inside, outside, scale * V)


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
        taken(0, {}, -np.ones(3), V, np.zeros(2))
        rungs[theta] = list(seen)
    assert rungs == {1.0: ["gramian"], 1e-3: ["", "pairs"], 1e-5: ["", ""]}


def test_observers_see_every_subproblem_once_and_in_coordinates():
    for values, V, thresholds in list(linearizations(generic))[:4]:
        seen = []
        for products in (0, 10**18):
            pairs = []
            settings, observe = {"formulation": "cone"}, lambda *pair, pairs=pairs: pairs.append(pair)
            taken(products, settings, values, V, thresholds, observe=observe)
            seen.append(sorted(np.concatenate([answers.status for _, answers in pairs]).tolist()))
            assert all(problems.gradient.shape[1] == V.shape[-1 if products else -2] for problems, _ in pairs)
        assert seen[0] == seen[1]


class Failing:
    """Answers nothing in few coordinates; elsewhere as active-set does."""

    tolerance = 1e-9

    def solve(self, problem):
        if problem.n <= 1 + problem.m:
            return Direction(np.zeros(problem.n), np.zeros(problem.m), Status.NUMERICAL_ERROR)
        return SOLVERS["active-set"].solve(problem)


@pytest.mark.parametrize("on_failure", ["skip", "raise"])
def test_what_fails_in_coordinates_is_tried_on_the_rows(on_failure):
    values, V, thresholds = next(linearizations(generic))
    settings = {"solver": Failing(), "on_failure": on_failure, "formulation": "cone"}
    inside, outside = (taken(products, settings, values, V, thresholds) for products in (0, 10**18))
    require_same(inside, outside, V)
    assert inside.change.any()


class Hopeless:
    """Answers nothing."""

    tolerance = 1e-9

    def solve(self, problem):
        return Direction(np.zeros(problem.n), np.zeros(problem.m), Status.NUMERICAL_ERROR)


def test_failures_are_handled_in_coordinates_as_on_the_rows():
    values, V, thresholds = next(linearizations(generic))
    for on_failure in ("skip", "fallback"):
        settings = {"solver": Hopeless(), "on_failure": on_failure}
        inside, outside = (taken(products, settings, values, V, thresholds) for products in (0, 10**18))
        require_same(inside, outside, V)
        assert inside.counts["skipped" if on_failure == "skip" else "fallback"] > 0
    with pytest.raises(DirectionError):
        taken(0, {"solver": Hopeless(), "on_failure": "raise"}, values, V, thresholds)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_bad_gradients_are_refused_where_they_are_long_too(bad):
    V = np.ones((2, 3, 120))
    V[1, 2, 7] = bad
    with least_products(0), pytest.raises(ValueError, match="gradients should be finite"):
        Linearization(np.zeros((2, 3)), V)


def test_gradients_are_read_where_they_lie_and_left_as_they_are():
    values, V, thresholds = list(linearizations(generic))[1]
    stored = np.asfortranarray(V)
    before = stored.copy()
    inside = taken(0, {}, values, stored, thresholds)
    require_same(inside, taken(10**18, {}, values, V, thresholds), V)
    assert (stored == before).all()
    inside.change[:] = 0.0
    assert (stored == before).all()


def test_gradients_that_change_under_a_linearization_step_as_they_are_then():
    """Inner products are of the old ones; J and the change that it makes are compared in both."""
    values, V, thresholds = list(linearizations(generic))[1]
    with least_products(0):
        linearization, step = Linearization(-np.abs(values), V), ConstrainedStep()
        step(linearization, thresholds)
        V[2] = V[3] + V[4] * np.arange(120)
        found = step(linearization, thresholds)
    require_same(found, taken(10**18, {}, -np.abs(values), V, thresholds), V)
