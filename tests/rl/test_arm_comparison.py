"""`--compare`: which trainings, what is tabulated of each run, and where it is written."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from rl.experiments.arm import ArmExperiment
from rl.experiments.arm.conditions import CONDITIONS
from rl.experiments.arm.tables import MEASURES
from rl.experiments.arm.tables import measure as measured
from rl.experiments.records import train
from rl.experiments.runner import files_of, reproduce

SETTINGS = ArmExperiment(runs=2, episodes=60, conditions=["c"], compare=True, record_every=20)
STEPS = [("equality", "rosen"), ("cone", "active-set"), ("restoring", "active-set"), ("linearized", "active-set")]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    directory = tmp_path_factory.mktemp("compared")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rl.experiments.runner.draw", lambda *_: None)
        return reproduce(SETTINGS, directory), directory


def rows(directory):
    with (directory / "compare.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_b_and_c_are_trained_under_every_formulation_and_the_settings_own_step_once():
    labels = [case.label for case in ArmExperiment(compare=True).cases()]
    others = [f"{condition}, {formulation}" for condition in "bc" for formulation, _ in STEPS[1:]]
    assert labels == [*CONDITIONS, *others]
    assert [(case.condition, case.formulation, case.solver) for case in SETTINGS.compared()] == [
        (condition, *step) for condition in "bc" for step in STEPS
    ]
    other = ArmExperiment(compare=True, conditions=["b"], solver="osqp", formulation="restoring").cases()
    named = {case.label: (case.condition, case.solver, case.formulation) for case in other}
    assert named["b"] == ("b", "osqp", "restoring")
    assert named["b, restoring"] == ("b", "active-set", "restoring")
    assert [case.label for case in other if case.in_learning] == ["b"]
    assert len({case.label for case in other}) == len(other) == 9
    assert not ArmExperiment().compared()


def test_compare_csv_has_a_row_for_each_training_and_run(finished):
    _, directory = finished
    table = rows(directory)
    assert list(table[0]) == [
        "condition",
        "formulation",
        "solver",
        "run",
        "episode",
        *(measure.name for measure in MEASURES),
    ]
    keys = [(row["condition"], row["formulation"], row["solver"], row["run"]) for row in table]
    assert keys == [(condition, *step, run) for condition in "bc" for step in STEPS for run in "01"]
    assert {row["episode"] for row in table} == {"60"}


def test_learning_csv_holds_the_conditions_alone(finished):
    _, directory = finished
    text = (directory / "learning.csv").read_text(encoding="utf-8")
    assert {line.split(",")[0] for line in text.splitlines()[1:]} == {"c"}
    assert {path.name for path in directory.iterdir()} == {
        name for name in files_of(ArmExperiment) if not name.startswith("fig") and name != "subproblems.npz"
    }


def test_a_row_is_made_of_late_touches_violations_and_counts_per_update(finished):
    done, directory = finished
    curves, outcome = done.results.curves["c, cone"], done.results.outcomes["c, cone"]
    row = next(
        row for row in rows(directory) if (row["condition"], row["formulation"], row["run"]) == ("c", "cone", "1")
    )
    assert float(row["square"]) == pytest.approx(curves.late().rates()[1, 2])
    assert float(row["early_violation"]) == pytest.approx(curves.early().outside()[1])
    assert float(row["violation"]) == pytest.approx(curves.late().outside()[1])
    assert float(row["length"]) == pytest.approx(curves.length[1, -1])  # the last block is the last tenth
    assert float(row["capped"]) == pytest.approx(outcome.counts["capped"][1] / 60)
    assert float(row["constrained"]) == pytest.approx(outcome.counts["constrained"][1] / 60)
    assert float(row["uncertified"]) == 0
    failing = dict(outcome.counts) | {"fallback": np.array([0, 6]), "skipped": np.array([0, 3])}
    again = measured(curves, replace(outcome, counts=failing))
    np.testing.assert_allclose(again[:, [measure.name for measure in MEASURES].index("uncertified")], [0, 9 / 60])


def test_the_table_shows_mean_and_spread_of_each_training(finished, capsys):
    done, directory = finished
    results = done.results
    ((comparison, table),) = done.tables
    rates = results.curves["b, restoring"].late().rates()[:, 3]
    cells = dict(zip(("circle", "star", "square", "triangle"), table[3][3:7], strict=True))
    assert table[3][:3] == ["b", "restoring", "active-set"]
    assert cells["triangle"] == f"{rates.mean():.1f} ± {rates.std(ddof=1):.1f}"
    markdown = (directory / "compare.md").read_text(encoding="utf-8").splitlines()
    assert sum(line.startswith(("| b |", "| c |")) for line in markdown) == 2 * len(STEPS)
    assert len({line.count("|") for line in markdown if line.startswith("|")}) == 1
    comparison.show(table)
    assert "restoring" in capsys.readouterr().out


def test_what_was_finished_before_an_interrupt_is_in_compare_csv(tmp_path):
    def interrupt(advance):
        if advance.label == "c, cone":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(SETTINGS, tmp_path, listen=interrupt)
    assert {(row["condition"], row["formulation"]) for row in rows(tmp_path)} >= {("b", "cone"), ("c", "equality")}
    assert ("c", "cone") not in {(row["condition"], row["formulation"]) for row in rows(tmp_path)}
    assert (tmp_path / "learning.csv").read_text(encoding="utf-8").count("\nc,") == 2 * 3
