"""The paper's first experiment (§3): CPGRL, CONB and SUM on the three-state MDP, beside exact averages."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.arrays import Float
from cpgrl_opt.comparison.recording import Recording
from cpgrl_opt.solvers import compile_kernels
from cpgrl_opt.step import Observer
from cpgrl_opt.validation import require_count
from envs import ThreeStateMDP
from envs.tabular import ConstrainedOptimum

from ..estimators import GPOMDP
from ..learners import CPGRL, ConstraintSwitching, Learner, WeightedSum
from ..policies import SoftmaxTable
from ..streams import MOST_RUNS
from ..training import Training, TrainingRecord, uniform_parameters
from .checkpoints import Checkpoint, Checkpoints, as_columns, from_columns
from .learning_curves import LearningCurves
from .solver_cases import require_installed
from .subproblems import SubproblemRecorder, subproblem_recorder
from .tidy_csv import TidyCsv
from .workers import run_tasks

METHODS = ("cpgrl", "conb", "sum")
Listener = Callable[["Snapshot | Tick"], None]
_TICK = 0.2  # s between signs of life


@dataclass(frozen=True, kw_only=True)
class ThreeStateSettings:
    """Settings of the experiment; the defaults are the paper's (§3.1).

    runs, episodes N_K, steps N_T per episode, seed, record_every (episodes between two records): whole numbers.
    record: how many of CPGRL's direction problems to keep, 0 for none.
    solver, formulation: names from SOLVERS and FORMULATIONS, for CPGRL. step_size α₁, restoration_rate αₑ,
    average_rate α_r, trace_decay β, thresholds G², G³, G⁴ (reward per step). gradient: eq. 3 as printed,
    and bias_correction: eq. 4 as printed, from 0, see `GPOMDP`.
    Raises ValueError for bad numbers and unknown names.
    """

    runs: int = 20
    episodes: int = 10_000
    steps: int = 100
    seed: int = 0
    solver: str = "rosen"
    formulation: str = "equality"
    record_every: int = 100
    record: int = 0
    step_size: float = 0.02
    restoration_rate: float = 0.02
    average_rate: float = 0.02
    trace_decay: float = 0.99
    thresholds: tuple[float, ...] = (0.0, 0.0, 0.0)
    gradient: str = "episode mean"
    bias_correction: bool = False

    def __post_init__(self) -> None:
        require_count("runs", self.runs, most=MOST_RUNS)
        for name in ("episodes", "steps", "record_every"):
            require_count(name, getattr(self, name))
        for name in ("seed", "record"):
            require_count(name, getattr(self, name), 0)
        self.step()
        self.estimator()

    def step(self) -> ConstrainedStep:
        """CPGRL's step."""
        return ConstrainedStep(
            solver=self.solver,
            formulation=self.formulation,
            step_size=self.step_size,
            restoration_rate=self.restoration_rate,
        )

    def estimator(self) -> GPOMDP:
        """Eq. 3 and 4."""
        return GPOMDP(
            trace_decay=self.trace_decay, average_rate=self.average_rate, steps=self.steps,
            gradient=self.gradient, bias_correction=self.bias_correction,
        )  # fmt: skip

    def learner(self, method: str) -> Learner:
        """CPGRL, CONB or SUM by its name in METHODS."""
        if method == "cpgrl":
            return CPGRL(self.step(), self.thresholds)
        if method == "conb":
            return ConstraintSwitching(self.thresholds, step_size=self.step_size)
        return WeightedSum(step_size=self.step_size)


@dataclass(frozen=True)
class Snapshot:
    """All runs of a method after `episode` updates: θ and ρ as it is carried."""

    label: str
    episode: int
    parameters: Float[np.ndarray, "R n"]
    estimated: Float[np.ndarray, "R channels"]
    recorded: ClassVar[bool] = True


@dataclass(frozen=True)
class Tick:
    """A sign of life: the method has done so many episodes."""

    label: str
    episode: int


@dataclass(frozen=True)
class MethodOutcome:
    """What training one method cost.

    steps: of the environment; seconds: of training; preparation: s, compiling or loading before it; counts: how often
    the learner counted each event, over all runs and episodes; recording: of its direction problems, if wanted.
    """

    steps: int
    seconds: float
    preparation: float
    counts: Mapping[str, int] = field(default_factory=dict)
    recording: Recording | None = None

    @property
    def steps_per_second(self) -> float:
        """Environment steps per wall second of training."""
        return self.steps / self.seconds


@dataclass(frozen=True)
class ThreeStateResults:
    """What the experiment found: learning curves and costs by method, and the exact constrained optimum."""

    settings: ThreeStateSettings
    curves: Mapping[str, LearningCurves]
    outcomes: Mapping[str, MethodOutcome]
    optimum: ConstrainedOptimum


def train_three_state(
    settings: ThreeStateSettings,
    learning_csv: Path,
    *,
    processes: int = 1,
    listen: Listener | None = None,
    meanwhile: Callable[[], object] | None = None,
    checkpoints: Checkpoints | None = None,
) -> ThreeStateResults:
    """All three methods, each record into the CSV as it comes: whatever ends the training, what was done is there.

    processes: over which the methods are shared out; the numbers do not depend on it. listen: sees each snapshot and
    tick. meanwhile: see `run_tasks`. checkpoints: where each method goes on from, and keeps how far it is. Raises
    MissingPackageError, DivergenceError, WorkerDiedError, CheckpointError.
    """
    mdp = ThreeStateMDP()
    require_installed(settings.step().solver)
    with Recorder(mdp, learning_csv) as recorder:

        def heard(message: Snapshot | Tick) -> None:
            if isinstance(message, Snapshot):
                recorder.append(message)
            if listen is not None:
                listen(message)

        items = [(settings, method) for method in METHODS]
        task = partial(train_method, checkpoints=checkpoints)
        outcomes = run_tasks(task, items, heard, processes=processes, meanwhile=meanwhile)
    optimum = mdp.constrained_optimum(settings.thresholds)
    return ThreeStateResults(settings, recorder.curves(), dict(zip(METHODS, outcomes, strict=True)), optimum)


def train_method(
    item: tuple[ThreeStateSettings, str], report: Listener, checkpoints: Checkpoints | None = None
) -> MethodOutcome:
    """One method, all its runs in lockstep; reports a snapshot before the first update and at every record.

    Where it was stopped before, it reports what it had, and goes on.
    """
    settings, method = item
    started = perf_counter()
    for _ in _training(replace(settings, episodes=1, runs=1), method):
        pass  # kernels are compiled, or loaded from the cache, so that the clock below sees training alone
    if method == "cpgrl":  # the others solve no direction problems, and it only a few that are hard
        compile_kernels(thorough=False)
    course = _Course(settings, method, report, Checkpoint(checkpoints, method))
    for record in course.training:
        course.see(record)
    return course.outcome(course.begun - started)


class _Course:
    """A method under way, from its checkpoint if it has one: training, recorder, snapshots, counts, seconds."""

    def __init__(self, settings: ThreeStateSettings, method: str, report: Listener, checkpoint: Checkpoint) -> None:
        self.settings, self.method, self.report, self.checkpoint = settings, method, report, checkpoint
        self.begun = self.ticked = perf_counter()
        saved = checkpoint.read()
        self.watcher = _watcher(settings, method, saved)
        self.training = _training(settings, method, self.watcher)
        self.snapshots: list[Snapshot] = []
        self.before = 0.0  # seconds that it took until it was stopped
        # Summed over runs at the end.
        self.counted: dict[str, np.ndarray] = {"steps": np.zeros(settings.runs, dtype=np.int64)}
        if saved is None:
            nothing = np.zeros((settings.runs, len(settings.thresholds) + 1))
            self.tell(Snapshot(method, 0, self.training.parameters, nothing))
            return
        self.training.restore(saved["training"])
        self.counted, self.before = saved["counted"], saved["seconds"]
        for snapshot in from_columns(Snapshot, saved["snapshots"]):
            self.tell(snapshot)

    def tell(self, snapshot: Snapshot) -> None:
        self.snapshots.append(snapshot)
        self.report(snapshot)

    def see(self, record: TrainingRecord) -> None:
        """Counts, and reports what is to be reported after this update."""
        settings = self.settings
        if self.watcher is not None:
            self.watcher.next_episode()
        self.counted["steps"] += record.estimate.steps
        for name, number in record.update.counts.items():
            self.counted[name] = self.counted[name] + number if name in self.counted else number
        if record.episode % settings.record_every == 0 or record.episode == settings.episodes:
            self.tell(Snapshot(self.method, record.episode, record.parameters, record.estimate.values))
        elif perf_counter() - self.ticked > _TICK:
            self.ticked = perf_counter()
            self.report(Tick(self.method, record.episode))
        if self.checkpoint.is_due(at_the_end=record.episode == settings.episodes):
            self.save()

    def save(self) -> None:
        """The checkpoint."""
        self.checkpoint.write(
            {
                "training": self.training.state(),
                "snapshots": as_columns(self.snapshots),
                "counted": self.counted,
                "seconds": self.seconds(),
                "recording": None if self.watcher is None else self.watcher.state(),
            }
        )

    def seconds(self) -> float:
        return self.before + perf_counter() - self.begun

    def outcome(self, preparation: float) -> MethodOutcome:
        counts = {name: int(number.sum()) for name, number in self.counted.items()}
        recording = None if self.watcher is None else self.watcher.recording()
        return MethodOutcome(counts.pop("steps"), self.seconds(), preparation, counts, recording)


def _watcher(settings: ThreeStateSettings, method: str, saved: Mapping[str, Any] | None) -> SubproblemRecorder | None:
    if method != "cpgrl":  # the others have no direction problems
        return None
    runs = settings.runs
    return subproblem_recorder(settings.record, method, range(runs), of=runs, episodes=settings.episodes, saved=saved)


def _training(settings: ThreeStateSettings, method: str, observe: Observer | None = None) -> Training:
    """From θ₀ ~ U[0, 1]⁹ of each run."""
    mdp = ThreeStateMDP()
    size = mdp.states * mdp.actions
    return Training(
        mdp, SoftmaxTable(mdp.states, mdp.actions), settings.estimator(), settings.learner(method),
        episodes=settings.episodes, runs=settings.runs, seed=settings.seed, initial=uniform_parameters(size),
        observe=observe,
    )  # fmt: skip


class Recorder:
    """Snapshots, as they come, into `learning.csv` and into learning curves, exact averages beside the estimates."""

    def __init__(self, mdp: ThreeStateMDP, path: Path) -> None:
        channels = range(1, mdp.reward_channels + 1)
        columns = ["method", "run", "episode"]
        columns += [f"estimated_{channel}" for channel in channels] + [f"exact_{channel}" for channel in channels]
        self.mdp = mdp
        self.table = SoftmaxTable(mdp.states, mdp.actions)
        self.csv = TidyCsv(path, columns, METHODS)
        self.kept: dict[str, list[tuple[Snapshot, np.ndarray, np.ndarray]]] = {method: [] for method in METHODS}

    def append(self, snapshot: Snapshot) -> None:
        """A row for each run."""
        policies = self.table.probabilities(snapshot.parameters)
        exact = self.mdp.average_rewards(policies)
        self.kept[snapshot.label].append((snapshot, exact, policies))
        self.csv.append(
            [
                (snapshot.label, run, snapshot.episode, *estimated, *averages)
                for run, (estimated, averages) in enumerate(zip(snapshot.estimated, exact, strict=True))
            ]
        )

    def curves(self) -> dict[str, LearningCurves]:
        """What was recorded of each method."""
        return {
            method: LearningCurves(
                np.array([snapshot.episode for snapshot, _, _ in kept]),
                np.stack([snapshot.estimated for snapshot, _, _ in kept], axis=1),
                np.stack([exact for _, exact, _ in kept], axis=1),
                np.stack([policies for _, _, policies in kept], axis=1),
            )
            for method, kept in self.kept.items()
        }

    def __enter__(self) -> "Recorder":
        self.csv.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self.csv.__exit__(*error)
