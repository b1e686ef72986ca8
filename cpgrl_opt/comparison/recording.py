"""Direction problems met in training: an exact `.npz` of them, and how it is read back.

Every array is float64, int64 or bool of one row per problem, so that a file holds the problems bit for bit, is read
without unpickling anything, and the same problems give the same bytes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Bool, Float, Int
from ..problem import DirectionProblem, ProblemBatch
from .recording_file import read_arrays

FORMAT = "cpgrl recording 1"
FORMAT_WITH_RADIUS = "cpgrl recording 2"  # has one array more; what has no ball is written as ever
# What an update solves: PΔ¹ and the restoration (one problem in the formulation "restoring"), both again after a drop.
PARTS = ("tangent", "restoration", "tangent after a drop", "restoration after a drop")
SHIPPED = ("three-state", "arm")
_ROWS = ("training", "run", "episode", "part", "stretch")
_TEXTS = ("format", "trainings", "selection")


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """P direction problems of one shape and where each comes from, ordered by training, run, episode and part.

    gradient g: (P, n); jacobian J: (P, m, n); bound b, equality: (P, m); as in `ProblemBatch`.
    training: (P,), index into `trainings`, the names of what was trained; run: from 0; episode: the one before the
    update, from 1; part: index into PARTS; stretch: problems of one training, run and stretch come from updates that
    follow each other. selection: in words, which problems were kept.
    Raises ValueError for arrays that do not fit together or that no direction problem may have.
    """

    gradient: Float[np.ndarray, "P n"]
    jacobian: Float[np.ndarray, "P m n"]
    bound: Float[np.ndarray, "P m"]
    equality: Bool[np.ndarray, "P m"]
    training: Int[np.ndarray, "P"]
    run: Int[np.ndarray, "P"]
    episode: Int[np.ndarray, "P"]
    part: Int[np.ndarray, "P"]
    stretch: Int[np.ndarray, "P"]
    trainings: tuple[str, ...]
    selection: str
    radius: Float[np.ndarray, "P"] | None = None

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            if name != "radius" or self.radius is not None:
                _require_kind(name, getattr(self, name))
        if self.radius is None:
            object.__setattr__(self, "radius", np.full(len(self.gradient), np.inf))
        _require_unicode(self.selection, *self.trainings)
        for name in _ROWS:
            array = getattr(self, name)
            if array.shape != (len(self.gradient),) or (array < 0).any():
                raise ValueError(
                    f"{name} should hold {len(self.gradient)} integers ≥ 0; found shape {array.shape}, "
                    f"least {array.min(initial=0)}"
                )
        for name, names in (("training", self.trainings), ("part", PARTS)):
            if (getattr(self, name) >= len(names)).any():
                raise ValueError(f"{name} should be below {len(names)}; found {getattr(self, name).max()}")
        if self.radii.shape != (len(self.gradient),) or not (self.radii > 0).all():
            raise ValueError(f"radius should hold {len(self.gradient)} numbers > 0; found {self.radii}")
        _ = self._without_balls  # checks the problems

    @property
    def radii(self) -> Float[np.ndarray, "P"]:
        """(P,), inf for a problem without a ball."""
        return np.asarray(self.radius)

    @cached_property
    def _without_balls(self) -> ProblemBatch:
        return ProblemBatch(self.gradient, self.jacobian, self.bound, self.equality)

    @cached_property
    def batch(self) -> ProblemBatch:
        """All problems, stacked. ValueError where some have a radius and some not."""
        has_ball = self.radii < np.inf
        if not has_ball.any():
            return self._without_balls
        if not has_ball.all():
            raise ValueError(f"problems of a batch should all have a radius, or none; found {has_ball.sum()} that have")
        return ProblemBatch(self.gradient, self.jacobian, self.bound, self.equality, radius=self.radii)

    @cached_property
    def problems(self) -> list[DirectionProblem]:
        """All problems, one by one."""
        return [_in_ball(problem, float(r)) for problem, r in zip(self._without_balls, self.radii, strict=True)]

    @cached_property
    def sequences(self) -> list[list[int]]:
        """Indices of problems that a run met one after the other: a list for each training, run, stretch and part."""
        found: dict[tuple[int, ...], list[int]] = {}
        for index, key in enumerate(zip(self.training, self.run, self.stretch, self.part, strict=True)):
            found.setdefault(tuple(map(int, key)), []).append(index)
        return list(found.values())

    def __len__(self) -> int:
        return len(self.gradient)

    def select(self, rows: Any) -> "Recording":
        """The problems that an index array, a mask or a slice names."""
        arrays = {name: getattr(self, name)[rows] for name in _ARRAYS}
        return Recording(**arrays, trainings=self.trainings, selection=self.selection)

    def as_inequalities(self) -> "Recording":
        """The same with Jᵢd ≥ bᵢ for every Jᵢd = bᵢ: what the formulation "cone" asks at the same θ."""
        return replace(self, equality=np.zeros_like(self.equality))

    def save(self, path: Path) -> None:
        """Writes the `.npz`; the same recording, the same bytes."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        has_balls = bool((self.radii < np.inf).any())
        if not has_balls:
            del arrays["radius"]
        written = FORMAT_WITH_RADIUS if has_balls else FORMAT
        texts: dict[str, Any] = {"format": np.array(written), "selection": np.array(self.selection)}
        # No `allow_pickle`, which NumPy before 2.2 stores as one more array; no bare path, which would get a suffix.
        with Path(path).open("wb") as file:
            np.savez_compressed(file, **arrays, **texts, trainings=np.array(self.trainings, str))


def _in_ball(problem: DirectionProblem, radius: float) -> DirectionProblem:
    if radius == np.inf:
        return problem
    return DirectionProblem(problem.gradient, problem.jacobian, problem.bound, problem.equality, radius=radius)


_ARRAYS = tuple(field.name for field in fields(Recording) if field.name not in _TEXTS)
_TYPES = {name: np.int64 if name in _ROWS else np.float64 for name in _ARRAYS} | {"equality": np.bool_}
_AXES = dict.fromkeys(_ARRAYS, 1) | {"jacobian": 3, "gradient": 2, "bound": 2, "equality": 2}


def join(recordings: Iterable[Recording]) -> Recording:
    """One recording of the problems of several, at least one, of one shape; trainings of one name are one training."""
    parts = list(recordings)
    shapes = {part.jacobian.shape[1:] for part in parts if len(part)}
    if len(shapes) > 1:
        raise ValueError(f"recordings should have problems of one shape (m, n); found {sorted(shapes)}")
    full = [part for part in parts if len(part)] or parts[:1]
    names = tuple(dict.fromkeys(name for part in parts for name in part.trainings))
    arrays = {name: np.concatenate([getattr(part, name) for part in full]) for name in _ARRAYS}
    own = [np.array([names.index(name) for name in part.trainings], np.int64)[part.training] for part in full]
    arrays["training"] = np.concatenate(own)
    order = np.lexsort([arrays[name] for name in ("part", "episode", "run", "training")])
    return Recording(
        **{name: array[order] for name, array in arrays.items()}, trainings=names, selection=parts[0].selection
    )


def load_recording(path: Path | str) -> Recording:
    """The recording that `Recording.save` wrote; nothing in the file is unpickled or run.

    Raises ValueError for a file that is not there or not such a recording.
    """
    contents = read_arrays(Path(path), (*_ARRAYS, *_TEXTS), optional=("radius",))
    try:
        texts = {name: _texts(name, contents.pop(name)) for name in _TEXTS}
        written = FORMAT_WITH_RADIUS if "radius" in contents else FORMAT
        if texts["format"] != (written,):
            raise ValueError(f"format should be {written!r}; found {texts['format'][0]!r}")
        return Recording(**contents, trainings=texts["trainings"], selection=texts["selection"][0])
    except ValueError as error:
        raise ValueError(f"{path} should be a recording, but its {error}") from error


def shipped_recording(name: str) -> Recording:
    """A small recording of the paper's experiments that comes with the package: "three-state" or "arm".

    README.md beside the files has the commands that made them.
    """
    if name not in SHIPPED:
        raise ValueError(f"a shipped recording should be one of {', '.join(SHIPPED)}; found {name!r}")
    return load_recording(shipped_path(name))


def shipped_path(name: str) -> Path:
    """The file of a shipped recording."""
    return Path(__file__).with_name("recorded") / f"{name}.npz"


def shipped_problem(rng: np.random.Generator, name: str, *, equality: bool) -> DirectionProblem:
    """One of the problems of a shipped recording, as it was or with inequalities in place of the equalities."""
    problems = _shipped_problems(name, equality)
    return problems[int(rng.integers(len(problems)))]


@cache
def _shipped_problems(name: str, equality: bool) -> Sequence[DirectionProblem]:
    recording = shipped_recording(name)
    return (recording if equality else recording.as_inequalities()).problems


def _require_kind(name: str, array: Any) -> None:
    if not isinstance(array, np.ndarray) or array.dtype != _TYPES[name]:
        found = getattr(array, "dtype", type(array).__name__)
        raise ValueError(f"{name} should be an array of {np.dtype(_TYPES[name])}; found {found}")
    if array.ndim != _AXES[name]:
        raise ValueError(f"{name} should have {_AXES[name]} axes; found shape {array.shape}")


def _texts(name: str, array: np.ndarray) -> tuple[str, ...]:
    if array.dtype.kind != "U" or array.ndim > (name == "trainings"):
        raise ValueError(f"{name} should be text; found {array.dtype} of shape {array.shape}")
    return tuple(map(str, array.reshape(-1)))


def _require_unicode(*texts: str) -> None:
    for text in texts:
        try:
            text.encode()
        except UnicodeEncodeError as error:
            raise ValueError(f"texts should be Unicode; found {text!a}") from error


def empty_recording(trainings: Sequence[str], selection: str, m: int = 0, n: int = 1) -> Recording:
    """A recording of no problem, of shape (m, n)."""
    rows = {name: np.zeros(0, np.int64) for name in _ROWS}
    return Recording(
        gradient=np.zeros((0, n)),
        jacobian=np.zeros((0, m, n)),
        bound=np.zeros((0, m)),
        equality=np.zeros((0, m), np.bool_),
        **rows,
        trainings=tuple(trainings),
        selection=selection,
    )
