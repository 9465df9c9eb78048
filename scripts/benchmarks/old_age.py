"""Does a decision cost more as a robot grows old, and how much memory do its examples take?

    python -m scripts.benchmarks.old_age

One robot with 20 sensorimotor dimensions learns made-up transitions. When it has as many examples
as one of `ages` says, its last thousand decisions (act and observe) have been timed, in seconds of
the processor, and the memory of the process is read. Prints Markdown; `docs/benchmarks.md` holds a
copy.

Source of the scale: Oudeyer, Kaplan and Hafner (2007) claim "a few milliseconds" and about 230 MB
for 3,000,000 examples of 20 dimensions.
"""

import resource
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from torch import Tensor
from tqdm import trange

import torch_iac as iac

N_ACTIONS, N_SENSORS = 4, 16
COUNTED = 1000
"""Decisions over which times are taken."""


@dataclass(frozen=True)
class OldAge:
    """How old the robot becomes."""

    ages: tuple[int, ...] = (30_000, 300_000, 1_000_000, 3_000_000)
    """At how many examples it is measured."""
    seed: int = 0
    """Seed of the robot and of its sensors."""


def main(old_age: OldAge) -> None:
    """Print the table."""
    torch.set_num_threads(1)
    actions = tuple(iac.Dimension(f"a{i}", 0.0, 1.0) for i in range(N_ACTIONS))
    sensors = tuple(iac.Dimension(f"s{i}", 0.0, 1.0) for i in range(N_SENSORS))
    space = iac.SensorimotorSpace(actions, sensors, sensors[:1])
    agent = iac.IAC(space, iac.IACConfig(meta=None), seeds=[old_age.seed])
    world = World(old_age.seed)
    before = resident()
    print("| examples | regions | median ms | mean ms | slowest ms | memory / raw numbers |")
    print("|---|---|---|---|---|---|")
    for age in sorted(old_age.ages):
        for _ in trange(age - COUNTED - agent.n_decisions, disable=None, leave=False):
            world.decide(agent)
        times = 1000 * np.array([world.decide(agent) for _ in range(COUNTED)])
        raw = 4 * age * (N_ACTIONS + N_SENSORS + 1)
        print(
            f"| {age:,} | {agent.tree.n_rows:,} | {np.median(times):.3f} | {times.mean():.3f} "
            f"| {times.max():.1f} | {(resident() - before) / raw:.2f} |",
            flush=True,
        )
    most = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(f"\nThe most memory at any time: {(most - before) / raw:.2f} of the raw numbers.")


class World:
    """Made-up transitions: the first sensor follows two actions and two sensors, in part of it."""

    def __init__(self, seed: int) -> None:
        self._generator = torch.Generator().manual_seed(seed)
        self._sensors = self._noise()

    def decide(self, agent: iac.IAC) -> float:
        """Let an agent take a decision; return the processor's seconds that it took."""
        started = time.process_time()
        actions = agent.act(self._sensors)
        acted = time.process_time() - started
        after = self._noise()
        follows = (actions[:, 0] + self._sensors[:, 1] * actions[:, 1] + self._sensors[:, 2]) / 3
        after[:, 0] = torch.where(actions[:, 2] > 0.5, follows, after[:, 0])
        self._sensors = after
        started = time.process_time()
        agent.observe(after)
        return acted + time.process_time() - started

    def _noise(self) -> Tensor:
        return torch.rand(1, N_SENSORS, generator=self._generator)


def resident() -> int:
    """Return how many bytes of memory the process has now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


if __name__ == "__main__":
    main(tyro.cli(OldAge, description=__doc__))
