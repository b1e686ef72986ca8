"""Watching a training: the direction problems of some updates, kept with run and episode."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..direction import DirectionBatch
from ..problem import ProblemBatch
from ..validation import require_count
from .recording import Recording, empty_recording

STRETCH = 20  # updates that follow each other: enough to see what a warm start is worth
_ARRAYS = ("gradient", "jacobian", "bound", "equality")  # of a problem
_PER_UPDATE = 2  # problems, tangent and restoration; more only where constraints are dropped


@dataclass(frozen=True)
class Stretch:
    """The updates of one run after the episodes first … last; at most `room` problems of them are kept."""

    run: int
    first: int
    last: int
    room: int


def stretches(limit: int, runs: int, episodes: int) -> list[Stretch]:
    """Which updates to record so that at most `limit` problems are kept: all of them if that many fit.

    Otherwise stretches of STRETCH updates that follow each other (fewer if there were less than four stretches), their
    beginnings spread evenly from the first episode to the last, each from the next run in turn.
    """
    for name, value in (("limit", limit), ("runs", runs), ("episodes", episodes)):
        require_count(name, value)
    room = limit // runs
    if room >= _PER_UPDATE * episodes:
        return [Stretch(run, 1, episodes, room) for run in range(runs)]
    length = max(1, min(STRETCH, episodes, limit // (4 * _PER_UPDATE)))
    count = max(1, limit // (_PER_UPDATE * length))
    step = (episodes - length) / max(1, count - 1)
    room = min(_PER_UPDATE * length, limit)
    return [Stretch(k % runs, first, first + length - 1, room) for k in range(count) for first in [1 + int(k * step)]]


def in_words(limit: int, chosen: Sequence[Stretch], episodes: int) -> str:
    """What `stretches` chose, for people."""
    length = chosen[0].last - chosen[0].first + 1
    if length == episodes:
        which = f"every update of run{'s' if len(chosen) > 1 else ''} 0{f' to {len(chosen) - 1}' * (len(chosen) > 1)}"
    else:
        which = (
            f"{len(chosen)} stretches of {length} consecutive updates, beginning evenly spaced over {episodes} "
            "episodes, each from the next run in turn"
        )
    return f"at most {limit} problems with an active constraint: {which}"


class Recorder:
    """An `Observer` that keeps the problems of the chosen updates; call `next_episode` after each update.

    runs: which ones the training advances in lockstep, in order; chosen: by `stretches`; training: its name.
    A problem without an active constraint (its answer is d = g) is not kept, nor is one that was only handed to
    another solver. Memory: the kept problems, and those of one update. ValueError for problems with a metric: a step
    solves its own where M = I.
    """

    def __init__(self, runs: Sequence[int], chosen: Sequence[Stretch], training: str, selection: str = "") -> None:
        self.training, self.selection = training, selection
        self.episode = 1
        self._positions = {run: position for position, run in enumerate(runs)}
        self._kept: list[dict[str, Any]] = []  # a row of the recording each
        self._room = {k: own.room for k, own in enumerate(chosen) if own.run in self._positions}
        self._chosen = chosen
        self._update: _Update | None = None
        self._shape = (0, 1)

    def __call__(self, problems: ProblemBatch, answers: DirectionBatch) -> None:  # noqa: ARG002 - an Observer
        """Keeps what belongs to the chosen updates; the first call after `next_episode` has every run's problems."""
        if problems.metric is not None:
            raise ValueError("problems to record should have no metric; found one that has")
        self._shape = problems.jacobian.shape[1:]
        is_open = [k for k in self._room if self._chosen[k].first <= self.episode <= self._chosen[k].last]
        if not is_open:
            return
        if self._update is None:
            self._update = _Update(problems, len(self._positions))
        wanted = {self._positions[self._chosen[k].run]: k for k in is_open}
        for row, position, part in self._update.news(problems, list(wanted)):
            k = wanted[position]
            if (problems.bound[row] > -np.inf).any() and self._room[k]:
                self._room[k] -= 1
                where = {"run": self._chosen[k].run, "episode": self.episode, "part": part, "stretch": k}
                radius = np.inf if problems.radius is None else problems.radius[row]
                arrays = {name: getattr(problems, name)[row].copy() for name in _ARRAYS}
                self._kept.append(where | arrays | {"radius": np.float64(radius)})

    def next_episode(self) -> None:
        """The update is done."""
        self.episode += 1
        self._update = None

    def recording(self) -> Recording:
        """What was kept so far."""
        if not self._kept:
            return empty_recording([self.training], self.selection, *self._shape)
        rows = sorted(self._kept, key=lambda row: (row["run"], row["episode"], row["part"]))
        arrays = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
        zeros = np.zeros(len(rows), np.int64)
        return Recording(**arrays, training=zeros, trainings=(self.training,), selection=self.selection)


class _Update:
    """One update's problems so far: which run a later, smaller batch speaks of, and what was met before.

    With a radius the tangents come first and alone, since restorations know none; without one both come together.
    """

    def __init__(self, problems: ProblemBatch, runs: int) -> None:
        if len(problems) not in (runs, 2 * runs):
            raise ValueError(
                f"the first problems of an update should be one or two for each of {runs} runs; found {len(problems)}"
            )
        self.runs = runs
        self.jacobians = problems.jacobian[:runs].copy()
        self.met: set[bytes] = set()
        self.in_balls = problems.radius is not None
        self.awaited = [True, False] if self.in_balls else [False]  # whether the next whole batch has a radius

    def news(self, problems: ProblemBatch, positions: list[int]) -> list[tuple[int, int, int]]:
        """(row, run's position, part) of the problems of these runs that were not met in this update before."""
        has_ball, count = problems.radius is not None, len(problems)
        apart = int(self.in_balls and not has_ball)  # 1 for a restoration in a batch of its own
        if self.awaited[:1] == [has_ball]:
            rows = [(row, row % self.runs, apart + row // self.runs) for row in range(count)]
            self.awaited.pop(0)
        else:  # after a drop, for some of the runs: tangents, then restorations. J tells whose they are.
            second = 0 if apart else count if self.in_balls else count // 2
            rows = [
                (row, position, 2 + (row >= second))
                for row in range(count)
                for position in positions
                if np.array_equal(problems.jacobian[row], self.jacobians[position])
            ]
        fresh = []
        for row, position, part in rows:
            if position in positions:
                arrays = b"".join(getattr(problems, name)[row].tobytes() for name in _ARRAYS)
                key = b"%d %d " % (position, has_ball) + arrays
                if key not in self.met:
                    self.met.add(key)
                    fresh.append((row, position, part))
        return fresh
