"""`cpgrl reproduce arm`: its own options and messages; what is every experiment's is tested in test_cli.py."""

import pytest
from typer.testing import CliRunner

from cpgrl_opt import FORMULATIONS, SOLVERS
from rl.cli import app
from rl.experiments.arm.conditions import CONDITIONS
from rl.experiments.arm.experiment import ESTIMATORS

TINY = ["--runs", "1", "--episodes", "6", "--block", "3", "--jobs", "1"]


def cpgrl_arm(*arguments):
    return CliRunner().invoke(app, ["reproduce", "arm", *map(str, arguments)])


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    out = tmp_path_factory.mktemp("cli") / "new" / "results"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rl.experiments.runner.draw", lambda *_: None)
        return cpgrl_arm(*TINY, "--conditions", "c, a", "--compare", "--record", 8, "--out", out), out


def test_a_small_reproduction_prints_claims_comparison_speed_and_where_it_wrote(finished):
    result, out = finished
    assert result.exit_code == 0, result.output
    for text in (
        "claims hold",
        "The arm under each formulation",
        "M steps/s",
        "our additions",
        "subproblems.npz holds",
        "subproblems.npz leaves out b, linearized; c, linearized: problems of another shape.",  # no ridge
        str(out),
    ):
        assert text in result.stdout.replace("\n", ""), text
    for path in out.iterdir():
        assert path.name in result.stdout
    assert not result.stderr  # no progress bar without a terminal
    first = (out / "learning.csv").read_text(encoding="utf-8").splitlines()[1]
    assert first.startswith("a,0,3,")


@pytest.mark.parametrize(
    ("option", "value", "names"),
    [
        ("--conditions", "a,d", list(CONDITIONS)),
        ("--conditions", "", list(CONDITIONS)),
        ("--estimator", "kond", list(ESTIMATORS)),
        ("--solver", "rosn", list(SOLVERS)),
        ("--formulation", "cones", list(FORMULATIONS)),
    ],
)
def test_a_wrong_name_is_answered_with_the_right_ones(option, value, names, tmp_path):
    result = cpgrl_arm(option, value, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1  # one line, no traceback
    assert all(name in result.stderr for name in names)
    assert not (tmp_path / "out").exists()


def test_a_block_is_the_episodes_between_two_records(tmp_path):
    result = cpgrl_arm("--block", -1, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert result.stderr.startswith("cpgrl: record_every should be")
    assert not (tmp_path / "out").exists()
