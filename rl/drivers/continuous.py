"""The driver of compiled environments with a normalised Gaussian network: B runs play an episode in one call.

Inside, vectors of θ's length have their rows and columns exchanged (`normalized_gaussian_kernels`).
"""

from collections.abc import Sequence

import numpy as np

from cpgrl_opt.arrays import Float
from envs.interface import RESET_SIGNATURE, STEP_SIGNATURE, ContinuousKernels, random_state

from ..policies import NormalizedGaussianNetwork
from ..policies.normalized_gaussian_kernels import act, grid_of
from .interface import Batch, RuleStep, Score
from .kernels import account, close_run, driver_signature, kernel, open_run, play


class ContinuousDriver:
    """B runs of a `NormalizedGaussianNetwork` on `ContinuousKernels`.

    A run's episodes draw from its random state alone: the reset, then for each step the action and the step, as the
    kernels take them.

    Raises
    ------
    ValueError
        When the policy's state or action does not fit the kernels.
    """

    carried = ("random_states",)

    def __init__(
        self,
        kernels: ContinuousKernels,
        policy: NormalizedGaussianNetwork,
        streams: Sequence[np.random.SeedSequence],
        steps: int,
    ) -> None:
        for what, found, wanted in (
            ("axes of the state", len(policy.counts), kernels.state_size),
            ("components of the action", policy.dimensions, kernels.action_size),
        ):
            if found != wanted:
                raise ValueError(f"policy should have {wanted} {what}, as the environment; found {found}")
        self.shape = (len(streams), kernels.reward_channels, len(policy.parameters))
        self.kernels, self.limit, self.dimensions = kernels, min(int(steps), kernels.max_steps), policy.dimensions
        self.network = (*grid_of(policy), policy.deviation)
        self.random_states = np.array([random_state(stream) for stream in streams])

    def play(self, step: RuleStep, parameters: Float[np.ndarray, "B n"], batch: Batch) -> None:
        """One episode of each run in one call."""
        functions = {RESET_SIGNATURE: self.kernels.reset, STEP_SIGNATURE: self.kernels.step}
        fixed = (self.kernels.constants, self.limit, *self.network)
        theta = _exchange(parameters, self.shape[2] // self.dimensions, self.dimensions)
        play(advance, step, functions, *fixed, theta, self.random_states, batch)
        batch.gradients[...], batch.spans[...] = self.reorder(batch.gradients), self.reorder(batch.spans)

    def reorder(self, vectors: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "... n"]:
        """Rows and columns exchanged back."""
        return _exchange(vectors, self.dimensions, self.shape[2] // self.dimensions)


def _exchange(vectors: Float[np.ndarray, "... n"], rows: int, columns: int) -> Float[np.ndarray, "... n"]:
    """Each vector, read as (rows, columns), by columns; a fresh array."""
    by_columns = vectors.reshape(*vectors.shape[:-1], rows, columns).swapaxes(-1, -2)
    return np.ascontiguousarray(by_columns).reshape(vectors.shape)


@kernel(
    driver_signature(
        "float64[::1], int64, int64[::1], float64[:, ::1], float64[:, ::1], float64, float64[:, ::1], uint64[:, ::1]",
        RESET_SIGNATURE,
        STEP_SIGNATURE,
    )
)
def advance(  # type: ignore[no-untyped-def]
    rule,
    reset,
    step,
    constants,  # of the environment
    limit,
    counts,  # of the network, as places, falls and deviation
    places,
    falls,
    deviation,
    parameters,  # (B, n), exchanged
    random_states,  # (B, 4), advanced
    batch,
):
    """One episode of B runs, one after the other."""
    n, size = parameters.shape[1], 1
    for count in counts:
        size *= count
    state, action, reward = np.empty(counts.size), np.empty(n // size), np.empty(batch.average.size)
    weights, features, scores = np.empty(counts.max()), np.empty(size), np.empty((2, n))
    for run in range(parameters.shape[0]):
        course, random, theta = open_run(batch, run), random_states[run], parameters[run]
        reset(constants, random, state)
        event, t, last = 0, -1, False
        while True:
            following = scores[(t + 1) % 2]
            if event == 0 and (batch.looks_ahead or not last):  # the only call, so that it is compiled in place
                act(theta, state, deviation, counts, places, falls, random, weights, features, action, following)
            else:
                following[:] = 0.0
            if t >= 0:
                account(batch, run, t, reward)
                rule(course, t, Score(0, scores[t % 2]), reward, Score(0, following), last)
            if last:
                break
            t += 1
            event = step(constants, state, action, random, reward)
            last = event != 0 or t + 1 == limit
        close_run(batch, run, t + 1, event)
