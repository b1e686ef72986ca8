"""`--record N`: direction problems met in a training, into `subproblems.npz` among the results."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from cpgrl_opt.comparison.recorder import Recorder, in_words, stretches
from cpgrl_opt.comparison.recording import Recording, joined

FILE = "subproblems.npz"


def subproblem_recorder(limit: int, training: str, runs: Sequence[int], *, of: int, episodes: int) -> Recorder | None:
    """Watches these runs of a training of `of` runs, which keeps at most `limit` problems; None for limit 0."""
    if limit == 0:
        return None
    chosen = stretches(limit, of, episodes)
    return Recorder(runs, chosen, training, in_words(limit, chosen, episodes))


def joined_recordings(recordings: Iterable[Recording | None]) -> Recording | None:
    """One of all; None where nothing was recorded."""
    parts = [part for part in recordings if part is not None]
    return joined(parts) if parts else None


def write_subproblems(recordings: Iterable[Recording | None], directory: Path) -> list[str]:
    """The file, if there is a recording; and sentences on what it holds, and what it does not.

    A file has problems of one shape, the first training's: with a ridge they have m parameters more.
    """
    parts = [part for part in recordings if part is not None]
    shape = next((part.jacobian.shape[1:] for part in parts if len(part)), None)
    fitting = [part for part in parts if not len(part) or part.jacobian.shape[1:] == shape]
    recording = joined_recordings(fitting)
    if recording is None:
        return []
    recording.save(directory / FILE)
    others = [name for part in parts if part not in fitting for name in part.trainings]
    left_out = [f"{FILE} leaves out {'; '.join(others)}: problems of another shape."] if others else []
    each = " (of each training)" if len(recording.trainings) > 1 else ""
    held = f"{len(recording)} direction problems in {len(recording.sequences)} sequences"
    return [f"{FILE} holds {held}: {recording.selection}{each}.", *left_out]
