"""Statistics over runs: standard deviation, percentile bootstrap (Efron 1979)."""

import numpy as np

from cpgrl_opt.arrays import Float


def mean_intervals(
    values: Float[np.ndarray, "*cases R measures"],
    rng: np.random.Generator,
    *,
    level: float = 0.95,
    resamples: int = 9999,
) -> Float[np.ndarray, "*cases 3 measures"]:
    """Mean over R independent runs, and the ends of its interval at `level`, along a new axis before the last.

    Quantiles of the means of `resamples` samples of R runs, drawn with replacement, the same for every case and
    measure, so that differences between them are not blurred by the drawing. One run has an interval of length 0.
    """
    runs = values.shape[-2]
    weights = rng.multinomial(runs, np.full(runs, 1 / runs), size=resamples) / runs
    means = np.einsum("sr,...rk->...sk", weights, values)
    tail = (1 - level) / 2
    low, high = np.quantile(means, [tail, 1 - tail], axis=-2)
    return np.stack([values.mean(axis=-2), low, high], axis=-2)


def spread(values: Float[np.ndarray, "R *shape"]) -> Float[np.ndarray, "*shape"]:
    """Standard deviation over the runs, with R − 1; 0 for a single run."""
    if len(values) < 2:
        return np.zeros(values.shape[1:])
    deviation: Float[np.ndarray, "*shape"] = values.std(axis=0, ddof=1)
    return deviation
