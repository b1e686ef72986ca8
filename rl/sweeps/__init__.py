"""Sweeps: a training for each of many settings and seeds, on loky, Dask or Ray, in one tidy table."""

from .sweep import Sweep, estimates, sweep

__all__ = ["Sweep", "estimates", "sweep"]
