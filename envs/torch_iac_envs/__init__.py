"""The toy rooms as Gymnasium environments; importing the package registers them."""

import gymnasium as gym

gym.register(id="torch_iac_envs/ToyRoom-v0", entry_point="torch_iac_envs.toy_room:ToyRoom")
gym.register(
    id="torch_iac_envs/ToyRoomKinematic-v0",
    vector_entry_point="torch_iac_envs.kinematic:ToyRoomKinematic",
)
