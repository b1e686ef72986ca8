"""`--record N`: direction problems met in a training, into `subproblems.npz` among the results."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt.comparison.recorder import Recorder, in_words, stretches
from cpgrl_opt.comparison.recording import Recording, join

FILE = "subproblems.npz"


class SubproblemRecorder(Recorder):
    """Keeps at most `limit` problems of these runs of a training of `of` runs.

    saved: of a training that goes on, what its checkpoint holds.
    """

    def __init__(
        self, limit: int, training: str, runs: Sequence[int], *, of: int, episodes: int,
        saved: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        self.before = None if saved is None else Recording(**saved["recording"])
        chosen = stretches(limit, of, episodes)
        kept = np.bincount(() if self.before is None else self.before.stretch, minlength=len(chosen))
        left = [replace(each, room=each.room - int(own)) for each, own in zip(chosen, kept, strict=True)]
        super().__init__(runs, left, training, in_words(limit, chosen, episodes))
        self.episode = 1 if saved is None else saved["training"]["episode"] + 1

    def recording(self) -> Recording:
        """What was kept so far."""
        recording = super().recording()
        return recording if self.before is None else join([self.before, recording])

    def state(self) -> dict[str, Any]:
        """The recording as plain values."""
        recording = self.recording()
        return {field.name: getattr(recording, field.name) for field in fields(recording)}


def join_recordings(recordings: Iterable[Recording | None]) -> Recording | None:
    """One of all; None where nothing was recorded.

    Parameters
    ----------
    recordings
        None where nothing was recorded.

    Returns
    -------
    Recording or None
        Of all, in their order.
    """
    parts = [part for part in recordings if part is not None]
    return join(parts) if parts else None


def write_subproblems(recordings: Iterable[Recording | None], directory: Path) -> list[str]:
    """The file, if there is a recording; and sentences on what it holds, and what it does not.

    A file has problems of one shape, the first training's: with a ridge they have m parameters more.

    Parameters
    ----------
    recordings
        One a training.
    directory
        For the file.

    Returns
    -------
    list of str
        Sentences.
    """
    parts = [part for part in recordings if part is not None]
    shape = next((part.jacobian.shape[1:] for part in parts if len(part)), None)
    fitting = [part for part in parts if not len(part) or part.jacobian.shape[1:] == shape]
    recording = join_recordings(fitting)
    if recording is None:
        return []
    recording.save(directory / FILE)
    others = [name for part in parts if part not in fitting for name in part.trainings]
    left_out = [f"{FILE} leaves out {'; '.join(others)}: problems of another shape."] if others else []
    each = " (of each training)" if len(recording.trainings) > 1 else ""
    held = f"{len(recording)} direction problems in {len(recording.sequences)} sequences"
    return [f"{FILE} holds {held}: {recording.selection}{each}.", *left_out]
