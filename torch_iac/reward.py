"""Learning progress as the reward, for any library of reinforcement learning.

Two Gymnasium wrappers, for one world and for a vector of worlds. A learner chooses the actions;
experts predict and learn from every transition, and the worth of an action to them, learning
progress unless the config has another drive, is the reward.

Source: Oudeyer, Kaplan and Hafner (2007), who define learning progress as an internal reward and
name reinforcement learning as a way to maximise it.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias

import gymnasium as gym
import torch
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray
from torch import Tensor

from torch_iac.agent import IAC
from torch_iac.config import IACConfig
from torch_iac.records import Step
from torch_iac.space import SensorimotorSpace
from torch_iac.worlds.encoders import CONVOLUTION
from torch_iac.worlds.senses import BOUNDS_FROM, Senses
from torch_iac.worlds.vector import outcome_of

Array: TypeAlias = NDArray[Any]
"""Numbers of each world: actions, shape `(A, action_dim)`, or sensors, `(A, sensor_dim)`."""

When: TypeAlias = Literal["learnt", "chosen"]
"""When the worth of an action is computed: after the experts learnt from it, or before."""

INFO = "iac"
"""Key in `info` of the experts' errors, regions and progress."""


class ProgressReward(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """A wrapper whose reward is the learning progress of experts.

        reward = scale * LP of the region that holds (action, sensors), in scaled units

    With another drive in the config it is what the action is worth to that drive. Actions,
    observations and their spaces are the world's own, of any kind that `torch-iac` takes; the
    experts see them as rows of numbers, as `torch_iac.worlds.spaces.Flat` says. The experts keep
    what they know from one episode to the next; a reset with a seed begins everything anew, experts
    included, so that the same seed gives the same rewards again.

    `info["iac"]` holds `world_reward`, the reward that the world itself gave; `error`, in scaled
    units; `region`, whose expert predicted; and `progress`, of that region before it learnt.

    Args:
        env: A world.
        config: The numbers of the algorithm. Those by which IAC chooses actions (`choice`,
            `n_candidates`, `epsilon`) have no effect here.
        outcomes: The names of the sensors to predict, or "all".
        seed: Seeds what is random in the experts; the world's seed is that of `reset`.
        when: Whether the reward is what the action is worth once the experts have learnt from it
            (`"learnt"`, as the papers define it), or was worth when it was chosen (`"chosen"`, what
            IAC itself goes by). Novelty is gone once learnt: such a drive needs `"chosen"`.
        scale: What worth is multiplied by. Progress is small, in the toy room some 0.01 at best;
            most libraries expect rewards of about 1. Infinite worth, as that of novelty where
            nothing is known, gives no reward.
        encoder: What makes sensors of pictures: `convolution`, `pixels` or `module:Name`.
        sensor_bounds: Low and high of sensors, in raw units, by name; the experts see readings
            beyond as the bound.
        bounds_from: How many random decisions, in a copy of the world, find those of others that
            have none.

    Attributes:
        agent: The experts, a population of one; another one after a reset with a seed.
        last: The last step; None before the first one.

    Raises:
        ValueError: A space or an outcome does not fit, `when`, `scale` or the encoder is none of
            the above, or bounds must be found and the world cannot be made once more.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        config: IACConfig | None = None,
        *,
        outcomes: Sequence[str] | Literal["all"] = "all",
        seed: int = 0,
        when: When = "learnt",
        scale: float = 1.0,
        encoder: str = CONVOLUTION,
        sensor_bounds: Mapping[str, tuple[float, float]] | None = None,
        bounds_from: int = BOUNDS_FROM,
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(
            self,
            config=config,
            outcomes=outcomes,
            seed=seed,
            when=when,
            scale=scale,
            encoder=encoder,
            sensor_bounds=sensor_bounds,
            bounds_from=bounds_from,
        )
        gym.Wrapper.__init__(self, env)
        self._senses = Senses(env, encoder, sensor_bounds, bounds_from)
        space = SensorimotorSpace.from_env(self._senses, outcomes)
        self._onlooker = _Onlooker(IAC(space, config, [seed]), when, scale)

    @property
    def agent(self) -> IAC:
        """The experts, a population of one."""
        return self._onlooker.agent

    @property
    def last(self) -> Step | None:
        """The last step."""
        return self._onlooker.last

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; with a seed, new experts too."""
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._onlooker.begin_anew()
        self._onlooker.see(self._senses.sensors(observation))
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take an action in the world, and let the experts learn from the outcome.

        Raises:
            ResetNeeded: The world was not reset.
            ValueError: An action or a sensor is outside its bounds.
            FloatingPointError: A loss is not finite.
        """
        self._onlooker.take(self._senses.actions(action))
        observation, world_reward, terminated, truncated, info = self.env.step(action)
        sensors = self._senses.sensors(observation)
        rewards, seen = self._onlooker.observe(sensors)
        self._onlooker.see(sensors)
        mine = {name: column.item() for name, column in seen.items()}
        info = {**info, INFO: {"world_reward": world_reward, **mine}}
        return observation, rewards.item(), terminated, truncated, info


class VectorProgressReward(gym.vector.VectorWrapper[Any, Any, Any, Any, Any]):
    """As `ProgressReward`, for a vector of worlds: each has experts of its own.

    Rewards and what `info["iac"]` holds have shape `(A,)`; they are arrays or, where the world's
    rewards are tensors, tensors. Worlds whose episodes end must be made with
    `AutoresetMode.SAME_STEP`, or left to be reset by others.

    Args:
        env: A vector of such worlds.
        config: The numbers of the algorithm.
        outcomes: The names of the sensors to predict, or "all".
        seeds: One for each world's experts; 0, 1, ... if not given.
        when: When worth is computed: `"learnt"` or `"chosen"`.
        scale: What worth is multiplied by.
        encoder: As for `ProgressReward`.
        sensor_bounds: As for `ProgressReward`.
        bounds_from: As for `ProgressReward`.
        device: Where the experts are kept.

    Attributes:
        agent: The experts, an agent a world; another population after a reset with a seed.
        last: The last step; None before the first one.

    Raises:
        ValueError: As for `ProgressReward`, or there are not as many seeds as worlds, or the device
            is not there.
    """

    def __init__(
        self,
        env: gym.vector.VectorEnv[Any, Any, Any],
        config: IACConfig | None = None,
        *,
        outcomes: Sequence[str] | Literal["all"] = "all",
        seeds: Sequence[int] | None = None,
        when: When = "learnt",
        scale: float = 1.0,
        encoder: str = CONVOLUTION,
        sensor_bounds: Mapping[str, tuple[float, float]] | None = None,
        bounds_from: int = BOUNDS_FROM,
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__(env)
        seeds = range(env.num_envs) if seeds is None else seeds
        if len(seeds) != env.num_envs:
            raise ValueError(f"seeds must name one for each of {env.num_envs} worlds, got {seeds}")
        self._senses = Senses(env, encoder, sensor_bounds, bounds_from)
        space = SensorimotorSpace.from_env(self._senses, outcomes)
        self._onlooker = _Onlooker(IAC(space, config, seeds, device), when, scale)

    @property
    def agent(self) -> IAC:
        """The experts, an agent a world."""
        return self._onlooker.agent

    @property
    def last(self) -> Step | None:
        """The last step."""
        return self._onlooker.last

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes; with a seed, new experts too."""
        observations, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        if seed is not None:
            self._onlooker.begin_anew()
        self._onlooker.see(self._senses.sensors(observations))
        return observations, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Take actions in the worlds, and let the experts learn from the outcomes.

        Raises:
            ResetNeeded: The worlds were not reset.
            ValueError: An action or a sensor is outside its bounds, or an episode ended in worlds
                that do not show its end.
            FloatingPointError: A loss is not finite.
        """
        self._onlooker.take(self._senses.actions(actions))
        observations, world_rewards, terminated, truncated, info = self.env.step(actions)
        sensors, is_over = self._senses.sensors(observations), terminated | truncated
        outcomes = outcome_of(self.env, sensors, is_over, self._senses.info(info))
        rewards, seen = self._onlooker.observe(outcomes)
        self._onlooker.see(sensors)
        mine = {name: _like(world_rewards, column) for name, column in seen.items()}
        info = {**info, INFO: {"world_reward": world_rewards, **mine}}
        return observations, _like(world_rewards, rewards), terminated, truncated, info


class _Onlooker:
    """Agents that learn from actions of others, and compute rewards.

    Args:
        agent: They, untrained.
        when: When worth is computed.
        scale: What it is multiplied by.
    """

    def __init__(self, agent: IAC, when: str, scale: float) -> None:
        if when not in ("learnt", "chosen"):
            raise ValueError(f"when must be learnt or chosen, got {when}")
        if not (math.isfinite(scale) and scale > 0):
            raise ValueError(f"scale must be finite and above 0, got {scale}")
        self.agent = agent
        self.last: Step | None = None
        self._when, self._scale = when, scale
        self._sensors: Tensor | None = None

    def begin_anew(self) -> None:
        """Forget everything."""
        old = self.agent
        if old.n_decisions:
            self.agent = IAC(old.space, old.config, old.seeds, old.device)
        self.last = None

    def see(self, sensors: Array | Tensor) -> None:
        """Copy the sensors before the next actions; worlds and users may overwrite them."""
        self._sensors = sensors.clone() if isinstance(sensors, Tensor) else torch.tensor(sensors)

    def take(self, actions: Array | Tensor) -> None:
        """Register the actions that are taken now."""
        if self._sensors is None:
            raise ResetNeeded("reset must be called before step")
        self.agent.set_actions(actions, self._sensors)
        if self._when == "chosen":
            self._worth = self.agent.worth(actions, self._sensors)

    def observe(self, sensors: Array | Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """Learn from the outcome; return rewards `(A,)`, and what `info` holds of the experts."""
        self.last = step = self.agent.observe(sensors)
        if self._when == "learnt":
            self._worth = self.agent.worth(step.actions, step.sensors)
        rewards = self._scale * self._worth.masked_fill(self._worth.isinf(), 0.0)
        return rewards, {"error": step.errors, "region": step.regions, "progress": step.progress}


def _like(world_rewards: Array | Tensor, column: Tensor) -> Array | Tensor:
    """Return a column in the form of the world's own: a tensor or an array."""
    return column if isinstance(world_rewards, Tensor) else column.cpu().numpy()
