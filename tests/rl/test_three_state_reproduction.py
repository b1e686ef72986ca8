"""The three-state experiment: every file it writes, its determinism, and the paper's claims at a small size."""

import csv
import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from envs import ThreeStateMDP
from rl import SoftmaxTable, train, uniform_parameters
from rl.experiments.records import Records
from rl.experiments.records import train as train_all
from rl.experiments.runner import files_of, remarks, reproduce
from rl.experiments.share import train_share
from rl.experiments.three_state import METHODS, ThreeStateExperiment
from rl.experiments.three_state.claims import PRINTED

SMALL = ThreeStateExperiment(runs=5, episodes=3000)
TINY = ThreeStateExperiment(runs=2, episodes=25, steps=20, record_every=10)
COLUMNS = ["method", "run", "episode"] + [f"{kind}_{i}" for kind in ("estimated", "exact") for i in (1, 2, 3, 4)]
# Pr(a₁|s₁) of CONB is about a half under the transitions taken (docs/reproduction.md §2).
CONTRADICTED = {"all-choose-a1-in-s1"}
# With a tolerance it is a matter of time: Pr(a₁|s₁) = 0.92 at the end, and ρ¹ = 82 % of the optimum, not ≤ 75 %.
TOLERANT_EARLY, TOLERANT_LATE = {"all-choose-a1-in-s1-tolerant"}, {"conb-fails-to-maximise-tolerant"}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    directory = tmp_path_factory.mktemp("small")
    return reproduce(SMALL, directory), directory


def rows(directory: Path) -> list[dict[str, str]]:
    with (directory / "learning.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def trained(settings, directory: Path, **options) -> bytes:
    train_all(settings, directory, **options)
    return (directory / "learning.csv").read_bytes()


def test_the_papers_claims_hold_at_a_small_size(small):
    done, _ = small
    assert {claim.id for claim in done.claims if not claim.holds} == CONTRADICTED | TOLERANT_EARLY
    printed = [claim for claim in done.claims if claim.about == PRINTED]
    assert [claim.id for claim in done.claims[14:]] == [f"{claim.id}-tolerant" for claim in printed]
    assert {claim.about for claim in done.claims[14:]} == {"CONB with a tolerance, η = 0.006"}
    assert [claim.about for claim in done.claims if "conb" in claim.id].count("") == 0


def test_every_file_is_written_and_nothing_else(small):
    _, directory = small
    assert {path.name for path in directory.iterdir()} == {
        name
        for name in files_of(ThreeStateExperiment)
        if not name.startswith(("subproblems", "comparison", "tolerances"))
    }


def test_learning_csv_is_tidy_sorted_and_complete(small):
    _, directory = small
    table = rows(directory)
    assert list(table[0]) == COLUMNS
    keys = [(row["method"], int(row["run"]), int(row["episode"])) for row in table]
    episodes = range(0, SMALL.episodes + 1, SMALL.record_every)
    assert keys == [(method, run, k) for method in METHODS for run in range(SMALL.runs) for k in episodes]


def test_learning_csv_holds_what_the_claims_are_judged_by(small):
    done, directory = small
    table = rows(directory)
    for kind in ("estimated", "exact"):
        written = np.array([[float(row[f"{kind}_{i}"]) for i in (1, 2, 3, 4)] for row in table])
        shape = (len(METHODS), SMALL.runs, -1, 4)
        judged = np.stack([getattr(done.results.curves[method], kind) for method in METHODS])
        np.testing.assert_allclose(written.reshape(shape), judged, rtol=1e-8, atol=1e-12)


def test_exact_averages_are_those_of_the_policies_and_obey_the_rewards_sum(small):
    done, _ = small
    mdp = ThreeStateMDP()
    for learned in done.results.curves.values():
        np.testing.assert_allclose(mdp.average_rewards(learned.policies[1, -1]), learned.exact[1, -1], rtol=1e-12)
        np.testing.assert_allclose(learned.exact[..., 1:].sum(axis=-1), 0, atol=1e-12)  # r² + r³ + r⁴ = 0
        np.testing.assert_allclose(learned.estimated[..., 1:].sum(axis=-1), 0, atol=1e-12)


def test_the_last_row_is_after_the_last_update_and_the_first_before_any(tmp_path):
    results = train_all(TINY, tmp_path)
    assert [learned.episodes.tolist() for learned in results.curves.values()] == [[0, 10, 20, 25]] * 4
    *_, last = train(
        ThreeStateMDP(), SoftmaxTable(3, 3), TINY.estimator(), TINY.learner(TINY.cases()[1]),
        episodes=25, runs=2, seed=TINY.seed, initial=uniform_parameters(9),
    )  # fmt: skip
    conb, table = results.curves["conb"], SoftmaxTable(3, 3)
    np.testing.assert_array_equal(results.outcomes["conb"].parameters, last.parameters)
    np.testing.assert_array_equal(conb.policies[:, -1], table.probabilities(last.parameters))
    np.testing.assert_array_equal(conb.estimated[:, -1], last.estimate.values)
    spread = np.exp(1.0)  # θ₀ in [0, 1]: no action is e times as likely as another
    assert (conb.policies[:, 0].max(axis=-1) <= spread * conb.policies[:, 0].min(axis=-1)).all()
    assert not conb.estimated[:, 0].any()
    assert [int(row["episode"]) for row in rows(tmp_path)[:4]] == [0, 10, 20, 25]


def test_methods_start_from_the_same_parameters(small):
    done, _ = small
    first = [learned.policies[:, 0] for learned in done.results.curves.values()]
    np.testing.assert_array_equal(first[0], first[1])
    np.testing.assert_array_equal(first[0], first[2])


def test_the_same_seed_gives_the_same_bytes_for_any_number_of_processes(tmp_path):
    once = trained(TINY, tmp_path)
    assert trained(TINY, tmp_path, processes=2) == once
    assert trained(ThreeStateExperiment(runs=2, episodes=25, steps=20, record_every=10, seed=1), tmp_path) != once


def test_a_run_does_not_depend_on_the_runs_beside_it(tmp_path):
    def rows_of_run_1(runs: int) -> list[bytes]:
        settings = ThreeStateExperiment(runs=runs, episodes=25, steps=20, record_every=10)
        return [line for line in trained(settings, tmp_path).splitlines() if line.split(b",")[1] == b"1"]

    assert rows_of_run_1(2) == rows_of_run_1(4)


def test_summary_json_says_how_the_results_were_made(small):
    _, directory = small
    summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
    assert summary["steps_per_second"] > 0
    assert summary["settings"]["runs"] == SMALL.runs
    assert summary["settings"]["solver"] == "rosen"
    assert summary["seeds"]["seed"] == SMALL.seed
    assert {"python", "numpy", "numba", "cpgrl-opt"} <= set(summary["versions"])
    assert summary["wall_time"]["total"] >= summary["wall_time"]["training"] > 0
    for method in METHODS:
        part = summary["methods"][method]
        assert part["environment_steps"] == SMALL.runs * SMALL.episodes * SMALL.steps
    assert summary["methods"]["cpgrl"]["counts"]["fallback"] == 0
    np.testing.assert_allclose(summary["optimum"]["values"], [1, 0, 0, 0], atol=1e-9)
    speed = summary["methods"]["cpgrl"]["environment_steps"] / summary["methods"]["cpgrl"]["training_seconds"]
    assert summary["steps_per_second"] == pytest.approx(speed, rel=0.01)


def test_summary_json_ends_where_learning_csv_does(small):
    _, directory = small
    methods = json.loads((directory / "summary.json").read_text(encoding="utf-8"))["methods"]
    with (directory / "learning.csv").open(encoding="utf-8", newline="") as file:
        last = [row for row in csv.DictReader(file) if int(row["episode"]) == SMALL.episodes]
    for method in METHODS:
        exact = [[float(row[f"exact_{k}"]) for k in range(1, 5)] for row in last if row["method"] == method]
        final = methods[method]["final"]
        assert len(exact) == SMALL.runs
        np.testing.assert_allclose(final["mean"], np.mean(exact, axis=0), rtol=0, atol=1e-8)
        np.testing.assert_allclose(final["standard_deviation"], np.std(exact, axis=0, ddof=1), rtol=0, atol=1e-8)
        np.testing.assert_allclose(np.sum(final["policy"], axis=1), 1.0)


@pytest.mark.parametrize("name", ["fig4", "fig5"])
def test_figures_are_a_printed_page_wide_as_png_and_svg(small, name):
    from matplotlib.image import imread

    _, directory = small
    pixels = imread(directory / f"{name}.png")
    assert pixels.shape[1] == 1380  # 6.9 inches at 200 dpi
    colours = (pixels[..., :3] * 255).round().astype(np.uint8)
    for method in ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167)):
        assert (colours == method).all(axis=2).any()
    assert ElementTree.parse(directory / f"{name}.svg").getroot().tag.endswith("svg")


def test_a_solver_that_does_not_take_the_formulation_is_told_plainly(tmp_path):
    settings = ThreeStateExperiment(runs=2, episodes=20, steps=20, solver="rosen", formulation="cone")
    done = reproduce(settings, tmp_path)
    assert done.results.outcomes["cpgrl"].counted()["fallback"] > 0
    told = " ".join(remarks(done))
    assert "rosen does not take the formulation cone: active-set solved" in told
    assert "subproblems handed to active-set" in told


def last_averages_of_cpgrl(settings, directory: Path) -> np.ndarray:
    case, *_ = settings.cases()
    with Records(settings, directory) as records:
        train_share((settings, case, tuple(range(settings.runs))), records.hear)
    return records.curves("cpgrl").exact[:, -1]


def test_another_solver_and_formulation_climb_to_the_same_place(tmp_path):
    settings = ThreeStateExperiment(runs=1, episodes=500, solver="osqp", formulation="restoring")
    final = last_averages_of_cpgrl(settings, tmp_path)
    assert (final[:, 0] > 0.45).all()  # from 0.35 at the start; 24 seeds are at 0.56 ± 0.07 a hundred episodes before
    assert (final[:, 1:] > -0.02).all()


@pytest.mark.slow
def test_the_papers_claims_hold_at_full_size(tmp_path):
    done = reproduce(ThreeStateExperiment(), tmp_path, processes=2)
    assert {claim.id for claim in done.claims if not claim.holds} == CONTRADICTED | TOLERANT_LATE
    final = done.results.curves["cpgrl"].exact[:, -1]
    assert final[:, 0].mean() > 0.98
    np.testing.assert_allclose(final[:, 1:], 0, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "formulation", "episodes"),
    [("active-set", "cone", 5000), ("active-set", "restoring", 5000), ("osqp", "restoring", 3000)],
)
def test_every_formulation_reaches_the_optimum(tmp_path, solver, formulation, episodes):
    settings = ThreeStateExperiment(runs=3, episodes=episodes, solver=solver, formulation=formulation)
    final = last_averages_of_cpgrl(settings, tmp_path)
    assert final[:, 0].mean() > 0.95
    assert (final[:, 1:] > -0.02).all()
