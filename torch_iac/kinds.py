"""Experts, drives and choices by name, and the user's own by `module:Name`."""

from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

from torch import nn

from torch_iac.drives.baselines import Error, Improvement, Novelty, Random
from torch_iac.drives.choices import Choice, Greedy, Proportional, Softmax
from torch_iac.drives.curriculum import Curriculum, Stage
from torch_iac.drives.learning_progress import (
    AbsoluteProgress,
    GlobalProgress,
    MetaProgress,
    Progress,
)
from torch_iac.drives.protocol import Drive
from torch_iac.experts.hybrid import HybridExperts
from torch_iac.experts.knn import KNNExperts
from torch_iac.experts.mlp import MLP
from torch_iac.experts.network import MLPExperts, NetworkExperts
from torch_iac.experts.protocol import Experts
from torch_iac.internal.parts import import_object, make_importable
from torch_iac.internal.suggestions import suggested_one
from torch_iac.meta_predictor import ImprovementPredictor, MetaPredictor

EXPERTS: dict[str, type[Experts]] = {
    "knn": KNNExperts,
    "mlp": MLPExperts,
    "hybrid": HybridExperts,
}
"""Kinds of experts by name."""
DRIVES: dict[str, type[Drive]] = {
    "progress": Progress,
    "meta_progress": MetaProgress,
    "absolute_progress": AbsoluteProgress,
    "global_progress": GlobalProgress,
    "error": Error,
    "novelty": Novelty,
    "improvement": Improvement,
    "curriculum": Curriculum,
    "random": Random,
}
"""Drives by name."""
CHOICES: dict[str, type[Choice]] = {
    "greedy": Greedy,
    "proportional": Proportional,
    "softmax": Softmax,
}
"""Choices by name."""

KINDS: dict[str, tuple[Mapping[str, type], type]] = {
    "experts": (EXPERTS, Experts),
    "drive": (DRIVES, Drive),
    "choice": (CHOICES, Choice),
}
"""The library's own parts by name, and the protocol of any other."""

METHODS = {"experts": "pool", "drive": "worth", "choice": "pick"}
"""The method that each kind of part must have."""

PARTS: dict[str, type] = {
    part.__name__: part
    for part in (
        *(KNNExperts, MLPExperts, NetworkExperts, HybridExperts, MLP),
        *(MetaPredictor, ImprovementPredictor),
        *(Progress, AbsoluteProgress, GlobalProgress, MetaProgress),
        *(Error, Novelty, Improvement, Random, Curriculum, Stage),
        *(Greedy, Proportional, Softmax),
    )
}
"""Classes that a config's JSON names without a module."""


def named(kind: str, name: str) -> Any:
    """Return a part of a config, with its default numbers, by its name.

    Args:
        kind: Experts, drive or choice.
        name: One of the library's own, or `module:Name`: a class of a user's own; for experts also
            a module or a factory of one, which is then in each region.

    Raises:
        ValueError: There is none of that name, or it is something else.
    """
    known, protocol = KINDS[kind]
    if name in known:
        return known[name]()
    if ":" not in name:
        perhaps = suggested_one(name, known)
        raise ValueError(f"{kind} must be {', '.join(known)} or module:Name, got {name}{perhaps}")
    make_importable(Path.cwd())
    found = import_object(name, kind)
    if kind == "experts" and not hasattr(found, "pool"):
        is_class = isinstance(found, type) and is_dataclass(found)
        makes_factory = is_class and not issubclass(found, nn.Module)
        return NetworkExperts(module=_made(found, kind, name) if makes_factory else found)
    if not hasattr(found, METHODS[kind]):
        raise ValueError(f"{kind} must have a method {METHODS[kind]}, got {name}, which has none")
    made = _made(found, kind, name)
    if not isinstance(made, protocol):
        raise ValueError(f"{kind} must have what {protocol.__name__} has, got {name}")
    return made


def _made(found: Callable[[], Any], kind: str, name: str) -> Any:
    """Return an object of a class with its default numbers."""
    try:
        return found() if isinstance(found, type) else found
    except TypeError as error:
        raise ValueError(
            f"{kind} must have defaults for all fields, got {name} ({error})"
        ) from None
