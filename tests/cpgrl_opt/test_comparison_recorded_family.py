"""What a family of recorded problems says of them."""

from dataclasses import replace

import numpy as np
import pytest

from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.comparison.recorded_family import make_recorded_family
from cpgrl_opt.comparison.recording import empty_recording, shipped_recording


@pytest.mark.parametrize("name", ["three-state", "arm"])
def test_what_the_families_say_of_the_shipped_recordings_is_so(name):
    recording = shipped_recording(name)
    for suffix, own in (("", recording), ("-cone", recording.as_inequalities())):
        family, shipped = make_recorded_family(own, "own"), FAMILIES[f"recorded-{name}{suffix}"]
        facts = [(each.feasible, each.well_posed, each.is_large) for each in (family, shipped)]
        assert facts[0] == facts[1] == (True, True, False)
        for number in range(5):
            problem = shipped.problem(number, 0)
            assert any(np.array_equal(problem.gradient, other) for other in own.gradient)


def test_a_family_says_so_when_a_recorded_problem_is_infeasible_or_ill_posed():
    one = shipped_recording("three-state").select(slice(0, 1))
    row = one.jacobian[:, :1]
    everything = {"equality": np.ones((1, 2), bool), "bound": np.array([[1.0, 2.0]])}
    twice = replace(one, jacobian=np.concatenate([row, row], axis=1), **everything)
    assert (make_recorded_family(twice, "x").feasible, make_recorded_family(twice, "x").well_posed) == (False, False)
    consistent = replace(twice, bound=np.ones((1, 2)))
    assert (make_recorded_family(consistent, "x").feasible, make_recorded_family(consistent, "x").well_posed) == (
        True,
        False,
    )


def test_a_recording_of_nothing_is_no_family():
    with pytest.raises(ValueError, match="a family should have a problem"):
        make_recorded_family(empty_recording(["x"], ""), "x")
