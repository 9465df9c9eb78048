"""What a caller sets in torch as a whole does not reach the engine, and stays as it was set."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from torch_iac import (
    IAC,
    Dimension,
    HybridExperts,
    IACConfig,
    KNNExperts,
    MetaPredictor,
    MLPExperts,
    NetworkExperts,
    SensorimotorSpace,
    load_run,
)
from torch_iac.drives.learning_progress import MetaProgress
from torch_iac.experts.protocol import Experts
from torch_iac.internal.torch_defaults import with_torch_defaults
from torch_iac.runs.recorder import Recorder

PUSH, PLACE = Dimension("push", -1.0, 1.0), Dimension("place", 0.0, 1.0)
SPACE = SensorimotorSpace((PUSH,), (PLACE,), (PLACE,))


class Embedding(nn.Module):
    """A network that makes tensors of torch's default type on torch's default device."""

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(n_inputs + 1, 8), nn.Tanh(), nn.Linear(8, n_outputs))

    def forward(self, inputs: Tensor) -> Tensor:
        outputs: Tensor = self.layers(torch.cat([inputs, torch.ones(len(inputs), 1)], dim=1))
        return outputs


@contextmanager
def default_type(dtype: torch.dtype) -> Iterator[None]:
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


@contextmanager
def matmul_precision(precision: str) -> Iterator[None]:
    torch.set_float32_matmul_precision(precision)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision("highest")


SETTINGS: dict[str, Callable[[], Any]] = {
    "float64": lambda: default_type(torch.float64),
    "bfloat16": lambda: default_type(torch.bfloat16),
    "device": lambda: torch.device("meta"),
    "inference": torch.inference_mode,
    "autocast": lambda: torch.autocast("cpu", dtype=torch.bfloat16),
    "no gradients": torch.no_grad,
    "precision": lambda: matmul_precision("medium"),
}
EXPERTS: dict[str, Experts] = {
    "knn": KNNExperts(k=3),
    "mlp": MLPExperts(hidden=(8,)),
    "hybrid": HybridExperts(),
    "module": NetworkExperts(module=Embedding),
}


def life(agent: IAC, n_decisions: int = 30) -> None:
    places = np.full((2, 1), 0.5)
    for _ in range(n_decisions):
        pushes = agent.act(places)
        places = np.clip(np.cos(pushes) * places, 0, 1)
        agent.observe(places)


def robots(experts: str) -> IAC:
    config = IACConfig(
        experts=EXPERTS[experts],
        drive=MetaProgress(),
        meta=MetaPredictor(memory=20),
        shadows={"other": MLPExperts(hidden=(4,))},
        max_examples=20,
        window=5,
        delay=5,
    )
    return IAC(SPACE, config, [0, 1])


@pytest.mark.parametrize("experts", EXPERTS)
@pytest.mark.parametrize("setting", SETTINGS)
def test_robots_are_the_same_under_any_setting(setting: str, experts: str) -> None:
    plain = robots(experts)
    life(plain)
    life(plain)
    with SETTINGS[setting]():
        agent = robots(experts)
        life(agent)
        state = agent.state()
        predictions = agent.predict(np.zeros((5, 1)), np.zeros((5, 1)))
        assert predictions.dtype == np.float32
        other = robots(experts)
        other.load_state(state)
    life(agent)  # made under the setting, and gone on with without
    life(other)
    for name, tensor in plain.state().items():
        for found in (agent, other):
            assert torch.equal(tensor.nan_to_num(), found.state()[name].nan_to_num()), name


@pytest.mark.parametrize("setting", SETTINGS)
def test_what_is_recorded_is_the_same_under_any_setting(setting: str, tmp_path: Path) -> None:
    def record(folder: Path) -> Any:
        agent, places = robots("mlp"), torch.full((2, 1), 0.5, device="cpu", dtype=torch.float32)
        with Recorder(folder, agent, log_every=10) as recorder:
            for _ in range(20):
                agent.act(places)
                recorder.record(agent.observe(places))
        return load_run(folder).table()

    with SETTINGS[setting]():
        altered = record(tmp_path / "altered")
    assert altered.equals(record(tmp_path / "plain"))


def test_settings_are_the_callers_again_after_an_error() -> None:
    @with_torch_defaults
    def fail() -> None:
        assert torch.get_default_dtype() is torch.float32
        assert not torch.is_inference_mode_enabled()
        raise ZeroDivisionError

    with default_type(torch.float64), torch.device("meta"), torch.inference_mode():
        with pytest.raises(ZeroDivisionError):
            fail()
        assert torch.empty(0).device.type == "meta"
        assert torch.get_default_dtype() is torch.float64
        assert torch.is_inference_mode_enabled()


def test_threads_do_not_disturb_each_other() -> None:
    wrong = []

    @with_torch_defaults
    def look() -> None:
        if torch.tensor([1.0]).dtype is not torch.float32:
            wrong.append(1)

    def look_often() -> None:
        for _ in range(2000):
            look()

    with default_type(torch.float64):
        threads = [Thread(target=look_often) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert torch.get_default_dtype() is torch.float64
    assert not wrong
