import json
import logging
import platform
from pathlib import Path

import pytest

from torch_iac.cli.main import main
from torch_iac.internal.processor import described, processor, rounds_alike
from torch_iac.runs.schema import CONFIG

HERE = processor()
ELSEWHERE = HERE | {"model": "Abacus 9000", "capability": "BEADS"}
RUN = ["train", "--world", "kinematic", "--steps", "30", "--out"]


def test_a_processor_is_told_by_what_decides_how_it_rounds() -> None:
    assert HERE["architecture"] == platform.machine()
    assert all(HERE.values())
    assert described(ELSEWHERE) == f"{platform.machine()}, Abacus 9000, BEADS"
    assert described(None) == "not written down"


@pytest.mark.parametrize(
    ("began_on", "is_exact", "alike"),
    [
        (HERE, True, True),
        (HERE, False, True),
        (ELSEWHERE, True, True),
        (ELSEWHERE, False, False),
        (HERE | {"architecture": "abacus"}, True, False),
        (None, True, False),
    ],
)
def test_exact_runs_are_the_same_on_one_architecture(
    began_on: object, is_exact: bool, alike: bool
) -> None:
    assert rounds_alike(began_on, HERE, is_exact) == alike


@pytest.mark.parametrize("architecture", [platform.machine(), "abacus"])
def test_resuming_elsewhere_says_so_where_bits_may_differ(
    architecture: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "run"
    main([*RUN, str(folder)])
    config = json.loads((folder / CONFIG).read_text())
    assert config["processor"] == HERE
    began_on = ELSEWHERE | {"architecture": architecture}
    (folder / CONFIG).write_text(json.dumps(config | {"processor": began_on}))
    with caplog.at_level(logging.INFO):
        main(["resume", str(folder), "--steps", "40"])
    said = [line for line in caplog.messages if "another kind of processor" in line]
    assert len(said) == (architecture == "abacus")
    assert json.loads((folder / CONFIG).read_text())["processor"] == began_on
