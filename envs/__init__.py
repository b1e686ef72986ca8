"""Environments with vector rewards: channel 0 intrinsic, the others extrinsic.

Finite Markov decision processes with exact answers, the three-state task of §3 of the paper, the two-link arm
of §4, a gridworld, and what an environment hands to compiled code (`envs.interface`). Importing this package registers
`cpgrl/ThreeState-v0` and `cpgrl/TwoLinkArm-v0` with Gymnasium.
"""

from gymnasium.envs.registration import register, registry

from .arm_constants import ArmObject
from .arm_env import TwoLinkArmEnv
from .gridworld import GridWorld
from .interface import (
    RESET_SIGNATURE,
    STEP_SIGNATURE,
    ContinuousEnvironment,
    ContinuousKernels,
    FiniteEnvironment,
    FiniteKernel,
    VectorReward,
    function_type,
    random_state,
)
from .tabular import ConstrainedOptimum, TabularMDP, random_mdp
from .tabular_env import TabularEnv
from .three_state import ThreeStateEnv, ThreeStateMDP
from .two_link_arm import TwoLinkArm

__all__ = [
    "RESET_SIGNATURE", "STEP_SIGNATURE", "ArmObject", "ConstrainedOptimum", "ContinuousEnvironment",
    "ContinuousKernels", "FiniteEnvironment", "FiniteKernel", "GridWorld", "TabularEnv", "TabularMDP",
    "ThreeStateEnv", "ThreeStateMDP", "TwoLinkArm", "TwoLinkArmEnv", "VectorReward", "function_type",
    "random_mdp", "random_state",
]  # fmt: skip

# The passive checker warns at every vector reward, so it stays off, as in MO-Gymnasium.
if "cpgrl/ThreeState-v0" not in registry:
    register(
        id="cpgrl/ThreeState-v0",
        entry_point="envs.three_state:ThreeStateEnv",
        max_episode_steps=100,  # N_T of §3.1
        disable_env_checker=True,
    )
if "cpgrl/TwoLinkArm-v0" not in registry:
    register(
        id="cpgrl/TwoLinkArm-v0",
        entry_point="envs.arm_env:TwoLinkArmEnv",  # ends by itself after the arm's max_steps
        disable_env_checker=True,
    )
