import pickle
from pathlib import Path

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep, Linearization, kkt_residuals
from cpgrl_opt.comparison.recorder import Recorder, in_words, stretches
from cpgrl_opt.comparison.recording import SHIPPED, join, load_recording, shipped_recording
from cpgrl_opt.problem import ProblemBatch
from cpgrl_opt.solvers import SOLVERS, ActiveSet, Rosen

RUNS, EPISODES, N = 3, 30, 5


class Watched:
    """A little training on random gradients: every problem met, by (run, episode, part), beside the recorder."""

    def __init__(self, limit, step, *, runs=tuple(range(RUNS)), seed=0, values=None):
        self.chosen = stretches(limit, RUNS, EPISODES)
        self.recorder = Recorder(runs, self.chosen, "toy", in_words(limit, self.chosen, EPISODES))
        self.met = {}
        rng = np.random.default_rng(seed)
        for episode in range(1, EPISODES + 1):
            rho = rng.standard_normal((RUNS, 3)) if values is None else np.tile(values, (RUNS, 1))
            gradients = rng.standard_normal((RUNS, 3, N))
            if step.drop == "always":
                gradients[:, 0] = gradients[:, 1]  # so that λ of constraint 1 is positive: it is dropped
            own = list(runs)
            calls = []
            step(Linearization(rho[own], gradients[own]), [0.0, 0.0], None, self._both(calls))
            for position, run in enumerate(runs):
                for part, problems in enumerate(
                    calls[0][k : k + len(runs)] for k in range(0, len(calls[0]), len(runs))
                ):
                    self.met[run, episode, part] = problems[position]
            self.recorder.next_episode()
        self.recording = self.recorder.recording()

    def _both(self, calls):
        def observe(problems, answers):
            calls.append(problems)
            self.recorder(problems, answers)

        return observe


def origin(recording, index):
    return tuple(int(getattr(recording, name)[index]) for name in ("run", "episode", "part"))


def same(one, other):
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("gradient", "jacobian", "bound", "equality")
    )


@pytest.mark.parametrize("formulation", ["equality", "cone", "restoring"])
def test_every_problem_with_an_active_constraint_is_kept_bit_for_bit_with_its_run_and_episode(formulation):
    watched = Watched(10_000, ConstrainedStep(solver="rosen", formulation=formulation, on_failure="fallback"))
    active = {key: problem for key, problem in watched.met.items() if (problem.bound > -np.inf).any()}
    assert 0 < len(active) < len(watched.met)
    recording = watched.recording
    assert {origin(recording, k) for k in range(len(recording))} == set(active)
    assert len(recording) == len(active)  # rosen hands cone problems to active-set: these are not met twice
    assert all(same(problem, active[origin(recording, k)]) for k, problem in enumerate(recording.problems))


def test_problems_after_a_drop_are_kept_with_the_run_they_belong_to():
    watched = Watched(10_000, ConstrainedStep(solver="rosen", drop="always"))
    recording = watched.recording
    again = [k for k in range(len(recording)) if recording.part[k] >= 2]
    assert again
    for k in again:
        run, episode, part = origin(recording, k)
        first, second = watched.met[run, episode, part - 2], recording.problems[k]
        assert np.array_equal(first.jacobian, second.jacobian)
        assert np.array_equal(first.gradient, second.gradient)
        assert (second.bound > -np.inf).sum() < (first.bound > -np.inf).sum()


@pytest.mark.parametrize("limit", [1, 16, 179])
def test_no_more_than_the_limit_is_kept_and_the_selection_is_spread_over_runs_and_episodes(limit):
    watched = Watched(limit, ConstrainedStep(solver="rosen"), values=[0.0, -1.0, -1.0])
    recording = watched.recording
    assert 0 < len(recording) <= limit
    chosen = watched.chosen
    assert sum(stretch.room for stretch in chosen) <= limit
    assert chosen[0].first == 1
    if len(chosen) > 1:
        assert chosen[-1].last == EPISODES
        assert {stretch.run for stretch in chosen} == set(range(min(len(chosen), RUNS)))


def test_a_sequence_is_one_run_s_problems_of_one_kind_in_the_order_met():
    recording = Watched(100, ConstrainedStep(solver="rosen"), values=[0.0, -1.0, -1.0]).recording
    assert sorted(index for sequence in recording.sequences for index in sequence) == list(range(len(recording)))
    for sequence in recording.sequences:
        assert len({(int(recording.run[k]), int(recording.part[k])) for k in sequence}) == 1
        steps = np.diff(recording.episode[sequence])
        assert (steps == 1).all()


def test_shares_of_the_runs_joined_are_what_all_runs_together_record():
    step = ConstrainedStep(solver="rosen")
    whole = Watched(60, step).recording
    parts = [Watched(60, step, runs=runs).recording for runs in ((2,), (0, 1))]
    assert recorded_bytes(join(parts)) == recorded_bytes(whole)


def recorded_bytes(recording):
    names = ("gradient", "jacobian", "bound", "equality", "run", "episode", "part", "stretch")
    return [getattr(recording, name).tobytes() for name in names]


def test_a_file_gives_back_the_same_bits_and_is_itself_the_same_each_time(tmp_path):
    recording = Watched(60, ConstrainedStep(solver="rosen")).recording
    for name in ("one.npz", "other.npz"):
        recording.save(tmp_path / name)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "other.npz").read_bytes()
    again = load_recording(tmp_path / "one.npz")
    assert recorded_bytes(again) == recorded_bytes(recording)
    assert (again.trainings, again.selection) == (recording.trainings, recording.selection)


class Trap:
    def __reduce__(self):
        return (pytest.fail, ("a file was unpickled",))


def write(path, **changes):
    recording = Watched(60, ConstrainedStep(solver="rosen")).recording
    recording.save(path)
    with np.load(path) as file:
        contents = dict(file)
    for name, value in changes.items():
        contents[name] = value(contents[name]) if callable(value) else value
    contents = {name: value for name, value in contents.items() if value is not None}
    np.savez(path, **contents)


BAD_FILES = {
    "not there": Path.absolute,
    "a pickle": lambda path: path.write_bytes(pickle.dumps(Trap())),
    "a pickle inside": lambda path: write(path, run=np.array([Trap()], dtype=object)),
    "another format": lambda path: write(path, format=np.array("cpgrl recording 0")),
    "no run": lambda path: write(path, run=None),
    "a negative episode": lambda path: write(path, episode=lambda rows: rows - 9),
    "NaN": lambda path: write(path, gradient=np.full((1, N), np.nan)),
    "a part of no update": lambda path: write(path, part=np.full(1, 9)),
}


@pytest.mark.parametrize("spoil", BAD_FILES)
def test_a_bad_file_is_refused_in_words_and_never_unpickled(spoil, tmp_path):
    path = tmp_path / "bad.npz"
    BAD_FILES[spoil](path)
    with pytest.raises(ValueError, match=r"bad\.npz should .*(found|but)"):
        load_recording(path)


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_recordings_are_small_and_solvable(name):
    recording = shipped_recording(name)
    assert len(recording) >= 100
    assert max(map(len, recording.sequences)) >= 10
    answers = ActiveSet().solve_batch(recording.batch)
    worst = [kkt_residuals(*pair).worst for pair in zip(recording.problems, answers, strict=True)]
    assert (answers.status <= 1).all()
    assert max(np.array(worst)[answers.status == 0]) <= 1e-9


@pytest.mark.parametrize("arguments", [(0, 1, 1), (2.0, 1, 1)])
def test_a_selection_of_nothing_is_refused(arguments):
    with pytest.raises(ValueError, match="should be an integer ≥ 1; found"):
        stretches(*arguments)


def test_a_recorder_that_was_not_told_of_the_next_episode_says_what_it_expected():
    recorder = Recorder([0, 1], stretches(100, 2, 2), "toy")
    problems = ProblemBatch(np.ones((3, 2)), np.ones((3, 1, 2)), np.zeros((3, 1)), np.ones((3, 1), bool))
    with pytest.raises(ValueError, match="one or two for each of 2 runs; found 3"):
        recorder(problems, Rosen().solve_batch(problems))


def test_problems_in_a_metric_are_refused_rather_than_recorded_without_it():
    problems = ProblemBatch(
        np.ones((1, 2)), np.ones((1, 1, 2)), np.zeros((1, 1)), np.ones((1, 1), bool), np.ones((1, 2))
    )
    with pytest.raises(ValueError, match="should have no metric"):
        Recorder([0], stretches(100, 1, 2), "toy")(problems, SOLVERS["enumeration"].solve_batch(problems))
