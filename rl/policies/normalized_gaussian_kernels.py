"""The normalised Gaussian network for compiled rollouts; `NormalizedGaussianNetwork` says what these compute.

Inside kernels a vector of θ's length has its rows and columns exchanged, index c·K + j instead of j·d + c, so that
every loop over it runs along memory; the driver changes between the two orders.
"""

from typing import NamedTuple

import numpy as np

from cpgrl_opt.arrays import Float64, Int64
from envs.interface.random_stream import uniform

from .._kernels import kernel
from .._late_kernels import inner
from .normalized_gaussian_network import NormalizedGaussianNetwork


class Grid(NamedTuple):
    """Constants of the basis for `act`.

    counts: (D,); places: (2, D), lowest centre and 1/spacing along each axis; falls: (2, max counts),
    exp(−½(i/width)²) for i spacings, and 1/width² at [1, 0].
    """

    counts: Int64[np.ndarray, "D"]
    places: Float64[np.ndarray, "2 D"]
    falls: Float64[np.ndarray, "2 most"]


def grid_of(policy: NormalizedGaussianNetwork) -> Grid:
    """Fresh arrays."""
    steps = np.arange(max(policy.counts))
    falls = np.exp(-0.5 * (steps / policy.width) ** 2)
    places = np.array([policy.low, 1 / policy.spacing])
    return Grid(np.array(policy.counts), places, np.array([falls, np.full_like(falls, policy.width**-2)]))


@kernel("void(float64, int64, float64[:, ::1], float64[::1])")
def _along_axis(place, count, falls, weights):  # type: ignore[no-untyped-def]
    """Normalised Gaussians at `place`, counted in spacings from the lowest centre, from one exponential.

    With r the nearest centre and s = place − r,  g_{r±i} ∝ exp(±s i/width²) exp(−½ (i/width)²).
    """
    nearest = 0
    if place > 0.0:  # false for NaN, which must not become an index
        nearest = int(min(place + 0.5, count - 1.0))
    ratio = np.exp((place - nearest) * falls[1, 0])
    weights[nearest] = total = power = 1.0
    for i in range(1, count - nearest):
        power *= ratio
        weights[nearest + i] = power * falls[0, i] if falls[0, i] > 0.0 else 0.0  # the power may be infinite
        total += weights[nearest + i]
    power, ratio = 1.0, 1.0 / ratio
    for i in range(1, nearest + 1):
        power *= ratio
        weights[nearest - i] = power * falls[0, i] if falls[0, i] > 0.0 else 0.0
        total += weights[nearest - i]
    share = 1.0 / total
    for i in range(count):
        weights[i] *= share


@kernel("void(float64[::1], int64[::1], float64[:, ::1], float64[:, ::1], float64[::1], float64[::1])")
def fill_features(state, counts, places, falls, weights, features):  # type: ignore[no-untyped-def]
    """n(x) into `features`, (K,); weights: (max counts,), scratch."""
    features[0] = 1.0
    size = 1
    for axis in range(counts.size):
        count = counts[axis]
        _along_axis((state[axis] - places[0, axis]) * places[1, axis], count, falls, weights)
        for j in range(size - 1, -1, -1):  # from the end, so that nothing is overwritten before it is used
            factor = features[j]
            for i in range(count):
                features[j * count + i] = factor * weights[i]
        size *= count


@kernel("UniTuple(float64, 2)(uint64[::1])")
def normal_pair(random_state):  # type: ignore[no-untyped-def]
    """Two independent N(0, 1). Source: Marsaglia & Bray (1964), the polar method."""
    while True:
        x, y = 2.0 * uniform(random_state) - 1.0, 2.0 * uniform(random_state) - 1.0
        square = x * x + y * y
        if 0.0 < square < 1.0:
            factor = np.sqrt(-2.0 * np.log(square) / square)
            return x * factor, y * factor


@kernel(
    "void(float64[::1], float64[::1], float64, int64[::1], float64[:, ::1], float64[:, ::1], uint64[::1], "
    "float64[::1], float64[::1], float64[::1], float64[::1])"
)
def act(  # type: ignore[no-untyped-def]
    theta,  # (d·K,), exchanged
    state,
    deviation,
    counts,
    places,
    falls,
    random_state,  # (4,), advanced: one pair of normals for each two components of u
    weights,  # (max counts,), scratch
    features,  # (K,), filled
    action,  # (d,), filled
    score,  # (d·K,), filled, exchanged
):
    """u ~ μ_θ(x, ·) and its ψ, from the noise itself: u − Θᵀn would lose it beside a large mean."""
    fill_features(state, counts, places, falls, weights, features)
    size, dimensions = features.size, action.size
    second = 0.0
    for c in range(dimensions):
        noise = second
        if c % 2 == 0:
            noise, second = normal_pair(random_state)
        action[c] = inner(theta, c * size, features) + deviation * noise
        scaled = noise / deviation
        for j in range(size):
            score[c * size + j] = features[j] * scaled
