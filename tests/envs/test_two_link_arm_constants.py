"""What the two-link arm may be made of."""

import math

import numpy as np
import pytest

from envs import ArmObject, TwoLinkArm

FAR = (ArmObject("far", (9.0, 9.0)),)


def test_constants_are_the_ones_of_the_paper_and_of_the_table():
    arm = TwoLinkArm()
    assert arm.box == ((math.pi / 10, math.pi / 2), (math.pi / 4, 3 * math.pi / 4))
    assert (arm.link_lengths, arm.dt, arm.max_speed, arm.stop_margin) == ((1, 1), 0.05, 3, 0.25)
    assert (arm.touch_radius, arm.reward_width, arm.max_steps) == (0.06, 0.3, 1000)
    places = {thing.name: (*thing.position, thing.reward) for thing in arm.objects}
    assert places == {
        "circle": (-0.69, 0.87, 0),
        "star": (-0.04, 1.11, -1),
        "square": (0.58, 1.56, 1),
        "triangle": (-0.45, 1.60, 0),
    }


def test_an_arm_is_a_value():
    assert TwoLinkArm(box=[[0.1, 1], [0.2, 2]]) == TwoLinkArm(box=((0.1, 1.0), (0.2, 2.0)))
    assert len({TwoLinkArm(), TwoLinkArm(), TwoLinkArm(dt=0.1)}) == 2
    with pytest.raises(AttributeError):
        TwoLinkArm().dt = 0.1


@pytest.mark.parametrize(
    ("constants", "message"),
    [
        ({"link_lengths": (1.0, 0.0)}, r"link_lengths should be a number in \[1e-09, 1e\+09\]; found 0.0"),
        ({"link_lengths": (1.0,)}, "link_lengths should be a pair of numbers"),
        ({"link_lengths": 1.0}, "link_lengths should be a pair of numbers"),
        ({"dt": -0.05}, "dt should be a number"),
        ({"dt": "0.05"}, "dt should be a number.*found '0.05'"),
        ({"max_speed": np.nan}, "max_speed should be a number.*found nan"),
        ({"max_speed": np.inf}, "max_speed should be a number.*found inf"),
        ({"box": ((1, 0), (0, 1))}, r"box should hold \(least, greatest\) angles.*found \(1.0, 0.0\)"),
        ({"box": ((0, 1), (1, 1))}, r"box should hold \(least, greatest\) angles.*found \(1.0, 1.0\)"),
        ({"box": ((0, 1),)}, "box should be two pairs of angles"),
        ({"box": ((0, np.nan), (0, 1))}, "box of φ₁ should be a number"),
        ({"box": ((0, 1), (0, 1, 2))}, "box of φ₂ should be a pair"),
        ({"stop_margin": -0.1}, r"stop_margin should be a number in \[0, "),
        ({"objects": ()}, "objects should be one ArmObject or more"),
        ({"objects": ["star"]}, "objects should be one ArmObject or more"),
        ({"objects": 4}, "objects should be a sequence of ArmObject"),
        ({"objects": (FAR[0], FAR[0])}, r"objects should have different names; found \['far', 'far'\]"),
        ({"touch_radius": 0}, "touch_radius should be a number"),
        ({"touch_radius": 4.0}, "should be free of objects to start in; found 0.00%"),
        ({"reward_width": True}, "reward_width should be a number.*found True"),
        ({"max_steps": 0}, "max_steps should be an integer ≥ 1; found 0"),
        ({"max_steps": 10.0}, "max_steps should be an integer ≥ 1; found 10.0"),
    ],
)
def test_constants_that_make_no_arm_are_refused(constants, message):
    with pytest.raises(ValueError, match=message):
        TwoLinkArm(**constants)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("", (0, 0)), "the name of an object should be a string, not empty"),
        (("none", (0, 0)), "not 'none'; found 'none'"),
        ((7, (0, 0)), "the name of an object should be a string"),
        (("it", (0, 0, 0)), "position of it should be a pair of numbers"),
        (("it", (0, np.inf)), "position of it should be a number"),
        (("it", (0, 0), np.nan), "reward of it should be a number"),
    ],
)
def test_objects_that_cannot_be_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ArmObject(*arguments)


def test_points_and_angles_of_other_shapes_are_refused():
    arm = TwoLinkArm()
    for function, name in [
        (arm.forward_kinematics, "angles"),
        (arm.intrinsic_reward, "points"),
        (arm.touched, "points"),
    ]:
        for bad in (0.0, [1, 2, 3], np.zeros((2, 3))):
            with pytest.raises(ValueError, match=rf"{name} should have shape \(…, 2\)"):
                function(bad)
        with pytest.raises(ValueError, match=f"{name} should have no NaN"):
            function([0, np.nan])
    with pytest.raises(ValueError, match="lines should be an integer ≥ 2; found 1"):
        arm.reachable_mesh(1)
    with pytest.raises(ValueError, match="within should be 'stops' or 'box'; found 'all'"):
        arm.reachable_mesh(within="all")
