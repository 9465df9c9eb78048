"""What is known of the toy room: its names, what is predicted in it, what to look at."""

from typing import Literal

BETTER_SHARES: dict[str, Literal["lower", "higher"]] = {"f1": "lower", "f2": "higher"}
"""Time with what cannot be learnt is lost, time with what is hard and can be learnt is not."""

FOCUS_SHARES = {"f3": 0.6, "f2": 0.5}
"""The share of a window that counts as a focus on a zone, for the zones of the 2004 paper; it gives
no number."""

WORLDS = {
    "toyroom": "torch_iac_envs/ToyRoom-v0",
    "kinematic": "torch_iac_envs/ToyRoomKinematic-v0",
}
"""What the toy rooms are called here, and by Gymnasium."""
OUTCOMES = {"toyroom": ("toy_distance",), "kinematic": ("toy_distance",)}
"""What is predicted in them, as in the papers, if nobody says otherwise."""
WORLD_BYTES = {"toyroom": 30_000_000, "kinematic": 4_000}
"""What a world takes in the main memory; with pybullet it is a whole physics engine."""
OTHER_WORLD_BYTES = 1_000_000
"""What any other is taken to need; one of MuJoCo was seen to take 0.6 MB."""
