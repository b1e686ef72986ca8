"""Any finite Markov decision process as a Gymnasium environment with vector rewards."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete

from .arrays import Float64, UInt8
from .interface import FiniteKernel, finite_kernel_of, register_code
from .tabular import TabularMDP


@register_code
class TabularEnv(gymnasium.Env[np.int64, np.int64]):
    """States and actions are 0 … n − 1; `step` returns r(s, a) of the state that it leaves, (1 + m,) float64.

    MO-Gymnasium's conventions: `reward_space` bounds the rewards, `reward_dim` = 1 + m. An episode never ends
    by itself; `gymnasium.make` or `TimeLimit` cuts it off. `reset(seed=…)` fixes all that follows.

    Parameters
    ----------
    mdp
        Without a step of its own.
    render_mode
        None, or "rgb_array" for `render`.

    Raises
    ------
    ValueError
        For another MDP or mode; in `step`, for an action that is none.
    ResetNeeded
        In `step` and `render`, before the first reset.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012  Gymnasium's own form

    def __init__(self, mdp: TabularMDP, *, render_mode: str | None = None) -> None:
        if render_mode is not None and not (
            isinstance(render_mode, str) and render_mode in self.metadata["render_modes"]
        ):
            raise ValueError(f"render_mode should be None or 'rgb_array'; found {render_mode!r}")
        kernel = finite_kernel_of(mdp)
        if kernel is None:
            raise ValueError(f"mdp should be a TabularMDP without a step of its own; found {type(mdp).__name__}")
        self.mdp = mdp
        self.render_mode = render_mode
        self.observation_space = Discrete(mdp.states)
        self.action_space = Discrete(mdp.actions)
        low, high = kernel.rewards.min(axis=(1, 2)), kernel.rewards.max(axis=(1, 2))
        self.reward_space = Box(low, high, dtype=np.float64)
        self.reward_dim = kernel.reward_channels
        self._kernel = kernel
        self._state: int | None = None
        self._last: tuple[int, int] | None = None

    @property
    def reward_channels(self) -> int:
        """1 + m."""
        return self._kernel.reward_channels

    def finite_kernel(self) -> FiniteKernel:
        """The arrays that `step` goes by, as fresh copies: training need not go through it."""
        return FiniteKernel(self._kernel.transition_cumulative, self._kernel.rewards, self._kernel.start)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.int64, dict[str, Any]]:
        """The start state; a seed starts the random stream anew."""
        super().reset(seed=seed, options=options)
        self._state, self._last = self._kernel.start, None
        return np.int64(self._state), {}

    # Vector rewards are MO-Gymnasium's departure from Gymnasium's types, and ours.
    def step(
        self, action: np.int64 | int
    ) -> tuple[np.int64, Float64[np.ndarray, "channels"], bool, bool, dict[str, Any]]:
        """s′ ~ T(s, a, ·) and r(s, a); never terminated, never truncated."""
        if not self.action_space.contains(action):
            raise ValueError(f"action should be an integer in 0 … {self.mdp.actions - 1}; found {action!r}")
        state, choice = self._current_state(), int(action)
        row = self._kernel.transition_cumulative[state, choice]
        self._state = int(np.searchsorted(row, self.np_random.random(), side="right"))
        self._last = state, choice
        return np.int64(self._state), self._kernel.rewards[:, state, choice].copy(), False, False, {}

    def render(self) -> UInt8[np.ndarray, "height width 3"]:
        """A picture of the chain: the state lit up, the last action's possible outcomes as arrows."""
        if self.render_mode is None:
            raise ValueError("render_mode should be 'rgb_array' to draw; found None: pass it to gymnasium.make")
        from .chain_drawing import draw_chain

        return draw_chain(self.mdp, self._current_state(), self._last)

    def _current_state(self) -> int:
        if self._state is None:
            raise gymnasium.error.ResetNeeded("reset should be called before step or render; found no state")
        return self._state
