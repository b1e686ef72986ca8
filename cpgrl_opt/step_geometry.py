"""Kept so that steps with a metric or a radius that were pickled before 2026-11-27 can be read."""


class StepGeometry:
    """What such a step kept of its metric; dropped as it is read."""
