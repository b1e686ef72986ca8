"""Active-set rules: which constraints enter the subproblem.

A rule maps the slack ρ − G and the previous active set to the new one. State is explicit: whoever steps keeps the
set that a step returns. Settings are fixed by `functools.partial(violated, margin=0.1)`.
"""

from typing import Protocol, runtime_checkable

import numpy as np

from .arrays import ArrayLike, Bool, Float, Number
from .validation import boolean_array, real_values, require_nonnegative, require_number, require_shape


@runtime_checkable
class ActiveSetRule(Protocol):
    """(slack, previous active set) → active set; arrays may carry leading axes, one row for each run."""

    def __call__(
        self, slack: Float[np.ndarray, "*runs m"], previous: Bool[np.ndarray, "*runs m"] | None = None
    ) -> Bool[np.ndarray, "*runs m"]:
        """True where the constraint enters the subproblem."""


def violated(
    slack: ArrayLike,
    previous: Bool[np.ndarray, "*runs m"] | None = None,  # noqa: ARG001 - a rule without memory
    *,
    margin: Number = 0.0,
) -> Bool[np.ndarray, "*runs m"]:
    """𝒜 = {i : ρⁱ − Gⁱ ≤ margin}; margin 0 is the paper's (§2.3).

    Parameters
    ----------
    slack
        ρ − G, (…, m), in the unit of the constraints, as margin is
    previous
        not looked at; a rule without memory
    margin
        at least 0

    Returns
    -------
    array
        (…, m), True where the constraint is in 𝒜

    Raises
    ------
    ValueError
        NaN in slack, or a negative margin.
    """
    require_nonnegative("margin", margin)
    return np.asarray(_check_slack(slack) <= margin)


def hysteresis(
    slack: ArrayLike, previous: ArrayLike | None = None, *, enter: Number = 0.0, leave: Number = 0.01
) -> Bool[np.ndarray, "*runs m"]:
    """𝒜 = {i : slackᵢ ≤ enter} ∪ {i ∈ 𝒜_previous : slackᵢ ≤ leave}: noise about the threshold does not toggle it.

    Parameters
    ----------
    slack
        ρ − G, (…, m), in the unit of the constraints, as enter and leave are
    previous
        (…, m), 𝒜_previous; None: empty
    enter, leave : numbers, enter ≤ leave

    Returns
    -------
    array
        (…, m), True where the constraint is in 𝒜

    Raises
    ------
    ValueError
        NaN in slack, previous of another shape or not Boolean, or leave < enter.
    """
    for name, value in (("enter", enter), ("leave", leave)):
        require_number(name, value)
    require_nonnegative("leave − enter", leave - enter)
    slack = _check_slack(slack)
    entered = slack <= enter
    if previous is None:
        return entered
    stays = boolean_array("previous", previous)
    require_shape("previous", stays, slack.shape)
    return entered | (stays & (slack <= leave))


def _check_slack(slack: ArrayLike) -> Float[np.ndarray, "*runs m"]:
    array = real_values("slack", slack)
    if np.isnan(array).any():  # which no comparison would tell: a constraint would never be active
        raise ValueError("slack should have no NaN; found some")
    return array


ACTIVE_SET_RULES: dict[str, ActiveSetRule] = {"violated": violated, "hysteresis": hysteresis}
