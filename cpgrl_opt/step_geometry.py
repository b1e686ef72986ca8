"""Nothing any more: a name that steps with a metric or a radius, pickled before 2026-11-27, ask for to be read."""


class StepGeometry:
    """What such a step kept of its metric; dropped as it is read."""
