"""`--compare`: cases, common random numbers, measures by hand, intervals that cover."""

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from cpgrl_opt import SOLVERS
from cpgrl_opt.solvers import is_usable
from envs import ThreeStateMDP
from rl import SoftmaxTable
from rl.cli import app
from rl.experiments.bootstrap import mean_intervals
from rl.experiments.messages import Outcome
from rl.experiments.runner import reproduce
from rl.experiments.share import train_share
from rl.experiments.three_state import METHODS, ThreeStateExperiment
from rl.experiments.three_state.tables import MEASURES, measure

TINY = ThreeStateExperiment(runs=3, episodes=12, steps=20, compare=True)
SETTINGS = replace(TINY, compare_solvers=["rosen", "active-set", "rosen-drop", "nnls"], compare_episodes=8)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    directory = tmp_path_factory.mktemp("compared")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rl.experiments.runner.draw", lambda *_: None)
        return reproduce(SETTINGS, directory), directory


@pytest.fixture(scope="module")
def outcomes(finished):
    """(case, its exact averages by moment, its outcome) of each training compared."""
    results = finished[0].results
    return [
        (case, results.curves[case.label]["exact"][:, 0], results.outcomes[case.label]) for case in SETTINGS.compared
    ]


def test_every_solver_is_compared_where_it_is_taken_and_the_first_under_every_drop_rule():
    cases = [(case.formulation, case.drop, case.solver, case.episodes) for case in SETTINGS.compared]
    assert cases == [
        ("equality", "never", "rosen", 12),
        ("equality", "stationary", "rosen", 12),
        ("equality", "always", "rosen", 12),
        ("equality", "stationary", "active-set", 12),
        ("equality", "stationary", "rosen-drop", 8),
        ("equality", "stationary", "nnls", 8),
        ("cone", "", "active-set", 12),
        ("cone", "", "rosen-drop", 8),
        ("cone", "", "nnls", 8),
        ("restoring", "", "active-set", 12),
        ("restoring", "", "nnls", 8),
        ("linearized", "", "active-set", 12),
        ("linearized", "", "nnls", 8),
    ]
    assert SETTINGS.common == 8
    assert [case.label for case in SETTINGS.cases() if case.in_learning] == list(METHODS)


def test_all_means_every_solver_that_can_be_used():
    every = replace(TINY, compare_solvers=["all"], compare_formulations=["equality"])
    assert every.solvers_compared() == [name for name, solver in SOLVERS.items() if is_usable(solver)]
    assert {case.solver for case in every.compared} >= {"rosen", "enumeration"}


def test_cases_share_their_random_numbers_so_that_exact_solvers_learn_the_same(outcomes):
    by_case = {(case.formulation, case.solver): exact for case, exact, _ in outcomes if case.drop != "always"}
    first = outcomes[0][1][:, 0]
    for _, exact, _ in outcomes:
        assert np.array_equal(exact[:, 0], first)
        assert exact.shape == (3, SETTINGS.common + 1, 4)
    for formulation, one, other in (("equality", "rosen", "nnls"), ("cone", "active-set", "nnls")):
        np.testing.assert_allclose(by_case[formulation, one], by_case[formulation, other], atol=1e-9)
    assert not np.allclose(by_case["equality", "rosen"], by_case["restoring", "nnls"], atol=1e-9)


def test_what_a_solver_does_not_certify_is_counted(outcomes):
    for case, _, outcome in outcomes:
        failed = {name for name, number in outcome.totals.items() if number and name.isupper()}
        failed -= {"OPTIMAL", "INFEASIBLE"}
        assert bool(outcome.counts["uncertified"].any()) == bool(failed)
        if case.solver == "rosen-drop":  # restorations have b > 0
            assert failed == {"UNSUPPORTED"}
        else:
            assert not failed


def test_the_result_does_not_depend_on_processes_or_on_what_else_is_compared(outcomes):
    case, exact, outcome = outcomes[1]
    heard = []
    alone = train_share((SETTINGS, case, (0, 1, 2)), heard.append)
    assert np.array_equal(heard[-2].values["exact"], exact)
    assert np.array_equal(alone.parameters, outcome.parameters)


def measured(below, last_below=0.0):
    """Measures by name of two runs or more whose ρ³ lies so far below its threshold, by moment; ρ¹ = 0.5."""
    below = np.asarray(below, dtype=float)
    exact = np.zeros((*below.shape, 4))
    exact[..., 0] = 0.5
    exact[..., 2] = -below
    last = np.tile([0.75, 0.0, -last_below, 0.0], (len(below), 1))
    none = np.zeros(len(below), np.int64)
    outcome = Outcome("", tuple(range(len(below))), 4, none, 1.0, 1.0, 0.0, last, {"uncertified": none})
    rows = measure(SETTINGS, {"exact": exact[:, None], "last": last[:, None]}, outcome)
    return dict(zip([measure.name for measure in MEASURES], rows.T, strict=True))


def test_measures_are_what_their_definition_says_by_hand(monkeypatch):
    penalties = SimpleNamespace(multipliers=np.array([0.0, 3.0, 1.0]))
    monkeypatch.setitem(vars(SETTINGS), "optimum", penalties)
    values = measured([[0.5, 0.25, 0.0, 0.125, 0.0], [0.0, 0.0, 0.0, 0.0, 0.25], [0.01] * 5], last_below=0.1)
    assert values["feasible_from"].tolist() == [4, 5, 0]  # 5: it is violated at the common end
    np.testing.assert_allclose(values["cumulative_violation"], [0.375, 0.25, 0.04])
    np.testing.assert_allclose(values["common_return"], 0.5)
    np.testing.assert_allclose(values["common_constrained_return"], [0.5, -0.25, 0.47])
    np.testing.assert_allclose(values["final_constrained_return"], 0.45)


def test_no_policy_has_a_constrained_return_above_the_optimum():
    mdp, rng = ThreeStateMDP(), np.random.default_rng(0)
    optimum = mdp.constrained_optimum([0.0, 0.0, 0.0])
    averages = mdp.average_rewards(rng.dirichlet(np.full(3, 0.3), size=(400, 3)))
    returns = averages[:, 0] - np.maximum(-averages[:, 1:], 0.0) @ optimum.multipliers
    assert returns.max() <= optimum.values[0] + 1e-9
    assert averages[:, 0].max() > optimum.values[0]  # by violation


def test_files_hold_every_run_and_the_table_the_intervals(finished, outcomes):
    done, directory = finished
    (_, table), _ = done.tables
    with (directory / "comparison.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(outcomes) * TINY.runs
    finals = [float(row["final_return"]) for row in rows[: TINY.runs]]
    policies = SoftmaxTable(3, 3).probabilities(outcomes[0][2].parameters)
    np.testing.assert_allclose(finals, ThreeStateMDP().average_rewards(policies)[:, 0], rtol=1e-8)
    assert f"{np.mean(finals):.4f} [" in table[1][table[0].index("final ρ¹")]
    text = (directory / "comparison.md").read_text(encoding="utf-8")
    assert text.count("\n| ") == len(outcomes) + 2
    assert "fewer updates" in text
    assert len(json.loads((directory / "comparison.json").read_text(encoding="utf-8"))["cases"]) == len(outcomes)


def test_conb_is_tabulated_by_its_tolerance_the_named_ones_trained_once(finished):
    done, directory = finished
    results = done.results
    with (directory / "tolerances.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["tolerance"] for row in rows[:: TINY.runs]] == ["0", "0.003", "0.005", "0.006", "0.01"]
    labels = ["conb", "conb, tolerance 0.003", "conb, tolerance 0.005", "conb-tolerant", "conb, tolerance 0.01"]
    assert [label for label in results.outcomes if label.startswith("conb")] == [
        labels[0],
        labels[3],
        *labels[1:3],
        labels[4],
    ]
    for label, row in zip(labels, rows[:: TINY.runs], strict=True):
        learned, counts = results.curves[label], results.outcomes[label].counts
        assert float(row["objective_share"]) == pytest.approx(counts["objective"][0] / TINY.episodes)
        assert float(row["a1_s2"]) == pytest.approx(learned.policies[0, -1, 1, 0])
        assert float(row["final_violation"]) == pytest.approx(max(0.0, -learned.exact[0, -1, 1:].min()))
    shares = [float(row["objective_share"]) for row in rows]
    assert shares[0] == 0 < max(shares)
    assert len((directory / "tolerances.md").read_text(encoding="utf-8").split("\n| ")) == 1 + 2 + len(labels)


def test_intervals_cover_the_mean_as_often_as_they_say():
    rng = np.random.default_rng(1)
    samples = rng.exponential(size=(600, 20, 1))
    intervals = mean_intervals(samples, rng, resamples=400)
    covered = ((intervals[:, 1] <= 1.0) & (intervals[:, 2] >= 1.0)).mean()
    assert 0.85 <= covered <= 0.97  # skewed and small samples: a little below 0.95
    np.testing.assert_allclose(intervals[:, 0], samples.mean(axis=1))
    one = mean_intervals(samples[0, :1], rng, resamples=9)
    assert (one == samples[0, 0]).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"compare_solvers": ["rosn"]}, "solver should be one of rosen, .*; found 'rosn'"),
        (
            {"compare_formulations": ["cones"]},
            "formulation should be one of equality, cone, .*, linearized; found 'cones'",
        ),
        (
            {"compare_solvers": ["rosen"], "compare_formulations": ["cone"]},
            "a solver should take one of the formulations",
        ),
        ({"compare_episodes": 0}, "compare_episodes should be"),
    ],
)
def test_bad_settings_are_answered_with_what_they_should_be(changes, message):
    assert "rosen" in SOLVERS
    with pytest.raises(ValueError, match=message):
        replace(TINY, **changes)


def test_the_command_compares_what_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.setattr("rl.experiments.runner.draw", lambda *_: None)
    result = CliRunner().invoke(
        app,
        ["reproduce", "three-state", "--runs", "2", "--episodes", "12", "--steps", "20", "--jobs", "1", "--compare",
         "--compare-solvers", "active-set, nnls", "--compare-formulations", "cone", "--compare-episodes", "5",
         "--out", str(tmp_path)],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "CPGRL on the three-state MDP by solver" in result.stdout
    assert "comparison.csv" in result.stdout
    lines = (tmp_path / "comparison.csv").read_text(encoding="utf-8").splitlines()
    assert [line.split(",")[:5] for line in lines[1::2]] == [
        ["cone", "", "active-set", "0", "12"],
        ["cone", "", "nnls", "0", "5"],
    ]
