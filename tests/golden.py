"""Golden runs: what short runs come to, to the last bit.

    python -m tests.golden                              # print their digests
    python -m tests.golden --write                      # make them the ones that are expected
    python -m tests.golden --steps 300 knn_pybullet     # shorter, and of one kind

A digest is the SHA-256 of all that two robots did, sensed, predicted, erred and learnt, decision by
decision. `golden.json` holds those that every x86-64 processor must give. With `--company`, what
networks learn alone is held against what they learn with others, too.
"""

import hashlib
import json
from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor

import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac.agent import IAC
from torch_iac.config import IACConfig
from torch_iac.experts import mlp
from torch_iac.experts.network import MLPExperts
from torch_iac.experts.stacked_networks import StackedNetworks, Training
from torch_iac.internal.losses import LOSSES
from torch_iac.meta_predictor import MetaPredictor
from torch_iac.records import Step
from torch_iac.space import SensorimotorSpace

FILE = Path(__file__).with_name("golden.json")
SEEDS = (0, 1)
STEPS = (300, 2_000)
KNN, MLP = IACConfig(meta=None), IACConfig(experts=MLPExperts(), meta=MetaPredictor())
RUNS = {
    "knn_pybullet": ("torch_iac_envs/ToyRoom-v0", KNN),
    "knn_kinematic": ("torch_iac_envs/ToyRoomKinematic-v0", KNN),
    "mlp_kinematic": ("torch_iac_envs/ToyRoomKinematic-v0", MLP),
}
"""The world and the robots of each kind of run."""


def digest(name: str, n_steps: int) -> str:
    """Return the digest of a run of some length."""
    world, config = RUNS[name]
    env: Any = gym.make_vec(world, len(SEEDS))
    agent = IAC(SensorimotorSpace.from_env(env, outcomes=["toy_distance"]), config, SEEDS)
    hasher = hashlib.sha256()
    sensors, _ = env.reset(seed=list(SEEDS))
    for _ in range(n_steps):
        sensors, *_ = env.step(agent.act(sensors))
        for column in _columns(agent.observe(sensors)):
            hasher.update(column.tobytes())
    env.close()
    return hasher.hexdigest()


def _columns(step: Step) -> list[np.ndarray]:
    """Return what is recorded of a decision, in a fixed order and in fixed types."""
    columns = [
        *(step.actions, step.sensors, step.outcomes, step.predictions),
        *(step.errors, step.expected_errors, step.regions, step.progress),
    ]
    return [np.asarray(column, "<f8") for column in columns if column is not None]


CASES = (((32, 32), 14, 1, 32), ((8,), 24, 1, 33), ((7,), 7, 3, 5), ((), 14, 2, 3))
"""Hidden layers, numbers of inputs and outputs, examples in a minibatch."""


def learnt(rows: Sequence[int], n_networks: int = 40) -> list[Tensor]:
    """Return the losses and answers `(rows, ...)` of networks that learn with those of `rows`."""
    found = []
    these = torch.tensor(rows)
    for hidden, n_inputs, n_outputs, size in CASES:
        generator = torch.Generator().manual_seed(0)
        inputs = torch.rand(n_networks, 2 * size, n_inputs, generator=generator)
        targets = torch.rand(n_networks, 2 * size, n_outputs, generator=generator)
        cpu = torch.device("cpu")
        networks = StackedNetworks(mlp.MLP(hidden), n_inputs, n_outputs, Training(), cpu)
        networks.reserve(n_networks)
        networks.start(torch.arange(n_networks), range(n_networks))
        for loss in LOSSES:
            for _ in range(5):
                losses = networks.train(these, inputs[these], targets[these], size, loss)
            found += [losses, networks.predict(these, inputs[these, :9])]
    return found


def check_company() -> None:
    """Check that networks learn alone, to the bit, what they learn with others."""
    together = learnt(range(40))
    for rows in ([0], [39], [3, 17]):
        for alone, all_of_them in zip(learnt(rows), together, strict=True):
            if not torch.equal(alone, all_of_them[rows]):
                raise AssertionError(f"networks {rows} learn otherwise alone than in company")


def main() -> None:
    """Print the digests, or write them."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(RUNS))
    parser.add_argument("--steps", type=int, nargs="+", default=STEPS)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--company", action="store_true")
    options = parser.parse_args()
    if options.company:
        check_company()
    found = {
        name: {str(n_steps): digest(name, n_steps) for n_steps in options.steps}
        for name in options.names
    }
    text = json.dumps(found, indent=2) + "\n"
    print(text, end="")  # noqa: T201
    if options.write:
        FILE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
