"""Makes the worlds of an experiment."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from typing import Any
from warnings import catch_warnings

import gymnasium as gym
import numpy as np
import torch
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import RepeatAction

import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac.toy_room import WORLDS
from torch_iac.worlds.encoders import CONVOLUTION
from torch_iac.worlds.options import EPISODES, check_options, parameters_of
from torch_iac.worlds.saving import savable
from torch_iac.worlds.spaces import FlatWorld, MakeEncoder, encoder_maker, is_flat
from torch_iac.worlds.vector import CopiedSensors, World


def make_world(
    name: str,
    n_worlds: int,
    options: Mapping[str, Any],
    device: torch.device,
    hold: int = 1,
    encoder: str = CONVOLUTION,
) -> World:
    """Return as many worlds as asked for, which can be saved, on the device if they are tensors.

    Spaces of single worlds that are no flat boxes are made some, as `torch_iac.worlds.spaces.Flat`
    says.

    Args:
        name: One of `WORLDS`, or an id of Gymnasium, such as `Pendulum-v1` or
            `module:id`.
        n_worlds: How many.
        options: Arguments of each.
        device: Where worlds that are tensors are.
        hold: For how many steps of the world an action is held.
        encoder: What makes sensors of pictures: `convolution`, `pixels` or `module:Name`.

    Raises:
        ValueError: There is no such world, it has no such option, refuses its value, or cannot
            hold actions.
    """
    spec = _spec(name)
    with _refusals(name, options):
        if spec.entry_point is None:
            if hold > 1:
                raise ValueError(f"hold must be left to worlds that are single, got {name}")
            return _batched(name, spec, n_worlds, options, device)
        parameters = dict(parameters_of(spec.entry_point))
        if spec.max_episode_steps is not None:
            parameters |= EPISODES
        check_options(name, options, parameters)
        wrappers: list[Any] = [partial(RepeatAction, num_repeats=hold)] if hold > 1 else []
        wrappers += [partial(_flat, make_encoder=encoder_maker(encoder)), CopiedSensors]
        mode = {"autoreset_mode": AutoresetMode.SAME_STEP}
        return savable(gym.make_vec(spec, n_worlds, "sync", mode, wrappers, **options))


class SeededEpisodes(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """A wrapper that seeds every episode, from the seed of the first one.

    Some worlds begin an episode without a seed as chance would have it, and then no run in them
    could be repeated.

    Args:
        env: The world.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        gym.Wrapper.__init__(self, env)
        self._seeds: np.random.Generator | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; the first one with a seed says how those after it begin."""
        if seed is not None:
            self._seeds = np.random.default_rng(seed)
        elif self._seeds is not None:
            seed = int(self._seeds.integers(2**31))
        return self.env.reset(seed=seed, options=options)


def _flat(env: gym.Env[Any, Any], make_encoder: MakeEncoder | None) -> gym.Env[Any, Any]:
    """Return a world as it is if it is flat, or made flat, with every episode seeded."""
    if is_flat(env.action_space, env.observation_space):
        return env
    return FlatWorld(SeededEpisodes(env), make_encoder)


def _batched(
    name: str,
    spec: EnvSpec,
    n_worlds: int,
    options: Mapping[str, Any],
    device: torch.device,
) -> World:
    """Return a natively vectorised environment, such as one of tensors."""
    parameters = parameters_of(spec.vector_entry_point)
    check_options(name, options, parameters)
    # Actions are in their bounds; the check would make a GPU wait at every decision.
    known = {"device": device, "check_actions": False}
    own = {option: value for option, value in known.items() if option in parameters}
    arguments: dict[str, Any] = {**own, **options}
    return gym.make_vec(spec, n_worlds, "vector_entry_point", **arguments)


def _spec(name: str) -> EnvSpec:
    """Return Gymnasium's spec of a world; its module, if it names one, is imported."""
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


@contextmanager
def _refusals(name: str, options: Mapping[str, Any]) -> Iterator[None]:
    """Turn errors of worlds that cannot be made into a `ValueError`.

    Without options, other exceptions are passed on, since they may be bugs of the world.
    """
    given = f" with {_words(options)}" if options else ""
    try:
        with catch_warnings(action="ignore"):  # worlds refuse what Gymnasium warns of
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


@contextmanager
def refusals_at_reset(name: str, options: Mapping[str, Any]) -> Iterator[None]:
    """Turn errors of a world that cannot be reset with its options into a `ValueError`.

    Without options exceptions are passed on, since they may be bugs of the world.

    Raises:
        ValueError: It cannot.
    """
    try:
        yield
    except (ValueError, OSError, gym.error.Error):  # they say what is wrong
        raise
    except Exception as error:  # such as a division by an option that is 0
        if not options:
            raise
        raise ValueError(f"{name} cannot be reset with {_words(options)}: {error!r}") from error


def _words(options: Mapping[str, Any]) -> str:
    return " ".join(f"{option}={value!s:.80}" for option, value in options.items())
