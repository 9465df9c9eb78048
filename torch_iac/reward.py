"""Learning progress as the reward, for any library of reinforcement learning.

Two Gymnasium wrappers, for one world and for a vector of worlds. A learner chooses the actions;
experts predict and learn from every transition, and the worth of an action to them, learning
progress unless the config has another drive, is the reward.

Source: Oudeyer, Kaplan and Hafner (2007), who define learning progress as an internal reward and
name reinforcement learning as a way to maximise it.
"""

import math
from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any, Literal, Self, TypeAlias

import gymnasium as gym
import torch
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray
from torch import Tensor

from torch_iac.agent import IAC
from torch_iac.config import IACConfig
from torch_iac.internal.intake import own_tensor
from torch_iac.internal.state import State
from torch_iac.records import Step
from torch_iac.space import SensorimotorSpace
from torch_iac.worlds.bounds import BOUNDS_FROM
from torch_iac.worlds.encoders import CONVOLUTION
from torch_iac.worlds.senses import Senses
from torch_iac.worlds.vector import outcome_of, refuse_overwriting

Array: TypeAlias = NDArray[Any]
"""Numbers of each world: actions, shape `(A, action_dim)`, or sensors, `(A, sensor_dim)`."""

When: TypeAlias = Literal["learnt", "chosen"]
"""When the worth of an action is computed: after the experts learnt from it, or before."""

INFO = "iac"
"""Key in `info` of the experts' errors, regions and progress."""


class Judge:
    """A population that learns from actions of others, and says what they were worth to it.

    Args:
        agent: The population.
        when: When worth is computed.
        scale: What it is multiplied by.

    Attributes:
        agent: The population.

    Raises:
        ValueError: `when` is none of the two, or `scale` is not finite and above 0.
    """

    def __init__(self, agent: IAC, when: When = "learnt", scale: float = 1.0) -> None:
        if when not in ("learnt", "chosen"):
            raise ValueError(f"when must be learnt or chosen, got {when}")
        if not (math.isfinite(scale) and scale > 0):
            raise ValueError(f"scale must be finite and above 0, got {scale}")
        self.agent = agent
        self._when, self._scale = when, scale

    def take(self, actions: Any, sensors: Tensor) -> None:
        """Register actions, shape `(A, action_dim)`, taken at sensors `(A, sensor_dim)`."""
        self.agent.set_actions(actions, sensors)
        if self._when == "chosen":
            self._worth = self.agent.worth(actions, sensors)

    def observe(self, sensors: Any, *, learn: bool = True) -> tuple[Step, Tensor]:
        """Return what became of the actions, and the rewards, shape `(A,)`, float64.

        Args:
            sensors: Shape `(A, sensor_dim)`, after the actions, in raw units.
            learn: Whether the population learns from it.
        """
        step = self.agent.observe(sensors, learn=learn)
        if self._when == "learnt":
            self._worth = self.agent.worth(step.actions, step.sensors)
        return step, self._scale * self._worth.masked_fill(self._worth.isinf(), 0.0)


class _Judged:
    """What both wrappers share: experts that last longer than episodes, and can be shared.

    Args:
        judge: The experts.
        senses: What they see of the worlds.
        waits: Whether the first reset is to give their seeds.
    """

    learning = True
    """Whether the experts learn. If not, rewards and `info` are as usual, but nothing changes in
    the experts: for evaluation."""

    last: Step | None = None
    """The last step; None before the first one."""

    env: Any

    def __init__(self, judge: Judge, senses: Senses, waits: bool) -> None:
        self._judge, self._senses, self._waits = judge, senses, waits
        self._sensors: Tensor | None = None  # before the next action, of all worlds

    @property
    def agent(self) -> IAC:
        """The experts: a population, with an agent for each world.

        Raises:
            ResetNeeded: They take their seeds from the first reset, which is still to come.
        """
        if self._waits:
            raise ResetNeeded(
                "reset must be called before the experts can be had, since it gives their seed; "
                "or give one to the wrapper"
            )
        return self._judge.agent

    def for_evaluation(self, env: Any) -> Self:
        """Return another wrapper, with the same experts and the same reward, that does not learn.

        Args:
            env: A world, or a vector of worlds, like the one here.

        Raises:
            ResetNeeded: There was no reset, and the experts' seeds were not given.
            ValueError: It has other sensors or actions, or is a vector of more or fewer worlds.
        """
        agent = self.agent
        outcomes = [dimension.name for dimension in agent.space.outcomes]
        n_worlds = getattr(env, "num_envs", 1)
        senses = self._senses.of_another(env)
        if (
            SensorimotorSpace.from_env(senses, outcomes) != agent.space
            or n_worlds != agent.n_agents
        ):
            raise ValueError(f"env must be like the one whose experts it shares, got {env}")
        other = copy(self)
        other.env, other._senses = env, senses
        other.learning, other.last, other._sensors = False, None, None
        return other

    def forget(self) -> None:
        """Begin anew, with the same seeds: the experts forget all that they have learnt.

        `agent` is then another population.
        """
        self._renew(self._judge.agent.seeds)

    def state(self) -> State:
        """Return a copy of the experts' seeds and of all that they have learnt.

        Raises:
            ResetNeeded: There was no reset, and the experts' seeds were not given.
            TypeError: The experts cannot be saved.
        """
        agent = self.agent
        learnt = {f"agent/{name}": tensor for name, tensor in agent.state().items()}
        return {"seeds": torch.tensor(agent.seeds), **learnt}

    def load_state(self, state: State) -> None:
        """Let experts with the seeds and the knowledge that `state` returned take over.

        `agent` is then another population. The wrapper was made with the same config, for worlds
        of the same space.

        Raises:
            ValueError: The state is of other experts; those that are here are left as they were.
        """
        seeds = state.get("seeds")
        n_agents = self._judge.agent.n_agents
        if seeds is None or len(seeds) != n_agents:
            got = "none" if seeds is None else seeds.tolist()
            raise ValueError(f"seeds must be in the state, {n_agents} of them, got {got}")
        agent = _anew(self._judge.agent, seeds.tolist())
        agent.load_state(
            {name.removeprefix("agent/"): of for name, of in state.items() if name != "seeds"}
        )
        self._judge.agent, self._waits = agent, False

    def _renew(self, seeds: Sequence[int]) -> None:
        self._judge.agent, self.last = _anew(self._judge.agent, seeds), None

    def _begin(self, observations: Any, seeds: Sequence[int | None]) -> None:
        """Register what worlds show after a reset; the first one gives the experts' seeds."""
        if self._waits:
            self._renew([i if seed is None else seed for i, seed in enumerate(seeds)])
            self._waits = False
        self._sensors = own_tensor(self._senses.sensors(observations), "sensors")

    def _ready(self) -> Tensor:
        """Return the sensors before the action that is taken now."""
        if self._sensors is None:
            raise ResetNeeded(
                "reset must be called before step, and when an episode is over; "
                "gymnasium.wrappers.Autoreset must be put around this wrapper, not inside"
            )
        return self._sensors

    def _observe(self, outcomes: Any) -> tuple[Tensor, dict[str, Tensor]]:
        """Return rewards `(A,)`, and what `info` holds of the experts."""
        self.last, rewards = self._judge.observe(outcomes, learn=self.learning)
        step = self.last
        return rewards, {"error": step.errors, "region": step.regions, "progress": step.progress}


class ProgressReward(_Judged, gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """A wrapper whose reward is the learning progress of experts.

        reward = scale * LP of the region that holds (action, sensors), in scaled units

    With another drive in the config it is what the action is worth to that drive. Actions,
    observations and their spaces are the world's own, of any kind that `torch-iac` takes; the
    experts see them as rows of numbers, as `torch_iac.worlds.spaces.Flat` says. The experts keep
    what they know from one episode to the next, and when a reset seeds the world: only `forget` and
    `load_state` change them otherwise.

    `info["iac"]` holds `world_reward`, the reward that the world itself gave; `error`, in scaled
    units; `region`, whose expert predicted; and `progress`, of that region before it learnt.

    Args:
        env: A world. It does not reset itself.
        config: The numbers of the algorithm. Those by which IAC chooses actions (`choice`,
            `n_candidates`, `epsilon`) have no effect here.
        outcomes: The names of the sensors to predict, or "all".
        seed: Seeds what is random in the experts. If not given, it is the seed of the first
            `reset`, or 0 if that has none.
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
        learning: Whether the experts learn; True unless it is set. If not, rewards and `info` are
            as usual, but nothing changes in the experts: for evaluation.
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
        seed: int | None = None,
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
        senses = Senses(env, encoder, sensor_bounds, bounds_from)
        space = SensorimotorSpace.from_env(senses, outcomes)
        agent = IAC(space, config, [0 if seed is None else seed])
        _Judged.__init__(self, Judge(agent, when, scale), senses, waits=seed is None)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode. A seed is the world's; the experts keep what they know."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._begin(observation, [seed])
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take an action in the world, and let the experts learn from the outcome.

        Raises:
            ResetNeeded: The world was not reset, or not since its episode ended.
            ValueError: An action or a sensor is outside its bounds.
            FloatingPointError: A loss is not finite.
        """
        self._judge.take(self._senses.actions(action), self._ready())
        observation, world_reward, terminated, truncated, info = self.env.step(action)
        sensors = own_tensor(self._senses.sensors(observation), "sensors")
        rewards, seen = self._observe(sensors)
        self._sensors = None if terminated or truncated else sensors
        mine = {name: column.item() for name, column in seen.items()}
        info = {**info, INFO: {"world_reward": world_reward, **mine}}
        return observation, rewards.item(), terminated, truncated, info


class VectorProgressReward(_Judged, gym.vector.VectorWrapper[Any, Any, Any, Any, Any]):
    """As `ProgressReward`, for a vector of worlds: each has experts of its own.

    Rewards and what `info["iac"]` holds have shape `(A,)`; they are arrays or, where the world's
    rewards are tensors, tensors. Worlds whose episodes end must be made with
    `AutoresetMode.SAME_STEP`, or left to be reset by others.

    Args:
        env: A vector of such worlds.
        config: The numbers of the algorithm.
        outcomes: The names of the sensors to predict, or "all".
        seeds: One for each world's experts. If not given, they are those of the first `reset`: its
            list, or its seed, the next whole number, and so on; or 0, 1, ... if that has none.
        when: When worth is computed: `"learnt"` or `"chosen"`.
        scale: What worth is multiplied by.
        encoder: As for `ProgressReward`.
        sensor_bounds: As for `ProgressReward`.
        bounds_from: As for `ProgressReward`.
        device: Where the experts are kept.

    Attributes:
        learning: Whether the experts learn; True unless it is set.
        last: The last step; None before the first one.

    Raises:
        ValueError: As for `ProgressReward`, or there are not as many seeds as worlds, the device is
            not there, or a world overwrites the last sensors of its episodes.
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
        gym.vector.VectorWrapper.__init__(self, env)
        if seeds is not None and len(seeds) != env.num_envs:
            raise ValueError(f"seeds must name one for each of {env.num_envs} worlds, got {seeds}")
        senses = Senses(env, encoder, sensor_bounds, bounds_from)
        space = SensorimotorSpace.from_env(senses, outcomes)
        agent = IAC(space, config, range(env.num_envs) if seeds is None else seeds, device)
        _Judged.__init__(self, Judge(agent, when, scale), senses, waits=seeds is None)
        refuse_overwriting(env)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes. Seeds are the worlds'; the experts keep what they know."""
        observations, info = self.env.reset(seed=seed, options=options)
        first = 0 if seed is None else seed
        seeds = range(first, first + self.num_envs) if isinstance(first, int) else first
        self._begin(observations, seeds)
        return observations, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Take actions in the worlds, and let the experts learn from the outcomes.

        Raises:
            ResetNeeded: The worlds were not reset.
            ValueError: An action or a sensor is outside its bounds, or an episode ended in worlds
                that do not show its end.
            FloatingPointError: A loss is not finite.
        """
        self._judge.take(self._senses.actions(actions), self._ready())
        observations, world_rewards, terminated, truncated, info = self.env.step(actions)
        sensors, is_over = self._senses.sensors(observations), terminated | truncated
        outcomes = outcome_of(self.env, sensors, is_over, self._senses.info(info))
        rewards, seen = self._observe(outcomes)
        self._sensors = own_tensor(sensors, "sensors")
        mine = {name: _like(world_rewards, column) for name, column in seen.items()}
        info = {**info, INFO: {"world_reward": world_rewards, **mine}}
        return observations, _like(world_rewards, rewards), terminated, truncated, info


def _anew(agent: IAC, seeds: Sequence[int]) -> IAC:
    """Return a population like another one that has learnt nothing yet."""
    return IAC(agent.space, agent.config, seeds, agent.device)


def _like(world_rewards: Array | Tensor, column: Tensor) -> Array | Tensor:
    """Return a column in the form of the world's own: a tensor or an array."""
    return column if isinstance(world_rewards, Tensor) else column.cpu().numpy()
