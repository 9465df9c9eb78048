"""A `config.json` that was damaged: every command refuses it in one sentence, or can do without."""

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import torch_iac as iac
from torch_iac.cli.options import parse_train
from torch_iac.experiment import load_experiment
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.schema import CONFIG, STEPS
from torch_iac.worlds.bounds import recorded_bounds

OTHERS: tuple[Any, ...] = (
    *(None, 2.5, "x", [[]], {}),
    *({"kind": 5}, {"kind": "x", "lost": 3}),
)
"""What may stand anywhere instead."""

BOUNDS = {"given": ["sensor_0"], "found": []}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run whose config has every kind of part."""
    config = iac.IACConfig(
        n_candidates=2,
        experts=iac.HybridExperts(),
        shadows={"mlp": iac.MLPExperts()},
        drive="curriculum",  # type: ignore[arg-type]
    )
    experiment = iac.Experiment(
        world="kinematic", config=config, seeds=(3, 4), steps=3, world_options={"beams": 2}
    )
    return experiment.run(tmp_path_factory.mktemp("run") / "a")


def paths(content: Any, *names: Any) -> Iterator[tuple[Any, ...]]:
    """Yield where each part of JSON stands."""
    parts = content.items() if isinstance(content, dict) else ()
    for name, part in enumerate(content) if isinstance(content, list) else parts:
        yield (*names, name)
        yield from paths(part, *names, name)


def damaged(content: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the content without each of its parts, and with something else there."""
    for *names, last in paths(content):
        for other in ("dropped", *OTHERS):
            changed = copy.deepcopy(content)
            place: Any = changed
            for name in names:
                place = place[name]
            if other == "dropped":
                del place[last]
            else:
                place[last] = other
            yield f"{names} {last} {other}", changed


def read(run: Run) -> None:
    """Read all that commands read of a config."""
    assert run.space.situation_names
    assert run.n_recorded <= run.n_agents
    for name in ("zone_names", "error_columns", "error_window", "delay", "is_hybrid"):
        getattr(run, name)
    recorded_bounds(run.config)


def test_every_part_may_be_missing_or_of_another_type(run: Run, tmp_path: Path) -> None:
    content = {**run.config, "bounds": BOUNDS}
    n_refused = 0
    for what, changed in damaged(content):
        (tmp_path / CONFIG).write_text(json.dumps(changed))
        for command in (
            lambda: read(load_run(tmp_path)),
            lambda: load_experiment(tmp_path),
            lambda: parse_train(["--config", str(tmp_path / CONFIG)]),
        ):
            try:
                command()
            except ValueError:
                n_refused += 1
            except Exception as error:
                pytest.fail(f"{what}: {error!r}")
    assert n_refused > 500


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"seeds": NaN}', "\xff", '{"a": 1, "a": 2}'])
def test_what_is_no_config_at_all_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / CONFIG).write_text(text, encoding="latin-1")
    (tmp_path / STEPS).mkdir()
    for command in (lambda: read(load_run(tmp_path)), lambda: iac.resume(tmp_path)):
        with pytest.raises(ValueError, match=CONFIG):
            command()
