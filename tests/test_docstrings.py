"""The examples in docstrings give what they say."""

import doctest
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import torch_iac
import torch_iac_envs


def with_examples(package: ModuleType) -> list[str]:
    folder = Path(str(package.__file__)).parent
    modules = sorted(path for path in folder.glob("*.py") if ">>>" in path.read_text())
    return [f"{package.__name__}.{path.stem}" for path in modules]


MODULES = with_examples(torch_iac) + with_examples(torch_iac_envs)


@pytest.mark.parametrize("name", MODULES)
def test_examples_come_out(name: str) -> None:
    found = doctest.testmod(import_module(name))
    assert found.attempted
    assert not found.failed
