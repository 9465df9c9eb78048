"""Random numbers of many worlds: a pure function of a world's seed and of a counter, the moment.

A counter-based generator: no state but the moment's number, and a world's numbers do not depend on
how many others there are. Integers make the uniform numbers, which are the same on every device.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torch_iac_envs.elementary import circle, logarithm, root

GOLDEN = -0x61C8864680B583EB
"""2**64 / golden ratio, as a signed 64-bit integer."""
MIX_1 = -0x40A7B892E31B1A47
MIX_2 = -0x6B2FB644ECCEEE15
"""SplitMix64's factors, as signed 64-bit integers."""
WORLD = 0x746F79726F6F6D
"""Makes a world's numbers independent of those that an agent draws from the same seed."""
UNIT_BITS = 24
"""How many random bits a number has."""


def pack_seeds(seeds: Sequence[int], device: torch.device) -> Tensor:
    """Return the seeds, taken modulo 2**64, shape `(A,)`, int64."""
    return torch.tensor([_signed(seed) for seed in seeds], dtype=torch.int64, device=device)


def uniform(seeds: Tensor, moment: int, n_numbers: int) -> Tensor:
    """Return each world's numbers at a moment, shape `(n_numbers, A)`, float32.

    They are multiples of 2**-24, uniform over [0, 1).

    Args:
        seeds: As `pack_seeds` returns them.
        moment: How many times numbers were drawn before.
        n_numbers: How many numbers each world needs.

    Source: the finaliser of SplitMix64 (Steele, Lea and Flood, 2014), on counters.
    """
    key = _mix(_mix(seeds + GOLDEN) ^ WORLD)
    moment_key = _mix(key + _signed((moment + 1) * GOLDEN))
    lanes = torch.arange(1, n_numbers + 1, device=seeds.device) * GOLDEN
    bits = _mix(moment_key + lanes[:, None])
    return _logical_shift(bits, 64 - UNIT_BITS).float() * 2.0**-UNIT_BITS


def normal(uniforms: Tensor) -> Tensor:
    """Return standard normal numbers for pairs of uniform ones, shape `(2, pairs, A)`.

    Source: Box and Muller (1958), A note on the generation of random normal deviates.
    """
    first, second = uniforms.double().unbind()
    radius = root(-2 * logarithm(1 - first))
    return (radius * circle(math.tau * second)).to(uniforms.dtype)


def _mix(z: Tensor) -> Tensor:
    """The finaliser of SplitMix64 (Steele, Lea and Flood, 2014), on 64-bit integers that wrap."""
    z = (z ^ _logical_shift(z, 30)) * MIX_1
    z = (z ^ _logical_shift(z, 27)) * MIX_2
    return z ^ _logical_shift(z, 31)


def _logical_shift(z: Tensor, bits: int) -> Tensor:
    return (z >> bits) & ((1 << (64 - bits)) - 1)


def _signed(number: int) -> int:
    return (number + 2**63) % 2**64 - 2**63
