"""`--compare`: which trainings, common random numbers, measures by hand, and tables that say what was measured."""

import csv
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from cpgrl_opt import SOLVERS
from cpgrl_opt.solvers import is_usable
from envs import ThreeStateMDP
from rl import SoftmaxTable
from rl.experiments.arm import ArmExperiment
from rl.experiments.arm import tables as arm_tables
from rl.experiments.arm.conditions import CONDITIONS
from rl.experiments.messages import Outcome
from rl.experiments.records import train
from rl.experiments.runner import reproduce
from rl.experiments.three_state import METHODS, ThreeStateExperiment
from rl.experiments.three_state.tables import MEASURES, measure

CHAIN = ThreeStateExperiment(
    runs=3, episodes=12, steps=20, compare=True, compare_solvers=["rosen", "active-set", "rosen-drop", "nnls"]
)
ARM = ArmExperiment(runs=2, episodes=60, conditions=["c"], compare=True, record_every=20)
STEPS = [("equality", "rosen"), ("cone", "active-set"), ("restoring", "active-set"), ("linearized", "active-set")]


@pytest.fixture(autouse=True, scope="module")
def short():
    """Solvers that are not compiled have eight updates."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rl.experiments.three_state.experiment.COMPARED_EPISODES", 8)
        yield


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """finished(name): what was done, and where."""

    @cache
    def run(name):
        directory = tmp_path_factory.mktemp(name)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("rl.experiments.runner.draw", lambda *_: None)
            return reproduce({"chain": CHAIN, "arm": ARM}[name], directory), directory

    return run


@pytest.fixture
def outcomes(finished):
    """(case, its exact averages by moment, its outcome) of each of three-state's trainings compared."""
    results = finished("chain")[0].results
    return [(case, results.curves[case.label]["exact"][:, 0], results.outcomes[case.label]) for case in CHAIN.compared]


def tabulated(path):
    lines = (line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("| "))
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def rows(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_every_solver_is_compared_where_it_is_taken_and_the_first_under_every_drop_rule():
    cases = [(case.formulation, case.drop, case.solver, case.episodes) for case in CHAIN.compared]
    lengths = {"rosen": 12, "active-set": 12, "rosen-drop": 8, "nnls": 8}  # by whether it is compiled
    drops = [("never", "rosen"), ("stationary", "rosen"), ("always", "rosen")]
    equality = drops + [("stationary", name) for name in ("active-set", "rosen-drop", "nnls")]
    others = {"cone": ("active-set", "rosen-drop", "nnls")}
    others |= dict.fromkeys(("restoring", "linearized"), ("active-set", "nnls"))
    assert cases == [
        *(("equality", drop, name, lengths[name]) for drop, name in equality),
        *((formulation, "", name, lengths[name]) for formulation, names in others.items() for name in names),
    ]
    assert CHAIN.common == 8
    assert [case.label for case in CHAIN.cases() if case.in_learning] == list(METHODS)
    every = replace(CHAIN, compare_solvers=["all"])
    assert every.solvers_compared() == [name for name, solver in SOLVERS.items() if is_usable(solver)]


def test_b_and_c_are_trained_under_every_formulation_and_the_settings_own_step_once():
    labels = [case.label for case in ArmExperiment(compare=True).cases()]
    assert labels == [*CONDITIONS, *(f"{name}, {formulation}" for name in "bc" for formulation, _ in STEPS[1:])]
    other = ArmExperiment(compare=True, conditions=["b"], solver="osqp", formulation="restoring").cases()
    named = {case.label: (case.condition, case.solver, case.formulation) for case in other}
    assert named["b"] == ("b", "osqp", "restoring")
    assert named["b, restoring"] == ("b", "active-set", "restoring")
    assert [case.label for case in other if case.in_learning] == ["b"]


def test_cases_share_their_random_numbers_so_that_exact_solvers_learn_the_same(outcomes):
    by_case = {(case.formulation, case.solver): exact for case, exact, _ in outcomes if case.drop != "always"}
    for _, exact, _ in outcomes:
        assert np.array_equal(exact[:, 0], outcomes[0][1][:, 0])
        assert exact.shape == (3, CHAIN.common + 1, 4)
    for formulation, one, other in (("equality", "rosen", "nnls"), ("cone", "active-set", "nnls")):
        np.testing.assert_allclose(by_case[formulation, one], by_case[formulation, other], atol=1e-9)
    assert not np.allclose(by_case["equality", "rosen"], by_case["restoring", "nnls"], atol=1e-9)


def test_what_a_solver_does_not_certify_is_counted(outcomes):
    for case, _, outcome in outcomes:
        failed = {name for name, number in outcome.totals.items() if number and name.isupper()}
        failed -= {"OPTIMAL", "INFEASIBLE"}
        assert bool(outcome.counts["uncertified"].any()) == bool(failed)
        assert failed == ({"UNSUPPORTED"} if case.solver == "rosen-drop" else set())  # restorations have b > 0


def test_measures_are_what_their_definition_says_by_hand(monkeypatch):
    """Three runs whose ρ³ lies so far below its threshold, by moment; ρ¹ = 0.5."""
    monkeypatch.setitem(vars(CHAIN), "optimum", SimpleNamespace(multipliers=np.array([0.0, 3.0, 1.0])))
    below = np.array([[0.5, 0.25, 0.0, 0.125, 0.0], [0.0, 0.0, 0.0, 0.0, 0.25], [0.01] * 5])
    exact = np.zeros((3, 1, 5, 4))
    exact[:, 0, :, 0], exact[:, 0, :, 2] = 0.5, -below
    last = np.tile([0.75, 0.0, -0.1, 0.0], (3, 1, 1))
    none = np.zeros(3, np.int64)
    outcome = Outcome("", (0, 1, 2), 4, none, 1.0, 1.0, last[:, 0], {"uncertified": none})
    table = measure(CHAIN, {"exact": exact, "last": last}, outcome)
    values = dict(zip([measure.name for measure in MEASURES], table.T, strict=True))
    assert values["feasible_from"].tolist() == [4, 5, 0]  # 5: it is violated at the common end
    np.testing.assert_allclose(values["cumulative_violation"], [0.375, 0.25, 0.04])
    np.testing.assert_allclose(values["common_return"], 0.5)
    np.testing.assert_allclose(values["common_constrained_return"], [0.5, -0.25, 0.47])
    np.testing.assert_allclose(values["final_constrained_return"], 0.45)


def test_three_states_files_hold_every_run_and_the_table_the_intervals(finished, outcomes):
    _, directory = finished("chain")
    head, _, *table = tabulated(directory / "comparison.md")
    written = rows(directory / "comparison.csv")
    assert len(written) == len(outcomes) * CHAIN.runs
    finals = [float(row["final_return"]) for row in written[: CHAIN.runs]]
    policies = SoftmaxTable(3, 3).probabilities(outcomes[0][2].parameters)
    np.testing.assert_allclose(finals, ThreeStateMDP().average_rewards(policies)[:, 0], rtol=1e-8)
    assert f"{np.mean(finals):.4f} [" in table[0][head.index("final ρ¹")]
    assert len(table) == len(outcomes)


def test_conb_is_tabulated_by_its_tolerance_the_named_ones_trained_once(finished):
    done, directory = finished("chain")
    written = rows(directory / "tolerances.csv")[:: CHAIN.runs]
    labels = ["conb", "conb, tolerance 0.003", "conb, tolerance 0.005", "conb-tolerant", "conb, tolerance 0.01"]
    assert sorted(label for label in done.results.outcomes if label.startswith("conb")) == sorted(labels)
    for label, tolerance, row in zip(labels, ("0", "0.003", "0.005", "0.006", "0.01"), written, strict=True):
        learned, counts = done.results.curves[label], done.results.outcomes[label].counts
        assert row["tolerance"] == tolerance
        assert float(row["objective_share"]) == pytest.approx(counts["objective"][0] / CHAIN.episodes)
        assert float(row["a1_s2"]) == pytest.approx(learned.policies[0, -1, 1, 0])
        assert float(row["final_violation"]) == pytest.approx(max(0.0, -learned.exact[0, -1, 1:].min()))


def test_the_arms_files_hold_every_run_and_the_table_the_spread(finished):
    done, directory = finished("arm")
    _, _, *table = tabulated(directory / "compare.md")
    written, names = rows(directory / "compare.csv"), [measure.name for measure in arm_tables.MEASURES]
    assert list(written[0]) == ["condition", "formulation", "solver", "run", "episode", *names]
    keys = [(row["condition"], row["formulation"], row["solver"], row["run"]) for row in written]
    assert keys == [(condition, *step, run) for condition in "bc" for step in STEPS for run in "01"]
    assert {row["condition"] for row in rows(directory / "learning.csv")} == {"c"}
    rates = done.results.curves["b, restoring"].late().rates()[:, 3]
    assert table[2][:3] == ["b", "restoring", "active-set"]
    assert table[2][6] == f"{rates.mean():.1f} ± {rates.std(ddof=1):.1f}"


def test_a_row_of_the_arms_is_made_of_late_touches_violations_and_counts_per_update(finished):
    done, directory = finished("arm")
    curves, outcome = done.results.curves["c, cone"], done.results.outcomes["c, cone"]
    row = next(own for own in rows(directory / "compare.csv")[11:] if own["formulation"] == "cone")
    late, counts = curves.late(), outcome.counts
    wanted = {
        "square": late.rates()[1, 2], "early_violation": curves.early().outside()[1], "violation": late.outside()[1],
        "length": curves.length[1, -1],  # the last block is the last tenth
        "capped": counts["capped"][1] / 60, "constrained": counts["constrained"][1] / 60,
    }  # fmt: skip
    assert {name: float(row[name]) for name in wanted} == pytest.approx(wanted)
    failing = dict(counts) | {"fallback": np.array([0, 6]), "skipped": np.array([0, 3])}
    again = arm_tables.measure(curves, replace(outcome, counts=failing))
    np.testing.assert_allclose(again[:, -1], [0, 9 / 60])


def test_what_was_finished_before_an_interrupt_is_in_compare_csv(tmp_path):
    def interrupt(message, _):
        if message.label == "c, cone":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(ARM, tmp_path, listen=interrupt)
    written = {(row["condition"], row["formulation"]) for row in rows(tmp_path / "compare.csv")}
    assert written >= {("b", "cone"), ("c", "equality")}
    assert ("c", "cone") not in written
    assert len(rows(tmp_path / "learning.csv")) == 2 * 3
