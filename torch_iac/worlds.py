"""The worlds that the command makes: which there are, and how their options are written."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from inspect import Parameter, signature
from json import loads
from typing import Any
from warnings import catch_warnings

import gymnasium as gym
import torch
from gymnasium.envs.registration import EnvSpec, load_env_creator
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import RepeatAction

import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac.bounds import Bounds
from torch_iac.replaying import Replayed
from torch_iac.training import STATE, World

WORLDS = {
    "toyroom": "torch_iac_envs/ToyRoom-v0",
    "kinematic": "torch_iac_envs/ToyRoomKinematic-v0",
}
"""What the toy rooms are called here, and by Gymnasium."""
OUTCOMES = {"toyroom": ("toy_distance",), "kinematic": ("toy_distance",)}
"""What is predicted in them, as in the papers, if nobody says otherwise."""
WORLD_BYTES = {"toyroom": 30_000_000, "kinematic": 4_000}
"""What a world takes in the main memory; with pybullet it is a whole physics engine."""
OTHER_WORLD_BYTES = 1_000_000
"""What any other is taken to need; one of MuJoCo was seen to take 0.6 MB."""

KINDS: dict[Any, str] = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    str: "a text",
    str | None: "a text or null",
}
"""What an argument of a world may be, in words."""

EPISODES = {
    "max_episode_steps": Parameter("max_episode_steps", Parameter.KEYWORD_ONLY, annotation=int)
}
"""What Gymnasium takes for any world whose episodes it ends."""


def make_world(
    name: str,
    n_worlds: int,
    options: Mapping[str, Any],
    device: torch.device,
    hold: int = 1,
    bounds: Bounds | None = None,
) -> World:
    """Return as many worlds as asked for, which can be saved, on the device if they are tensors.

    Args:
        name: One of `WORLDS`, or what Gymnasium calls a world, such as `Pendulum-v1` or
            `module:id`.
        n_worlds: How many.
        options: Arguments of each.
        device: Where worlds that are tensors are.
        hold: For how many steps of the world an action is held.
        bounds: What sensors are clipped to; None leaves them as they are.

    Raises:
        ValueError: There is no such world, it has no such option, refuses its value, or cannot be
            given bounds or hold actions.
    """
    spec = _spec(name)
    with _refusals(name, options):
        if spec.entry_point is None:
            if hold > 1 or bounds is not None:
                raise ValueError(
                    f"hold and sensor_bounds must be left to worlds that are single, got {name}"
                )
            return _batched(name, spec, n_worlds, options, device)
        parameters = dict(_parameters(spec.entry_point))
        if spec.max_episode_steps is not None:
            parameters |= EPISODES
        _check_options(name, options, parameters)
        wrappers: list[Callable[..., gym.Wrapper[Any, Any, Any, Any]]] = []
        if hold > 1:
            wrappers.append(partial(RepeatAction, num_repeats=hold))
        if bounds is not None:
            wrappers.append(bounds.clips)
        mode = {"autoreset_mode": AutoresetMode.SAME_STEP}
        return _saved(gym.make_vec(spec, n_worlds, "sync", mode, wrappers, **options))


def _batched(
    name: str,
    spec: EnvSpec,
    n_worlds: int,
    options: Mapping[str, Any],
    device: torch.device,
) -> World:
    """Return worlds that are one object, such as one of tensors."""
    parameters = _parameters(spec.vector_entry_point)
    _check_options(name, options, parameters)
    # Actions are in their bounds; the check would make a GPU wait at every decision.
    known = {"device": device, "check_actions": False}
    own = {option: value for option, value in known.items() if option in parameters}
    arguments: dict[str, Any] = {**own, **options}
    return gym.make_vec(spec, n_worlds, "vector_entry_point", **arguments)


def _parameters(entry_point: Any) -> Mapping[str, Parameter]:
    """Return the arguments of a world that Gymnasium knows by its class or where that is."""
    is_named = isinstance(entry_point, str)
    return signature(load_env_creator(entry_point) if is_named else entry_point).parameters


def _spec(name: str) -> EnvSpec:
    """Return what Gymnasium knows of a world, once its module, if it names one, is imported."""
    module, _, world = WORLDS.get(name, name).rpartition(":")
    try:
        if module:
            import_module(module)
        return gym.spec(world)
    except (ImportError, TypeError, ValueError, gym.error.Error) as error:
        raise ValueError(
            f"world must be {', '.join(WORLDS)} or a world of Gymnasium such as Pendulum-v1, "
            f"got {name} ({error})"
        ) from None


def _check_options(
    name: str, options: Mapping[str, Any], parameters: Mapping[str, Parameter]
) -> None:
    """Refuse what the arguments of a world, as far as they are written down, do not take."""
    kinds = {parameter.kind for parameter in parameters.values()}
    allowed = [parameter for parameter in parameters if parameter not in ("num_envs", "device")]
    for option, value in options.items():
        if option not in allowed and Parameter.VAR_KEYWORD not in kinds:
            raise ValueError(f"options of {name} must be among {', '.join(allowed)}, got {option}")
        kind = _kind(parameters[option]) if option in parameters else None
        if kind in KINDS and not _is_a(kind, value):
            raise ValueError(f"{option} must be {KINDS[kind]}, got {value!s:.80}")


@contextmanager
def _refusals(name: str, options: Mapping[str, Any]) -> Iterator[None]:
    """Turn what worlds raise when they are made into a `ValueError`.

    What may be a bug of the world's comes through, unless options may be to blame.
    """
    words = " ".join(f"{option}={value!s:.80}" for option, value in options.items())
    given = f" with {words}" if words else ""
    try:
        with catch_warnings(action="ignore"):  # worlds refuse by themselves what is warned of
            yield
    except (ValueError, OSError, gym.error.Error):  # they say what is wrong
        raise
    except RuntimeError as error:  # such as a window where there is no display
        raise ValueError(str(error)) from error
    except (TypeError, ImportError) as error:  # such as an option that is none, or a package
        raise ValueError(f"{name} cannot be made{given}: {error}") from error
    except Exception as error:  # such as a division by an option that is 0
        if not options:
            raise
        raise ValueError(f"{name} cannot be made{given}: {error!r}") from error


def _saved(env: World) -> World:
    """Return single worlds as they are if they can be saved, else such that they are replayed."""
    worlds = getattr(env, "envs", ())
    know_how = all(hasattr(type(world.unwrapped), STATE) for world in worlds)
    return env if know_how else Replayed(env)


def _kind(parameter: Parameter) -> Any:
    """Return what an argument shall be: as it says, or else of the kind that it is by default."""
    says_nothing = parameter.annotation is Parameter.empty
    return type(parameter.default) if says_nothing else parameter.annotation


def _is_a(kind: Any, value: object) -> bool:
    if isinstance(value, bool):
        return kind is bool
    return isinstance(value, (int, float) if kind is float else kind)


def parse_options(pairs: Sequence[str]) -> dict[str, Any]:
    """Return the arguments of a world, written as name=value, the value in JSON or plain text.

    Raises:
        ValueError: One is not written so.
    """
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
