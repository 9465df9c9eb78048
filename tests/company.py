"""What networks learn in company and alone: checked, and its digest printed.

    python -m tests.company

Run under settings that make libraries round as on another processor.
"""

import hashlib
from collections.abc import Sequence

import torch
from torch import Tensor

from torch_iac.losses import LOSSES
from torch_iac.networks import MLP, StackedNetworks, Training

CASES = (((32, 32), 14, 1, 32), ((8,), 24, 1, 33), ((7,), 7, 3, 5), ((), 14, 2, 3))
"""Hidden layers, numbers of inputs and outputs, examples in a minibatch."""


def learnt(n_networks: int, rows: Sequence[int]) -> list[Tensor]:
    """Return the losses and answers `(rows, ...)` of networks that learn with those of `rows`."""
    found = []
    these = torch.tensor(rows)
    for hidden, n_inputs, n_outputs, size in CASES:
        generator = torch.Generator().manual_seed(0)
        inputs = torch.rand(n_networks, 2 * size, n_inputs, generator=generator)
        targets = torch.rand(n_networks, 2 * size, n_outputs, generator=generator)
        cpu = torch.device("cpu")
        networks = StackedNetworks(MLP(hidden), n_inputs, n_outputs, Training(), cpu)
        networks.reserve(n_networks)
        networks.start(torch.arange(n_networks), range(n_networks))
        for loss in LOSSES:
            for _ in range(5):
                losses = networks.train(these, inputs[these], targets[these], size, loss)
            found += [losses, networks.predict(these, inputs[these, :9])]
    return found


def digest(tensors: Sequence[Tensor]) -> str:
    """Return the SHA-256 of all their bytes."""
    return hashlib.sha256(b"".join(part.numpy().tobytes() for part in tensors)).hexdigest()


def main() -> None:
    """Check that company changes nothing and print the digest."""
    together = learnt(40, range(40))
    for rows in ([0], [39], [3, 17]):
        for alone, all_of_them in zip(learnt(40, rows), together, strict=True):
            assert torch.equal(alone, all_of_them[rows])
    print(digest(together))  # noqa: T201


if __name__ == "__main__":
    main()
