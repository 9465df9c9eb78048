"""Random numbers as a pure function of an agent's seed, a stream and a decision.

A counter-based generator: no state to keep, to share or to save, the same numbers on every device,
and an agent's numbers do not depend on the other agents.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

_GOLDEN = -0x61C8864680B583EB  # 2**64 / golden ratio, as a signed 64-bit integer
_MIX_1 = -0x40A7B892E31B1A47
_MIX_2 = -0x6B2FB644ECCEEE15
_BLOCK_NUMBERS = 2**15  # what is at work then stays in a processor's cache
_UNIT_BITS = 23


class RandomStream:
    """Uniform numbers for each agent and decision.

    Args:
        seeds: One an agent; agents with the same seed draw the same numbers.
        n_numbers: How many numbers an agent needs at a decision.
        stream: Which of the agent's streams; different streams are independent.
        device: Where the numbers are made.

    Source: the finaliser of SplitMix64 (Steele, Lea and Flood, 2014), on counters.
    """

    def __init__(
        self, seeds: Sequence[int], n_numbers: int, stream: int, device: torch.device
    ) -> None:
        key = torch.tensor([_signed(seed) for seed in seeds], dtype=torch.int64, device=device)
        self._key = _mix(_mix(key + _GOLDEN) + _signed(stream * _GOLDEN))
        self._lanes = torch.arange(1, n_numbers + 1, device=device) * _GOLDEN
        self._block_size = block_size(len(seeds), n_numbers)
        self._block_start = -1
        self._block = torch.empty(0)

    def at(self, step: int) -> Tensor:
        """Return the numbers of a decision, shape `(A, n_numbers)`, float32.

        They are multiples of 2**-23, uniform over [0, 1).
        """
        offset = step % self._block_size
        if step - offset != self._block_start:
            self._block_start = step - offset
            self._block = self._draw(self._block_start)
        return self._block[offset]

    def _draw(self, start: int) -> Tensor:
        steps = torch.arange(start, start + self._block_size, device=self._key.device)
        decision_keys = _mix(self._key + (steps[:, None] + 1) * _GOLDEN)  # (B, A)
        bits = _mix_high(decision_keys[..., None] + self._lanes)  # (B, A, n)
        return _logical_shift(bits, 64 - _UNIT_BITS).float().mul_(2.0**-_UNIT_BITS)


def block_size(n_agents: int, n_numbers: int) -> int:
    """Return for how many decisions numbers are drawn at once.

    For one agent, the numbers of a decision then cost next to nothing.
    """
    return max(1, min(256, _BLOCK_NUMBERS // (n_agents * n_numbers)))


def _mix(z: Tensor) -> Tensor:
    """Mix 64-bit integers in place: SplitMix64's finaliser (Steele, Lea and Flood, 2014)."""
    z = _mix_high(z)
    return z.bitwise_xor_(_logical_shift(z, 31))


def _mix_high(z: Tensor) -> Tensor:
    """Mix all but the last step of `_mix`, which leaves the highest 31 bits as they are."""
    z.bitwise_xor_(_logical_shift(z, 30)).mul_(_MIX_1)
    return z.bitwise_xor_(_logical_shift(z, 27)).mul_(_MIX_2)


def _logical_shift(z: Tensor, bits: int) -> Tensor:
    return (z >> bits).bitwise_and_((1 << (64 - bits)) - 1)


def _signed(seed: int) -> int:
    return (seed + 2**63) % 2**64 - 2**63
