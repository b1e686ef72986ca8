"""The two-link arm as a Gymnasium environment with vector rewards."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike

from .arm_constants import NONE
from .arrays import Float64, UInt8
from .interface import ContinuousKernels, continuous_kernels_of, register_code
from .two_link_arm import TwoLinkArm
from .validation import finite_array, real_array


@register_code
class TwoLinkArmEnv(gymnasium.Env[Float64[np.ndarray, "2"], ArrayLike]):
    """`cpgrl/TwoLinkArm-v0`: observations are angles φ, rad; actions joint velocities, rad/s; rewards (3,).

    MO-Gymnasium's conventions: `reward_space` bounds the rewards, `reward_dim` = 3. An action beyond the
    speed limit is clipped. A touch terminates; `arm.max_steps` truncate. info["touched"] is the object's name
    or "none", info["event"] its number from 1, or 0. `reset(seed=…)` fixes all that follows.

    Parameters
    ----------
    arm, constants
        The arm, or its constants by name: `gymnasium.make("cpgrl/TwoLinkArm-v0", touch_radius=0.1)`.
    render_mode
        None, or "rgb_array" for `render`.

    Raises
    ------
    ValueError
        For both an arm and constants, and for another mode; in `step`, for NaN or a wrong shape.
    ResetNeeded
        In `step`, before a reset and after the end.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012  real time at dt = 0.05 s
    event_key = "event"  # where info has the event that ended an episode

    def __init__(self, arm: TwoLinkArm | None = None, *, render_mode: str | None = None, **constants: Any) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode should be None or 'rgb_array'; found {render_mode!r}")
        if arm is not None and constants:
            raise ValueError(f"constants should come with the arm or by name, not both; found {sorted(constants)}")
        self.arm = TwoLinkArm(**constants) if arm is None else arm
        self.render_mode = render_mode
        low, high = self.arm.stops
        self.observation_space = Box(low, high, dtype=np.float64)
        self.action_space = Box(-self.arm.max_speed, self.arm.max_speed, (2,), np.float64)
        prizes = [thing.reward for thing in self.arm.objects]
        self.reward_space = Box(
            np.array([0.0, -1.0, min(0.0, *prizes)]), np.array([1.0, 0.0, max(0.0, *prizes)]), dtype=np.float64
        )
        self.reward_dim = self.arm.reward_channels
        self._kernels = _kernels_of(self.arm)
        self._angles, self._reward = np.zeros(2), np.zeros(self.reward_dim)
        self._steps, self._event = 0, 0
        self._begun = self._running = False

    @property
    def reward_channels(self) -> int:
        """1 + m = 3."""
        return self.arm.reward_channels

    def continuous_kernels(self) -> ContinuousKernels:
        """The dynamics that `step` goes by: training need not go through it."""
        return _kernels_of(self.arm)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float64[np.ndarray, "2"], dict[str, Any]]:
        """A random start, or options["angles"], (2,), rad, within the stops; a seed starts the stream anew."""
        super().reset(seed=seed, options=options)
        unknown = sorted(set(options or {}) - {"angles"})
        if unknown:
            raise ValueError(f"options should hold 'angles' or nothing; found {unknown}")
        if options and "angles" in options:
            self._angles = self._check_start(options["angles"])
        else:
            words = self.np_random.integers(2**64, size=4, dtype=np.uint64)
            self._kernels.reset(self._kernels.constants, words, self._angles)
        self._reward = np.zeros(self.reward_dim)
        self._steps, self._event = 0, 0
        self._begun = self._running = True
        return self._angles.copy(), self._info()

    # Vector rewards are MO-Gymnasium's departure from Gymnasium's types, and ours.
    def step(
        self, action: ArrayLike
    ) -> tuple[Float64[np.ndarray, "2"], Float64[np.ndarray, "3"], bool, bool, dict[str, Any]]:
        """φ′, (r¹, r², r³), whether an object was touched, whether time ran out without a touch, info."""
        velocity = real_array("action", action).copy()
        if velocity.shape != (2,):
            raise ValueError(f"action should have shape (2,); found {velocity.shape}")
        if not self._running:
            found = "an episode that has ended" if self._begun else "no state"
            raise gymnasium.error.ResetNeeded(f"reset should be called before step; found {found}")
        self._reward = np.zeros(self.reward_dim)
        unused = np.zeros(4, np.uint64)  # the arm moves as it is told: nothing is drawn
        self._event = int(self._kernels.step(self._kernels.constants, self._angles, velocity, unused, self._reward))
        self._steps += 1
        terminated = self._event > 0
        truncated = not terminated and self._steps >= self.arm.max_steps
        self._running = not (terminated or truncated)
        return self._angles.copy(), self._reward.copy(), terminated, truncated, self._info()

    def render(self) -> UInt8[np.ndarray, "height width 3"]:
        """The arm among the objects, what it reaches, and where r² = 0: 400 × 400 pixels."""
        if self.render_mode is None:
            raise ValueError("render_mode should be 'rgb_array' to draw; found None: pass it to gymnasium.make")
        if not self._begun:
            raise gymnasium.error.ResetNeeded("reset should be called before render; found no state")
        from .arm_drawing import arm_picture

        return arm_picture(self.arm, self._angles, self._caption())

    def _check_start(self, angles: ArrayLike) -> Float64[np.ndarray, "2"]:
        start = finite_array("angles", angles).copy()
        if start.shape != (2,) or not self.observation_space.contains(start):
            low, high = self.arm.stops
            raise ValueError(f"angles should be (2,) between the stops {low} and {high}; found {start}")
        return start

    def _info(self) -> dict[str, Any]:
        return {"touched": (NONE, *self.arm.events)[self._event], "event": self._event}

    def _caption(self) -> str:
        if self._steps == 0:
            return "start"
        rewards = ", ".join(f"{reward:.3g}" for reward in self._reward).replace("-", "−")
        touched = f"{self._info()['touched']}    " if self._event else ""
        return f"{touched}r = ({rewards})"


def _kernels_of(arm: TwoLinkArm) -> ContinuousKernels:
    kernels = continuous_kernels_of(arm)
    if kernels is None:
        raise ValueError(f"arm should be a TwoLinkArm without a step of its own; found {type(arm).__name__}")
    return kernels
