"""The agent: a population of curious robots that act, observe and learn."""

from collections.abc import Sequence, Sized
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from torch_iac.config import IACConfig
from torch_iac.drives.curriculum import Curriculum
from torch_iac.drives.protocol import Candidates, Knowledge
from torch_iac.experts.hybrid import HybridPool
from torch_iac.experts.protocol import ExpertPool
from torch_iac.internal.devices import available_device
from torch_iac.internal.intake import own_tensor
from torch_iac.internal.randomness import RandomStream
from torch_iac.internal.scaling import Scale, action_scale
from torch_iac.internal.state import State, Stateful
from torch_iac.internal.torch_defaults import with_torch_defaults
from torch_iac.internal.validation import settled
from torch_iac.memory_estimate import check_agents_memory
from torch_iac.records import Genealogy, RegionSummary, ShadowStep, Step
from torch_iac.regions.cuts import best_cut
from torch_iac.regions.error_history import ErrorHistory
from torch_iac.regions.examples import Examples
from torch_iac.regions.tree import RegionTree
from torch_iac.space import SensorimotorSpace

Array = TypeVar("Array", np.ndarray, Tensor)
"""Arrays in, arrays out; tensors in, tensors out. Lists are taken as arrays, and numbers of any
kind as float32. Each method gives the shapes."""

CHOICE_STREAM = 0
"""Which of an agent's random streams its choices are drawn from."""

PREDICT_CHUNK = 4096
"""Situations per chunk, which bounds memory."""


@dataclass(frozen=True)
class _Decision:
    """Actions in progress, chosen by `act` or registered, with what `observe` needs."""

    sensors: Tensor  # (A, sensor_dim), raw
    actions: Tensor  # (A, action_dim), raw
    situations: Tensor  # (A, D)
    nodes: Tensor  # (A,)
    random: Tensor  # (A,)


class IAC(Stateful):
    """A population of robots driven by Intelligent Adaptive Curiosity.

    An agent's run depends on its own seed and on what its world returns, not on the others.

    Args:
        space: What the robots do, sense and predict.
        config: The numbers of the algorithm; those of 2004 if not given.
        seeds: One for each agent, any whole numbers.
        device: Where everything is kept and computed.

    Attributes:
        n_decisions: How many decisions each agent has taken.
        tree: The regions.
        examples: What each leaf holds.
        history: The errors and the progress of each leaf.
        whole_history: Each agent's errors in all regions together; None if the drive needs none.
        experts: The agents' own experts, which predict.
        shadows: Experts that predict and learn without any influence, by name.
        meta: MP; None without one.
        improvement: What learns how much an update lowers the error; None without one.

    Raises:
        ValueError: There are no seeds, the device is not available, a module cannot be the experts'
            network, or a curriculum names an action that the world does not have.

    Example:
        A robot that pushes and senses how far it got:

        >>> from torch_iac import Dimension
        >>> push, place = Dimension("push", -1.0, 1.0), Dimension("place", 0.0, 1.0)
        >>> agent = IAC(SensorimotorSpace((push,), (place,), outcomes=(place,)), seeds=[0])
        >>> actions = agent.act(np.array([[0.5]]))
        >>> step = agent.observe(np.array([[0.75]]))
        >>> step.predictions, step.errors
        (tensor([[0.5000]]), tensor([0.2500], dtype=torch.float64))

    Source: Oudeyer and Kaplan (2004).
    """

    saved = (
        "n_decisions",
        "tree",
        "examples",
        "history",
        "whole_history",
        "experts",
        "shadows",
        "meta",
        "improvement",
    )

    @with_torch_defaults
    def __init__(
        self,
        space: SensorimotorSpace,
        config: IACConfig | None = None,
        seeds: Sequence[int] = (0,),
        device: torch.device | str = "cpu",
    ) -> None:
        if isinstance(seeds, str) or not isinstance(seeds, Sized):
            raise ValueError(f"seeds must be a list of whole numbers, got {seeds!r}")
        if not len(seeds):
            raise ValueError("seeds must name at least one agent, got none")
        if config is not None and isinstance(config.drive, Curriculum):
            config.drive.columns(space)  # checked now, not when the stage begins
        self.space = space
        self.config = config = config or IACConfig()
        self.device = available_device(device)
        check_agents_memory(space, config, len(seeds), self.device)
        self.seeds = settled("seeds", seeds, tuple[int, ...])
        self.n_decisions = 0
        # On a GPU sensors are checked in `_judge`, with the one transfer of a decision.
        self._asks_late = self.device.type != "cpu"

        n_agents, action_dim = len(seeds), len(space.actions)
        outcome_dim, situation_dim = len(space.outcomes), len(space.situation)
        self.tree = RegionTree(n_agents, self.device)
        self.examples = Examples(
            n_agents, situation_dim, outcome_dim, config.max_examples, self.device
        )
        self.history = ErrorHistory(n_agents, config.window, config.delay, self.device)
        self.whole_history = (
            ErrorHistory(n_agents, config.window, config.delay, self.device)
            if "whole_history" in config.drive.needs
            else None
        )
        dims = (situation_dim, outcome_dim)
        self.experts = config.experts.pool(*dims, self.seeds, self.device)
        self.shadows = {
            name: experts.pool(*dims, self.seeds, self.device)
            for name, experts in config.shadows.items()
        }
        start = (situation_dim, self.seeds, self.device)
        self.meta = config.meta.start(*start) if config.meta else None
        self.improvement = config.improvement.start(*start) if config.improvement else None
        # For each decision: is it random, which candidate if that is left to chance, candidates.
        self._choices = RandomStream(
            self.seeds, 2 + config.n_candidates * action_dim, CHOICE_STREAM, self.device
        )
        self._action_scale = action_scale(space.actions, self.device)
        self._sensor_scale = Scale(space.sensors, self.device)
        self._outcome_scale = Scale(space.outcomes, self.device)
        self._outcome_columns = torch.tensor(space.outcome_columns, device=self.device)
        self._first_candidates = torch.arange(n_agents, device=self.device) * config.n_candidates
        self._decision: _Decision | None = None

    def __repr__(self) -> str:
        parts = (type(part).__name__ for part in (self.config.experts, self.config.drive))
        return (
            f"IAC({', '.join(parts)}: {self.n_agents} agents, {self.n_decisions} decisions, "
            f"{self.tree.n_rows} regions, on {self.device})"
        )

    @property
    def n_agents(self) -> int:
        """How many robots there are."""
        return len(self.seeds)

    @with_torch_defaults
    @torch.no_grad()
    def act(self, sensors: Array) -> Array:
        """Return the action that each agent takes now.

        Args:
            sensors: Shape `(A, sensor_dim)`, in raw units, as an array or a tensor.

        Returns:
            Shape `(A, action_dim)`, in raw units, float32, an array or a tensor like `sensors`.

        Raises:
            ValueError: The sensors have the wrong shape, NaN, or values outside their bounds (which
                on a GPU `observe` notices), or what the drive returns has the wrong shape.
            RuntimeError: The drive looks at knowledge that its `needs` do not name.
        """
        readings = self._checked(sensors)
        numbers = self._choices.at(self.n_decisions)
        drawn = numbers[:, 2:].reshape(self.n_agents, self.config.n_candidates, -1)
        candidates, nodes = self._candidates(readings, self._action_scale.of_drawn(drawn))
        worth = self._worth(candidates)
        # Candidates are drawn independently, so the first is a random action.
        random = numbers[:, 0] < self.config.epsilon
        chosen = self.config.choice.pick(worth, numbers[:, 1]).masked_fill_(random, 0)
        chosen += self._first_candidates
        situations = candidates.situations.flatten(0, 1).index_select(0, chosen)
        actions = self._action_scale.to_raw(situations[:, : len(self.space.actions)])
        nodes = nodes.take(chosen)
        self._decision = _Decision(readings, actions, situations, nodes, random)
        return actions if isinstance(sensors, Tensor) else actions.cpu().numpy()

    @with_torch_defaults
    @torch.no_grad()
    def set_actions(self, actions: np.ndarray | Tensor, sensors: np.ndarray | Tensor) -> None:
        """Register externally chosen actions, instead of choosing them by `act`.

        No such action counts as random (epsilon).

        Args:
            actions: Shape `(A, action_dim)`, in raw units, as an array or a tensor.
            sensors: Shape `(A, sensor_dim)`, before the actions, alike.

        Raises:
            ValueError: A shape is wrong, or a value is NaN, outside its bounds (which on a GPU, for
                sensors, `observe` notices) or none that an action has.
        """
        readings, given, candidates, nodes = self._told(actions, sensors)
        random = torch.zeros(self.n_agents, dtype=torch.bool, device=self.device)
        self._decision = _Decision(
            readings, given, candidates.situations[:, 0], nodes[:, 0], random
        )

    @with_torch_defaults
    @torch.no_grad()
    def worth(self, actions: np.ndarray | Tensor, sensors: np.ndarray | Tensor) -> Tensor:
        """Return the worth of an action to each agent now, according to the config's drive.

        Args:
            actions: Shape `(A, action_dim)`, in raw units, as an array or a tensor.
            sensors: Shape `(A, sensor_dim)`, before the actions, alike.

        Returns:
            Shape `(A,)`, float64, in the drive's units: of progress, those of scaled errors.

        Raises:
            ValueError: A shape is wrong, or a value is NaN or outside its bounds (which on a GPU,
                for sensors, is not checked).
        """
        _, _, candidates, _ = self._told(actions, sensors)
        return self._worth(candidates)[:, 0]

    @with_torch_defaults
    @torch.no_grad()
    def observe(self, sensors: np.ndarray | Tensor, *, learn: bool = True) -> Step:
        """Learn from what the sensors read after the action.

        Args:
            sensors: Shape `(A, sensor_dim)`, in raw units, as an array or a tensor.
            learn: False leaves everything as it is, the number of decisions too: the step only says
                what was predicted and how well.

        Raises:
            RuntimeError: There was no `act` or `set_actions` before.
            ValueError: The sensors have the wrong shape, NaN, or values outside their bounds.
            FloatingPointError: A loss is not finite; the message names the agent and the region.
        """
        decision = self._decision
        if decision is None:
            raise RuntimeError(
                "observe needs an action to learn from: call act first, or set_actions"
            )
        readings = self._checked(sensors)
        raw_outcomes = readings.index_select(1, self._outcome_columns)
        outcomes = self._outcome_scale.to_unit(raw_outcomes)
        rows = self.tree.rows.take(decision.nodes)
        predictions, errors = self._predict(self.experts, rows, decision, outcomes)
        step = Step(
            number=self.n_decisions,
            actions=decision.actions,
            sensors=decision.sensors,
            outcomes=raw_outcomes,
            predictions=self._outcome_scale.to_raw(predictions),
            errors=errors,
            expected_errors=self._expected_errors(decision.situations),
            regions=self.tree.region.take(decision.nodes),
            progress=self.history.progress.take(rows),
            random_actions=decision.random,
            shadows=tuple(
                self._shadow_step(name, pool, rows, decision, outcomes)
                for name, pool in self.shadows.items()
            ),
            used_network=(
                self.experts.uses_network(rows) if isinstance(self.experts, HybridPool) else None
            ),
        )
        if learn:
            counts, losses = self._learn(rows, decision, outcomes, errors)
            if self._judge(readings, decision, counts, losses):
                full = (counts > self.config.max_examples).nonzero()[:, 0]
                self._split(decision.nodes.take(full), rows.take(full))
            self.n_decisions += 1
        elif self._asks_late:
            self._check_readings(readings, decision)
        self._decision = None
        return step

    @with_torch_defaults
    @torch.no_grad()
    def predict(self, actions: Array, sensors: Array) -> Array:
        """Return each agent's predictions for some situations, without learning from them.

        Args:
            actions: Shape `(N, action_dim)`, in raw units, as an array or a tensor.
            sensors: Shape `(N, sensor_dim)`, before the actions, alike.

        Returns:
            Shape `(A, N, K)`, in raw units, float32, an array or a tensor like `sensors`.

        Raises:
            ValueError: A shape is wrong, or a value is NaN or outside its bounds.
        """
        parts = [
            self._scaled(actions, "actions", len(sensors), self._action_scale),
            self._scaled(sensors, "sensors", len(sensors), self._sensor_scale),
        ]
        at_once = max(1, PREDICT_CHUNK // self.n_agents)
        situations = torch.split(torch.cat(parts, dim=1), at_once)
        predictions = torch.cat([self._expected_outcomes(of) for of in situations], dim=1)
        predictions = self._outcome_scale.to_raw(predictions)
        return predictions if isinstance(sensors, Tensor) else predictions.cpu().numpy()

    @with_torch_defaults
    def state(self) -> State:
        """Return a copy of all that the future decisions depend on, besides the world.

        Raises:
            RuntimeError: The outcome of an action was not observed yet.
            TypeError: Experts, the agents' own or a shadow's, cannot be saved.
        """
        if self._decision is not None:
            raise RuntimeError("a state lies between two decisions: call observe first")
        return super().state()

    @with_torch_defaults
    def load_state(self, state: State) -> None:
        """Go on, bit for bit, from what `state` returned.

        The population must have been made with the same space, config and seeds.

        Raises:
            ValueError: A tensor is missing, has another type or shape, or is not known. The
                population is then of no use any more.
        """
        super().load_state(state)
        self._decision = None

    @with_torch_defaults
    @torch.no_grad()
    def expert(self, region: int, agent: int = 0) -> Any:
        """Return a copy of what predicts in a region now.

        Args:
            region: The number of a region that is a leaf, as steps and region tables have it.
            agent: Which agent's, counted from 0.

        Returns:
            Of networks the region's, a `torch.nn.Module` that turns situations `(n, D)` in the unit
            cube into outcomes `(n, K)` in scaled units; of nearest neighbours the
            `RegionExamples`.

        Raises:
            ValueError: There is no such agent or leaf, or the experts have no method `expert`.
        """
        if not 0 <= agent < self.n_agents:
            raise ValueError(f"agent must lie in [0, {self.n_agents}), got {agent}")
        leaves = self.tree.leaves()
        leaves = leaves[self.tree.agent[leaves] == agent]
        found = leaves[self.tree.region[leaves] == region]
        if not len(found):
            there = ", ".join(map(str, sorted(self.tree.region[leaves].tolist())))
            raise ValueError(f"region must be a leaf of agent {agent} ({there}), got {region}")
        if not hasattr(self.experts, "expert"):
            name = type(self.experts).__name__
            raise ValueError(f"experts must have a method expert for this, got {name}")
        return self.experts.expert(self.examples, int(self.tree.rows[found[0]]))

    @with_torch_defaults
    def genealogy(self) -> Genealogy:
        """Return every region ever made."""
        return self.tree.genealogy(self.examples.counts)

    @with_torch_defaults
    def region_summary(self, n_agents: int | None = None) -> RegionSummary:
        """Return what each present leaf knows.

        Args:
            n_agents: Only of the first so many agents; of all if not given.
        """
        nodes = self.tree.leaves()
        if n_agents is not None:
            nodes = nodes[self.tree.agent[nodes] < n_agents]
        rows = self.tree.rows[nodes]
        columns = RegionSummary(
            agent=self.tree.agent[nodes],
            region=self.tree.region[nodes],
            progress=self.history.progress[rows],
            mean_error=self.history.mean_error(rows),
            n_examples=self.examples.counts[rows],
        )
        return RegionSummary(**{name: column.cpu() for name, column in vars(columns).items()})

    def _checked(self, sensors: np.ndarray | Tensor) -> Tensor:
        expected = (self.n_agents, len(self.space.sensors))
        readings = self._given(sensors, "sensors", "agents", expected)
        if not self._asks_late:
            self._sensor_scale.check(readings, "agent")
        return readings

    def _given(
        self, values: np.ndarray | Tensor, what: str, rows: str, expected: tuple[int, int]
    ) -> Tensor:
        """Return a copy, since worlds reuse their buffers, of values of the right shape."""
        given = own_tensor(values, what, self.device)
        if given.shape != expected:
            raise ValueError(
                f"{what} must have the shape ({rows}, {what}) = {expected}, "
                f"got {tuple(given.shape)}"
            )
        return given

    def _scaled(self, values: Array, what: str, n_rows: int, scale: Scale) -> Tensor:
        """Return values of any situations, checked and scaled to the unit cube."""
        given = self._given(values, what, "situations", (n_rows, len(scale.dimensions)))
        scale.check(given, "situation")
        return scale.to_unit(given)

    def _told(
        self, actions: np.ndarray | Tensor, sensors: np.ndarray | Tensor
    ) -> tuple[Tensor, Tensor, Candidates, Tensor]:
        """Return external sensors and actions, checked, in raw units, and as the only candidate."""
        readings = self._checked(sensors)
        expected = (self.n_agents, len(self.space.actions))
        given = self._given(actions, "actions", "agents", expected)
        self._action_scale.check(given, "agent")
        candidates, nodes = self._candidates(readings, self._action_scale.to_unit(given)[:, None])
        return readings, given, candidates, nodes

    def _candidates(self, readings: Tensor, actions: Tensor) -> tuple[Candidates, Tensor]:
        """Return the situations of scaled actions `(A, C, action_dim)`, and their leaves."""
        context = self._sensor_scale.to_unit(readings)[:, None]
        situations = torch.cat([actions, context.expand(-1, actions.shape[1], -1)], dim=2)
        nodes = self.tree.route(situations)
        return Candidates(situations, self.tree.rows.take(nodes)), nodes

    def _worth(self, candidates: Candidates) -> Tensor:
        worth = self.config.drive.worth(candidates, self._knowledge())
        if worth.shape != candidates.rows.shape:
            raise ValueError(
                f"a drive's worth must have the shape (agents, candidates) = "
                f"{tuple(candidates.rows.shape)}, got {tuple(worth.shape)}"
            )
        return worth

    def _knowledge(self) -> Knowledge:
        return Knowledge(
            self.n_decisions,
            self.space,
            self.examples,
            self.history,
            self.meta,
            self.whole_history,
            self.improvement,
        )

    def _predict(
        self, pool: ExpertPool, rows: Tensor, decision: _Decision, outcomes: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return predictions `(A, K)` and their errors `(A,)`, in scaled units."""
        predictions = pool.predict(self.examples, rows, decision.situations)
        difference = (predictions - outcomes).double()
        size = difference.abs_() if self.config.error == "absolute" else difference.square_()
        return predictions, size.mean(dim=1)

    def _expected_outcomes(self, situations: Tensor) -> Tensor:
        """Return what each agent expects of situations `(N, D)`, shape `(A, N, K)`, scaled."""
        asked = situations.expand(self.n_agents, -1, -1)
        rows = self.tree.rows.take(self.tree.route(asked))
        predictions = self.experts.predict(self.examples, rows.flatten(), asked.flatten(0, 1))
        return predictions.view(*rows.shape, -1)

    def _expected_errors(self, situations: Tensor) -> Tensor | None:
        return self.meta.expect(situations[:, None])[:, 0] if self.meta else None

    def _shadow_step(
        self, name: str, pool: ExpertPool, rows: Tensor, decision: _Decision, outcomes: Tensor
    ) -> ShadowStep:
        predictions, errors = self._predict(pool, rows, decision, outcomes)
        return ShadowStep(name, self._outcome_scale.to_raw(predictions), errors)

    def _learn(
        self, rows: Tensor, decision: _Decision, outcomes: Tensor, errors: Tensor
    ) -> tuple[Tensor, list[Tensor]]:
        """Return how many examples each row has now, and the losses of all that learnt, `(A,)`."""
        self.history.add(rows, errors)
        if self.whole_history is not None:
            self.whole_history.add(self.tree.roots, errors)
        counts = self.examples.add(rows, decision.situations, outcomes)
        pools = (self.experts, *self.shadows.values())
        losses = [pool.learn(self.examples, rows, self.n_decisions) for pool in pools]
        if self.improvement is not None:
            _, errors_after = self._predict(self.experts, rows, decision, outcomes)
            gains = errors - errors_after
            losses.append(self.improvement.learn(decision.situations, gains, self.n_decisions))
        if self.meta is not None:
            losses.append(self.meta.learn(decision.situations, errors, self.n_decisions))
        return counts, [loss for loss in losses if loss is not None]

    def _judge(
        self, readings: Tensor, decision: _Decision, counts: Tensor, losses: list[Tensor]
    ) -> bool:
        """Return whether a region is full (C1), unless something is wrong.

        All flags of a decision are transferred from a GPU here at once: each transfer waits.
        """
        wrong = [~loss.isfinite() for loss in losses]
        if self._asks_late:
            wrong += [self._sensor_scale.outside(seen) for seen in (decision.sensors, readings)]
        full = counts > self.config.max_examples
        *is_wrong, is_full = torch.stack([flags.any() for flags in (*wrong, full)]).tolist()
        if any(is_wrong):
            self._check_readings(readings, decision)
            for loss in losses:
                self._refuse_infinite(loss, decision.nodes)
        return bool(is_full)

    def _check_readings(self, readings: Tensor, decision: _Decision) -> None:
        for seen in (decision.sensors, readings):
            self._sensor_scale.check(seen, "agent")

    def _refuse_infinite(self, losses: Tensor, nodes: Tensor) -> None:
        bad = (~losses.isfinite()).nonzero()
        if len(bad):
            agent = int(bad[0])
            raise FloatingPointError(
                f"a loss must be finite, got {losses[agent].item()} in region "
                f"{self.tree.region[nodes[agent]].item()} of agent {agent} at decision "
                f"{self.n_decisions}"
            )

    def _split(self, nodes: Tensor, rows: Tensor) -> None:
        situations = self.examples.situations[rows]  # (F, D, N)
        outcomes = self.examples.outcomes[rows]
        cut = best_cut(situations.mT, outcomes.mT, self.config.balance)
        if not cut.found.all():
            self.examples.forget_oldest(rows[~cut.found])
            nodes, rows, situations = nodes[cut.found], rows[cut.found], situations[cut.found]
            cut = type(cut)(*(column[cut.found] for column in vars(cut).values()))
            if not len(nodes):
                return
        split = self.tree.split(nodes, cut, self.examples.counts[rows], self.n_decisions)
        along_cut = situations.gather(
            1, cut.dimension[:, None, None].expand(-1, 1, situations.shape[2])
        )[:, 0]
        self.examples.split(split, along_cut > cut.value[:, None])
        self.history.split(split, self.config.inherit_history)
        for pool in (self.experts, *self.shadows.values()):
            pool.split(self.examples, split)
