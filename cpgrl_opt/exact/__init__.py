"""Small direction problems answered in rational arithmetic: no rounding, no tolerance, none of the solvers.

`answer`: the optimum or the proof that there is none; `trust_region`: the same in a ball; `faces` and `violation`: the
searches that both stand on; `rational`: the problem's numbers as fractions.
"""

from .answer import ExactAnswer, exact_answer, is_small_enough
from .trust_region import TrustRegionAnswer, exact_trust_region, shortest_length

__all__ = [
    "ExactAnswer",
    "TrustRegionAnswer",
    "exact_answer",
    "exact_trust_region",
    "is_small_enough",
    "shortest_length",
]
