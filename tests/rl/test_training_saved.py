"""A training that was saved goes on, bit for bit, as if there had been no stop; what does not fit is refused."""

import io
import json
import pickle
import zipfile
from functools import partial

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, ConstrainedStep
from cpgrl_opt.active_set import hysteresis
from envs import ThreeStateMDP, TwoLinkArm, TwoLinkArmEnv
from envs.tabular_env import TabularEnv
from rl import (
    CPGRL,
    GPOMDP,
    ConstraintSwitching,
    DivergenceError,
    Estimate,
    ExactGradient,
    GradientWithRestoration,
    KondaActorCritic,
    LearnerUpdate,
    NormalizedGaussianNetwork,
    SoftmaxTable,
    Training,
    WeightedSum,
    uniform_parameters,
)

CHAIN, ARM = ThreeStateMDP(), TwoLinkArm()
TABLE, NETWORK = SoftmaxTable(3, 3), NormalizedGaussianNetwork(*ARM.stops, (3, 4), 2)
ROSEN = CPGRL(ConstrainedStep(solver="rosen"), [0, 0, 0])
WITH_MEMORY = CPGRL(ConstrainedStep(rule=partial(hysteresis, leave=0.2)), [0, 0, 0])
SAFE = {"ridge": 1e-4, "max_restoration": 0.1}
ON_THE_ARM = CPGRL(ConstrainedStep(solver="rosen", **SAFE), [0, 0.5])
MIXED = {"average": ("step", "step", "episode"), "steps": 40}
# environment, policy, estimator, learner, episodes
CASES = {
    "compiled": (CHAIN, TABLE, GPOMDP(bias_correction=False), ROSEN, 120),
    "compiled once averages are settled": (CHAIN, TABLE, GPOMDP(average_rate=0.5, steps=20), ROSEN, 60),
    "compiled, updates in Python": (CHAIN, TABLE, GPOMDP(average="episode", steps=20), WITH_MEMORY, 40),
    "Konda on the chain": (CHAIN, TABLE, KondaActorCritic(steps=20), ConstraintSwitching([0, 0, 0]), 40),
    "exact": (CHAIN, TABLE, ExactGradient(), WITH_MEMORY, 30),
    "GPOMDP in Python": (TabularEnv(CHAIN), TABLE, GPOMDP(steps=10), ROSEN, 14),
    "Konda in Python": (TabularEnv(CHAIN), TABLE, KondaActorCritic(steps=10), WeightedSum(), 14),
    "GPOMDP on the arm": (ARM, NETWORK, GPOMDP(**MIXED), ON_THE_ARM, 40),
    "Konda on the arm": (ARM, NETWORK, KondaActorCritic(**MIXED), ON_THE_ARM, 40),
    "in a metric, rates of NumPy's": (
        CHAIN, TABLE, GPOMDP(steps=20, average="episode", average_rate=np.float64(0.1)),
        CPGRL(ConstrainedStep(formulation="linearized", metric=np.diag(np.arange(1.0, 10.0))), [0, 0, 0]), 12,
    ),
    "Konda on the arm in Python": (
        TwoLinkArmEnv(), NETWORK, KondaActorCritic(steps=10),
        GradientWithRestoration(ConstrainedStep(**SAFE), [0, 0]), 8,
    ),
}  # fmt: skip
PLAIN = CASES["compiled"]


def training(case=PLAIN, **options):
    *parts, episodes = case
    initial = uniform_parameters(9) if parts[1] is TABLE else None
    return Training(*parts, **{"episodes": episodes, "runs": [0, 3], "seed": 5, "initial": initial, **options})


def seen(record):
    estimate, update = record.estimate, record.update
    arrays = [record.parameters, *(getattr(estimate, name) for name in ("values", "gradients", "steps", "rewards"))]
    return record.episode, [array.tobytes() for array in (*arrays, update.change, update.active)]


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
    "runs[1]": {"runs": 2},
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
        assert "should be a saved training of the format 'cpgrl state 2', whole; found" in refused(saved)
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
    assert "'recording'" in told(**{"state.json": json.dumps({**text, "kind": "recording"})})
    less = {name: part for name, part in text["state"]["dict"].items() if name != "memory"}
    assert "memory" in told(**{"state.json": json.dumps({**text, "state": {"dict": less}})})
    objects = io.BytesIO()
    np.lib.format.write_array(objects, np.array([print], dtype=object))
    assert "whole; found" in told(**{"0.npy": objects.getvalue()})
    huge = good["0.npy"].replace(b"(2, 24)", b"(2e9,) ")
    assert huge != good["0.npy"]
    assert "whole; found" in told(**{"0.npy": huge})
    assert "whole; found" in told(**{"0.npy": good["0.npy"].replace(b"(2, 24)", b"(9, 24)")})
    written(saved, good, zipfile.ZIP_DEFLATED)
    assert "packed" in refused(saved)
    saved.write_bytes(pickle.dumps(good))
    assert "whole; found" in refused(saved)


class Remembers:
    """A learner that remembers what it is told to."""

    def __init__(self, memory):
        self._memory = memory
        self._met = []

    def update(self, linearization, memory=None, observe=None):  # noqa: ARG002 - a Learner
        self._met.append(memory)
        update = WeightedSum().update(linearization)
        return LearnerUpdate(update.change, update.active, update.stationary, {}, self._memory)


def test_a_learners_memory_of_plain_values_comes_back_as_it_was(tmp_path):
    memory = {"a": [1, 2.5, None, True, "é"], "b": (np.arange(3), np.float64(0.1), np.array([], bool)), "c": -np.inf}
    first, second = Remembers(memory), Remembers(memory)
    begun = training((CHAIN, TABLE, GPOMDP(steps=20), first, 2))
    next(iter(begun))
    begun.save(tmp_path / "training.npz")
    again = training((CHAIN, TABLE, GPOMDP(steps=20), second, 2))
    again.load(tmp_path / "training.npz")
    list(again)
    ((met,), (none, *_)) = second._met, first._met
    assert none is None
    assert met["a"] == memory["a"]
    assert met["c"] == -np.inf
    assert type(met["b"]) is tuple
    for one, other in zip(met["b"], memory["b"], strict=True):
        assert type(one) is type(other)
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def test_a_memory_of_other_things_cannot_be_saved(tmp_path):
    begun = training((CHAIN, TABLE, GPOMDP(steps=20), Remembers({"when": {1, 2}}), 2))
    next(iter(begun))
    with pytest.raises(ValueError, match=r"state\['memory'\]\['when'\] should consist of .* found set"):
        begun.save(tmp_path / "training.npz")
    assert list(tmp_path.iterdir()) == []


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


class Untold:
    """An estimator of one's own; `carried` is for `Told` alone."""

    def __init__(self):
        self.total = 0.0

    def start(self, environment, policy, streams):  # noqa: ARG002 - a GradientEstimator
        return type(self)._estimation(len(streams))


class Counting:
    def __init__(self, runs):
        self.sums, self.rngs = np.zeros(runs), [np.random.Generator(np.random.MT19937(k)) for k in range(runs)]

    def episode(self, parameters):
        self.sums += [rng.random() for rng in self.rngs]
        runs, n = parameters.shape
        gradients = np.tile(self.sums[:, None, None], (1, 4, n))
        return Estimate(gradients[:, :, 0], gradients, np.ones(runs, int), np.zeros((runs, 4)), np.zeros(runs, int))


class Saying(Counting):
    carried = ("sums", "rngs")


def test_an_estimator_of_ones_own_is_saved_where_it_says_what_it_carries(tmp_path):
    path = tmp_path / "training.npz"
    Untold._estimation, case = Saying, (CHAIN, TABLE, Untold(), WeightedSum(), 9)
    undisturbed = [seen(record) for record in training(case)]
    begun = training(case)
    found = [seen(record) for record, _ in zip(begun, range(4), strict=False)]
    begun.save(path)
    again = training(case)
    again.load(path)
    assert (
        found[: begun.episode] + [seen(record) for record in again]
        == undisturbed[: len(found)] + undisturbed[begun.episode :]
    )
    Untold._estimation = Counting
    with pytest.raises(ValueError, match=r"Counting should name .* carried"):
        training(case).save(path)


def test_after_an_error_it_neither_goes_on_nor_is_saved(tmp_path):
    diverging = training((CHAIN, TABLE, GPOMDP(steps=20), WeightedSum(), 9), max_change=1e-9)
    with pytest.raises(DivergenceError):
        list(diverging)
    for act in (lambda: diverging.save(tmp_path / "training.npz"), lambda: next(iter(diverging))):
        with pytest.raises(ValueError, match="halfway"):
            act()
    assert list(tmp_path.iterdir()) == []
