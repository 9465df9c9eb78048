"""Defaults for the toy rooms: names, outcomes, and which measures are better."""

from typing import Literal

BETTER_SHARES: dict[str, Literal["lower", "higher"]] = {"f1": "lower", "f2": "higher"}
"""Whether more time in a zone is better: f1 cannot be learnt, f2 can and is hard."""

FOCUS_SHARES = {"f3": 0.6, "f2": 0.5}
"""The share of a window that counts as a focus on a zone, for the zones of the 2004 paper; it gives
no number."""

WORLDS = {
    "toyroom": "torch_iac_envs/ToyRoom-v0",
    "kinematic": "torch_iac_envs/ToyRoomKinematic-v0",
}
"""Names of the toy rooms here, and Gymnasium's ids."""
OUTCOMES = {"toyroom": ("toy_distance",), "kinematic": ("toy_distance",)}
"""Their default outcomes, as in the papers."""
WORLD_BYTES = {"toyroom": 30_000_000, "kinematic": 4_000}
"""Main memory of one world, in bytes; with pybullet, of its physics engine."""
OTHER_WORLD_BYTES = 1_000_000
"""Assumed for any other; one of MuJoCo's took 0.6 MB."""
