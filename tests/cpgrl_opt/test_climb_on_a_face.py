"""What `climb_on_face` promises of one face, by the conditions of its optimum; nobody searches, so nobody mends."""

import numpy as np
import pytest

from cpgrl_opt.solvers.small_problem import SmallProblem
from cpgrl_opt.solvers.trust_region import climb_on_face

# Rows of length 1, three on the face and one off it, which the face ignores.
ROWS = np.random.default_rng(4).standard_normal((4, 6))
ROWS /= np.linalg.norm(ROWS, axis=1, keepdims=True)
FACE = np.array([True, False, True, True])


def drawn(seed: int, *, pull: float = 1.0) -> tuple[np.random.Generator, np.ndarray, np.ndarray]:
    """Bounds that a ball of 1 meets, and a g of length 1 whose part along the face is `pull` of what is drawn."""
    rng = np.random.default_rng(seed)
    q = rng.standard_normal(3) @ ROWS[FACE]
    q *= rng.uniform(0.1, 0.9) / np.linalg.norm(q)
    g = rng.standard_normal(6)
    across = np.linalg.pinv(ROWS[FACE]) @ (ROWS[FACE] @ g)
    g = across + pull * (g - across)
    return rng, ROWS @ q, g / np.linalg.norm(g)


@pytest.mark.parametrize("seed", range(5))
def test_x_is_the_best_point_of_the_face_on_the_sphere_and_the_multipliers_prove_it(seed: int) -> None:
    """A_𝒜x = b, ‖x‖ = r, κx = g + A_𝒜ᵀμ with κ > 0: of all such x the one with the largest gᵀx."""
    rng, bound, g = drawn(seed)
    radius = 1.0 + rng.random()
    # As equalities: multipliers of inequalities that come out negative are sought anew, whatever they were.
    [(x, mu, kappa)] = climb_on_face(SmallProblem(g, ROWS, bound, np.ones(4, bool)), radius, FACE)
    np.testing.assert_allclose(ROWS[FACE] @ x, bound[FACE], atol=1e-14)
    assert np.linalg.norm(x) == pytest.approx(radius, rel=1e-14)
    assert kappa > 0.0
    assert mu[1] == 0.0
    np.testing.assert_allclose(kappa * x, g + ROWS.T @ mu, atol=1e-13 * (1.0 + np.abs(mu).sum()))
    q = np.linalg.pinv(ROWS[FACE]) @ bound[FACE]
    along = np.linalg.svd(ROWS[FACE])[2][3:]
    others = rng.standard_normal((1000, 3)) @ along
    others *= np.sqrt(radius**2 - q @ q) / np.linalg.norm(others, axis=1, keepdims=True)
    assert ((q + others) @ g <= g @ x + 1e-14).all()


def test_of_inequalities_that_hold_g_back_the_multipliers_are_positive() -> None:
    """g = (3, 4), x₂ ≤ 1 in a ball of 2: (√3, 1), κ = √3 and μ = 4 − √3."""
    small = SmallProblem(np.array([3.0, 4.0]), np.array([[0.0, -1.0]]), np.array([-1.0]), np.array([False]))
    [(x, mu, kappa)] = climb_on_face(small, 2.0, np.array([True]))
    np.testing.assert_allclose([*x, kappa, *mu], [3**0.5, 1.0, 3**0.5, 4.0 - 3**0.5], rtol=1e-15)


def test_where_nothing_is_left_to_climb_the_shortest_point_comes_without_kappa() -> None:
    """g ⟂ the face: x = q inside the ball, κ = 0, A_𝒜ᵀμ = −g."""
    _, bound, g = drawn(7, pull=0.0)
    [(x, mu, kappa)] = climb_on_face(SmallProblem(g, ROWS, bound, np.ones(4, bool)), 1.0, FACE)
    np.testing.assert_allclose(x, np.linalg.pinv(ROWS[FACE]) @ bound[FACE], atol=1e-14)
    np.testing.assert_allclose(ROWS.T @ mu, -g, atol=1e-13)
    assert kappa == 0.0


def test_a_face_beyond_the_ball_has_no_point() -> None:
    assert climb_on_face(SmallProblem(np.ones(6), ROWS, 3.0 * np.ones(4), np.ones(4, bool)), 1.0, FACE) == []
