"""A correct solver that a third party wrote in plain NumPy passes every law of the kit."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cpgrl_opt import Direction, Status, kkt_residuals
from cpgrl_opt.testing import check_direction_solver

RANK = 1e-12


def face_projection(g, rows, bound):
    """(d, μ) of the projection onto rows d = bound, by a pseudo-inverse."""
    inverse = np.linalg.pinv(rows, rcond=RANK)
    d = g + inverse @ (bound - rows @ g)
    d = d + inverse @ (bound - rows @ d)
    return d, inverse.T @ (d - g)


def nearest(g, rows, bound, equality, project=face_projection):
    """(d, μ, error) of the best active set."""
    best = (g, np.zeros(len(bound)), np.inf)
    always, optional = np.flatnonzero(equality), np.flatnonzero(~equality)
    for size in range(len(optional) + 1):
        for more in combinations(optional, size):
            face = np.array([*always, *more], dtype=int)
            mu = np.zeros(len(bound))
            d, mu[face] = project(g, rows[face], bound[face])
            lack = bound - rows @ d
            error = max(np.where(equality, np.abs(lack), np.maximum(lack, -mu)).max(initial=0.0), 0.0)
            if error < best[2]:
                best = d, mu, error
            if error < 1e-13:
                return best
    return best


@dataclass(frozen=True)
class ByHand:
    """Every active set in plain NumPy on unit rows; declares neither a tolerance nor the cases that it takes."""

    def solve(self, problem):
        if not np.isfinite(problem.gradient).all() or np.isnan(problem.bound).any():
            raise ValueError("found what is not finite")
        lengths = np.linalg.norm(problem.jacobian, axis=1)
        on = (problem.bound > -np.inf) & (lengths > 0)
        impossible = (lengths == 0) & ((problem.bound > 0) | (problem.equality & (problem.bound != 0)))
        if not np.isfinite(lengths).all() or (problem.bound == np.inf).any():
            raise ValueError("found what is not finite")
        rows, bound, equality = (
            problem.jacobian[on] / lengths[on, None],
            problem.bound[on] / lengths[on],
            problem.equality[on],
        )
        scale = max([np.linalg.norm(problem.gradient), *np.where(equality, np.abs(bound), bound)]) or 1.0
        g, bound = problem.gradient / scale, bound / scale
        d, weights, error = nearest(g, rows, bound, equality)
        mu = np.zeros(problem.m)
        mu[on] = weights * scale / lengths[on]
        answer = Direction(d * scale, mu, Status.OPTIMAL)
        if not impossible.any() and error < 1e-9 and kkt_residuals(problem, answer).worst <= 1e-6:
            return answer
        return self.infeasible(problem, (g, rows, bound, equality), on, impossible, lengths, scale)

    def infeasible(self, problem, parts, on, impossible, lengths, scale):
        """min ‖y − b‖ s.t. Jᵀy = 0, y ≥ 0 on I is both the least violation and Farkas' vector."""
        g, rows, bound, equality = parts
        sides = np.vstack([np.eye(len(bound))[~equality], rows.T])
        is_null = np.arange(len(sides)) >= (~equality).sum()
        y, _, _ = nearest(bound, sides, np.zeros(len(sides)), is_null)
        d, _, _ = nearest(g, rows, bound - y, equality)
        proof = np.zeros(problem.m)
        proof[on] = y / lengths[on]
        if impossible.any():
            proof = np.where(impossible, np.sign(problem.bound), 0.0)
        status = Status.INFEASIBLE if impossible.any() or np.linalg.norm(y) > 1e-4 else Status.UNCERTIFIED
        return Direction(d * scale, proof, status)


def test_a_correct_solver_of_a_third_party_passes():
    verdict = check_direction_solver(ByHand(), max_examples=10)
    verdict.raise_for_failures()
    assert [result.check for result in verdict.results if not result.supported] == [
        "check_batch_is_loop",
        "check_neighbours_change_nothing",
        "check_warm_start_is_cold_start",
    ]
