"""The arguments of worlds: parsed and checked."""

from collections.abc import Mapping, Sequence
from inspect import Parameter, signature
from json import loads
from typing import Any

from gymnasium.envs.registration import load_env_creator

KINDS: dict[Any, str] = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    str: "a text",
    str | None: "a text or null",
}
"""Types of a world's arguments, in words."""

EPISODES = {
    "max_episode_steps": Parameter("max_episode_steps", Parameter.KEYWORD_ONLY, annotation=int)
}
"""The argument that Gymnasium accepts for any world whose episodes it ends."""


def parameters_of(entry_point: Any) -> Mapping[str, Parameter]:
    """Return the arguments of a world that Gymnasium knows by its class or where that is."""
    is_named = isinstance(entry_point, str)
    return signature(load_env_creator(entry_point) if is_named else entry_point).parameters


def check_options(
    name: str, options: Mapping[str, Any], parameters: Mapping[str, Parameter]
) -> None:
    """Refuse options that a world does not have, or values of the wrong type.

    Raises:
        ValueError: An option is none of its arguments, or of another kind.
    """
    kinds = {parameter.kind for parameter in parameters.values()}
    allowed = [parameter for parameter in parameters if parameter not in ("num_envs", "device")]
    for option, value in options.items():
        if option not in allowed and Parameter.VAR_KEYWORD not in kinds:
            raise ValueError(f"options of {name} must be among {', '.join(allowed)}, got {option}")
        kind = _kind(parameters[option]) if option in parameters else None
        if kind in KINDS and not _is_a(kind, value):
            raise ValueError(f"{option} must be {KINDS[kind]}, got {value!s:.80}")


def _kind(parameter: Parameter) -> Any:
    """Return the type of an argument: its annotation, or else the type of its default."""
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
