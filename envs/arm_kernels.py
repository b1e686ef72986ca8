"""The two-link arm for compiled code: `envs.two_link_arm.TwoLinkArm` says what these compute.

A step tests squared distances and takes one exponential; the random stream serves `reset` alone. NaN in an
action is not clipped to a legal move: it spreads to state and reward, where the caller sees it.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from .arrays import Float64
from .interface import RESET_SIGNATURE, STEP_SIGNATURE
from .interface.kernel_cache import compile_and_cache
from .interface.random_stream import uniform

if TYPE_CHECKING:
    from .two_link_arm import TwoLinkArm

# Where each constant stands. numba's cache does not notice a change made in another file, so the layout and
# the kernels that read it share this one.
_LINK_1, _LINK_2, _DT, _SPEED, _RADIUS_SQUARED, _FALL_OFF = range(6)
_BOX = 6  # least and greatest φ₁, least and greatest φ₂
_STOPS = 10  # the same
_OBJECTS = 14  # x, y, reward of each


def pack(arm: "TwoLinkArm") -> Float64[np.ndarray, "constants"]:
    """The constants of `arm` as the kernels read them."""
    low, high = arm.stops
    scalars = (*arm.link_lengths, arm.dt, arm.max_speed, arm.touch_radius**2, 1 / (2 * arm.reward_width**2))
    things = [(*thing.position, thing.reward) for thing in arm.objects]
    return np.concatenate([scalars, np.ravel(arm.box), np.stack([low, high], axis=1).ravel(), np.ravel(things)])


@compile_and_cache("float64(float64, float64, float64)")
def _clip(value, low, high):  # type: ignore[no-untyped-def]
    # By comparisons, so that NaN stays NaN; min and max may swallow it.
    if value < low:
        return low
    if value > high:
        return high
    return value


@compile_and_cache("Tuple((int64, float64))(float64[::1], float64[::1])")
def _nearest(constants, state):  # type: ignore[no-untyped-def]
    """Index of the object nearest to the end effector, the first of equals, and the squared distance, m²."""
    elbow, total = state[0], state[0] + state[1]
    x = constants[_LINK_1] * math.cos(elbow) + constants[_LINK_2] * math.cos(total)
    y = constants[_LINK_1] * math.sin(elbow) + constants[_LINK_2] * math.sin(total)
    nearest, least = 0, (x - constants[_OBJECTS]) ** 2 + (y - constants[_OBJECTS + 1]) ** 2
    for k in range(1, (constants.size - _OBJECTS) // 3):
        squared = (x - constants[_OBJECTS + 3 * k]) ** 2 + (y - constants[_OBJECTS + 3 * k + 1]) ** 2
        if squared < least:
            nearest, least = k, squared
    return nearest, least


@compile_and_cache(RESET_SIGNATURE, nogil=True)
def reset(constants, random_state, state):  # type: ignore[no-untyped-def]
    """φ uniform in the box, drawn anew while an object is touched."""
    squared = -1.0
    while squared <= constants[_RADIUS_SQUARED]:
        for joint in range(2):
            low, high = constants[_BOX + 2 * joint], constants[_BOX + 2 * joint + 1]
            state[joint] = min(low + (high - low) * uniform(random_state), high)  # rounding may pass high
        _, squared = _nearest(constants, state)


@compile_and_cache(STEP_SIGNATURE, nogil=True)
def step(constants, state, action, random_state, reward):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """φ′ into `state`, (r¹, r², r³) into `reward`; the number of the touched object, from 1, or 0."""
    inside = True
    for joint in range(2):
        velocity = _clip(action[joint], -constants[_SPEED], constants[_SPEED])
        desired = state[joint] + constants[_DT] * velocity
        inside &= constants[_BOX + 2 * joint] <= desired <= constants[_BOX + 2 * joint + 1]
        state[joint] = _clip(desired, constants[_STOPS + 2 * joint], constants[_STOPS + 2 * joint + 1])
    nearest, squared = _nearest(constants, state)
    touched = squared <= constants[_RADIUS_SQUARED]
    reward[0] = math.exp(-squared * constants[_FALL_OFF])
    reward[1] = 0.0 if inside else -1.0
    reward[2] = constants[_OBJECTS + 3 * nearest + 2] if touched else 0.0
    return nearest + 1 if touched else 0
