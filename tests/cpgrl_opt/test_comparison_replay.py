from dataclasses import replace

import numpy as np
import pytest

from cpgrl_opt import Status
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.comparison.recording import empty_recording, shipped_recording
from cpgrl_opt.comparison.replay import recorded_family, replay
from cpgrl_opt.solvers import OSQP, ActiveSet


@pytest.fixture(scope="module")
def recording():
    whole = shipped_recording("three-state")
    longest = sorted(whole.sequences, key=len)[-4:]
    return whole.chosen(sorted(index for sequence in longest for index in sequence))


def test_cold_and_warm_replays_find_the_same_answers_and_a_warm_start_is_no_cold_one(recording):
    cone = recording.as_inequalities()
    cold, warm = (replay(cone, OSQP(), warm=warm) for warm in (False, True))
    for done in (cold, warm):
        assert (done.status == Status.OPTIMAL).all()
        assert done.worst.max() <= OSQP().tolerance
        assert (done.seconds > 0).all()
    firsts = [sequence[0] for sequence in cone.sequences]
    assert np.array_equal(cold.iterations[firsts], warm.iterations[firsts])  # each sequence begins anew
    assert not np.array_equal(cold.iterations, warm.iterations)


def test_a_replay_is_in_the_order_of_the_recording(recording):
    solver = ActiveSet()
    done = replay(recording, solver, repeats=2)
    for index in (0, len(recording) - 1):
        alone = solver.solve(recording.problems[index])
        assert (done.status[index], done.iterations[index]) == (alone.status, alone.iterations)


def test_a_solver_without_warm_start_is_not_replayed_warm(recording):
    with pytest.raises(ValueError, match="should have a session with warm_start"):
        replay(recording, ActiveSet(), warm=True)


@pytest.mark.parametrize("name", ["three-state", "arm"])
def test_what_the_families_say_of_the_shipped_recordings_is_so(name):
    recording = shipped_recording(name)
    for suffix, own in (("", recording), ("-cone", recording.as_inequalities())):
        family, shipped = recorded_family(own, "own"), FAMILIES[f"recorded-{name}{suffix}"]
        facts = [(each.feasible, each.well_posed, each.is_large) for each in (family, shipped)]
        assert facts[0] == facts[1] == (True, True, False)
        for number in range(5):
            problem = shipped.problem(number, 0)
            assert any(np.array_equal(problem.gradient, other) for other in own.gradient)


def test_a_family_says_so_when_a_recorded_problem_is_infeasible_or_ill_posed(recording):
    one = recording.chosen(slice(0, 1))
    row = one.jacobian[:, :1]
    everything = {"equality": np.ones((1, 2), bool), "bound": np.array([[1.0, 2.0]])}
    twice = replace(one, jacobian=np.concatenate([row, row], axis=1), **everything)
    assert (recorded_family(twice, "x").feasible, recorded_family(twice, "x").well_posed) == (False, False)
    consistent = replace(twice, bound=np.ones((1, 2)))
    assert (recorded_family(consistent, "x").feasible, recorded_family(consistent, "x").well_posed) == (True, False)


def test_a_recording_of_nothing_is_no_family():
    with pytest.raises(ValueError, match="a family should have a problem"):
        recorded_family(empty_recording(["x"], ""), "x")
