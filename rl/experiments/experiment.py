"""What an experiment declares: settings, trainings, records, claims, figures, comparisons; `runner` does the rest.

An experiment is one file: a subclass of `Experiment`, and a line in `registry`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.solvers import compile_kernels
from cpgrl_opt.step import Observer
from cpgrl_opt.validation import require_count

from ..streams import MOST_COUNTED, MOST_RUNS
from ..training import Training, TrainingRecord
from .claims import Claim
from .comparison import Comparison
from .messages import Outcome

# How each is drawn, by the name of its PNG and SVG; of one file, such as fig.gif, how it is written to its path.
Figures = Mapping[str, Callable[..., Any]]


def option(default: Any, words: str) -> Any:
    """A setting that the command has as an option; words: its help."""
    return field(default=default, metadata={"words": words})


@dataclass(frozen=True, kw_only=True)
class TrainingCase:
    """One training of an experiment.

    label: its name in progress, files and results; episodes: how many, with a record after each `every`, and before
    the first if from_start; solver: of its directions, "" for none. in_learning: `learning.csv` has it; by_cpgrl: its
    speed counts as CPGRL's; kept: --record keeps its direction problems. rank: what takes long begins early, 0 first.
    """

    label: str
    episodes: int
    every: int
    from_start: bool = False
    solver: str = ""
    in_learning: bool = True
    by_cpgrl: bool = False
    kept: bool = False
    rank: int = 0


class CaseRecorder:
    """What is recorded of a training. carried: names of attributes that hold what it has seen since its last record."""

    carried: ClassVar[tuple[str, ...]] = ()

    def see(self, record: TrainingRecord) -> Mapping[str, np.ndarray]:
        """Looks at an update; returns events of its own to count, (R,) by name."""
        raise NotImplementedError

    def values(self) -> dict[str, np.ndarray]:
        """The record, (R, …) by name; begins the next one."""
        raise NotImplementedError

    def totals(self) -> dict[str, float]:
        """What it summed over all runs and updates."""
        return {}


@dataclass(frozen=True, eq=False)
class Results:
    """What an experiment found, by the labels of its cases: what its `curves` makes of the records, and costs."""

    settings: Any
    curves: Mapping[str, Any]
    outcomes: Mapping[str, Outcome]


@dataclass(frozen=True, kw_only=True)
class Experiment(ABC):
    """An experiment with its settings, the paper's (§3.1) unless given.

    runs, episodes N_K, steps N_T per episode (at most), seed, record_every (episodes between two records): whole
    numbers. record: how many direction problems of each training to keep, 0 for none. solver, formulation: names from
    SOLVERS and FORMULATIONS, for CPGRL. step_size α₁, restoration_rate αₑ, average_rate α_r, trace_decay β. gradient,
    bias_correction: of the estimator; eq. 3 and 4 as printed.
    Raises ValueError for bad numbers and unknown names.
    """

    name: ClassVar[str]  # of the command
    about: ClassVar[str]  # in a line
    key: ClassVar[str]  # heading of the trainings' labels
    recorded: ClassVar[Mapping[str, Sequence[str]]]  # headings of `learning.csv` by the name of a recorded value
    files: ClassVar[tuple[str, ...]] = ()  # beside those of every experiment
    splits: ClassVar[bool] = True  # a training's runs may be shared out over processes

    runs: int = option(20, "Independent runs of each training.")
    episodes: int = option(10_000, "Episodes of a run; an update follows each.")
    steps: int = 100
    seed: int = option(0, "Seed of all random streams.")
    solver: str = option("rosen", "CPGRL's direction solver; `cpgrl solvers` lists them.")
    formulation: str = option("equality", "Of the subproblem: equality, cone, restoring, linearized.")
    record_every: int = option(100, "Episodes between two rows of a run in learning.csv.")
    record: int = option(0, "Direction problems of each training to keep in subproblems.npz; 0 for none.")
    step_size: float = 0.02
    restoration_rate: float = 0.02
    average_rate: float = 0.02
    trace_decay: float = 0.99
    gradient: str = "episode mean"
    bias_correction: bool = False

    def __post_init__(self) -> None:
        require_count("runs", self.runs, most=MOST_RUNS)
        for name in ("episodes", "steps", "record_every"):
            require_count(name, getattr(self, name), most=MOST_COUNTED)
        for name in ("seed", "record"):
            require_count(name, getattr(self, name), 0)
        self.step()

    def step(self, **changes: Any) -> ConstrainedStep:
        """CPGRL's step, but for what is given."""
        settings: dict[str, Any] = {
            "solver": self.solver,
            "formulation": self.formulation,
            "step_size": self.step_size,
            "restoration_rate": self.restoration_rate,
        }
        return ConstrainedStep(**(settings | changes))

    def estimator_settings(self) -> dict[str, Any]:
        """Settings of an estimator of eq. 3 and 4."""
        names = ("trace_decay", "average_rate", "steps", "gradient", "bias_correction")
        return {name: getattr(self, name) for name in names}

    @abstractmethod
    def cases(self) -> Sequence[TrainingCase]:
        """What is trained, in the order of the results."""

    @abstractmethod
    def begin(self, case: Any, runs: Sequence[int], observe: Observer | None = None) -> tuple[Training, CaseRecorder]:
        """These runs of a training, and who records it; observe: sees the direction problems if they are kept."""

    @staticmethod
    def measure(record: TrainingRecord) -> dict[str, np.ndarray]:
        """What a sweep records: arrays (R, 1 + m) by name."""
        return {"value": record.estimate.values}

    def prepare(self, case: Any) -> None:  # noqa: ARG002 - for those that need less
        """Compiles what the training may need, before its clock runs."""
        compile_kernels()

    def curves(self, case: Any, episodes: np.ndarray, values: Mapping[str, np.ndarray]) -> Any:  # noqa: ARG002
        """What claims, figures and comparisons look at: records at E episodes, (R, E, …) by name."""
        return values

    @abstractmethod
    def claims(self, results: Results) -> list[Claim]:
        """Statements about the results, judged."""

    def figures(self, results: Results) -> Figures:  # noqa: ARG002
        """Those of the results."""
        return {}

    def comparisons(self) -> Sequence[Comparison]:
        """Tables of trainings, where they are asked for."""
        return ()

    def summary(self, results: Results) -> dict[str, Any]:  # noqa: ARG002
        """What `summary.json` holds besides what it holds of every experiment."""
        return {}

    def summary_of(self, case: Any, results: Results) -> dict[str, Any]:  # noqa: ARG002
        """The same of one training."""
        return {}

    def remarks(self) -> list[str]:
        """Sentences for whoever reads the results."""
        return []
