"""Settings of a step, checked once."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from .active_set import ACTIVE_SET_RULES, ActiveSetRule, violated
from .arrays import ArrayLike, Float, Number
from .direction import DirectionBatch
from .formulation import FORMULATIONS
from .metric import Whitening, check_metric
from .metric_operator import ITERATIONS, TOLERANCE, require_limits
from .problem import ProblemBatch
from .settings import CheckedSettings
from .solvers import SOLVERS, ActiveSet, DirectionSolver, Rosen, facts_of, find_solver, tolerance_of
from .validation import real_values, require_member, require_nonnegative, require_positive
from .vectors import is_long, kind_of
from .vectors._structure import map_leaves
from .vectors._trees import is_tree

Observer = Callable[[ProblemBatch, DirectionBatch], None]

DROP_RULES = ("never", "stationary", "always")
ON_FAILURE = ("fallback", "skip", "raise")
# Of their answers PΔ¹ = 0 is seen as well as by the closed form.
CLOSED_FORM = (ActiveSet, Rosen)
_WITHOUT_RADIUS, _WITH_RADIUS = 0.02, 1.0  # the paper's α₁; a step as long as the radius


@dataclass(frozen=True, kw_only=True)
class StepSettings(CheckedSettings):
    """The settings of `ConstrainedStep`, which says what they mean."""

    solver: DirectionSolver | str = field(default_factory=lambda: SOLVERS["active-set"])
    formulation: str = "equality"
    rule: ActiveSetRule | str = violated
    step_size: Number | None = None
    restoration_rate: Number = 0.02
    slack_fraction: Number = 1.0
    drop: str = "stationary"
    raw_multipliers: bool = False
    ridge: Number = 0.0
    max_restoration: Number = np.inf
    on_failure: str = "fallback"
    metric: ArrayLike | Callable[[Any], Any] | None = field(default=None, compare=False)
    radius: Number | None = None
    metric_tolerance: Number = TOLERANCE
    metric_iterations: Number = ITERATIONS
    _metric_bytes: bytes = field(default=b"", init=False, repr=False)  # by which steps compare and hash
    _whitening: Whitening | None = field(default=None, init=False, repr=False, compare=False)  # L of M = LLᵀ

    def __post_init__(self) -> None:
        self._look_up_names()
        if self.step_size is None:
            vars(self).update(step_size=_WITHOUT_RADIUS if self.radius is None else _WITH_RADIUS)
        self._check_numbers()
        self._check_formulation()
        require_limits(self.metric_tolerance, self.metric_iterations)
        if self.metric is not None:
            self._take_metric()

    def _take_metric(self) -> None:
        metric: Any = self.metric
        whitening: Whitening | None = None
        if callable(metric) and not isinstance(metric, type):
            vars(self).update(_metric_bytes=str(id(metric)).encode())
            return
        if self.metric_is_tree:  # whose leaves are put in the gradients' order when these are known
            vars(self).update(metric=deepcopy(metric))
            tree: Any = kind_of(metric, [])
            metric = check_metric(row := tree.whole_gradient(), len(row))[0]
        else:
            metric, whitening = check_metric(metric, len(np.atleast_1d(real_values("metric", metric))))
            vars(self).update(metric=metric)
        form = repr(map_leaves(np.shape, self.metric) if self.metric_is_tree else metric.shape).encode()
        vars(self).update(_whitening=whitening, _metric_bytes=form + metric.tobytes())

    @property
    def metric_is_tree(self) -> bool:
        """Whether the metric came as a tree of arrays, as gradients do."""
        return isinstance(self.metric, list | tuple | dict) and is_tree(self.metric)

    def __setstate__(self, state: dict[str, Any]) -> None:
        # What follows from the settings is found anew: older states may lack it, or have it in another form.
        names = {each.name for each in fields(self)}
        vars(self).update({name: value for name, value in state.items() if name in names})
        self.__post_init__()

    def _look_up_names(self) -> None:
        vars(self).update(solver=find_solver(self.solver))
        if isinstance(self.rule, str):
            require_member("rule", self.rule, tuple(ACTIVE_SET_RULES))
            vars(self).update(rule=ACTIVE_SET_RULES[self.rule])
        if isinstance(self.rule, type) or not callable(self.rule):
            raise ValueError(f"rule should be a name or a function (slack, previous) → mask; found {self.rule!r}")
        require_member("formulation", self.formulation, tuple(FORMULATIONS))
        require_member("drop", self.drop, DROP_RULES)
        require_member("on_failure", self.on_failure, ON_FAILURE)

    def _check_numbers(self) -> None:
        for name in ("step_size", "restoration_rate", "slack_fraction", "ridge"):
            require_nonnegative(name, getattr(self, name))
        if self.slack_fraction > 1:
            raise ValueError(f"slack_fraction should be a number in [0, 1]; found {self.slack_fraction!r}")
        require_nonnegative("max_restoration", self.max_restoration, allow_infinite=True)
        if self.radius is not None:
            require_positive("radius", self.radius)
            if not facts_of(self.solver).takes_geometry:
                raise ValueError(f"solver should take a radius (see WithGeometry); found {self.solver!r}")
        super().__post_init__()

    def _check_formulation(self) -> None:
        of, known = FORMULATIONS[self.formulation], f"with formulation {self.formulation!r}"
        restoration, step = float(self.restoration_rate), float(self.step_size)  # type: ignore[arg-type]
        if of.restores_inside and step == 0:
            raise ValueError(f"step_size should be > 0 {known}, which divides by it; found 0")
        if of.restores_inside and restoration / step == np.inf:
            raise ValueError(f"restoration_rate / step_size should be finite {known}; found {restoration} / {step}")
        if of.takes_all and self.ridge > 0:
            raise ValueError(f"ridge should be 0 {known}, whose bounds it would soften; found {self.ridge!r}")
        if of.takes_all and self.rule is not violated:  # others may change the slack and not the set
            raise ValueError(f"rule should be the default {known}, which takes all constraints; found {self.rule!r}")

    @cached_property
    def _direct(self) -> Float[np.ndarray, "8"] | None:
        """What `direct_step.move_parameters` takes of these settings; None where they need more than it does."""
        is_plain = self.ridge == 0 and self.max_restoration == np.inf and self.radius is None
        drops_always = self.formulation == "equality" and self.drop == "always"
        if type(self.solver) not in CLOSED_FORM or not is_plain or drops_always:
            return None
        of = FORMULATIONS[self.formulation]
        kind = type(self.solver) is Rosen, of.is_equality, of.restores_inside, of.takes_all
        rates = self.step_size, self.restoration_rate, self.slack_fraction
        return np.array([*kind, *rates, tolerance_of(self.solver)], np.float64)

    def usual_way(self, m: int, n: int) -> Float[np.ndarray, "8"] | None:
        """What `move_parameters` takes, after 𝒜 = {i : slackᵢ ≤ 0}, where that is all of a step; None where not."""
        needs_more = self.rule is not violated or self.metric is not None or is_long(m, n)
        return None if needs_more else self._direct
