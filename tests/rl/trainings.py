"""Trainings of all kinds, each of which every law of training is put to."""

from functools import partial

import numpy as np

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.active_set import hysteresis
from envs import ThreeStateMDP, TwoLinkArm, TwoLinkArmEnv
from envs.tabular_env import TabularEnv
from rl import (
    CPGRL,
    GPOMDP,
    ConstraintSwitching,
    ExactGradient,
    GradientWithRestoration,
    KondaActorCritic,
    NormalizedGaussianNetwork,
    SoftmaxTable,
    Training,
    WeightedSum,
    uniform_parameters,
)

CHAIN, ARM = ThreeStateMDP(), TwoLinkArm()
TABLE, NETWORK = SoftmaxTable(3, 3), NormalizedGaussianNetwork(*ARM.stops, (3, 4), 2)
ROSEN = CPGRL(ConstrainedStep(solver="rosen"), [0, 0, 0])
WITH_MEMORY = CPGRL(ConstrainedStep(rule=partial(hysteresis, leave=0.2)), [0, 0, 0])
SAFE = {"ridge": 1e-4, "max_restoration": 0.1}
ON_THE_ARM = CPGRL(ConstrainedStep(solver="rosen", **SAFE), [0, 0.5])
MIXED = {"average": ("step", "step", "episode"), "steps": 40}
# environment, policy, estimator, learner, episodes
CASES = {
    "compiled": (CHAIN, TABLE, GPOMDP(bias_correction=False), ROSEN, 120),
    "compiled once averages are settled": (CHAIN, TABLE, GPOMDP(average_rate=0.5, steps=20), ROSEN, 60),
    "compiled, updates in Python": (CHAIN, TABLE, GPOMDP(average="episode", steps=20), WITH_MEMORY, 40),
    "Konda on the chain": (CHAIN, TABLE, KondaActorCritic(steps=20), ConstraintSwitching([0, 0, 0]), 40),
    "exact": (CHAIN, TABLE, ExactGradient(), WITH_MEMORY, 30),
    "GPOMDP in Python": (TabularEnv(CHAIN), TABLE, GPOMDP(steps=10), ROSEN, 14),
    "Konda in Python": (TabularEnv(CHAIN), TABLE, KondaActorCritic(steps=10), WeightedSum(), 14),
    "GPOMDP on the arm": (ARM, NETWORK, GPOMDP(**MIXED), ON_THE_ARM, 40),
    "Konda on the arm": (ARM, NETWORK, KondaActorCritic(**MIXED), ON_THE_ARM, 40),
    "in a metric, rates of NumPy's": (
        CHAIN, TABLE, GPOMDP(steps=20, average="episode", average_rate=np.float64(0.1)),
        CPGRL(ConstrainedStep(formulation="linearized", metric=np.diag(np.arange(1.0, 10.0))), [0, 0, 0]), 12,
    ),
    "Konda on the arm in Python": (
        TwoLinkArmEnv(), NETWORK, KondaActorCritic(steps=10),
        GradientWithRestoration(ConstrainedStep(**SAFE), [0, 0]), 8,
    ),
}  # fmt: skip
PLAIN = CASES["compiled"]


def training(case=PLAIN, **options):
    *parts, episodes = case
    initial = uniform_parameters(9) if parts[1] is TABLE else None
    return Training(*parts, **{"episodes": episodes, "runs": [0, 3], "seed": 5, "initial": initial, **options})


def seen(record):
    estimate, update = record.estimate, record.update
    arrays = [record.parameters, *(getattr(estimate, name) for name in ("values", "gradients", "steps", "rewards"))]
    return record.episode, [array.tobytes() for array in (*arrays, update.change, update.active)]
