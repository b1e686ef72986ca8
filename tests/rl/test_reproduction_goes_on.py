"""A reproduction that was killed goes on where it was, and its files do not tell."""

import json
import os
import shutil
import signal
import subprocess
import time
import traceback
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from rl.cli import app
from rl.experiments import checkpoints, runner
from rl.experiments.arm import ArmExperiment
from rl.experiments.checkpoints import CheckpointError
from rl.experiments.messages import Block
from rl.experiments.three_state import ThreeStateExperiment
from rl.saved_state import read_state

CHAIN = ThreeStateExperiment(runs=2, episodes=60, steps=10, record_every=7, record=40)
COMPARED = replace(CHAIN, episodes=40, compare=True, compare_solvers=("active-set", "nnls"))
ARM = ArmExperiment(
    runs=2, episodes=20, steps=60, record_every=7, record=40, conditions=("a", "c-episode"), compare=True
)
KINDS = {"chain": CHAIN, "chain compared": COMPARED, "arm": ARM}
CPGRL = "cpgrl, 0 to 1.npz"
SAME = ("learning.csv", "claims.json", "subproblems.npz", "compare.csv", "comparison.csv", "tolerances.csv")


@pytest.fixture(autouse=True)
def no_figures(monkeypatch):
    monkeypatch.setattr(runner, "draw", lambda *_: None)


def contents(directory):
    return {name: (directory / name).read_bytes() for name in SAME if (directory / name).exists()}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The bytes of each kind's files."""
    whole = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "draw", lambda *_: None)
        for kind, settings in KINDS.items():
            directory = tmp_path_factory.mktemp(kind)
            runner.reproduce(settings, directory)
            whole[kind] = contents(directory)
            assert not list(directory.glob("unfinished*"))
    assert [len(files) for files in whole.values()] == [3, 5, 4]
    return whole


def reached(directory):
    """How far each training's checkpoint is."""
    files = directory.glob("unfinished*/*0 to *.npz")
    return {path.name: read_state(path, checkpoints._KIND)["training"]["episode"] for path in files}


def kill_after(seconds, work):
    """Whether a process that does the work was still at it when it got SIGKILL."""
    process = os.fork()
    if process == 0:
        try:
            work()
            os._exit(0)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
    time.sleep(seconds)
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)
    _, status = os.waitpid(process, 0)
    assert status in (0, signal.SIGKILL), "it failed"
    return status == signal.SIGKILL


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.parametrize("kind", ["chain compared", "arm"])
def test_killed_at_random_moments_it_goes_on(kind, tmp_path, undisturbed):
    rng, before, kills = np.random.default_rng(3), {}, 0
    for _ in range(4):
        seconds = rng.uniform(0.05, 0.4)
        kills += kill_after(seconds, lambda: runner.reproduce(KINDS[kind], tmp_path, checkpoint_every=0.01))
        now = reached(tmp_path)
        assert all(now.get(name, np.inf) >= episode for name, episode in before.items())
        before = now
    assert kills
    runner.reproduce(KINDS[kind], tmp_path)
    assert contents(tmp_path) == undisturbed[kind]
    assert not list(tmp_path.glob("unfinished*"))


class StopError(Exception):
    pass


def stop_at(directory, settings, number):
    """Stops it while it reports its n-th record."""
    heard = []

    def listen(message, _):
        if isinstance(message, Block) and message.values:
            heard.append(message)
        if len(heard) == number:
            raise StopError

    with pytest.raises(StopError):
        runner.reproduce(settings, directory, listen=listen, checkpoint_every=0.0)
    return heard


def test_no_more_than_the_last_interval_is_lost(tmp_path):
    last = stop_at(tmp_path, CHAIN, 7)[-1]
    assert reached(tmp_path) == {CPGRL: last.episode - 1}, "an episode"
    heard = []
    runner.reproduce(CHAIN, tmp_path, listen=lambda message, _: heard.append(message))
    blocks = [message for message in heard if isinstance(message, Block) and message.values]
    own = [block.episode for block in blocks if block.label == "cpgrl"]
    assert own == [*range(0, CHAIN.episodes, CHAIN.record_every), CHAIN.episodes]


def test_what_is_done_is_not_done_again(tmp_path, undisturbed, monkeypatch):
    """Killed after the training, before the last file."""

    def stop(*_):
        raise StopError

    with monkeypatch.context() as patch:
        patch.setattr(runner, "write_claims", stop)
        with pytest.raises(StopError):
            runner.reproduce(ARM, tmp_path)
    assert set(reached(tmp_path).values()) == {case.episodes for case in ARM.cases()}
    runner.reproduce(ARM, tmp_path)
    assert contents(tmp_path) == undisturbed["arm"]


def test_only_the_same_experiment_goes_on(tmp_path, undisturbed, monkeypatch):
    other = replace(CHAIN, seed=1)
    stop_at(tmp_path, CHAIN, 6)
    (own,) = tmp_path.iterdir()
    with monkeypatch.context() as patch:
        patch.setattr(runner, "versions", lambda *_: {"numpy": "0.1"})
        stop_at(tmp_path, CHAIN, 4)
    with monkeypatch.context() as patch:
        patch.setattr(runner, "sources_digest", lambda: "other sources")
        stop_at(tmp_path, CHAIN, 4)
    stop_at(tmp_path, other, 9)
    assert len(list(tmp_path.iterdir())) == 4
    runner.reproduce(CHAIN, tmp_path)
    assert contents(tmp_path) == undisturbed["chain"]
    assert not own.exists()
    runner.reproduce(other, tmp_path)
    assert contents(tmp_path) != undisturbed["chain"]
    assert len(list(tmp_path.glob("unfinished*"))) == 2


def cpgrl(out, *options):
    settings = {name: getattr(CHAIN, name) for name in ("runs", "episodes", "steps", "record_every", "record")}
    words = [word for name, value in settings.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    return CliRunner().invoke(app, ["reproduce", "three-state", *words, "--jobs", "1", "--out", str(out), *options])


def test_the_command_says_that_it_goes_on_or_starts_over(tmp_path, undisturbed):
    out, damaged = tmp_path / "out", tmp_path / "damaged"
    stop_at(out, CHAIN, 6)
    shutil.copytree(out, damaged)
    (place,) = out.iterdir()
    done = cpgrl(out)
    assert (done.exit_code, done.stderr) == (0, f"Going on where {place} was left; --anew starts over.\n")
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["was_stopped"] is True
    assert contents(out) == undisturbed["chain"]
    path = damaged / place.name / CPGRL
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(CheckpointError, match=r"cpgrl, 0 to 1.npz should be .* whole; found .*\. --anew starts over"):
        runner.reproduce(CHAIN, damaged)
    assert cpgrl(damaged).exit_code == 2
    anew = cpgrl(damaged, "--anew")
    assert (anew.exit_code, anew.stderr) == (0, "")
    assert contents(damaged) == undisturbed["chain"]
    assert json.loads((damaged / "summary.json").read_text(encoding="utf-8"))["was_stopped"] is False


def test_an_interval_that_is_none_is_refused(tmp_path):
    refused = cpgrl(tmp_path / "out", "--checkpoint-every", "inf")
    assert refused.exit_code == 2
    assert refused.stderr.startswith("cpgrl: checkpoint_every should be a number ≥ 0; found")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="kills process groups")
@pytest.mark.parametrize(("kind", "settings"), [
    ("three-state", ["--runs", "4", "--episodes", "3000", "--compare", "--compare-solvers", "active-set,nnls"]),
    ("arm", ["--runs", "2", "--episodes", "600", "--conditions", "a,b"]),
])  # fmt: skip
def test_the_command_killed_at_random_moments_with_any_jobs(kind, settings, tmp_path, start_cpgrl):
    words = ["reproduce", kind, *settings, "--checkpoint-every", "0.1"]
    start_cpgrl(*words, "--jobs", "2", "--out", tmp_path / "whole").communicate(timeout=600)
    rng, kills = np.random.default_rng(5), 0
    for _ in range(5):
        process = start_cpgrl(*words, "--jobs", str(rng.integers(1, 4)), "--out", tmp_path / "killed")
        with suppress(subprocess.TimeoutExpired):
            process.wait(rng.uniform(2, 12))
        if process.poll() is None:
            os.kill(process.pid, signal.SIGKILL)
            kills += 1
        process.communicate(timeout=600)
    last = start_cpgrl(*words, "--jobs", "2", "--out", tmp_path / "killed")
    last.communicate(timeout=600)
    assert (last.returncode, kills > 0) == (0, True)
    assert contents(tmp_path / "killed") == contents(tmp_path / "whole")
