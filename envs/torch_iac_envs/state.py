"""The parts of a world's saved state, as plain arrays."""

from dataclasses import astuple

import numpy as np
from numpy.typing import NDArray

from torch_iac_envs.physics import Command, Vector

WORD = 2**64 - 1
"""The largest 64-bit word."""


def pack_commands(commands: list[Command]) -> Vector:
    """Return one row a decision, shape `(n, 5)`; the columns are the fields of `Command`."""
    return np.array([astuple(command) for command in commands], np.float64).reshape(-1, 5)


def unpack_commands(commands: Vector) -> list[Command]:
    """Return the decisions that `pack_commands` packed, shape `(n, 5)`."""
    return [Command(left, right, x, y, jump > 0) for left, right, x, y, jump in commands.tolist()]


def pack_random(random: np.random.Generator) -> NDArray[np.uint64]:
    """Return a PCG64 generator's state as six 64-bit words, shape `(6,)`."""
    state = random.bit_generator.state
    words = [word >> shift & WORD for word in state["state"].values() for shift in (64, 0)]
    return np.array([*words, state["has_uint32"], state["uinteger"]], np.uint64)


def unpack_random(words: NDArray[np.uint64]) -> np.random.Generator:
    """Return the PCG64 generator that `pack_random` packed, shape `(6,)`."""
    high, low, inc_high, inc_low, has_uint32, uinteger = (int(word) for word in words)
    bits = np.random.PCG64()
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": high << 64 | low, "inc": inc_high << 64 | inc_low},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    return np.random.Generator(bits)
