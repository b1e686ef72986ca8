"""Statistics over runs: standard deviation, percentile bootstrap (Efron 1979)."""

from collections.abc import Callable
from typing import Any

import numpy as np

from cpgrl_opt.arrays import Float

_AT_ONCE = 100  # resamples in the memory


def mean_intervals(
    values: Float[np.ndarray, "*cases R measures"],
    rng: np.random.Generator,
    *,
    level: float = 0.95,
    resamples: int = 9999,
) -> Float[np.ndarray, "*cases 3 measures"]:
    """Mean over R independent runs, and the ends of its interval.

    Quantiles of the means of samples of R runs, drawn with replacement, the same for every case and measure, so that
    differences between them are not blurred by the drawing.

    Parameters
    ----------
    values : (…, R, k)
        Of k measures.
    rng
        Draws the samples.
    level
        How often the interval is to hold the true mean.
    resamples
        Number of samples.

    Returns
    -------
    (…, 3, k)
        Mean, lower and upper end, along a new axis before the last. One run has an interval of length 0.
    """
    return _intervals(np.mean, values, rng, level, resamples)


def interquartile_mean_intervals(
    values: Float[np.ndarray, "*cases R measures"],
    rng: np.random.Generator,
    *,
    level: float = 0.95,
    resamples: int = 2000,
) -> Float[np.ndarray, "*cases 3 measures"]:
    """As `mean_intervals`, of the mean without the ⌊R/4⌋ smallest and largest runs (Agarwal et al. 2021)."""
    return _intervals(_interquartile_mean, values, rng, level, resamples)


def spread(values: Float[np.ndarray, "R *shape"]) -> Float[np.ndarray, "*shape"]:
    """Standard deviation over the runs, with R − 1; 0 for a single run.

    Parameters
    ----------
    values
        (R, …): of R runs.

    Returns
    -------
    (…)
        In their unit.
    """
    if len(values) < 2:
        return np.zeros(values.shape[1:])
    deviation: Float[np.ndarray, "*shape"] = values.std(axis=0, ddof=1)
    return deviation


def _intervals(
    statistic: Callable[..., Any], values: np.ndarray, rng: np.random.Generator, level: float, resamples: int
) -> np.ndarray:
    from scipy.stats import bootstrap  # takes half a second

    found = statistic(values, axis=-2)
    if values.shape[-2] < 2:
        return np.stack([found] * 3, axis=-2)
    ends = bootstrap(
        (values,), statistic, axis=-2, n_resamples=resamples, batch=_AT_ONCE, confidence_level=level,
        method="percentile", rng=rng,
    ).confidence_interval  # fmt: skip
    return np.stack([found, ends.low, ends.high], axis=-2)


def _interquartile_mean(values: np.ndarray, axis: int) -> Any:
    from scipy.stats import trim_mean

    return trim_mean(values, 0.25, axis=axis)
