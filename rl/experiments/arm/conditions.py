"""What the arm is trained to: the paper's columns of Fig. 7, and ours beside them."""

from dataclasses import dataclass

PAPER = ("a", "b", "c")  # the columns of Fig. 7


@dataclass(frozen=True)
class Condition:
    """What is asked of a training besides r¹.

    title: for figures; thresholds (G², G³), None without constraints; average: whether ρ of r¹, r², r³ is per step or
    per episode; projected: whether the gradient is projected, as CPGRL does.
    """

    title: str
    thresholds: tuple[float, float] | None
    average: tuple[str, str, str] = ("step", "step", "step")
    projected: bool = True


# a, b, c are the paper's; the others are ours.
CONDITIONS = {
    "a": Condition("no constraints", None),
    "b": Condition("$G^2 = G^3 = 0$", (0.0, 0.0)),
    "c": Condition("$G^2 = 0$, $G^3 = 0.5$", (0.0, 0.5)),
    "c-episode": Condition("$G^3 = 0.5$ per episode", (0.0, 0.5), ("step", "step", "episode")),
    "c-feasible": Condition("$G^3 = 0.1$", (0.0, 0.1)),
    "c-no-projection": Condition("$G^3 = 0.5$, without $P$", (0.0, 0.5), projected=False),
}


def threshold_of_r3(condition: str) -> float:
    """G³; ValueError where there is none.

    Parameters
    ----------
    condition
        A name of CONDITIONS.

    Returns
    -------
    float
        Reward per step or per episode, as the condition averages.

    Raises
    ------
    ValueError
        Where the condition has no thresholds.
    """
    thresholds = CONDITIONS[condition].thresholds
    if thresholds is None:
        raise ValueError(f"condition should have thresholds; found {condition!r}")
    return thresholds[1]
