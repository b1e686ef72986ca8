"""What a training tells while it runs, and at its end."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cpgrl_opt.arrays import Float, Int
from cpgrl_opt.comparison.recording import Recording

from .subproblems import join_recordings


@dataclass(frozen=True, eq=False)
class Block:
    """What was recorded of some runs up to `episode`: arrays (R, …) by name; of none, a sign of life."""

    label: str
    runs: tuple[int, ...]
    episode: int
    values: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Some runs of a training when it is done.

    steps: (R,), of the environment; seconds: of training, by the wall, and cpu_seconds, by the process' own clock,
    which others on the machine do not stretch; parameters: (R, n), the last θ; counts: by event, (R,), as learner and
    recorder count; totals: what the recorder summed over the runs; recording: of the direction problems, if wanted.
    """

    label: str
    runs: tuple[int, ...]
    episode: int
    steps: Int[np.ndarray, "R"]
    seconds: float
    cpu_seconds: float
    parameters: Float[np.ndarray, "R n"]
    counts: Mapping[str, Int[np.ndarray, "R"]]
    totals: Mapping[str, float] = field(default_factory=dict)
    recording: Recording | None = None

    @property
    def steps_per_second(self) -> float:
        """Environment steps per wall second of one process."""
        return float(self.steps.sum()) / self.seconds

    def counted(self) -> dict[str, int]:
        """Events over all runs."""
        return {name: int(runs.sum()) for name, runs in self.counts.items()}


Message = Block | Outcome


def join_outcomes(parts: Sequence[Outcome]) -> Outcome:
    """The outcome of all runs from those of shares, in their order.

    Parameters
    ----------
    parts
        Of one training, in the order of their runs.

    Returns
    -------
    Outcome
        Of all runs; seconds are added.
    """
    first = parts[0]
    return Outcome(
        first.label,
        tuple(run for part in parts for run in part.runs),
        first.episode,
        np.concatenate([part.steps for part in parts]),
        sum(part.seconds for part in parts),
        sum(part.cpu_seconds for part in parts),
        np.concatenate([part.parameters for part in parts]),
        {name: np.concatenate([part.counts[name] for part in parts]) for name in first.counts},
        {name: sum(part.totals[name] for part in parts) for name in first.totals},
        join_recordings([part.recording for part in parts]),
    )
