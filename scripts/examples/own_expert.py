"""A robot whose experts are a network of your own: any module from situation to outcome."""

import gymnasium as gym
from torch import Tensor, nn

import torch_iac as iac
import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac.training import train


class Waves(nn.Module):
    """One hidden layer of sine waves."""

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__()
        self.waves, self.mix = nn.Linear(n_inputs, 24), nn.Linear(24, n_outputs)

    def forward(self, situations: Tensor) -> Tensor:
        """Return the outcomes `(n, n_outputs)` of situations `(n, n_inputs)`."""
        outcomes: Tensor = self.mix(self.waves(situations).sin())
        return outcomes


env = gym.make_vec("torch_iac_envs/ToyRoom-v0", num_envs=1)
space = iac.SensorimotorSpace.from_env(env, outcomes=["toy_distance"])
agent = iac.IAC(space, iac.IACConfig(experts=iac.NetworkExperts(module=Waves)), seeds=[0])
train(agent, env, n_decisions=500)
print(f"{agent.tree.n_rows} regions after {agent.n_decisions} decisions")
