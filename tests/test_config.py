"""The papers' numbers, written out: a default that changes must break a test."""

from dataclasses import asdict, fields

import pytest

from torch_iac.config import PRESETS, IACConfig
from torch_iac.drives.choices import Greedy
from torch_iac.drives.learning_progress import Progress
from torch_iac.experts.knn import KNNExperts
from torch_iac.experts.mlp import MLP
from torch_iac.experts.network import MLPExperts, NetworkTraining
from torch_iac.experts.stacked_networks import Training
from torch_iac.meta_predictor import MetaPredictor

PARTS = ("experts", "drive", "choice", "meta", "improvement", "shadows")

OF_2004 = {
    "n_candidates": 50,
    "epsilon": 0.1,
    "max_examples": 250,
    "balance": 0.15,
    "window": 150,
    "delay": 150,
    "error": "absolute",
    "inherit_history": True,
}
"""NS = 250, DELAY = 150, one action in ten at random; where the paper is silent, the choices of
`IACConfig`'s fields."""

OF_2007 = OF_2004 | {
    "epsilon": 0.15,
    "balance": 0.0,
    "window": 26,
    "delay": 15,
    "error": "squared",
}
"""theta = 25, tau = 15, no balance of sizes, 15 % at random in the toy experiment."""


@pytest.mark.parametrize(
    ("config", "numbers"),
    [(IACConfig(), OF_2004), (PRESETS["iac2004"], OF_2004), (PRESETS["iac2007"], OF_2007)],
    ids=["default", "iac2004", "iac2007"],
)
def test_a_preset_has_its_papers_numbers(config: IACConfig, numbers: dict[str, object]) -> None:
    assert {
        f.name: getattr(config, f.name) for f in fields(config) if f.name not in PARTS
    } == numbers
    assert (config.experts, config.drive, config.choice) == (
        KNNExperts(k=1),
        Progress(),
        Greedy(),
    )
    assert config.shadows == {}


def test_networks_have_the_numbers_that_the_results_were_measured_with() -> None:
    training = {
        "learning_rate": 0.01,
        "minibatches": 4,
        "minibatch_size": 32,
        "optimizer": "adam",
    }
    assert asdict(Training()) == training
    of_regions = training | {"children": "copy", "fresh_minibatches": 100}
    assert asdict(NetworkTraining()) == of_regions
    assert asdict(MLPExperts()) == of_regions | {"hidden": (32, 32)}
    assert MLP() == MLP(hidden=(32, 32))
    assert asdict(MetaPredictor()) == {
        "learning_rate": 0.001,
        "minibatches": 1,
        "minibatch_size": 128,
        "optimizer": "adam",
        "hidden": (8,),
        "memory": 600,
        "bins": 16,
    }


def test_equal_configs_have_equal_hashes() -> None:
    one, other = (IACConfig(shadows={"b": MLPExperts(hidden=hidden)}) for hidden in ((8,), [8]))  # type: ignore[arg-type]
    assert one == other
    assert hash(one) == hash(other)
    assert {IACConfig(), *PRESETS.values()} == set(PRESETS.values())
    with pytest.raises(TypeError):
        one.shadows["c"] = MLPExperts()  # type: ignore[index]
