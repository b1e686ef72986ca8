"""A third experiment is one file more, and a line in the registry: training, files, command and resume are there."""

import json
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pytest
from typer.testing import CliRunner

from envs import GridWorld
from rl import CPGRL, GPOMDP, SoftmaxTable, Training, WeightedSum
from rl.cli import app
from rl.experiments.claims import Statements
from rl.experiments.experiment import CaseRecorder, Experiment, TrainingCase, option
from rl.experiments.figure_style import blank_figure
from rl.experiments.runner import files_of, reproduce

STATEMENTS = Statements()


@dataclass(frozen=True, kw_only=True)
class GridExperiment(Experiment):
    """CPGRL and SUM on a gridworld."""

    name = "grid"
    about = "CPGRL and SUM on a gridworld."
    key = "method"
    recorded = MappingProxyType({"estimated": ["r1", "r2", "r3"]})
    files = ("rewards.png", "rewards.svg")
    hazard: float = option(-0.05, "Threshold of each kind of hazard.")

    def cases(self):
        cpgrl = TrainingCase(
            label="cpgrl", episodes=self.episodes, every=self.record_every, solver=self.solver, kept=True
        )
        return [cpgrl, TrainingCase(label="sum", episodes=self.episodes, every=self.record_every)]

    def begin(self, case, runs, observe=None):
        world = GridWorld()
        learner = CPGRL(self.step(), [self.hazard] * 2) if case.solver else WeightedSum(step_size=self.step_size)
        training = Training(
            world, SoftmaxTable(world.states, world.actions), GPOMDP(steps=self.steps), learner,
            episodes=case.episodes, runs=runs, seed=self.seed, observe=observe,
        )  # fmt: skip
        return training, Estimates()

    def claims(self, results):
        return STATEMENTS.judge(results)

    def figures(self, results):
        return {"rewards": lambda: drawn(results)}


class Estimates(CaseRecorder):
    def see(self, record):
        self.record = record
        return {}

    def values(self):
        return {"estimated": self.record.estimate.values}


def drawn(results):
    figure = blank_figure(3, 2)
    figure.subplots().plot(results.curves["cpgrl"]["estimated"][..., 0].T)
    return figure


@STATEMENTS.add("hazards-avoided", "CPGRL meets its thresholds", "nowhere", needs=("cpgrl",))
def hazards_avoided(results):
    worst = float(results.curves["cpgrl"]["estimated"][:, -1, 1:].min())
    return worst >= results.settings.hazard, {"worst": worst}


SMALL = GridExperiment(runs=2, episodes=40, steps=20, record_every=10, record=20)
SAME = ("learning.csv", "claims.json", "subproblems.npz", "rewards.svg")


def contents(directory):
    return [(directory / name).read_bytes() for name in SAME]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    directory = tmp_path_factory.mktemp("grid")
    return reproduce(SMALL, directory), directory


def test_every_file_is_there(finished):
    done, directory = finished
    assert {path.name for path in directory.iterdir()} == set(files_of(SMALL))
    lines = (directory / "learning.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "method,run,episode,r1,r2,r3"
    assert [line.split(",")[:3] for line in lines[1:5]] == [["cpgrl", "0", str(k)] for k in (10, 20, 30, 40)]
    assert done.results.curves["sum"]["estimated"].shape == (2, 4, 3)
    (claim,) = json.loads((directory / "claims.json").read_text(encoding="utf-8"))
    assert claim["id"] == "hazards-avoided"
    summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
    assert summary["settings"]["hazard"] == -0.05
    assert summary["methods"]["cpgrl"]["updates"] == 80


def test_it_goes_on_where_it_was_stopped_in_other_processes_too(finished, tmp_path):
    class StopError(Exception):
        pass

    heard = []

    def stop(*message):
        heard.append(message)
        if len(heard) == 5:
            raise StopError

    with pytest.raises(StopError):
        reproduce(SMALL, tmp_path, listen=stop, checkpoint_every=0.0)
    reproduce(SMALL, tmp_path, processes=2)
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["was_stopped"] is True
    assert contents(tmp_path) == contents(finished[1])


def test_the_command_has_its_settings_as_options(finished, tmp_path, monkeypatch):
    monkeypatch.setattr("rl.experiments.registry.EXPERIMENTS", {"grid": f"{__name__}:GridExperiment"})
    told = CliRunner().invoke(app, ["reproduce", "--help"], env={"COLUMNS": "200"})
    assert GridExperiment.about in told.stdout
    options = ["--runs", "2", "--episodes", "40", "--record-every", "10", "--record", "20", "--jobs", "1"]
    done = CliRunner().invoke(app, ["reproduce", "grid", *options, "--hazard", "-0.5", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "1 of 1 claims hold." in done.stdout
    assert np.isclose(json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["settings"]["hazard"], -0.5)
    wrong = CliRunner().invoke(app, ["reproduce", "gird"])
    assert (wrong.exit_code, wrong.stderr.count("\n")) == (2, 1)
