"""Memory that agents and a run of theirs will need, estimated before they begin, and free memory.

Memory grows with the leaves of the region trees, and those with decisions. Tables double when they
are full.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import NamedTuple

import torch

from torch_iac.config import IACConfig
from torch_iac.experts.hybrid import HybridExperts
from torch_iac.experts.mlp import MLP
from torch_iac.experts.modules import RowModule, buffers_of, weights_of
from torch_iac.experts.network import MLPExperts, NetworkExperts, NetworkTraining
from torch_iac.experts.protocol import Experts
from torch_iac.experts.stacked_networks import Training
from torch_iac.internal.randomness import block_size
from torch_iac.space import SensorimotorSpace

MARGIN = 1.2
"""Bytes allocated per byte needed, because of fragmentation."""

CUT_BYTES = 64
"""Peak temporary bytes of the best cut, for each coordinate of each example: its rank and
its value, and sums and gains in float64."""

NODE_BYTES = 1500
"""Bytes of a leaf, its ancestors and their exits in the region tree, whose tables double too."""

CANDIDATE_BYTES = 200
"""Peak temporary bytes of routing a candidate: eight comparisons and their numbers."""

DRAW_BYTES = 24
"""Peak temporary bytes of a random number."""

GROUPS = (
    ("/sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
    (
        "/sys/fs/cgroup/memory",
        "memory.limit_in_bytes",
        "memory.usage_in_bytes",
        "total_inactive_file",
    ),
)
"""Linux's control groups, newer and older: folder, files of limit and usage, and the name of the
memory that could be reclaimed."""


class Recording(NamedTuple):
    """The memory for the records of a run, in bytes.

    Attributes:
        kept: The decisions that are not yet on disk, where the agents are.
        on_host: In the main memory, to write and to sum up the records.
    """

    kept: int = 0
    on_host: int = 0


NOTHING = Recording()
"""What a run needs for its records without any."""


@dataclass(frozen=True)
class Need:
    """The memory of a run, in bytes.

    Attributes:
        tables: What the agents keep, where they are.
        working: Their peak temporary bytes, there too.
        recording: That for the records.
    """

    tables: int
    working: int
    recording: Recording

    @property
    def on_device(self) -> int:
        """All that is needed on the agents' device."""
        return int(MARGIN * (self.tables + self.working + self.recording.kept))


@dataclass(frozen=True)
class _Network:
    """The size of a network.

    Attributes:
        n_weights: How many weights it has.
        n_units: How many outputs all its layers have; for any other module, how many biases.
        n_buffer_bytes: How many bytes of buffers.
    """

    n_weights: int
    n_units: int
    n_buffer_bytes: int = 0


def check_memory(
    space: SensorimotorSpace,
    config: IACConfig,
    n_agents: int,
    n_decisions: int,
    device: torch.device,
    recording: Recording = NOTHING,
) -> None:
    """Refuse a run that will not fit into memory; where free memory is not known, refuse none.

    Args:
        space: What the robots do, sense and predict.
        config: The numbers of the algorithm.
        n_agents: How many robots.
        n_decisions: How many decisions each takes.
        device: Where the robots are.
        recording: What their records need.

    Raises:
        ValueError: It will not fit; the message says what is needed and what is free.
    """
    need = memory_needed(space, config, n_agents, n_decisions, recording)
    needed = {"cpu": recording.on_host}
    place = "cpu" if device.type == "cpu" else str(device)
    needed[place] = needed.get(place, 0) + need.on_device
    who = f"{n_agents:,} agents and {n_decisions:,} decisions"
    for place, n_bytes in needed.items():
        _check_fits(who, n_bytes, torch.device(place), "agents, steps or max_examples")


def check_agents_memory(
    space: SensorimotorSpace, config: IACConfig, n_agents: int, device: torch.device
) -> None:
    """Refuse agents whose tables will not fit into memory, even before their first region splits.

    Args:
        space: What they do, sense and predict.
        config: The numbers of the algorithm.
        n_agents: How many.
        device: Where they are.

    Raises:
        ValueError: They will not; the message says what is needed and what is free.
    """
    n_bytes = int(MARGIN * memory_needed(space, config, n_agents, n_decisions=1).tables)
    _check_fits(f"{n_agents:,} agents", n_bytes, device, "agents or max_examples")


def check_world_memory(n_worlds: int, world_bytes: int) -> None:
    """Refuse worlds that will not fit into the main memory.

    Args:
        n_worlds: How many.
        world_bytes: What each takes.

    Raises:
        ValueError: They will not; the message says what is needed and what is free.
    """
    _check_fits(f"{n_worlds:,} worlds", n_worlds * world_bytes, torch.device("cpu"), "agents")


def _check_fits(who: str, n_bytes: int, device: torch.device, lower: str) -> None:
    free = free_memory(device)
    if free is not None and n_bytes > free:
        raise ValueError(
            f"a run must fit into memory: {who} need about {n_bytes / 1e9:.1f} GB on {device}, "
            f"got {free / 1e9:.1f} GB free; lower {lower}"
        )


def memory_needed(
    space: SensorimotorSpace,
    config: IACConfig,
    n_agents: int,
    n_decisions: int,
    recording: Recording = NOTHING,
) -> Need:
    """Return about how much memory a run needs; experts of an unknown kind count as nothing.

    Args:
        space: What the robots do, sense and predict.
        config: The numbers of the algorithm.
        n_agents: How many robots.
        n_decisions: How many decisions each takes.
        recording: What their records need; nothing if not given.
    """
    dims = len(space.situation), len(space.outcomes)
    capacity = 2 ** (_n_leaves(config, n_decisions) - 1).bit_length()  # rows double
    drawn = _numbers_drawn(config, len(space.actions), n_agents)
    # While the largest column doubles, its old half is there too.
    doubling = (capacity // 2) * dims[0] * (config.max_examples + 1) * 4 if capacity > 1 else 0
    leaves = capacity * _leaf_bytes(config, *dims)
    return Need(
        tables=n_agents * (leaves + _agent_bytes(config, dims[0])) + 4 * sum(drawn),
        working=n_agents * max(doubling, *_working_bytes(config, space)) + DRAW_BYTES * max(drawn),
        recording=recording,
    )


def free_memory(device: torch.device) -> int | None:
    """Return how many bytes are free on a device; None where that is unknown."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    known = [*_free_of_machine(), *_free_of_groups()] if device.type == "cpu" else []
    return min(known, default=None)


def _n_leaves(config: IACConfig, n_decisions: int) -> int:
    """Return how many leaves an agent's tree is expected to have."""
    if n_decisions <= config.max_examples:
        return 1
    # How full a leaf is on average; unequal cuts leave small ones.
    fill = min(0.7, round(0.3 + 4 / 3 * config.balance, 3))
    return ceil(n_decisions / (fill * config.max_examples))


def _leaf_bytes(config: IACConfig, situation_dim: int, outcome_dim: int) -> int:
    """Return the bytes of each leaf."""
    examples = (situation_dim + outcome_dim) * (config.max_examples + 1) * 4
    history = (config.delay + config.window + 1) * 8
    networks = sum(
        _network_bytes(_network(experts, situation_dim, outcome_dim))
        for experts in _learners(config)
    )
    compared = sum(
        8 * (2 * of.recent + 3)
        for of in (config.experts, *config.shadows.values())
        if isinstance(of, HybridExperts)
    )
    return examples + history + networks + compared + NODE_BYTES


def _agent_bytes(config: IACConfig, situation_dim: int) -> int:
    """Return the bytes of each agent besides its leaves."""
    n_bytes = (config.delay + config.window + 1) * 8 if "whole_history" in config.drive.needs else 0
    for training in (config.meta, config.improvement):
        if training is not None:
            n_bytes += (situation_dim + 1) * training.memory * 4
            n_bytes += _network_bytes(_mlp(training.hidden, situation_dim * training.bins, 1))
    return n_bytes


def _numbers_drawn(config: IACConfig, action_dim: int, n_agents: int) -> list[int]:
    """Return how many random numbers each stream draws at once, for all agents."""
    needed = [2 + config.n_candidates * action_dim]
    for part in (*_learners(config), config.meta, config.improvement):
        if isinstance(part, Training):
            needed.append(_n_minibatches(part) * part.minibatch_size)
    return [n_agents * n * block_size(n_agents, n) for n in needed]


def _working_bytes(config: IACConfig, space: SensorimotorSpace) -> Iterator[int]:
    """Yield the peak temporary bytes of each agent: to cut, to weigh candidates, to learn."""
    dim, n_examples = len(space.situation), config.max_examples + 1
    yield CUT_BYTES * dim * n_examples  # all agents' first cuts fall on the same decision
    yield config.n_candidates * (3 * dim * 4 + CANDIDATE_BYTES)
    for experts in _learners(config):
        network = _network(experts, dim, len(space.outcomes))
        if network is not None and isinstance(experts, NetworkTraining):
            yield _training_bytes(network, experts, dim)
    for training in (config.meta, config.improvement):
        if training is not None:
            n_inputs = dim * training.bins
            network = _mlp(training.hidden, n_inputs, 1)
            yield _training_bytes(network, training, dim + n_inputs)
            yield config.n_candidates * 4 * (n_inputs + 2 * network.n_units)


def _learners(config: IACConfig) -> list[Experts]:
    """Return all experts; of hybrid ones the network, beside which the rest is small."""
    all_of_them = (config.experts, *config.shadows.values())
    return [of.network if isinstance(of, HybridExperts) else of for of in all_of_them]


def _network(experts: Experts, situation_dim: int, outcome_dim: int) -> _Network | None:
    """Return the size of the network of a kind of experts; None for other experts."""
    if isinstance(experts, MLPExperts):
        return _mlp(experts.hidden, situation_dim, outcome_dim)
    if isinstance(experts, NetworkExperts):
        made = RowModule(experts.module, situation_dim, outcome_dim, torch.device("cpu")).template
        parameters = list(weights_of(made).values())
        return _Network(
            n_weights=sum(weights.numel() for weights in parameters),
            n_units=sum(weights.numel() for weights in parameters if weights.ndim == 1),
            n_buffer_bytes=sum(buffer.nbytes for buffer in buffers_of(made).values()),
        )
    return None


def _mlp(hidden: tuple[int, ...], n_inputs: int, n_outputs: int) -> _Network:
    """Return the size of a multi-layer perceptron without making it."""
    sizes = MLP(hidden).sizes(n_inputs, n_outputs)
    n_weights = sum((n_in + 1) * n_out for n_in, n_out in sizes)
    return _Network(n_weights, sum(n_out for _, n_out in sizes))


def _network_bytes(network: _Network | None) -> int:
    """Return a network's bytes: its weights, and twice as much for the optimiser's state."""
    return 0 if network is None else 3 * 4 * network.n_weights + network.n_buffer_bytes


def _n_minibatches(training: Training) -> int:
    """Return how many minibatches are drawn at once, at most."""
    if isinstance(training, NetworkTraining) and training.children == "fresh":
        return max(training.minibatches, training.fresh_minibatches)
    return training.minibatches


def _training_bytes(network: _Network, training: Training, n_inputs: int) -> int:
    """Return the peak temporary bytes of a network while it learns.

    All minibatches of a decision are drawn at once; each layer keeps its outputs and their
    gradient; weights, gradient and optimiser state are copied, and copied again by a step.
    """
    picked = _n_minibatches(training) * training.minibatch_size * (8 + 4 * n_inputs)
    layers = 4 * 4 * training.minibatch_size * network.n_units
    return picked + layers + 8 * 4 * network.n_weights


def _free_of_machine() -> Iterator[int]:
    """Yield the machine's free memory, on Linux."""
    path = Path("/proc/meminfo")
    if path.is_file():
        lines = dict(line.split(":", 1) for line in path.read_text().splitlines())
        yield int(lines["MemAvailable"].split()[0]) * 1024


def _free_of_groups() -> Iterator[int]:
    """Yield the memory that the limits of this process's control groups leave free."""
    path = Path("/proc/self/cgroup")
    own = [line.split(":")[2] for line in path.read_text().splitlines()] if path.is_file() else []
    for root, most, taken, idle in GROUPS:
        for folder in {Path(root), *(Path(root) / name.strip("/") for name in own)}:
            limit = folder / most
            if limit.is_file() and (text := limit.read_text().strip()) != "max":
                stat = dict(
                    line.split() for line in (folder / "memory.stat").read_text().splitlines()
                )
                yield int(text) - int((folder / taken).read_text()) + int(stat.get(idle, 0))
