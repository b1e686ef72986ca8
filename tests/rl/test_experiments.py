"""The paper's experiments: every file and what it holds, runs that do not know of each other, the paper's picture."""

import csv
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.comparison.recording import load_recording
from envs import ThreeStateMDP, TwoLinkArm
from rl import CPGRL, KondaActorCritic, NormalizedGaussianNetwork, SoftmaxTable, train
from rl import uniform_parameters as uniform
from rl.experiments.arm import ArmExperiment
from rl.experiments.arm.conditions import CONDITIONS
from rl.experiments.messages import Block
from rl.experiments.records import Records
from rl.experiments.records import train as train_all
from rl.experiments.runner import draw, files_of, remarks, reproduce
from rl.experiments.share import train_share
from rl.experiments.subproblems import FILE, write_subproblems
from rl.experiments.three_state import METHODS, ThreeStateExperiment
from rl.experiments.three_state.claims import PRINTED

SMALL = {
    "three-state": ThreeStateExperiment(runs=5, episodes=3000),
    "arm": ArmExperiment(runs=4, episodes=450),
}
TINY = {
    "three-state": ThreeStateExperiment(runs=2, episodes=25, steps=20, record_every=10, record=40),
    "arm": ArmExperiment(runs=2, episodes=25, record_every=10, conditions=["c-no-projection", "b"]),
}
AVERAGES = [f"{kind}_{i}" for kind in ("estimated", "exact") for i in (1, 2, 3, 4)]
OBJECTS = ["circle", "star", "square", "triangle", "none"]
COLUMNS = {"three-state": ["method", *AVERAGES], "arm": ["condition", *OBJECTS, "violation", "length"]}
LABELS = {"three-state": METHODS, "arm": tuple(CONDITIONS)}
RECORDED = {"three-state": range(0, 3001, 100), "arm": (100, 200, 300, 400, 450)}
COMPARED = ("comparison.", "tolerances.", "compare.", "subproblems.")  # files that are there when they are asked for
# Pr(a₁|s₁) of CONB is about a half under the transitions taken (docs/reproduction.md §2).
CONTRADICTED = {"all-choose-a1-in-s1"}
# With a tolerance it is a matter of time: Pr(a₁|s₁) = 0.92 at the end, and ρ¹ = 82 % of the optimum, not ≤ 75 %.
TOLERANT_EARLY, TOLERANT_LATE = {"all-choose-a1-in-s1-tolerant"}, {"conb-fails-to-maximise-tolerant"}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """finished(name): what was done, and where, of an experiment."""

    @cache
    def run(name):
        directory = tmp_path_factory.mktemp(name)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("rl.experiments.arm.animation._FRAMES", 6)  # half of the time is drawing
            patch.setattr("rl.experiments.arm.paths._TRIES", 3)
            return reproduce(SMALL[name], directory), directory

    return run


def read(path):
    return json.loads(path.read_text(encoding="utf-8"))


def rows(directory):
    with (directory / "learning.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def share(settings, label, runs):
    case = next(case for case in settings.cases() if case.label == label)
    return train_share((settings, case, tuple(runs)), lambda _: None)


@pytest.mark.parametrize("name", SMALL)
def test_every_file_is_written_and_learning_csv_is_tidy_sorted_and_complete(finished, name):
    done, directory = finished(name)
    wanted = {file for file in files_of(SMALL[name]) if not file.startswith(COMPARED)}
    assert {path.name for path in directory.iterdir()} == wanted
    claims = read(directory / "claims.json")
    assert [(claim["id"], claim["holds"]) for claim in claims] == [(claim.id, claim.holds) for claim in done.claims]
    table, (key, *columns) = rows(directory), COLUMNS[name]
    assert list(table[0]) == [key, "run", "episode", *columns]
    keys = [(row[key], int(row["run"]), int(row["episode"])) for row in table]
    assert keys == [
        (label, run, k) for label in LABELS[name] for run in range(SMALL[name].runs) for k in RECORDED[name]
    ]


@pytest.mark.parametrize(
    ("name", "first"), [("three-state", ["cpgrl"]), ("arm", ["b", "c", "c-episode", "c-feasible"])]
)
def test_summary_json_says_how_the_results_were_made(finished, name, first):
    done, directory = finished(name)
    summary, settings = read(directory / "summary.json"), SMALL[name]
    parts = summary["methods" if name == "three-state" else "conditions"]
    for speed, clock in (("steps_per_second", "training_seconds"), ("steps_per_cpu_second", "training_cpu_seconds")):
        rate = sum(parts[label]["environment_steps"] for label in first) / sum(parts[label][clock] for label in first)
        assert summary[speed] == pytest.approx(rate, rel=0.02)  # CPGRL's; seconds are written to three places
    assert (summary["settings"]["runs"], summary["seeds"]["seed"]) == (settings.runs, settings.seed)
    assert {"python", "numpy", "numba", "cpgrl-opt"} <= set(summary["versions"])
    assert summary["wall_time"]["total"] >= summary["wall_time"]["training"] > 0
    for label, part in parts.items():
        outcome = done.results.outcomes[label]
        assert part["environment_steps"] == outcome.steps.sum() >= settings.runs * settings.episodes
        assert part["counts"] == outcome.counted()
        assert part["counts"].get("fallback", 0) == part["counts"].get("skipped", 0) == 0


def test_three_states_claims_hold_at_a_small_size(finished):
    done, directory = finished("three-state")
    assert {claim.id for claim in done.claims if not claim.holds} == CONTRADICTED | TOLERANT_EARLY
    printed = [claim for claim in done.claims if claim.about == PRINTED]
    assert [claim.id for claim in done.claims[14:]] == [f"{claim.id}-tolerant" for claim in printed]
    assert {claim.about for claim in done.claims[14:]} == {"CONB with a tolerance, η = 0.006"}
    np.testing.assert_allclose(read(directory / "summary.json")["optimum"]["values"], [1, 0, 0, 0], atol=1e-9)


def test_three_states_files_hold_what_the_claims_are_judged_by(finished):
    done, directory = finished("three-state")
    curves, methods = done.results.curves, read(directory / "summary.json")["methods"]
    table = np.array([[float(row[name]) for name in AVERAGES] for row in rows(directory)])
    for method, own in zip(METHODS, table.reshape(len(METHODS), 5, -1, 2, 4), strict=True):
        learned, final = curves[method], methods[method]["final"]
        np.testing.assert_allclose(own[:, :, 0], learned.estimated, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(own[:, :, 1], learned.exact, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(final["mean"], own[:, -1, 1].mean(axis=0), atol=1e-8)
        np.testing.assert_allclose(final["standard_deviation"], own[:, -1, 1].std(axis=0, ddof=1), atol=1e-8)
        np.testing.assert_allclose(ThreeStateMDP().average_rewards(learned.policies[1]), learned.exact[1], rtol=1e-12)
        np.testing.assert_array_equal(learned.policies[:, 0], curves["cpgrl"].policies[:, 0])  # the same θ₀


def test_three_states_first_row_is_before_any_update_and_its_last_after_all(tmp_path):
    settings = TINY["three-state"]
    results = train_all(settings, tmp_path)
    *_, last = train(
        ThreeStateMDP(), SoftmaxTable(3, 3), settings.estimator(), settings.learner(settings.cases()[1]),
        episodes=25, runs=2, seed=settings.seed, initial=uniform(9),
    )  # fmt: skip
    conb, table = results.curves["conb"], SoftmaxTable(3, 3)
    assert conb.episodes.tolist() == [0, 10, 20, 25]
    np.testing.assert_array_equal(results.outcomes["conb"].parameters, last.parameters)
    np.testing.assert_array_equal(conb.policies[:, -1], table.probabilities(last.parameters))
    np.testing.assert_array_equal(conb.estimated[:, -1], last.estimate.values)
    spread = np.exp(1.0)  # θ₀ in [0, 1]: no action is e times as likely as another
    assert (conb.policies[:, 0].max(axis=-1) <= spread * conb.policies[:, 0].min(axis=-1)).all()
    assert not conb.estimated[:, 0].any()


def test_the_arms_picture_shows_at_a_small_size(finished):
    done, directory = finished("arm")
    curves, c = done.results.curves, read(directory / "summary.json")["conditions"]["c"]

    def rates(name, first, last):
        return curves[name].within(first, last).mean_rates()

    assert rates("b", 0, 100)["star"] > 12  # about a fifth
    assert rates("b", 200, 450)["star"] < 0.85 * rates("b", 0, 100)["star"]  # (b) learns to avoid it
    free, zero = rates("a", 200, 450)["square"], rates("b", 200, 450)["square"]
    for name in ("c", "c-episode", "c-feasible", "c-no-projection"):
        assert rates(name, 200, 450)["square"] > max(45, 1.2 * zero, 1.5 * free)
    assert curves["a"].late().outside().mean() > 3 * curves["b"].late().outside().mean()  # G² = 0 is kept
    holds = {claim.id for claim in done.claims if claim.holds}
    assert len(done.claims) == 13
    assert {"c-threshold-out-of-reach", "b-touches-star-early", "a-learns-touching"} <= holds
    assert c["counts"]["capped"] > 0.6 * c["updates"]  # G³ is far off
    assert c["thresholds"] == [0.0, 0.5]
    told = " ".join(remarks(done))
    assert "our additions: ridge = 0.0001, max_restoration = 0.1, drop = never" in told
    assert "restorations shortened" in told


def test_blocks_count_the_episodes_of_training(tmp_path):
    """Condition b against `train` itself, with everything set by hand."""
    train_all(TINY["arm"], tmp_path)
    arm, printed = TwoLinkArm(), KondaActorCritic(gradient="episode mean", bias_correction=False)
    step = ConstrainedStep(solver="rosen", ridge=1e-4, max_restoration=0.1, drop="never")
    policy = NormalizedGaussianNetwork(*arm.stops, (5, 8), 2)
    records = list(train(arm, policy, printed, CPGRL(step, [0, 0]), episodes=25, runs=2))
    own = [row for row in rows(tmp_path) if (row["condition"], row["run"]) == ("b", "1")]
    for row, block in zip(own, (records[:10], records[10:20], records[20:]), strict=True):
        events = [int(record.estimate.events[1]) for record in block]
        steps = sum(record.estimate.steps[1] for record in block)
        assert [int(row[name]) for name in OBJECTS] == [events.count(k) for k in (1, 2, 3, 4, 0)]
        assert float(row["length"]) == pytest.approx(steps / len(block))
        outside = -sum(record.estimate.rewards[1, 1] for record in block)
        assert float(row["violation"]) == pytest.approx(outside / steps)


@pytest.mark.parametrize(("solver", "formulation"), [("osqp", "restoring"), ("rosen", "cone")])
def test_every_condition_trains_with_another_solver_formulation_and_estimator(tmp_path, solver, formulation):
    settings = ArmExperiment(runs=1, episodes=4, solver=solver, formulation=formulation, estimator="gpomdp")
    outcomes = train_all(settings, tmp_path).outcomes
    assert list(outcomes) == list(CONDITIONS)
    handed_over = sum(outcome.counted().get("fallback", 0) for outcome in outcomes.values())
    assert (handed_over > 0) == (solver == "rosen")  # which takes equalities alone


def test_a_solver_that_does_not_take_the_formulation_is_told_plainly(tmp_path, monkeypatch):
    monkeypatch.setattr("rl.experiments.runner.draw", lambda *_: None)
    told = " ".join(remarks(reproduce(replace(TINY["three-state"], formulation="cone"), tmp_path)))
    assert "rosen does not take the formulation cone: active-set solved" in told
    assert "subproblems handed to active-set" in told


@pytest.mark.parametrize(
    ("kind", "wrong", "message"),
    [
        (ArmExperiment, {"conditions": ["a", "d"]}, r"condition should be one of a, b, c, .*found 'd'"),
        (ArmExperiment, {"conditions": []}, "condition should be one of"),
        (ArmExperiment, {"estimator": "td"}, "estimator should be one of konda, gpomdp; found 'td'"),
        (ArmExperiment, {"ridge": -1.0}, "ridge should be"),
        (ThreeStateExperiment, {"runs": 0}, "runs should be"),
        (ThreeStateExperiment, {"solver": "rosn"}, "rosen"),
        (ThreeStateExperiment, {"compare_solvers": ["rosn"], "compare": True}, "solver should be .*'rosn'"),
    ],
)  # fmt: skip
def test_wrong_settings_are_told_the_right_ones(kind, wrong, message):
    assert ArmExperiment(conditions=["c", "a", "c"]).conditions == ("a", "c")  # in their order, once
    with pytest.raises(ValueError, match=message):
        kind(**wrong)


def test_figures_of_ours_stand_alone_where_nothing_of_the_papers_was_trained(tmp_path, monkeypatch):
    monkeypatch.setattr("rl.experiments.runner.save_figure", lambda _, directory, name: (directory / name).touch())
    monkeypatch.setattr("rl.experiments.arm.experiment.write_animation", lambda *words: words[-1].touch())
    draw(train_all(ArmExperiment(runs=1, episodes=3, conditions=["c-feasible"]), tmp_path), tmp_path)
    assert {path.name for path in tmp_path.glob("fig*")} == {"fig6", "fig7", "fig7.gif"}


def test_progress_is_that_of_the_run_that_is_least_far(tmp_path):
    def block(runs, episode):
        touches, rate = np.full((len(runs), 5), 2), np.ones(len(runs))
        return Block("b", runs, episode, {"touches": touches, "violation": rate, "length": rate})

    messages = Block("b", (2,), 4), block((0, 1), 10), block((2,), 10), Block("b", (2,), 17), Block("a", (0,), 3)
    with Records(ArmExperiment(runs=3, record_every=10), tmp_path) as records:
        assert [records.hear(message) for message in messages] == [0, 4, 10, 10, 0]
    assert [row["run"] for row in rows(tmp_path)] == ["0", "1", "2"]


def test_watching_a_training_does_not_change_it_and_keeps_what_was_asked_for():
    watched = share(TINY["three-state"], "cpgrl", (0, 1))
    alone = share(replace(TINY["three-state"], record=0), "cpgrl", (0, 1))
    assert np.array_equal(watched.parameters, alone.parameters)
    assert alone.recording is share(TINY["three-state"], "sum", (0,)).recording is None
    assert 0 < len(watched.recording) <= 40
    assert watched.recording.episode.min() >= 1
    assert watched.recording.episode.max() <= 25


def test_runs_shared_out_leave_the_same_file_as_all_together(tmp_path):
    settings = ArmExperiment(runs=3, episodes=8, record=1000)
    for name, shares in (("one", [(0, 1, 2)]), ("two", [(0, 1), (2,)])):
        (tmp_path / name).mkdir()
        write_subproblems([share(settings, "c", runs).recording for runs in shares], tmp_path / name)
    assert (tmp_path / "one" / FILE).read_bytes() == (tmp_path / "two" / FILE).read_bytes()
    recording = load_recording(tmp_path / "one" / FILE)
    assert (recording.trainings, set(recording.run)) == (("c",), {0, 1, 2})
    assert recording.jacobian.shape[1:] == (2, 82)  # the ridge adds a column for each constraint


@pytest.mark.slow
def test_three_states_claims_hold_at_full_size(tmp_path):
    done = reproduce(ThreeStateExperiment(), tmp_path, processes=2)
    assert {claim.id for claim in done.claims if not claim.holds} == CONTRADICTED | TOLERANT_LATE
    final = done.results.curves["cpgrl"].exact[:, -1]
    assert final[:, 0].mean() > 0.98
    np.testing.assert_allclose(final[:, 1:], 0, atol=0.01)


@pytest.mark.slow
def test_the_arms_claims_hold_at_full_size(tmp_path):
    done = reproduce(ArmExperiment(), tmp_path, processes=2)
    assert [claim.id for claim in done.claims if not claim.holds] == []
    late = {name: list(learned.late().mean_rates().values()) for name, learned in done.results.curves.items()}
    np.testing.assert_allclose(late["b"], (5, 3, 4, 88, 0), atol=10)  # docs/reproduction.md §3, 10 seeds
    np.testing.assert_allclose(late["c"], (1, 1, 96, 2, 0), atol=6)
    np.testing.assert_allclose(late["a"], (17, 74, 4, 5, 0), atol=12)
