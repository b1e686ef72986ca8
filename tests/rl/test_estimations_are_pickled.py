"""An estimation under way can be pickled and copied, and goes on with the same bits, in another process too."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest

from envs import ThreeStateMDP, TwoLinkArm, TwoLinkArmEnv
from envs.tabular_env import TabularEnv
from rl import GPOMDP, ExactGradient, KondaActorCritic, NormalizedGaussianNetwork, SoftmaxTable

ARM, CHAIN = TwoLinkArm(), ThreeStateMDP()
NETWORK = NormalizedGaussianNetwork(*ARM.stops, (5, 8), 2)
CASES = {
    "GPOMDP on the arm": (GPOMDP(steps=20), ARM, NETWORK),
    "Konda on the arm": (KondaActorCritic(steps=20), ARM, NETWORK),
    "GPOMDP on the chain": (GPOMDP(steps=20), CHAIN, SoftmaxTable(3, 3)),
    "Konda on the chain": (KondaActorCritic(steps=20), CHAIN, SoftmaxTable(3, 3)),
    "exact on the chain": (ExactGradient(), CHAIN, SoftmaxTable(3, 3)),
    "GPOMDP in an environment": (GPOMDP(steps=20), TwoLinkArmEnv(), NETWORK),
    "Konda in an environment": (KondaActorCritic(steps=20), TabularEnv(CHAIN), SoftmaxTable(3, 3)),
}


def started(case):
    estimator, environment, policy = CASES[case]
    estimation = estimator.start(environment, policy, np.random.SeedSequence(7).spawn(3))
    parameters = np.random.default_rng(0).normal(size=(3, len(policy.parameters)), scale=0.1)
    for _ in range(2):
        estimation.episode(parameters)
    return estimation, parameters


def same(one, other):
    for name in ("values", "gradients", "steps", "rewards", "events"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("how", [lambda each: pickle.loads(pickle.dumps(each)), copy.deepcopy], ids=["pickle", "copy"])
@pytest.mark.parametrize("case", CASES)
def test_it_goes_on_with_the_same_bits(case, how):
    estimation, parameters = started(case)
    other = how(estimation)
    for _ in range(2):
        same(estimation.episode(parameters), other.episode(parameters))


def test_it_goes_on_in_another_process(tmp_path):
    estimation, parameters = started("Konda on the arm")
    (tmp_path / "state").write_bytes(pickle.dumps((estimation, parameters)))
    program = (
        "import pickle, sys; estimation, parameters = pickle.load(open(sys.argv[1], 'rb'));"
        "pickle.dump(estimation.episode(parameters), open(sys.argv[1] + '.out', 'wb'))"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "state")], check=True)
    same(estimation.episode(parameters), pickle.loads((tmp_path / "state.out").read_bytes()))
