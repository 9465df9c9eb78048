"""Hybrid experts: nearest neighbours alongside a network, of which the better one is used."""

from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import torch_iac as iac
from tests.same_run import differences
from torch_iac.cli.options import experiment_of
from torch_iac.experts.hybrid import HybridPool

RECENT = 7
HYBRID = iac.HybridExperts(network=iac.MLPExperts(hidden=(8,)), recent=RECENT)
SMALL = iac.IACConfig(
    experts=HYBRID, n_candidates=5, max_examples=20, window=5, delay=5, meta=None, balance=0.0
)
SPACE = iac.SensorimotorSpace(
    actions=(iac.Dimension("push", 0.0, 1.0),),
    sensors=(iac.Dimension("place", 0.0, 1.0),),
    outcomes=(iac.Dimension("place", 0.0, 1.0),),
)


def live(agent: iac.IAC, sensors: np.ndarray, n_decisions: int) -> list[iac.Step]:
    """Let robots push something: to where depends on how hard, and right of the middle by chance.

    What chance does depends on the decision alone, so that it is the same for any robots.
    """
    steps = []
    for _ in range(n_decisions):
        push = agent.act(sensors)
        chance = np.random.default_rng(agent.n_decisions).random()
        sensors = np.where(push < 0.5, 0.8 * push, chance).astype(np.float32)
        steps.append(agent.observe(sensors))
    return steps


def begin(n_agents: int = 1) -> np.ndarray:
    return np.full((n_agents, 1), 0.5, np.float32)


def test_the_better_one_is_used_region_by_region() -> None:
    """A plain model of both errors in each region says which one every decision must use."""
    # The halves on their own, as shadows, predict and learn on the same stream.
    config = replace(SMALL, shadows={"knn": HYBRID.neighbours, "mlp": HYBRID.network})
    agent = iac.IAC(SPACE, config, seeds=[3])
    recent: dict[int, tuple[deque[float], deque[float]]] = {0: (deque(), deque())}
    used = []
    for step in live(agent, begin(), 300):
        region = int(step.regions)
        while region not in recent:  # the errors of its parent, which had split before
            parents = agent.genealogy().parent.tolist()
            line = [region]
            while line[-1] not in recent:
                line.append(parents[line[-1]])
            for child in reversed(line[:-1]):
                recent[child] = tuple(of.copy() for of in recent[parents[child]])  # type: ignore[assignment]
        knn, mlp = recent[region]
        expected = sum(mlp) < sum(knn)
        assert bool(step.used_network) == expected
        by_half = {shadow.name: shadow for shadow in step.shadows}
        assert torch.equal(step.predictions, by_half["mlp" if expected else "knn"].predictions)
        for errors, name in ((knn, "knn"), (mlp, "mlp")):
            errors.append(round(float(by_half[name].errors) * 2**30))
            if len(errors) > RECENT:
                errors.popleft()
        used.append(expected)
    assert agent.tree.n_rows > 4
    assert 0.05 < np.mean(used) < 0.95


def test_at_first_the_neighbours_are_used() -> None:
    agent = iac.IAC(SPACE, SMALL, seeds=[0, 1])
    step = live(agent, begin(2), 1)[0]
    assert step.used_network is not None
    assert step.used_network.tolist() == [False, False]
    assert step.predictions.tolist() == [[0.5], [0.5]]  # no example yet


def test_other_experts_do_not_say_which_they_used() -> None:
    step = live(iac.IAC(SPACE, replace(SMALL, experts=iac.KNNExperts())), begin(), 1)[0]
    assert step.used_network is None


def test_requests_between_decisions_change_nothing() -> None:
    asked, quiet = (iac.IAC(SPACE, SMALL, seeds=[1]) for _ in range(2))
    steps, sensors = live(quiet, begin(), 60), begin()
    for expected in steps:
        (step,) = live(asked, sensors, 1)
        sensors = step.outcomes.numpy()
        asked.predict(np.full((3, 1), 0.2), np.full((3, 1), 0.7))
        assert torch.equal(step.predictions, expected.predictions)


def test_alone_and_in_company_they_are_the_same() -> None:
    together = live(iac.IAC(SPACE, SMALL, seeds=range(4)), begin(4), 120)
    alone = live(iac.IAC(SPACE, SMALL, seeds=[2]), begin(), 120)
    for one, of_all in zip(alone, together, strict=True):
        assert torch.equal(one.predictions[0], of_all.predictions[2])
        assert one.used_network is not None
        assert of_all.used_network is not None
        assert one.used_network[0] == of_all.used_network[2]


def test_they_go_on_from_their_state() -> None:
    whole, first, second = (iac.IAC(SPACE, SMALL, seeds=[5]) for _ in range(3))
    expected = live(whole, begin(), 120)
    last = live(first, begin(), 70)[-1]
    second.load_state(first.state())
    for step, of_whole in zip(live(second, last.outcomes.numpy(), 50), expected[70:], strict=True):
        assert torch.equal(step.predictions, of_whole.predictions)


def test_the_expert_of_a_region_is_the_one_in_use() -> None:
    agent = iac.IAC(SPACE, SMALL, seeds=[0])
    live(agent, begin(), 150)
    assert isinstance(agent.experts, HybridPool)
    kinds = set()
    for region in agent.region_summary().region.tolist():
        node = agent.tree.leaves()[agent.tree.region[agent.tree.leaves()] == region]
        is_network = bool(agent.experts.uses_network(agent.tree.rows[node]))
        assert isinstance(agent.expert(region), torch.nn.Module) == is_network
        kinds.add(is_network)
    assert kinds == {True, False}


def test_they_cannot_learn_before_they_predict() -> None:
    agent = iac.IAC(SPACE, SMALL)
    with pytest.raises(RuntimeError, match="must predict before they learn"):
        agent.experts.learn(agent.examples, torch.tensor([0]), 0)


def test_what_is_compared_over_must_be_a_count() -> None:
    with pytest.raises(ValueError, match="recent must be at least 1, got 0"):
        iac.HybridExperts(recent=0)


def test_a_run_says_which_was_used(tmp_path: Path) -> None:
    words = "--world kinematic --experts hybrid --experts.recent 9 --experts.network.hidden 4"
    experiment = experiment_of(f"{words} --max-examples 40 --steps 300 --agents 2".split())
    assert experiment.config.experts == iac.HybridExperts(
        network=iac.MLPExperts(hidden=(4,)), recent=9
    )
    run = experiment.run(tmp_path / "a")
    used = run.column("used_network")
    assert used.shape == (300, 2)
    share = run.summary["network_share"]
    assert share["mean"] == pytest.approx(used.mean())
    zone = run.column("zone") == 2
    assert share["zones"]["f3"] == pytest.approx(
        np.mean([used[zone[:, agent], agent].mean() for agent in range(2)])
    )
    assert differences(experiment.run(tmp_path / "b").folder, run.folder) == []
