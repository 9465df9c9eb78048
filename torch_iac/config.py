"""Every number of the algorithm in one place, and the two papers' numbers."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Self

from torch_iac.drives.choices import Choice, Greedy
from torch_iac.drives.learning_progress import (
    Progress,
)
from torch_iac.drives.protocol import Drive
from torch_iac.experts.knn import KNNExperts
from torch_iac.experts.protocol import Experts
from torch_iac.internal.parts import build, from_json, to_json
from torch_iac.internal.validation import check_count, settle
from torch_iac.kinds import KINDS, PARTS, named
from torch_iac.meta_predictor import ImprovementPredictor, MetaPredictor


@dataclass(frozen=True, kw_only=True)
class IACConfig:
    """Every number of the algorithm; the defaults are the paper's (preset `iac2004`).

    Experts, drive and choice can also be given by name, as the command has them: `drive="error"`,
    `experts="mlp"`, `experts="my_module:MyNet"`.

    Raises:
        ValueError: A number is out of its range; the message names it, the rule and the value.

    Source: Oudeyer and Kaplan (2004); where the paper is silent, the field says so.
    """

    experts: Experts = field(default_factory=KNNExperts)
    """What predicts the outcome in each region."""
    drive: Drive = field(default_factory=Progress)
    """What a candidate action is worth."""
    choice: Choice = field(default_factory=Greedy)
    """Which candidate is taken, given what each is worth."""
    meta: MetaPredictor | None = field(default_factory=MetaPredictor)
    """MP, which learns what errors to expect; some drives need it, the default drive does not.
    None leaves it out."""
    improvement: ImprovementPredictor | None = None
    """What learns how much an update improves a prediction; one drive needs it."""
    shadows: Mapping[str, Experts] = field(default_factory=dict)
    """Other experts, by name, that predict and learn on the same stream without any influence."""
    n_candidates: int = 50
    """How many random actions are weighed at a decision (the papers do not say)."""
    epsilon: float = 0.1
    """Probability of a uniformly random action (2004: 0.1; 2007: 0.15 here, typically 0.35)."""
    max_examples: int = 250
    """C1: a region splits when it holds more examples than this (NS)."""
    balance: float = 0.15
    """C2: smallest share of the examples that a child may keep, in [0, 0.5] (2004 says "relatively
    balanced" and no number, 2007 nothing). A full region that cannot be cut so forgets its oldest
    example (the papers do not say)."""
    window: int = 150
    """How many errors of a region its mean error is taken over (DELAY; theta + 1 in 2007)."""
    delay: int = 150
    """How many errors of a region lie between the two means compared (DELAY; tau in 2007)."""
    error: Literal["absolute", "squared"] = "absolute"
    """Prediction error, in scaled units: absolute (2004) or squared (2007). Over several outcomes
    it is the mean (the papers have one)."""
    inherit_history: bool = True
    """Children take over their parent's errors and progress (2007; 2004 draws it in figure 2);
    otherwise they start with none."""

    def __post_init__(self) -> None:
        for kind, (_, protocol) in KINDS.items():
            value = getattr(self, kind)
            if isinstance(value, str):
                object.__setattr__(self, kind, named(kind, value))
            elif isinstance(value, type):
                raise ValueError(f"{kind} must be made, as {value.__name__}(), got the class")
            elif not isinstance(value, protocol):
                name = protocol.__name__
                raise ValueError(f"{kind} must have what {name} has, got {value!r:.80}")
        settle(self)
        for name in ("n_candidates", "max_examples", "window", "delay"):
            check_count(name, getattr(self, name), least=2 if name == "max_examples" else 1)
        for name, high in (("epsilon", 1), ("balance", 0.5)):
            if not 0 <= getattr(self, name) <= high:
                raise ValueError(f"{name} must lie in [0, {high}], got {getattr(self, name)}")
        for part in ("meta", "improvement"):
            if part in self.drive.needs and getattr(self, part) is None:
                drive = type(self.drive).__name__
                raise ValueError(f"{part} must be on for the drive {drive}, got None")

    def to_json(self) -> dict[str, Any]:
        """Return every number, and the kind and the numbers of each part, as JSON can hold them."""
        return {f.name: to_json(getattr(self, f.name), PARTS) for f in fields(IACConfig)}

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Self:
        """Return the config of which `to_json` made JSON; fields that are missing have defaults.

        Parts of a user's own are imported.

        Raises:
            ValueError: There is no such field, or it takes no such value; the message names it.
        """
        if not isinstance(content, Mapping):
            raise ValueError(f"a config must have fields by name, got {content!r:.80}")
        values = {name: from_json(part, PARTS, f"iac.{name}") for name, part in content.items()}
        config: Self = build(cls, values, "iac")
        return config


PRESETS = {
    "iac2004": IACConfig(),
    "iac2007": IACConfig(epsilon=0.15, balance=0.0, window=26, delay=15, error="squared"),
}
"""The two papers' parameters. The 2007 robot also senses the toy's distance alone: in the toy room,
`beams=0, toy_direction=False`."""
