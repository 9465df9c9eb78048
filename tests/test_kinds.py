"""Kinds of experts, drives and choices, by name."""

import re
from typing import Any

import pytest
from torch import Tensor, nn

import torch_iac as iac
from torch_iac.kinds import KINDS, named


class Net(nn.Linear):
    """A network of a user's own."""


class Hunger:
    """No drive, for it is worth nothing."""


def factory(n_inputs: int, n_outputs: int) -> nn.Module:
    """Makes a network."""
    return nn.Linear(n_inputs, n_outputs)


class Appetite:
    """A drive of a user's own."""

    needs: frozenset[Any] = frozenset()

    def worth(self, candidates: iac.Candidates, knowledge: iac.Knowledge) -> Tensor:
        """Return nothing for all."""
        return knowledge.history.progress.take(candidates.rows) * 0


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_has_a_name(kind: str) -> None:
    kinds, protocol = KINDS[kind]
    for name, made in kinds.items():
        assert named(kind, name) == made()
        assert isinstance(made(), protocol)


def test_names_do_in_a_config() -> None:
    config = iac.IACConfig(drive="error", experts="mlp", choice="softmax")  # type: ignore[arg-type]
    assert config == iac.IACConfig(
        drive=iac.Error(), experts=iac.MLPExperts(), choice=iac.Softmax()
    )


def test_parts_of_a_users_own_have_names() -> None:
    assert named("experts", "tests.test_kinds:Net") == iac.NetworkExperts(module=Net)
    assert named("experts", "tests.test_kinds:factory") == iac.NetworkExperts(module=factory)
    assert isinstance(named("drive", "tests.test_kinds:Appetite"), Appetite)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"drive": "eror"}, "or module:Name, got eror; perhaps you meant error"),
        ({"experts": "mpl"}, "experts must be knn, mlp, hybrid or module:Name, got mpl"),
        ({"drive": "tests.test_kinds:Hunger"}, "drive must have a method worth, got tests.test"),
        ({"drive": "tests.test_kinds:Net"}, "drive must have a method worth, got tests.test"),
        ({"drive": iac.Error}, "drive must be made, as Error(), got the class"),
        ({"experts": iac.KNNExperts}, "experts must be made, as KNNExperts(), got the class"),
        ({"drive": Hunger()}, "drive must have what Drive has, got <"),
        ({"choice": 3}, "choice must have what Choice has, got 3"),
    ],
)
def test_what_is_no_part_is_refused(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=re.escape(sentence)):
        iac.IACConfig(**values)


def test_a_network_that_is_made_is_no_factory() -> None:
    with pytest.raises(ValueError, match="got one that is made: Linear"):
        iac.NetworkExperts(module=nn.Linear(2, 1))
