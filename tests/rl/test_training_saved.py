"""A training that was saved goes on, bit for bit, as if there had been no stop; what does not fit is refused."""

import io
import json
import zipfile
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, ConstrainedStep
from envs import ThreeStateMDP
from rl import (
    CPGRL,
    GPOMDP,
    DivergenceError,
    ExactGradient,
    WeightedSum,
    map_runs,
)
from rl._carried import put_back, require_like, state_of
from rl.saved_state import read_state, write_state

from .trainings import CASES, CHAIN, PLAIN, TABLE, seen, training


@pytest.mark.parametrize("name", CASES)
def test_it_goes_on_with_the_same_bits(name, tmp_path):
    undisturbed = [seen(record) for record in training(CASES[name])]
    path = tmp_path / "training.npz"
    for stop in np.random.default_rng(0).choice(len(undisturbed), 2, replace=False):
        first, found = training(CASES[name]), []
        for record in first if stop else []:
            found.append(seen(record))
            if record.episode == stop:
                break
        first.save(path)
        np.testing.assert_array_equal(
            first.parameters, training(CASES[name]).parameters if not stop else record.parameters
        )
        second = training(CASES[name], seed=5)
        second.load(path)
        assert second.episode == stop
        assert found + [seen(record) for record in second] == undisturbed
        assert found + [seen(record) for record in first] == undisturbed, "saving disturbs nothing"
        first.load(path)
        assert [seen(record) for record in first] == undisturbed[stop:], "one that went on starts over"


def parameters_after(name, runs):
    """θ after each episode, (runs, episodes, n); on the way, that no record is written to later."""
    records, then = [], []
    for record in training(CASES[name], runs=runs):
        records.append(record)
        then.append(seen(record))
    assert [seen(record) for record in records] == then
    return np.stack([record.parameters for record in records], axis=1)


@pytest.mark.parametrize("name", CASES)
def test_a_run_is_the_same_in_any_batch_and_any_thread(name):
    together = parameters_after(name, [0, 3, 5])
    assert len(np.unique(together[:, -1], axis=0)) == 3
    np.testing.assert_array_equal(parameters_after(name, [5, 0]), together[[2, 0]])
    shares = map_runs(partial(parameters_after, name), [0, 3, 5], processes=3, threads=True)
    np.testing.assert_array_equal(np.concatenate(shares), together)


def test_a_loaded_training_may_be_longer(tmp_path):
    short = training(episodes=50)
    assert len(list(short)) == 50
    short.save(tmp_path / "training.npz")
    longer = training(episodes=120)
    longer.load(tmp_path / "training.npz")
    assert [seen(record) for record in longer] == [seen(record) for record in training()][50:]


def test_one_that_has_stopped_for_good_stays_stopped(tmp_path):
    case = (CHAIN, TABLE, ExactGradient(), WeightedSum([0, 0, 0, 0]), 30)
    stationary = training(case, stop_when_stationary=True)
    assert len(list(stationary)) == 1
    stationary.save(tmp_path / "training.npz")
    again = training(case, stop_when_stationary=True)
    again.load(tmp_path / "training.npz")
    assert list(again) == []


OTHERS = {
    "environment.finite": {"environment": ThreeStateMDP(0.3)},
    "estimator.trace_decay should be 0.99": {"estimator": GPOMDP(bias_correction=False, trace_decay=0.9)},
    "learner.step.step_size should be 0.02": {
        "learner": CPGRL(ConstrainedStep(solver="rosen", step_size=0.1), [0, 0, 0])
    },
    "learner should be": {"learner": WeightedSum()},
    "runs should be [0, 3]": {"runs": 2},
    "seed should be 5": {"seed": 6},
}


@pytest.mark.parametrize("told", OTHERS)
def test_another_training_is_refused_and_stays_as_it_was(told, tmp_path):
    saved = training()
    next(iter(saved))
    saved.save(tmp_path / "training.npz")
    other = dict(OTHERS[told])
    names = ("environment", "policy", "estimator", "learner")
    parts = [other.pop(name, part) for name, part in zip(names, PLAIN, strict=False)]
    refusing = training((*parts, 5), **other)
    with pytest.raises(ValueError, match=r"as saved; found") as refused:
        refusing.load(tmp_path / "training.npz")
    assert told in str(refused.value)
    assert "training.npz" in str(refused.value)
    assert [record.episode for record in refusing] == [1, 2, 3, 4, 5]


def written(path, entries, method=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)


def entries_of(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "training.npz"
    begun = training(CASES["Konda on the arm"])
    next(iter(begun))
    begun.save(path)
    return path


def refused(path):
    other = training(CASES["Konda on the arm"])
    with pytest.raises(ValueError, match=r"found") as error:
        other.load(path)
    assert other.episode == 0
    return str(error.value)


def test_a_damaged_file_is_refused_with_the_reason(saved):
    content, good = saved.read_bytes(), entries_of(saved)
    for end in [0, 1, 100, *range(500, len(content), 997), len(content) - 1]:
        saved.write_bytes(content[:end])
        assert "should be a saved training of the format 'cpgrl state 3', whole; found" in refused(saved)
    for place in np.random.default_rng(1).integers(len(content) // 2, size=20):  # in the data, not in the directory
        broken = bytearray(content)
        broken[place] ^= 0x40
        saved.write_bytes(bytes(broken))
        other = training(CASES["Konda on the arm"])
        try:
            other.load(saved)
        except ValueError:
            assert other.episode == 0
        else:  # a bit that says nothing, such as one of a date
            assert entries_of(saved) == good
    saved.unlink()
    assert "no such file" in refused(saved)


def test_what_another_program_wrote_is_refused(saved):
    good = entries_of(saved)

    def told(**changes):
        written(saved, {**good, **changes})
        return refused(saved)

    text = json.loads(good["state.json"])
    older = told(**{"state.json": json.dumps({**text, "format": "cpgrl state 1"})})
    assert "'cpgrl state 1', which an earlier version wrote" in older
    less = {name: part for name, part in text["state"]["dict"].items() if name != "memory"}
    assert "memory" in told(**{"state.json": json.dumps({**text, "state": {"dict": less}})})
    objects = io.BytesIO()
    np.lib.format.write_array(objects, np.array([print], dtype=object))
    assert "whole; found" in told(**{"0.npy": objects.getvalue()})
    huge = good["0.npy"].replace(b"(2, 24)", b"(2e9,) ")
    assert huge != good["0.npy"]
    assert "whole; found" in told(**{"0.npy": huge})
    written(saved, good, zipfile.ZIP_DEFLATED)
    assert "packed" in refused(saved)


def test_plain_values_come_back_as_they_were_and_other_things_are_refused(tmp_path):
    """As a learner's memory."""
    memory = {"a": [1, 2.5, None, True, "é"], "b": (np.arange(3), np.float64(0.1), np.array([], bool)), "c": -np.inf}
    write_state(tmp_path / "state.npz", "memory", memory)
    met = read_state(tmp_path / "state.npz", "memory")
    assert (met["a"], met["c"], type(met["b"])) == (memory["a"], -np.inf, tuple)
    for one, other in zip(met["b"], memory["b"], strict=True):
        assert type(one) is type(other)
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    with pytest.raises(ValueError, match=r"state\['when'\] should consist of .* found set"):
        write_state(tmp_path / "other.npz", "memory", {"when": {1, 2}})
    assert not (tmp_path / "other.npz").exists()


class CountingSolver:
    """Looks at what it is called with, which is no setting."""

    def __init__(self, tolerance=1e-9):
        self.calls, self.tolerance, self.owner = 0, tolerance, self

    def solve(self, problem):
        self.calls += 1
        return SOLVERS["active-set"].solve(problem)


def test_what_a_solver_counts_is_no_setting_but_its_tolerance_is(tmp_path):
    def case(**options):
        return (CHAIN, TABLE, GPOMDP(steps=20), CPGRL(ConstrainedStep(solver=CountingSolver(**options)), [0, 0, 0]), 6)

    begun, undisturbed = training(case()), [seen(record) for record in training(case())]
    for record in begun:
        if record.episode == 3:
            begun.save(tmp_path / "training.npz")
    again = training(case())
    again.load(tmp_path / "training.npz")
    assert [seen(record) for record in again] == undisturbed[3:]
    with pytest.raises(ValueError, match=r"learner\.step\.solver\.tolerance should be 1e-09, as saved; found 0\.1"):
        training(case(tolerance=0.1)).load(tmp_path / "training.npz")


def test_an_estimation_carries_generators_of_any_kind_or_says_nothing_and_cannot_be_saved(tmp_path):
    estimation = SimpleNamespace(rng=np.random.Generator(np.random.MT19937(3)), episode=print)
    begun = training((CHAIN, TABLE, SimpleNamespace(start=lambda *_: estimation), WeightedSum(), 9))
    with pytest.raises(ValueError, match=r"SimpleNamespace should name .* carried"):
        begun.save(tmp_path / "training.npz")
    before = state_of(estimation.rng)
    drawn = estimation.rng.random(700)  # more than one block of that generator
    require_like(estimation.rng, before, "rng")
    with pytest.raises(ValueError, match="rng should be as saved, MT19937; found PCG64"):
        require_like(np.random.default_rng(0), before, "rng")
    put_back(estimation.rng, before)
    np.testing.assert_array_equal(estimation.rng.random(700), drawn)


def test_after_an_error_it_neither_goes_on_nor_is_saved(tmp_path):
    diverging = training((CHAIN, TABLE, GPOMDP(steps=20), WeightedSum(), 9), max_change=1e-9)
    with pytest.raises(DivergenceError):
        list(diverging)
    for act in (lambda: diverging.save(tmp_path / "training.npz"), lambda: next(iter(diverging))):
        with pytest.raises(ValueError, match="halfway"):
            act()
    assert list(tmp_path.iterdir()) == []
