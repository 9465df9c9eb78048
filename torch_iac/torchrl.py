"""Learning progress as an intrinsic reward in TorchRL; needs the extra `torchrl`.

Source: Oudeyer, Kaplan and Hafner (2007), who define learning progress as an internal reward.
"""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.data import Unbounded
from torchrl.envs import Transform

from torch_iac.agent import IAC
from torch_iac.internal.state import State
from torch_iac.reward import Judge, When

SENSORS = "iac_sensors"
"""Key of the sensors as the experts see them, whatever later transforms make of observations."""


class ProgressTransform(Transform):  # type: ignore[misc]  # TorchRL has no types
    """A transform that writes the learning progress of experts as an intrinsic reward.

        reward = scale * LP of the region that holds (action, sensors), in scaled units

    The experts learn from every step, unless `learning` is False: then rewards are as usual, but
    nothing changes in the experts. (TorchRL's `train` and `eval` have no influence, since every
    `TransformedEnv` begins with `eval`.) What the experts know outlasts episodes, and is in
    `state_dict`. Clones share the experts.

    Sensors are those that the transform finds at its place: transforms that normalise observations
    belong after it, and those of actions before it.

    Args:
        agent: The experts, an agent for each world of the batch.
        when: When the worth of an action is computed: `"learnt"` or `"chosen"`.
        scale: What worth is multiplied by.
        in_keys: The key of the observations, flat, in raw units.
        out_keys: The key of the intrinsic reward; `["reward"]` replaces the world's own.
        action_key: The key of the actions.

    Attributes:
        agent: The experts.
        learning: Whether they learn; True unless it is set.

    Raises:
        ValueError: `when` or `scale` is not allowed, or there is not one key of each kind.

    Example:
        >>> import torch_iac as iac
        >>> from torchrl.envs import GymEnv, TransformedEnv
        >>> world = GymEnv("Pendulum-v1")
        >>> agent = iac.IAC(iac.SensorimotorSpace.from_env(world._env))
        >>> env = TransformedEnv(world, ProgressTransform(agent, scale=10.0))
        >>> env.rollout(3)["next", "intrinsic_reward"].shape
        torch.Size([3, 1])
    """

    def __init__(
        self,
        agent: IAC,
        *,
        when: When = "learnt",
        scale: float = 1.0,
        in_keys: Sequence[Any] = ("observation",),
        out_keys: Sequence[Any] = ("intrinsic_reward",),
        action_key: Any = "action",
    ) -> None:
        for name, keys in (("in_keys", in_keys), ("out_keys", out_keys)):
            if isinstance(keys, str) or len(keys) != 1:
                raise ValueError(f"{name} must be a list of one key, got {keys!r}")
        super().__init__(in_keys=list(in_keys), out_keys=[*out_keys, SENSORS])
        self.learning = True
        self._action_key = action_key
        self._judge = Judge(agent, when, scale)

    @property
    def agent(self) -> IAC:
        """The experts."""
        return self._judge.agent

    def get_extra_state(self) -> State:
        """Return what the experts have learnt, which `state_dict` holds."""
        return self.agent.state()

    def set_extra_state(self, state: State) -> None:
        """Let the experts go on from what `get_extra_state` returned."""
        self.agent.load_state(state)

    def transform_observation_spec(self, observation_spec: Any) -> Any:
        """Return the spec with the experts' sensors."""
        observation_spec[SENSORS] = observation_spec[self.in_keys[0]].clone()
        return observation_spec

    def transform_reward_spec(self, reward_spec: Any) -> Any:
        """Return the spec with the intrinsic reward."""
        reward_spec[self.out_keys[0]] = Unbounded(
            shape=(*reward_spec.shape, 1), device=reward_spec.device, dtype=torch.float32
        )
        return reward_spec

    def _reset(
        self,
        tensordict: TensorDictBase,  # noqa: ARG002 - TorchRL gives it
        tensordict_reset: TensorDictBase,
    ) -> TensorDictBase:
        return self._seen(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if tensordict.batch_size.numel() != self.agent.n_agents:
            raise ValueError(
                f"agent must have as many agents as there are worlds "
                f"({tensordict.batch_size.numel()}), got {self.agent.n_agents}"
            )
        before, actions, after = (
            of.reshape(self.agent.n_agents, -1)
            for of in (
                tensordict.get(SENSORS),
                tensordict.get(self._action_key),
                next_tensordict.get(self.in_keys[0]),
            )
        )
        self._judge.take(actions, before)
        _, rewards = self._judge.observe(after, learn=self.learning)
        rewards = rewards.to(after.device, torch.float32)
        next_tensordict.set(self.out_keys[0], rewards.reshape(*tensordict.batch_size, 1))
        return self._seen(next_tensordict)

    def _seen(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Keep the sensors, since other transforms may overwrite the observation."""
        return tensordict.set(SENSORS, tensordict.get(self.in_keys[0]).clone())
