"""Performance profiles (Dolan & Moré 2002): the share of problems solved within a factor of the fastest."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from .measurement import Measurement

Problem = tuple[str, int]  # family, number
Key = tuple[str, str]  # solver, variant


@dataclass(frozen=True)
class Profile:
    """ρ(τ) = |{p : t_p ≤ τ · min_s t_{p,s}}| / |P|, a step function.

    factors: the τ ≥ 1 at which it rises, increasing; shares: its value from there on. What is not a success is never
    solved, at any τ, so the last share is the share of successes.
    """

    factors: tuple[float, ...]
    shares: tuple[float, ...]

    def at(self, factor: float) -> float:
        """ρ(factor)."""
        return max(
            (share for start, share in zip(self.factors, self.shares, strict=True) if start <= factor), default=0.0
        )


def problems_met(measurements: Iterable[Measurement], variant: str) -> set[Problem]:
    """The problems that were put to any solver in this variant."""
    return {(each.family, each.problem) for each in measurements if each.variant == variant}


def problems_taken(measurements: Iterable[Measurement], variant: str) -> set[Problem]:
    """Of these, the ones that some solver takes."""
    return problems_met([each for each in measurements if each.outcome != "unsupported"], variant)


def performance_profiles(
    measurements: Sequence[Measurement], problems: Collection[Problem], variants: Collection[str]
) -> dict[Key, Profile]:
    """The profile of each solver × variant over these problems, the fastest being the fastest among all of them.

    A problem that a solver was not put to, or does not take, is one that it did not solve.
    """
    asked = set(problems)
    own = [each for each in measurements if each.variant in variants and (each.family, each.problem) in asked]
    fastest: dict[Problem, float] = {}
    for each in _successes(own):
        problem = (each.family, each.problem)
        fastest[problem] = min(_ratio(each), fastest.get(problem, _ratio(each)))
    factors: dict[Key, list[float]] = {(each.solver, each.variant): [] for each in own}
    for each in _successes(own):
        factors[each.solver, each.variant].append(_ratio(each) / fastest[each.family, each.problem])
    return {key: _profile(found, len(asked)) for key, found in factors.items()}


def _successes(measurements: Iterable[Measurement]) -> list[Measurement]:
    return [each for each in measurements if each.outcome == "success"]


def _ratio(each: Measurement) -> float:
    """At least 1e-6, since a clock that did not tick between two readings gives 0."""
    return max(each.ratio, 1e-6)


def _profile(factors: Sequence[float], problems: int) -> Profile:
    shares = {factor: (rank + 1) / problems for rank, factor in enumerate(sorted(factors))}
    return Profile(tuple(shares), tuple(shares.values()))
