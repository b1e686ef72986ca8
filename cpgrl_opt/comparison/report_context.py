"""What a report says about its making, beside the numbers."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ReportContext:
    """How the measurements came about.

    command: what to type to get them again; machine, versions, settings: name → value, shown in this order (seconds
    limits with their unit in the name); families: name → the reason it exists, in the order to show; wall_seconds: of
    the whole comparison; default_solver: whose time is 1; ill_posed: families of which float64 does not determine the
    direction, so that distances from the exact one are told apart from the others.
    """

    command: str
    machine: Mapping[str, object]
    versions: Mapping[str, object]
    settings: Mapping[str, object]
    families: Mapping[str, str]
    seed: int
    wall_seconds: float
    default_solver: str = "active-set"
    ill_posed: Collection[str] = ()
