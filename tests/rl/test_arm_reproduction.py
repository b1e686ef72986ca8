"""The arm's experiment: every file it writes, its determinism, and the paper's picture at a small size."""

import csv
import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep
from envs import TwoLinkArm
from rl import CPGRL, GPOMDP, DivergenceError, KondaActorCritic, NormalizedGaussianNetwork, train
from rl.experiments.arm import ArmExperiment
from rl.experiments.arm.conditions import CONDITIONS
from rl.experiments.messages import Block, Tick
from rl.experiments.records import Records
from rl.experiments.records import train as train_all
from rl.experiments.runner import draw, files_of, remarks, reproduce
from rl.experiments.share import train_share

COLUMNS = ["condition", "run", "episode", "circle", "star", "square", "triangle", "none", "violation", "length"]
OBJECTS = COLUMNS[3:8]
SMALL = ArmExperiment(runs=4, episodes=450)
TINY = ArmExperiment(runs=3, episodes=25, record_every=10, conditions=["c-no-projection", "b"])
FILES = files_of(ArmExperiment)
OPTIONAL = ("compare.csv", "compare.md", "subproblems.npz")


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    directory = tmp_path_factory.mktemp("small")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rl.experiments.arm.animation._FRAMES", 6)  # of an episode: half of the time is drawing
        return reproduce(SMALL, directory, processes=2), directory


def rows(directory: Path, name: str = "learning.csv") -> list[dict[str, str]]:
    with (directory / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def trained(settings, directory: Path, **options) -> bytes:
    train_all(settings, directory, **options)
    return (directory / "learning.csv").read_bytes()


def test_every_file_is_written_and_nothing_else(small):
    _, directory = small
    assert {path.name for path in directory.iterdir()} == set(FILES) - set(OPTIONAL)


def test_learning_csv_is_tidy_sorted_and_complete(small):
    _, directory = small
    table = rows(directory)
    assert list(table[0]) == COLUMNS
    keys = [(row["condition"], int(row["run"]), int(row["episode"])) for row in table]
    blocks = [100, 200, 300, 400, 450]
    assert keys == [(name, run, k) for name in CONDITIONS for run in range(SMALL.runs) for k in blocks]


def test_every_episode_of_a_block_ends_once_and_measures_are_in_range(small):
    _, directory = small
    for row in rows(directory):
        assert sum(int(row[name]) for name in OBJECTS) == (50 if row["episode"] == "450" else 100)
        assert 0 <= float(row["violation"]) <= 1
        assert 1 <= float(row["length"]) <= 1000


def test_the_papers_picture_shows_at_a_small_size(small):
    done, _ = small
    curves = done.results.curves

    def rates(name: str, first: int, last: int) -> dict[str, float]:
        return dict(zip(OBJECTS, curves[name].within(first, last).rates().mean(axis=0), strict=True))

    assert rates("b", 0, 100)["star"] > 12  # about a fifth
    assert rates("b", 200, 450)["star"] < 0.85 * rates("b", 0, 100)["star"]  # (b) learns to avoid it
    free, zero = rates("a", 200, 450)["square"], rates("b", 200, 450)["square"]
    for name in ("c", "c-episode", "c-feasible", "c-no-projection"):
        assert rates(name, 200, 450)["square"] > max(45, 1.2 * zero, 1.5 * free)
        assert rates(name, 200, 450)["none"] < 20
    assert curves["a"].late().outside().mean() > 3 * curves["b"].late().outside().mean()  # G² = 0 is kept


def test_claims_json_holds_the_claims_that_were_judged(small):
    done, directory = small
    written = json.loads((directory / "claims.json").read_text(encoding="utf-8"))
    assert [claim["id"] for claim in written] == [claim.id for claim in done.claims]
    assert len(written) == 13
    holds = {claim["id"]: claim["holds"] for claim in written}
    assert holds["c-threshold-out-of-reach"]
    assert holds["b-touches-star-early"]
    assert holds["a-learns-touching"]


def test_summary_json_names_speed_settings_safeguards_and_what_acted(small):
    done, directory = small
    summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
    by_cpgrl = [summary["conditions"][name] for name in ("b", "c", "c-episode", "c-feasible")]
    for speed, clock in (("steps_per_second", "training_seconds"), ("steps_per_cpu_second", "training_cpu_seconds")):
        rate = sum(part["environment_steps"] for part in by_cpgrl) / sum(part[clock] for part in by_cpgrl)
        assert summary[speed] == pytest.approx(rate, rel=0.02)
    assert summary["settings"]["runs"] == SMALL.runs
    assert summary["settings"]["estimator"] == "konda"
    assert (summary["safeguards"]["ridge"], summary["safeguards"]["max_restoration"]) == (1e-4, 0.1)
    assert summary["safeguards"]["drop"] == "never"
    assert "ours" in summary["safeguards"]
    assert summary["wall_time"]["total"] >= summary["wall_time"]["training"] > 0
    for name, condition in CONDITIONS.items():
        part = summary["conditions"][name]
        assert part["environment_steps"] == done.results.outcomes[name].steps.sum() > SMALL.runs * SMALL.episodes
        assert part["thresholds"] == (list(condition.thresholds) if condition.thresholds else None)
        if condition.thresholds:
            assert part["counts"]["fallback"] == part["counts"]["skipped"] == 0
            assert part["counts"]["constrained"] > 0.9 * part["updates"]  # ρ² never exceeds 0
    assert summary["conditions"]["c"]["counts"]["capped"] > 0.6 * summary["conditions"]["c"]["updates"]  # G³ is far off
    assert summary["conditions"]["a"]["counts"] == {"constrained": 0}


def test_the_safeguards_are_named_where_the_claims_are(small):
    done, _ = small
    told = " ".join(remarks(done))
    assert "our additions: ridge = 0.0001, max_restoration = 0.1, drop = never" in told
    assert "restorations shortened" in told
    assert "M steps/s" in told


@pytest.mark.parametrize("name", ["fig6", "fig7", "fig7-beside"])
def test_figures_are_a_printed_page_wide_as_png_and_svg(small, name):
    from matplotlib.image import imread

    _, directory = small
    assert imread(directory / f"{name}.png").shape[1] == 1380  # 6.9 inches at 200 dpi
    assert ElementTree.parse(directory / f"{name}.svg").getroot().tag.endswith("svg")


def test_blocks_count_the_episodes_of_training(tmp_path):
    """Condition b against `train` itself, with everything set by hand."""
    trained(ArmExperiment(runs=3, episodes=25, record_every=10, conditions=["b"]), tmp_path)
    arm = TwoLinkArm()
    step = ConstrainedStep(solver="rosen", ridge=1e-4, max_restoration=0.1, drop="never")
    policy = NormalizedGaussianNetwork(*arm.stops, (5, 8), 2)
    estimator = KondaActorCritic(gradient="episode mean", bias_correction=False)
    records = list(train(arm, policy, estimator, CPGRL(step, [0, 0]), episodes=25, runs=3))
    written = [row for row in rows(tmp_path) if row["run"] == "2"]
    assert [row["episode"] for row in written] == ["10", "20", "25"]
    for row, block in zip(written, (records[:10], records[10:20], records[20:]), strict=True):
        events = [int(record.estimate.events[2]) for record in block]
        steps = sum(record.estimate.steps[2] for record in block)
        assert [int(row[name]) for name in OBJECTS] == [events.count(k) for k in (1, 2, 3, 4, 0)]
        assert float(row["length"]) == pytest.approx(steps / len(block))
        outside = -sum(record.estimate.rewards[2, 1] for record in block)
        assert float(row["violation"]) == pytest.approx(outside / steps)


def test_the_same_seed_gives_the_same_results_for_any_number_of_processes(tmp_path):
    results = train_all(TINY, tmp_path)
    once = (tmp_path / "learning.csv").read_bytes()
    split = train_all(TINY, tmp_path, processes=2)  # which splits the runs too
    assert (tmp_path / "learning.csv").read_bytes() == once
    for label, outcome in results.outcomes.items():
        again = split.outcomes[label]
        assert again.runs == outcome.runs == (0, 1, 2)
        np.testing.assert_array_equal(again.parameters, outcome.parameters)
        np.testing.assert_array_equal(again.counts["capped"], outcome.counts["capped"])
        np.testing.assert_array_equal(split.curves[label].touches, results.curves[label].touches)
        np.testing.assert_array_equal(split.curves[label].length, results.curves[label].length)
    other = ArmExperiment(runs=3, episodes=25, record_every=10, conditions=TINY.conditions, seed=1)
    assert trained(other, tmp_path) != once


def test_a_run_does_not_depend_on_the_runs_beside_it(tmp_path):
    def rows_of_run_1(runs: int) -> list[bytes]:
        settings = ArmExperiment(runs=runs, episodes=25, record_every=10, conditions=["c", "b"])
        return [line for line in trained(settings, tmp_path).splitlines() if line.split(b",")[1] == b"1"]

    assert rows_of_run_1(2) == rows_of_run_1(5)


def test_progress_calls_recorded_only_what_the_file_holds_of_every_run(tmp_path):
    def block(runs, episode):
        touches, rate = np.full((len(runs), 5), 2), np.ones(len(runs))
        return Block("b", runs, episode, {"touches": touches, "violation": rate, "length": rate})

    with Records(ArmExperiment(runs=3, record_every=10), tmp_path) as records:
        heard = [
            records.hear(message)
            for message in (
                Tick("b", (2,), 4),
                block((0, 1), 10),
                block((2,), 10),
                Tick("b", (2,), 17),
                Tick("a", (0,), 3),
            )
        ]
    told = [(advance.label, advance.episode, advance.recorded) for advance in heard]
    assert told == [("b", 0, False), ("b", 4, False), ("b", 10, True), ("b", 10, False), ("a", 0, False)]
    assert [row["run"] for row in rows(tmp_path)] == ["0", "1", "2"]


def test_without_constraints_training_is_that_of_constraints_never_active():
    settings = ArmExperiment(runs=2, episodes=30)
    unconstrained, *_ = settings.cases()
    outcome = train_share((settings, unconstrained, (0, 1)), lambda _: None)
    arm = TwoLinkArm()
    learner = CPGRL(ConstrainedStep(), [-2, -2])
    network = NormalizedGaussianNetwork(*arm.stops, (5, 8), 2)
    *_, last = train(
        arm, network, KondaActorCritic(gradient="episode mean", bias_correction=False), learner, episodes=30, runs=2
    )
    np.testing.assert_allclose(outcome.parameters, last.parameters, rtol=1e-12)


def test_the_printed_update_diverges_without_the_safeguards_and_says_so(tmp_path):
    settings = ArmExperiment(runs=2, episodes=300, ridge=0.0, max_restoration=np.inf, conditions=["c"])
    with pytest.raises(DivergenceError, match=r"should (move by at most|be finite).*ridge or max_restoration"):
        trained(settings, tmp_path)
    assert (tmp_path / "learning.csv").read_text(encoding="utf-8").startswith("condition,run,episode")


def test_estimator_and_average_are_those_of_settings_and_condition():
    printed: dict[str, Any] = {"gradient": "episode mean", "bias_correction": False}
    kinds = ("step", "step", "episode")
    assert ArmExperiment().gradient_estimator("c") == KondaActorCritic(average=("step",) * 3, **printed)
    assert ArmExperiment().gradient_estimator("c-episode") == KondaActorCritic(average=kinds, **printed)
    gpomdp = ArmExperiment(estimator="gpomdp").gradient_estimator("c-episode")
    assert gpomdp == GPOMDP(steps=1000, average=kinds, **printed)


@pytest.mark.parametrize(("solver", "formulation"), [("osqp", "restoring"), ("nnls", "cone"), ("rosen", "cone")])
def test_every_condition_trains_with_another_solver_formulation_and_estimator(tmp_path, solver, formulation):
    settings = ArmExperiment(runs=1, episodes=4, solver=solver, formulation=formulation, estimator="gpomdp")
    results = train_all(settings, tmp_path)
    assert list(results.outcomes) == list(CONDITIONS)
    handed_over = sum(outcome.counts.get("fallback", np.zeros(1)).sum() for outcome in results.outcomes.values())
    assert (handed_over > 0) == (solver == "rosen")  # which takes equalities alone


def test_conditions_are_put_into_their_order_once():
    assert ArmExperiment(conditions=["c", "a", "c"]).conditions == ("a", "c")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"conditions": ["a", "d"]}, r"condition should be one of a, b, c, .*found 'd'"),
        ({"conditions": []}, "condition should be one of"),
        ({"estimator": "td"}, "estimator should be one of konda, gpomdp; found 'td'"),
        ({"runs": 0}, "runs should be"),
        ({"solver": "rosn"}, "rosen"),
        ({"formulation": "con"}, "cone"),
        ({"ridge": -1.0}, "ridge should be"),
    ],
)
def test_wrong_settings_are_told_the_right_ones(wrong, message):
    with pytest.raises(ValueError, match=message):
        ArmExperiment(**wrong)


def test_figures_of_ours_stand_alone_where_nothing_of_the_papers_was_trained(tmp_path, monkeypatch):
    monkeypatch.setattr("rl.experiments.arm.animation._FRAMES", 6)
    results = train_all(ArmExperiment(runs=1, episodes=3, conditions=["c-feasible"]), tmp_path)
    draw(results, tmp_path)
    assert {path.name for path in tmp_path.glob("fig7*")} == {"fig7.png", "fig7.svg", "fig7.gif"}


@pytest.mark.slow
def test_claims_hold_at_full_size(tmp_path):
    done = reproduce(ArmExperiment(), tmp_path, processes=2)
    assert [claim.id for claim in done.claims if not claim.holds] == []
    late = {name: learned.late().rates().mean(axis=0) for name, learned in done.results.curves.items()}
    np.testing.assert_allclose(late["b"], (5, 3, 4, 88, 0), atol=10)  # docs/reproduction.md §3, 10 seeds
    np.testing.assert_allclose(late["c"], (1, 1, 96, 2, 0), atol=6)
    np.testing.assert_allclose(late["a"], (17, 74, 4, 5, 0), atol=12)
