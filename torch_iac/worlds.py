"""The worlds that the command makes: which there are, and how their options are written."""

from collections.abc import Mapping, Sequence
from inspect import signature
from json import loads
from typing import Any
from warnings import catch_warnings

import gymnasium as gym
import torch
from gymnasium.envs.registration import load_env_creator

import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac.training import World

WORLDS = {
    "toyroom": "torch_iac_envs/ToyRoom-v0",
    "kinematic": "torch_iac_envs/ToyRoomKinematic-v0",
}
OUTCOMES = {"toyroom": ("toy_distance",), "kinematic": ("toy_distance",)}
WORLD_BYTES = {"toyroom": 30_000_000, "kinematic": 4_000}
"""What a world takes in the main memory; with pybullet it is a whole physics engine."""

KINDS = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    str: "a text",
    str | None: "a text or null",
}
"""What an argument of a world may be, in words."""


def make_world(name: str, n_worlds: int, options: Mapping[str, Any], device: torch.device) -> World:
    """Return as many worlds as asked for, on the device if they are tensors.

    Raises:
        ValueError: The world has no such option, or refuses its value.
    """
    spec = gym.spec(WORLDS[name])
    is_batched = spec.vector_entry_point is not None
    entry = spec.vector_entry_point if is_batched else spec.entry_point
    parameters = signature(load_env_creator(str(entry))).parameters
    allowed = [parameter for parameter in parameters if parameter not in ("num_envs", "device")]
    for option, value in options.items():
        if option not in allowed:
            raise ValueError(f"options of {name} must be among {', '.join(allowed)}, got {option}")
        kind = parameters[option].annotation
        if kind in KINDS and not _is_a(kind, value):
            raise ValueError(f"{option} must be {KINDS[kind]}, got {value!s:.80}")
    if is_batched:
        # Actions are in their bounds; the check would make a GPU wait at every decision.
        options = {"device": device, "check_actions": False, **options}
    way = "vector_entry_point" if is_batched else "sync"
    try:
        with catch_warnings(action="ignore"):  # worlds refuse by themselves what is warned of
            return gym.make_vec(spec.id, n_worlds, way, **options)
    except RuntimeError as error:  # such as a window where there is no display
        raise ValueError(str(error)) from error


def _is_a(kind: Any, value: object) -> bool:
    if isinstance(value, bool):
        return kind is bool
    return isinstance(value, (int, float) if kind is float else kind)


def parse_options(pairs: Sequence[str]) -> dict[str, Any]:
    """Return the arguments of a world, written as name=value, the value in JSON or plain text."""
    options = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not (name and equals):
            raise ValueError(f"world options must be written name=value, got {pair}")
        try:
            options[name.replace("-", "_")] = loads(value)
        except (ValueError, RecursionError):  # not JSON, or more than Python reads of it
            options[name.replace("-", "_")] = value
    return options
