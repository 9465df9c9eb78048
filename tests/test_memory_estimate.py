"""The estimate of the memory that a run needs, held to what agents really keep."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from torch_iac import (
    IAC,
    HybridExperts,
    IACConfig,
    MetaPredictor,
    MLPExperts,
    SensorimotorSpace,
    memory_estimate,
)
from torch_iac.memory_estimate import check_memory, check_world_memory, free_memory, memory_needed
from torch_iac.runs.buffer import recording_bytes

N_AGENTS, N_DECISIONS = 64, 300
KNN = IACConfig(max_examples=40, n_candidates=5)
CONFIGS = {
    "knn": KNN,
    "lopsided": replace(KNN, balance=0.0),
    "mlp": replace(KNN, experts=MLPExperts(hidden=(8,), minibatches=1)),
    "hybrid": replace(
        KNN,
        experts=HybridExperts(network=MLPExperts(hidden=(8,), minibatches=1), recent=200),
    ),
    "mp": replace(KNN, meta=MetaPredictor(memory=100, minibatch_size=8)),
    "shadow": replace(KNN, shadows={"mlp": MLPExperts(hidden=(16,), minibatches=1)}),
}


def tensor_bytes(thing: Any, seen: dict[int, Any]) -> int:
    """Return how many bytes the tensors under a thing take, each storage once."""
    if isinstance(thing, torch.Tensor):
        place = thing.untyped_storage().data_ptr()
        return 0 if seen.setdefault(place, thing) is not thing else thing.untyped_storage().nbytes()
    if id(thing) in seen:
        return 0
    seen[id(thing)] = thing
    parts = vars(thing).values() if hasattr(thing, "__dict__") else ()
    if isinstance(thing, dict):
        parts = thing.values()
    elif isinstance(thing, (list, tuple)):
        parts = thing
    return sum(tensor_bytes(part, seen) for part in parts)


@pytest.mark.parametrize("name", CONFIGS)
def test_the_estimate_is_above_what_agents_keep_and_not_far(
    space: SensorimotorSpace, name: str
) -> None:
    agent = IAC(space, CONFIGS[name], range(N_AGENTS))
    numbers = torch.Generator().manual_seed(0)
    for _ in range(N_DECISIONS):
        agent.act(torch.rand(N_AGENTS, 2, generator=numbers))
        agent.observe(torch.rand(N_AGENTS, 2, generator=numbers))
    kept = tensor_bytes(agent, {})
    need = memory_needed(space, CONFIGS[name], N_AGENTS, N_DECISIONS)
    assert kept <= need.tables <= 3 * kept
    assert need.tables + need.working <= need.on_device
    assert need.recording == (0, 0)


def test_more_of_anything_needs_more(space: SensorimotorSpace) -> None:
    config = CONFIGS["knn"]

    def needed(n_agents: int, n_decisions: int, n_recorded: int) -> int:
        recording = recording_bytes(space, config, n_decisions, n_recorded)
        need = memory_needed(space, config, n_agents, n_decisions, recording)
        return need.on_device + need.recording.on_host

    least = needed(10, 100, 1)
    for more in ((20, 100, 1), (10, 1000, 1), (10, 100, 10)):
        assert needed(*more) > least, more


@pytest.mark.parametrize("place", ["cpu", "cuda:1"])
def test_what_will_not_fit_is_refused_with_both_numbers(
    space: SensorimotorSpace, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    free = {place: 10**7}
    monkeypatch.setattr(memory_estimate, "free_memory", lambda device: free.get(str(device)))
    device = torch.device(place)
    check_memory(space, CONFIGS["knn"], 4, 1000, device)
    message = (
        r"a run must fit into memory: 4,000 agents and 1,000 decisions need about \d\.\d GB on "
        rf"{place}, got 0\.0 GB free; lower agents, steps or max_examples"
    )
    with pytest.raises(ValueError, match=message):
        check_memory(space, CONFIGS["knn"], 4000, 1000, device)


def test_agents_alone_that_will_not_fit_are_refused_before_anything_is_made(
    space: SensorimotorSpace,
) -> None:
    message = r"10,000,000,000 agents need about \d+\.\d GB on cpu, got .* lower agents or max_ex"
    with pytest.raises(ValueError, match=message):
        IAC(space, CONFIGS["mp"], range(10**10))


def test_worlds_and_records_need_the_main_memory(
    space: SensorimotorSpace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        memory_estimate, "free_memory", lambda on: 10**12 if on.type == "cuda" else 10**7
    )
    run = (space, CONFIGS["knn"], 4000, 1000, torch.device("cuda"))
    few, many = (recording_bytes(space, CONFIGS["knn"], 1000, n) for n in (10, 4000))
    check_memory(*run, few)
    with pytest.raises(ValueError, match="GB on cpu, got"):
        check_memory(*run, many)
    check_world_memory(100, 10**4)
    with pytest.raises(ValueError, match=r"4,000 worlds need about .* on cpu, got"):
        check_world_memory(4000, 10**4)


def test_where_free_memory_is_not_known_nothing_is_refused(
    space: SensorimotorSpace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory_estimate, "free_memory", lambda _: None)
    check_memory(space, CONFIGS["knn"], 10**9, 10**9, torch.device("cpu"))
    assert free_memory(torch.device("meta")) is None


@pytest.mark.parametrize(("limit", "free"), [("5000", 5000 - 3000 + 1000), ("max", None)])
def test_a_limit_of_the_group_of_processes_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, free: int | None
) -> None:
    (tmp_path / "most").write_text(f"{limit}\n")
    (tmp_path / "taken").write_text("3000\n")
    (tmp_path / "memory.stat").write_text("anon 2000\nidle 1000\n")
    monkeypatch.setattr(memory_estimate, "GROUPS", ((str(tmp_path), "most", "taken", "idle"),))
    known = free_memory(torch.device("cpu"))
    if free is not None:
        assert known == free
    else:
        assert known is None or known > 5000
