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


def interquartile_mean_intervals(
    values: Float[np.ndarray, "*cases R measures"],
    rng: np.random.Generator,
    *,
    level: float = 0.95,
    resamples: int = 2000,
) -> Float[np.ndarray, "*cases 3 measures"]:
    """As `mean_intervals`, of the mean without the ⌊R/4⌋ smallest and largest runs (Agarwal et al. 2021)."""
    *cases, runs, measures = values.shape
    counts = rng.multinomial(runs, np.full(runs, 1 / runs), size=resamples)
    once = np.ones((1, runs), dtype=counts.dtype)
    tail = (1 - level) / 2
    found = [
        np.concatenate([_trimmed(each, once), np.quantile(_trimmed(each, counts), [tail, 1 - tail], axis=0)])
        for each in values.reshape(-1, runs, measures)
    ]
    return np.reshape(found, (*cases, 3, measures))


def _trimmed(values: Float[np.ndarray, "R measures"], counts: np.ndarray) -> Float[np.ndarray, "S measures"]:
    """Of each sample in which run i stands counts[s, i] times: of the sorted R values those from R/4 to 3R/4."""
    runs = len(values)
    cut = runs // 4
    order = values.argsort(axis=0)
    places = np.clip(counts[:, order].cumsum(axis=1), cut, runs - cut)
    kept = np.diff(places, axis=1, prepend=cut)
    means: Float[np.ndarray, "S measures"] = np.einsum("srk,rk->sk", kept, np.take_along_axis(values, order, axis=0))
    return means / (runs - 2 * cut)
