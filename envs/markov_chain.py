"""Finite Markov chains: which states recur, and how often each is visited in the long run."""

import numpy as np

from .arrays import Bool, Chain, StateDistribution


def recurrent_states(chain: Chain) -> Bool[np.ndarray, "*runs states"]:
    """The states that every state reaches: the one recurrent class of a unichain.

    j is recurrent ⇔ i → j for all i, provided that there is such a j; there is one exactly when the chain has
    one recurrent class, since from inside one class no other can be reached. Decided on the graph of the
    positive probabilities, so no rounding enters. Transient states and periods are fine.

    Raises
    ------
    ValueError
        For a chain with more than one recurrent class.
    """
    states = chain.shape[-1]
    reaches: Bool[np.ndarray, "*runs states states"] = np.logical_or(chain > 0, np.eye(states))
    for _ in range(max(states - 1, 1).bit_length()):  # paths of length 2, 4, 8, … ≥ states − 1
        if reaches.all():
            break
        hops = reaches.astype(np.float32)
        reaches = (hops @ hops).astype(np.bool_)
    recurrent: Bool[np.ndarray, "*runs states"] = np.logical_and.reduce(reaches, axis=-2)
    multichain = ~recurrent.any(axis=-1)
    if multichain.any():
        raise ValueError(_describe_classes(reaches[tuple(np.argwhere(multichain)[0])]))
    return recurrent


def require_one_class(transitions: Bool[np.ndarray, "states actions states"], start: int) -> None:
    """ValueError where a policy that takes every action can be caught in more than one recurrent class from `start`.

    What `start` does not lead to does not matter: those states are taken to lead to it. For all policies that take
    every action the answer is the same.

    Parameters
    ----------
    transitions
        (states, actions, states), whether s′ may follow (s, a).
    start
        First state of an episode.
    """
    moves = np.asarray(transitions.any(axis=1))
    begun = np.arange(len(moves)) == start
    reached, found = np.zeros_like(begun), begun
    while (found > reached).any():
        reached, found = found, found | moves[found].any(axis=0)
    recurrent_states(np.where(found[:, None], moves, begun).astype(np.float64))


def stationary_distribution(chain: Chain) -> StateDistribution:
    """π with πP = π, Σπ = 1, every entry to high *relative* accuracy.

    States are cut out one by one, the last first: P′ᵢⱼ = Pᵢⱼ + Pᵢₙ Pₙⱼ / Σ_{k<n} Pₙₖ is the chain watched on
    {0 … n−1} only. On the way back state n gets the share a/(a + s), a its inflow Σ_{i<n} πᵢPᵢₙ and
    s = Σ_{k<n} Pₙₖ. There is no subtraction anywhere, so no cancellation, however nearly the chain
    decomposes. Transient states get exactly 0.

    Raises
    ------
    ValueError
        For a chain with more than one recurrent class, and for one whose least paths underflow.

    Notes
    -----
    Source: Grassmann, Taksar & Heyman (1985), Operations Research 33(5).
    """
    states = chain.shape[-1]
    # From every state the first one must be reached, else s = 0: a recurrent state goes first.
    first = recurrent_states(chain).argmax(axis=-1)
    order = (first[..., None] + np.arange(states)) % states
    watched = np.take_along_axis(np.take_along_axis(chain, order[..., None], -2), order[..., None, :], -1)
    leaving = np.ones(order.shape)
    for n in range(states - 1, 0, -1):
        leaving[..., n] = watched[..., n, :n].sum(axis=-1)
        if (leaving[..., n] == 0).any():
            raise ValueError("transition probabilities should multiply without underflow; found a lost path")
        to_others = watched[..., n, :n] / leaving[..., n, None]
        watched[..., :n, :n] += watched[..., :n, n, None] * to_others[..., None, :]
    share = np.zeros(order.shape)
    share[..., 0] = 1
    for n in range(1, states):
        arriving = (share[..., :n] * watched[..., :n, n]).sum(axis=-1)
        share[..., n] = arriving / (arriving + leaving[..., n])
        share[..., :n] *= (leaving[..., n] / (arriving + leaving[..., n]))[..., None]
    distribution = np.empty(order.shape)
    np.put_along_axis(distribution, order, share, axis=-1)
    return distribution


def _describe_classes(reaches: Bool[np.ndarray, "states states"]) -> str:
    # i recurs when whatever it reaches leads back to it; its class is what it reaches.
    recurs = (~reaches | reaches.T).all(axis=1)
    classes = sorted({tuple(int(j) for j in np.flatnonzero(reaches[i])) for i in np.flatnonzero(recurs)})
    listed = " and ".join(str(list(members)) for members in classes[:3])
    return (
        "the policy's Markov chain should have one recurrent class, since otherwise its average reward "
        f"depends on the start; found {len(classes)}: states {listed}{' …' if len(classes) > 3 else ''}"
    )
