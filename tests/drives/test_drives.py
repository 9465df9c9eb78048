import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor

from torch_iac import IAC, IACConfig, ImprovementPredictor, MetaPredictor, SensorimotorSpace
from torch_iac.drives.baselines import Error, Improvement, Novelty, Random
from torch_iac.drives.curriculum import Curriculum, Stage
from torch_iac.drives.learning_progress import (
    AbsoluteProgress,
    GlobalProgress,
    MetaProgress,
    Progress,
)
from torch_iac.drives.protocol import Candidates, Drive, Knowledge, Need, known
from torch_iac.regions.error_history import ErrorHistory
from torch_iac.regions.examples import Examples

CPU = torch.device("cpu")
LESSON = Curriculum(
    (Stage("tone", 4, 7, until=10), Stage("push", -2, 0, until=30), Stage("tone", 2, 5, until=0))
)
"""Tone lies in [0, 10], push in [-1, 1]."""

DRIVES: list[Drive] = [
    Progress(),
    MetaProgress(),
    AbsoluteProgress(),
    GlobalProgress(),
    Error(),
    Error("meta"),
    Novelty(),
    Improvement(),
    LESSON,
    Random(),
]
SITUATIONS = torch.tensor(
    [
        [[0.0, 0.2, 0.5, 0.5], [0.0, 0.6, 0.5, 0.5], [1.0, 0.6, 0.5, 0.5]],
        [[0.5, 0.5, 0.5, 0.5], [0.5, 1.0, 0.5, 0.5], [0.5, 0.3, 0.5, 0.5]],
    ]
)
CANDIDATES = Candidates(SITUATIONS, rows=torch.tensor([[0, 1, 0], [2, 2, 2]]))
"""Two agents with three candidates each: push, tone and two sensors. Agent 0 has leaves 0 and 1."""


class HalfTheTone:
    """MP, and what expects improvement, with known answers."""

    def expect(self, situations: Tensor) -> Tensor:
        return situations[..., 1] / 2

    predict = expect


def history(*errors: list[float]) -> ErrorHistory:
    kept = ErrorHistory(len(errors[0]), window=2, delay=2, device=CPU)
    for row_errors in errors:
        kept.add(torch.arange(len(row_errors)), torch.tensor(row_errors, dtype=torch.float64))
    return kept


@pytest.fixture
def knowledge(space: SensorimotorSpace) -> Knowledge:
    """Errors of leaf 0 stay, of leaf 1 fall, of leaf 2 grow; leaf 2 holds no example."""
    examples = Examples(3, 4, 1, 5, CPU)
    for row, situation in ((0, [0.0, 0.6, 0.5, 0.5]), (0, [1.0, 1.0, 0.5, 0.5]), (1, [0.3] * 4)):
        examples.add(torch.tensor([row]), torch.tensor([situation]), torch.tensor([[0.5]]))
    meta: Any = HalfTheTone()
    return Knowledge(
        step=0,
        space=space,
        examples=examples,
        history=history([0.5, 1.0, 0.0], [0.5, 0.75, 0.25], [0.5, 0.5, 0.5], [0.5, 0.25, 0.75]),
        meta=meta,
        whole_history=history([1.0, 0.0], [1.0, 0.5], [0.5, 0.5]),  # one decision short of progress
        improvement=meta,
    )


EXPECTED = {
    # LP of leaves 0, 1 and 2: of their means, (e1 + e2) / 2 - (e3 + e4) / 2.
    Progress(): [[0, 0.5, 0], [-0.5, -0.5, -0.5]],
    AbsoluteProgress(): [[0, 0.5, 0], [0.5, 0.5, 0.5]],
    # With MP's m for the next error: (e2 + e3) / 2 - (e4 + m) / 2.
    MetaProgress(): [
        [1 / 2 - (0.5 + 0.1) / 2, 1.25 / 2 - (0.25 + 0.3) / 2, 1 / 2 - (0.5 + 0.3) / 2],
        [0.75 / 2 - (0.75 + m) / 2 for m in (0.25, 0.5, 0.15)],
    ],
    # The same over all errors: (1 + 1) / 2 - (0.5 + m) / 2 and (0 + 0.5) / 2 - (0.5 + m) / 2.
    GlobalProgress(): [
        [1 - (0.5 + m) / 2 for m in (0.1, 0.3, 0.3)],
        [0.25 - (0.5 + m) / 2 for m in (0.25, 0.5, 0.15)],
    ],
    Error(): [[0.5, 0.375, 0.5], [0.625, 0.625, 0.625]],
    Error("meta"): [[0.1, 0.3, 0.3], [0.25, 0.5, 0.15]],
    Novelty(): [[0.4, math.sqrt(0.3**2 + 0.3**2 + 0.2**2 + 0.2**2), 0.4], [math.inf] * 3],
    Improvement(): [[0.1, 0.3, 0.3], [0.25, 0.5, 0.15]],
    Random(): [[0] * 3] * 2,
}


@pytest.mark.parametrize("drive", EXPECTED, ids=lambda drive: type(drive).__name__)
def test_known_answers(knowledge: Knowledge, drive: Drive) -> None:
    worth = drive.worth(CANDIDATES, knowledge)
    assert worth.dtype == torch.float64
    expected = torch.tensor(EXPECTED[drive], dtype=torch.float64)
    torch.testing.assert_close(worth, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("drive", DRIVES, ids=lambda drive: type(drive).__name__)
def test_to_judge_changes_nothing(knowledge: Knowledge, drive: Drive) -> None:
    situations, progress = SITUATIONS.clone(), knowledge.history.progress.clone()
    held = knowledge.examples.situations.clone()
    once = drive.worth(CANDIDATES, knowledge)
    once_copied = once.clone()
    once += 1  # what becomes of the answer is no matter of the drive's
    assert torch.equal(drive.worth(CANDIDATES, knowledge), once_copied)
    assert torch.equal(SITUATIONS, situations)
    assert torch.equal(knowledge.history.progress, progress)
    assert torch.equal(knowledge.examples.situations, held)


def test_a_region_without_errors_has_an_error_of_nothing(knowledge: Knowledge) -> None:
    empty = replace(knowledge, history=ErrorHistory(3, 2, 2, CPU))
    assert Error().worth(CANDIDATES, empty).tolist() == [[0] * 3] * 2


@pytest.mark.parametrize(
    ("step", "expected"),
    [
        (0, [[0, 1, 1], [1, 0, 0]]),
        (9, [[0, 1, 1], [1, 0, 0]]),
        (10, [[1, 1, 0], [1, 1, 1]]),
        (29, [[1, 1, 0], [1, 1, 1]]),
        (30, [[0, 0, 0], [1, 0, 1]]),  # a tone of 2 is not above the stage's low
        (10**6, [[0, 0, 0], [1, 0, 1]]),
    ],
)
def test_a_curriculum_keeps_its_stages(
    knowledge: Knowledge, step: int, expected: list[list[float]]
) -> None:
    at_last = LESSON.worth(CANDIDATES, replace(knowledge, step=step))
    assert at_last.tolist() == expected


def test_a_curriculum_is_about_actions(knowledge: Knowledge) -> None:
    drive = Curriculum((Stage("near", 0, 1, until=10),))
    with pytest.raises(
        ValueError, match=r"a stage must be about an action \(push, tone\), got near"
    ):
        drive.worth(CANDIDATES, knowledge)
    later = Curriculum((Stage("tone", 0, 1, until=1000), Stage("near", 0, 1, until=0)))
    with pytest.raises(ValueError, match="a stage must be about an action"):
        IAC(knowledge.space, IACConfig(drive=later))  # not a thousand decisions later


@pytest.mark.parametrize(("low", "high"), [(1, 0), (float("nan"), 1), (0, float("inf"))])
def test_a_stage_has_bounds(low: float, high: float) -> None:
    with pytest.raises(ValueError, match="low and high must be finite and in order, got"):
        Stage("tone", low, high, until=0)


def test_a_curriculum_has_stages() -> None:
    with pytest.raises(ValueError, match="stages must hold at least one stage, got none"):
        Curriculum(())


@pytest.mark.parametrize("drive", DRIVES, ids=lambda drive: type(drive).__name__)
def test_each_is_a_drive_and_looks_at_what_it_needs_and_nothing_else(
    knowledge: Knowledge, drive: Drive
) -> None:
    assert isinstance(drive, Drive)
    optional = {"meta", "whole_history", "improvement"}
    missing: dict[str, Any] = dict.fromkeys(optional - drive.needs)
    drive.worth(CANDIDATES, replace(knowledge, **missing))
    for need in drive.needs:
        without: dict[str, Any] = {need: None}
        with pytest.raises(RuntimeError, match=f"in its needs, got none of {need}"):
            drive.worth(CANDIDATES, replace(knowledge, **without))


@pytest.mark.parametrize("drive", DRIVES, ids=lambda drive: type(drive).__name__)
def test_a_config_refuses_a_drive_without_what_it_needs(drive: Drive) -> None:
    on: dict[Need, Any] = {"meta": MetaPredictor(), "improvement": ImprovementPredictor()}
    values = {name: part for name, part in on.items() if name in drive.needs}
    assert IACConfig(drive=drive, **values).drive == drive
    for name in values:
        kept: dict[Any, Any] = {**values, name: None}
        message = f"{name} must be on for the drive {type(drive).__name__}, got None"
        with pytest.raises(ValueError, match=message):
            IACConfig(drive=drive, **kept)


@dataclass(frozen=True)
class Forgetful:
    """A user's drive that looks at MP and does not say so."""

    needs: ClassVar[frozenset[Need]] = frozenset()

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        return known(knowledge.meta, "meta").expect(candidates.situations).double()


def test_a_users_drive_must_say_what_it_looks_at(knowledge: Knowledge) -> None:
    drive: Drive = Forgetful()
    assert isinstance(drive, Drive)
    with pytest.raises(
        RuntimeError,
        match="a drive must name what it looks at in its needs, got none of meta",
    ):
        drive.worth(CANDIDATES, replace(knowledge, meta=None))


def test_an_error_comes_from_the_region_or_from_mp() -> None:
    with pytest.raises(ValueError, match="source must be region or meta, got both"):
        Error("both")  # type: ignore[arg-type]
