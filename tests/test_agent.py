"""The engine against the paper's oracle, alone and in a population, and against bad input."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from tests.agreement import check_step, oracle_of, scaled
from torch_iac import (
    IAC,
    MLP,
    AbsoluteProgress,
    Choice,
    Curriculum,
    Dimension,
    Drive,
    Error,
    Experts,
    GlobalProgress,
    Greedy,
    HybridExperts,
    IACConfig,
    Improvement,
    ImprovementPredictor,
    KNNExperts,
    MetaPredictor,
    MetaProgress,
    MLPExperts,
    NetworkExperts,
    Novelty,
    Progress,
    Proportional,
    Random,
    SensorimotorSpace,
    Softmax,
    Stage,
    Step,
)
from torch_iac.regions.examples import Examples
from torch_iac.regions.tree import Split

SMALL = IACConfig(n_candidates=5, max_examples=20, window=8, delay=8, meta=None)
"""Splits often, so that a short run shows much."""

LEARNERS = replace(
    SMALL,
    experts=MLPExperts(hidden=(8,), minibatches=1),
    meta=MetaPredictor(hidden=(8,), minibatches=1),
    improvement=ImprovementPredictor(hidden=(8,), minibatches=1),
)
"""Everything learns, and little, so that it is fast."""


class Pendulum:
    """A small world: `far` follows the push, and noise if the tone is low; one a seed."""

    def __init__(self, seeds: list[int]) -> None:
        self.generators = [np.random.default_rng(seed) for seed in seeds]
        self.near = np.ones(len(seeds))

    def sense(self, far: np.ndarray) -> np.ndarray:
        return np.stack([self.near, far], axis=1).astype(np.float32)

    def reset(self) -> np.ndarray:
        return self.sense(np.zeros(len(self.generators)))

    def step(self, actions: np.ndarray) -> np.ndarray:
        noise = np.array([generator.uniform(-1, 1) for generator in self.generators])
        self.near = np.clip(self.near + 0.3 * actions[:, 0], 0, 2)
        return self.sense(np.where(actions[:, 1] < 4, noise, self.near))


def live(agent: IAC, n_decisions: int) -> list[Step]:
    world = Pendulum(list(agent.seeds))
    sensors, steps = world.reset(), []
    for _ in range(n_decisions):
        sensors = world.step(agent.act(sensors))
        steps.append(agent.observe(sensors))
    return steps


@pytest.mark.parametrize(
    "config",
    [
        SMALL,
        replace(SMALL, experts=KNNExperts(k=3)),
        replace(SMALL, error="squared", window=6, delay=3, balance=0.0),
        replace(SMALL, inherit_history=False),
    ],
    ids=["1-nn", "3-nn", "2007", "no history inherited"],
)
@pytest.mark.parametrize("seed", range(3))
def test_every_decision_is_the_oracles(
    space: SensorimotorSpace, config: IACConfig, seed: int
) -> None:
    robot = oracle_of(config)
    agent = IAC(space, config, seeds=[seed])
    for step in live(agent, 600):
        check_step(space, robot, step)
    assert robot.n_regions > 20


@pytest.mark.parametrize("seed", range(3))
def test_every_decision_is_the_oracles_where_an_action_has_but_some_values(
    space: SensorimotorSpace, seed: int
) -> None:
    tone = Dimension("tone", 0.0, 10.0, n_values=6)
    space = replace(space, actions=(space.actions[0], tone))
    robot, agent = oracle_of(SMALL), IAC(space, SMALL, seeds=[seed])
    steps = live(agent, 600)
    for step in steps:
        check_step(space, robot, step)
    tones = torch.cat([step.actions[:, 1] for step in steps])
    assert set(tones.tolist()) == {0.0, 2.0, 4.0, 6.0, 8.0, 10.0}
    cuts = agent.genealogy()
    at = cuts.cut_value[cuts.cut_dimension == 1] * 10
    assert len(at)
    assert (((at / 2) % 1 - 0.5).abs() < 0.49).all()  # none falls on a value


def test_a_told_action_that_there_is_not_is_refused(space: SensorimotorSpace) -> None:
    tone = Dimension("tone", 0.0, 10.0, n_values=6)
    agent = IAC(replace(space, actions=(space.actions[0], tone)), SMALL)
    sensors = np.array([[1.0, 0.0]])
    agent.set_actions(np.array([[0.3, 4.0]]), sensors)
    agent.observe(sensors)
    with pytest.raises(ValueError, match="tone must be one of 6 values from 0 to 10, got 5 from"):
        agent.set_actions(np.array([[0.3, 5.0]]), sensors)


def test_the_best_candidate_is_the_oracles(space: SensorimotorSpace) -> None:
    config = replace(SMALL, epsilon=0.0)
    agent, robot = IAC(space, config, seeds=[5]), oracle_of(config)
    world = Pendulum([5])
    sensors = world.reset()
    for number in range(400):
        raw = agent.act(sensors)
        context = scaled(space.sensors, torch.as_tensor(sensors))
        actions = agent._choices.at(number)[0, 2:].view(5, 2).tolist()
        candidates = [action + context for action in actions]
        chosen = candidates[robot.choose(candidates)]
        assert scaled(space.actions, torch.as_tensor(raw)) == pytest.approx(chosen[:2], abs=1e-6)
        sensors = world.step(raw)
        check_step(space, robot, agent.observe(sensors))


def follow(agent: IAC, n_decisions: int) -> list[Step]:
    """Let agents live through what others choose for them: random actions, by their seeds."""
    world, draws = Pendulum(list(agent.seeds)), [np.random.default_rng(s) for s in agent.seeds]
    sensors, steps = world.reset(), []
    for _ in range(n_decisions):
        actions = np.stack([draw.uniform([-1, 0], [1, 10]) for draw in draws])
        agent.set_actions(actions, sensors)
        sensors = world.step(actions)
        steps.append(agent.observe(sensors))
    return steps


def test_actions_that_others_chose_are_learnt_from_as_the_oracle_does(
    space: SensorimotorSpace,
) -> None:
    robot = oracle_of(SMALL)
    steps = follow(IAC(space, SMALL, seeds=[4]), 600)
    for step in steps:
        check_step(space, robot, step)
    assert robot.n_regions > 20
    assert not any(step.random_actions.any() for step in steps)
    assert torch.stack([step.actions for step in steps]).std(dim=0).min() > 0.5


def test_what_others_chose_for_one_agent_is_nothing_to_another(space: SensorimotorSpace) -> None:
    together = follow(IAC(space, LEARNERS, seeds=[3, 1, 7]), 60)
    alone = follow(IAC(space, LEARNERS, seeds=[7]), 60)
    for of_many, one in zip(together, alone, strict=True):
        assert_same(one, of_many, 0, 2)


def test_an_action_is_worth_the_progress_of_its_region(space: SensorimotorSpace) -> None:
    agent = IAC(space, SMALL, seeds=[0, 1])
    live(agent, 200)
    seen = set()
    for push in (-0.9, 0.0, 0.9):
        for tone in (1.0, 5.0, 9.0):
            actions, sensors = np.full((2, 2), [push, tone]), np.full((2, 2), [1.0, 0.5])
            worth = agent.worth(actions, sensors)
            agent.set_actions(actions, sensors)
            step = agent.observe(sensors)
            assert torch.equal(worth, step.progress)
            seen.update(worth.tolist())
    assert len(seen) > 4


def test_what_an_action_is_worth_is_the_drives_to_say(space: SensorimotorSpace) -> None:
    stages = (Stage("tone", 2.0, 5.0, until=20), Stage("push", -1.0, 0.5, until=0))
    agent = IAC(space, replace(SMALL, drive=Curriculum(stages)), seeds=[0, 1])
    sensors = np.zeros((2, 2))
    assert agent.worth(np.array([[0.9, 4.0], [0.0, 6.0]]), sensors).tolist() == [1, 0]
    live(agent, 20)
    assert agent.worth(np.array([[0.9, 4.0], [0.0, 6.0]]), sensors).tolist() == [0, 1]


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ([[0.0, 11.0]], r"tone must lie in \[0, 10\], got 11 from agent 0"),
        ([[math.nan, 5.0]], r"push must lie in \[-1, 1\], got nan from agent 0"),
        ([0.0, 5.0], r"actions must have the shape \(agents, actions\) = \(1, 2\), got \(2,\)"),
    ],
)
def test_actions_of_others_keep_to_the_bounds(
    space: SensorimotorSpace, actions: list[Any], message: str
) -> None:
    agent, sensors = IAC(space, SMALL), np.zeros((1, 2), np.float32)
    for told in (agent.set_actions, agent.worth):
        with pytest.raises(ValueError, match=message):
            told(np.array(actions), sensors)
    with pytest.raises(RuntimeError, match="needs an action"):
        agent.observe(sensors)


@pytest.mark.parametrize(
    "experts",
    [
        KNNExperts(),
        MLPExperts(hidden=(8,), minibatches=1),
        HybridExperts(network=MLPExperts(hidden=(8,), minibatches=1)),
    ],
)
def test_predictions_on_request_are_those_of_decisions(
    space: SensorimotorSpace, experts: Experts, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent = IAC(space, replace(SMALL, experts=experts), seeds=range(3))
    live(agent, 100)
    world = Pendulum([0, 1, 2])
    sensors = world.reset()
    actions = agent.act(sensors)
    every = agent.predict(actions, sensors)  # of each agent, what each one is about to do
    monkeypatch.setattr("torch_iac.agent.PREDICT_CHUNK", 6)
    np.testing.assert_array_equal(agent.predict(actions, sensors), every)
    step = agent.observe(world.step(actions))
    own = every[range(3), range(3)]
    np.testing.assert_allclose(own, step.predictions.numpy(), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("actions", "sensors", "message"),
    [
        ([[0.0]], [[0.0, 0.0]], r"actions must have the shape \(situations, actions\) = \(1, 2\)"),
        ([[0.0, 5.0]], [[0.0, 9.0]], r"far must lie in .* got 9 from situation 0"),
        ([[7.0, 5.0]], [[0.0, 0.0]], r"push must lie in .* got 7 from situation 0"),
    ],
)
def test_predictions_are_of_situations_within_bounds(
    space: SensorimotorSpace, actions: list[list[float]], sensors: list[list[float]], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        IAC(space).predict(np.array(actions), np.array(sensors))


def assert_same(one: Step, other: Step, agent: int, other_agent: int) -> None:
    """One agent's decision is another's, to the bit."""
    for name, value in vars(one).items():
        if isinstance(value, Tensor):
            assert torch.equal(value[agent], getattr(other, name)[other_agent]), name
        elif name != "shadows":
            assert value == getattr(other, name), name


@pytest.mark.parametrize(
    ("config", "n_decisions"),
    [
        (SMALL, 300),
        (replace(SMALL, experts=KNNExperts(k=3)), 300),
        (replace(SMALL, experts=MLPExperts()), 60),
        (
            replace(SMALL, experts=MLPExperts(hidden=(8,), children="fresh", fresh_minibatches=5)),
            60,
        ),
        (replace(SMALL, meta=MetaPredictor(), drive=MetaProgress()), 60),
        (replace(LEARNERS, drive=Improvement(), choice=Softmax()), 80),
        (replace(LEARNERS, drive=GlobalProgress(), choice=Proportional()), 80),
    ],
    ids=["1-nn", "3-nn", "MLPs", "fresh MLPs", "MP", "improvement", "global"],
)
def test_an_agent_of_a_population_has_the_run_that_it_has_alone(
    space: SensorimotorSpace, config: IACConfig, n_decisions: int
) -> None:
    seeds = list(range(40))
    together = live(IAC(space, config, seeds), n_decisions)
    for agent in (0, 1, 17, 39):
        alone = live(IAC(space, config, [seeds[agent]]), n_decisions)
        for one, of_many in zip(alone, together, strict=True):
            assert_same(one, of_many, 0, agent)


def test_every_example_lies_in_the_region_that_routing_returns(space: SensorimotorSpace) -> None:
    agent = IAC(space, SMALL, seeds=[0, 1])
    live(agent, 500)
    leaves = agent.tree.leaves()
    for leaf in leaves.tolist():
        row = int(agent.tree.rows[leaf])
        held = agent.examples.situations[row, :, : int(agent.examples.counts[row])].T
        both = held.expand(2, -1, -1)  # ask both agents' trees; the leaf belongs to one
        assert (agent.tree.route(both)[agent.tree.agent[leaf]] == leaf).all()
    summary = agent.region_summary()
    for agent_number in (0, 1):
        assert summary.n_examples[summary.agent == agent_number].sum() == 500
    lows, highs = (bounds[leaves] for bounds in agent.tree.boxes(len(agent.space.situation)))
    volumes = (highs - lows).prod(dim=1)
    assert volumes.sum().item() == pytest.approx(2.0, abs=1e-5)


def test_a_region_that_cannot_be_cut_forgets_its_oldest_example() -> None:
    wire = Dimension("x", 0.0, 1.0)
    space = SensorimotorSpace((Dimension("a", 0.0, 1.0),), (wire,), (wire,))
    agent = IAC(space, replace(SMALL, max_examples=4, balance=0.5), seeds=[0])
    sensors = np.zeros((1, 1), np.float32)
    for _ in range(60):  # 5 examples have no half, so the root is never cut
        agent.act(sensors)
        agent.observe(sensors)
    assert agent.examples.counts.tolist() == [4]
    assert agent.tree.n_nodes == 1


def test_epsilon_is_the_share_of_random_actions(space: SensorimotorSpace) -> None:
    steps = live(IAC(space, replace(SMALL, epsilon=0.25), seeds=list(range(50))), 100)
    share = torch.stack([step.random_actions for step in steps]).double().mean().item()
    assert share == pytest.approx(0.25, abs=0.025)


def test_without_a_drive_actions_are_uniform(space: SensorimotorSpace) -> None:
    steps = live(IAC(space, replace(SMALL, drive=Random()), seeds=list(range(20))), 100)
    actions = torch.cat([step.actions for step in steps])
    assert actions.mean(dim=0).tolist() == pytest.approx([0.0, 5.0], abs=0.25)
    assert actions.std(dim=0).tolist() == pytest.approx([2 / 12**0.5, 10 / 12**0.5], rel=0.05)


DRIVES = [
    Progress(),
    MetaProgress(),
    AbsoluteProgress(),
    GlobalProgress(),
    Error(),
    Error("meta"),
    Novelty(),
    Improvement(),
    Curriculum((Stage("tone", 2.0, 5.0, until=20), Stage("push", -1.0, 0.5, until=0))),
    Random(),
]


@pytest.mark.parametrize("choice", [Greedy(), Proportional(), Softmax()], ids=repr)
@pytest.mark.parametrize("drive", DRIVES, ids=lambda drive: type(drive).__name__)
def test_every_drive_lives_with_every_choice_and_lives_the_same_again(
    space: SensorimotorSpace, drive: Drive, choice: Choice
) -> None:
    config = replace(LEARNERS, drive=drive, choice=choice)
    run, again = (live(IAC(space, config, [3]), 60) for _ in range(2))
    for one, other in zip(run, again, strict=True):
        assert_same(one, other, 0, 0)
    assert all(step.errors.isfinite().all() for step in run)
    assert run[-1].regions.max() > 0


def test_a_curriculum_is_followed(space: SensorimotorSpace) -> None:
    drive = Curriculum((Stage("tone", 2.0, 5.0, until=40), Stage("push", 0.0, 1.0, until=0)))
    config = replace(SMALL, drive=drive, epsilon=0.0, n_candidates=50)
    actions = torch.stack([step.actions for step in live(IAC(space, config, [0, 1]), 80)])
    first, then = actions[:40, :, 1], actions[40:, :, 0]
    assert ((first > 2) & (first <= 5)).all()
    assert (then > 0).all()


def test_what_mp_expects_is_recorded_before_it_learns(space: SensorimotorSpace) -> None:
    agent = IAC(space, replace(SMALL, meta=MetaPredictor()), [0, 1])
    world = Pendulum([0, 1])
    sensors = world.reset()
    assert agent.meta is not None
    for number in range(40):
        sensors = world.step(agent.act(sensors))
        decision = agent._decision
        assert decision is not None
        before = agent.meta.expect(decision.situations[:, None])[:, 0]
        step = agent.observe(sensors)
        after = agent.meta.expect(decision.situations[:, None])[:, 0]
        assert step.expected_errors is not None
        assert torch.equal(step.expected_errors, before)
        if number > 20:  # MP begins with the largest error there is and comes down from it
            assert not torch.equal(step.expected_errors, after)


def test_improvement_is_learnt_from_the_error_before_and_after(space: SensorimotorSpace) -> None:
    agent = IAC(space, LEARNERS, [0, 1])
    agent.experts = KNNExperts()  # which knows every example by heart: no error is left
    gains = []

    class Witness:
        def learn(self, situations: Tensor, targets: Tensor, step: int) -> None:  # noqa: ARG002
            gains.append(targets)

    agent.improvement = Witness()  # type: ignore[assignment]
    errors = [step.errors for step in live(agent, 20)]
    assert torch.equal(torch.stack(gains), torch.stack(errors))
    assert torch.stack(errors).mean() > 0.1


def test_what_is_left_to_chance_is_not_what_makes_an_action_random(
    space: SensorimotorSpace,
) -> None:
    config = replace(SMALL, drive=Random(), choice=Proportional(), epsilon=0.5)
    agent = IAC(space, config, seeds=list(range(50)))
    taken = []
    for step in live(agent, 40):
        candidates = agent._choices.at(step.number)[:, 2:].view(50, 5, 2)
        pushes = torch.isclose(candidates[..., 0] * 2 - 1, step.actions[:, :1], atol=1e-6)
        taken.append(pushes.int().argmax(dim=1)[~step.random_actions])
    shares = torch.cat(taken).bincount(minlength=5) / len(torch.cat(taken))
    assert shares.tolist() == pytest.approx([0.2] * 5, abs=0.06)


def test_without_mp_no_error_is_expected_and_mp_changes_no_decision(
    space: SensorimotorSpace,
) -> None:
    without, with_mp = (
        live(IAC(space, replace(SMALL, meta=meta), [0]), 100) for meta in (None, MetaPredictor())
    )
    for one, other in zip(without, with_mp, strict=True):
        assert one.expected_errors is None
        assert_same(one, replace(other, expected_errors=None), 0, 0)


@pytest.mark.parametrize("experts", [KNNExperts(), MLPExperts(hidden=(8,), minibatches=2)])
def test_shadows_look_on_and_change_nothing(space: SensorimotorSpace, experts: Experts) -> None:
    config = replace(SMALL, experts=experts)
    shadows: dict[str, Experts] = {"mlp": MLPExperts(), "knn3": KNNExperts(3), "same": experts}
    without = live(IAC(space, config, [0, 1]), 120)
    shadowed = live(IAC(space, replace(config, shadows=shadows), [0, 1]), 120)
    others = [live(IAC(space, replace(config, shadows={"knn3": KNNExperts(3)}), [0, 1]), 120)]
    for one, other in zip(without, shadowed, strict=True):
        for agent in (0, 1):
            assert_same(one, other, agent, agent)
        assert one.shadows == ()
        assert [shadow.name for shadow in other.shadows] == list(shadows)
        same = other.shadows[2]
        assert torch.equal(same.predictions, other.predictions)
        assert torch.equal(same.errors, other.errors)
    for step, other in zip(shadowed, others[0], strict=True):  # nor do they heed one another
        assert torch.equal(step.shadows[1].predictions, other.shadows[0].predictions)
    assert shadowed[-1].regions.min() > 0


def test_a_shadow_predicts_as_it_would_in_regions_made_for_it(space: SensorimotorSpace) -> None:
    """C2 and a random drive do not heed predictions: as main experts it lives the same run."""
    config = replace(SMALL, drive=Random())
    shadowed = live(IAC(space, replace(config, shadows={"mlp": MLPExperts()}), [0]), 60)
    main = live(IAC(space, replace(config, experts=MLPExperts()), [0]), 60)
    for step, alone in zip(shadowed, main, strict=True):
        assert torch.equal(step.actions, alone.actions)
        assert torch.equal(step.shadows[0].predictions, alone.predictions)
        assert torch.equal(step.shadows[0].errors, alone.errors)


@dataclass(frozen=True)
class Cracked(KNNExperts):
    """Nearest neighbours whose loss breaks at a decision, for one agent."""

    loss: float = math.nan
    agent: int = 1
    decision: int = 30

    def learn(  # type: ignore[override]
        self,
        examples: Examples,  # noqa: ARG002
        rows: Tensor,
        step: int,
    ) -> Tensor:
        losses = torch.zeros(len(rows))
        if step == self.decision:
            losses[self.agent] = self.loss
        return losses


@pytest.mark.parametrize("loss", [math.nan, math.inf])
@pytest.mark.parametrize("as_shadow", [False, True])
def test_a_loss_that_is_not_finite_is_named(
    space: SensorimotorSpace, loss: float, as_shadow: bool
) -> None:
    region = live(IAC(space, SMALL, [0, 1, 2]), 31)[30].regions[1].item()
    assert region > 0
    cracked = Cracked(loss=loss)
    part: dict[str, Any] = {"shadows": {"cracked": cracked}} if as_shadow else {"experts": cracked}
    agent = IAC(space, replace(SMALL, **part), [0, 1, 2])
    message = f"a loss must be finite, got {loss} in region {region} of agent 1 at decision 30"
    with pytest.raises(FloatingPointError, match=message):
        live(agent, 60)


class Breaking(nn.Module):
    """A layer that answers NaN from its 60th step of training on."""

    n_steps: Tensor

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__()
        self.layer = nn.Linear(n_inputs, n_outputs)
        self.register_buffer("n_steps", torch.tensor(0))

    def forward(self, situations: Tensor) -> Tensor:
        self.n_steps += self.training
        return torch.where(self.n_steps >= 60, math.nan, self.layer(situations))


@pytest.mark.parametrize(
    "part",
    [
        {"experts": NetworkExperts(module=Breaking)},
        {"experts": MLPExperts(learning_rate=1e30, optimizer="sgd")},
        {"experts": MLPExperts(learning_rate=1e38)},
        {"meta": MetaPredictor(learning_rate=1e30, optimizer="sgd")},
        {"improvement": ImprovementPredictor(learning_rate=1e30)},
    ],
    ids=["module", "experts by SGD", "experts by Adam", "MP", "improvement"],
)
def test_learning_that_explodes_is_stopped(space: SensorimotorSpace, part: dict[str, Any]) -> None:
    message = r"a loss must be finite, got (nan|inf) in region 0 of agent 0 at decision \d+$"
    with pytest.raises(FloatingPointError, match=message):
        live(IAC(space, replace(SMALL, **part), [0]), 20)


@dataclass(frozen=True)
class Constant:
    """A user's experts: always the same answer, and a note of what splits."""

    answer: float = 0.25

    def pool(
        self,
        situation_dim: int,  # noqa: ARG002
        outcome_dim: int,
        seeds: Sequence[int],  # noqa: ARG002
        device: torch.device,  # noqa: ARG002
    ) -> "ConstantPool":
        return ConstantPool(self.answer, outcome_dim)


class ConstantPool:
    def __init__(self, answer: float, outcome_dim: int) -> None:
        self.answer, self.outcome_dim, self.n_splits = answer, outcome_dim, 0

    def predict(self, examples: Examples, rows: Tensor, situations: Tensor) -> Tensor:  # noqa: ARG002
        return torch.full((len(rows), self.outcome_dim), self.answer)

    def learn(self, examples: Examples, rows: Tensor, step: int) -> None:
        """Learn nothing."""

    def split(self, examples: Examples, split: Split) -> None:  # noqa: ARG002
        self.n_splits += len(split.rows)


def test_experts_of_ones_own_need_no_more_than_the_protocol(space: SensorimotorSpace) -> None:
    assert isinstance(Constant(), Experts)
    agent = IAC(space, replace(SMALL, experts=Constant()), [0, 1])
    for step in live(agent, 60):
        assert step.predictions.tolist() == [[0.0], [0.0]]  # a quarter of the way from -1 to 3
        expected = (step.outcomes / 4).abs()[:, 0].tolist()
        assert step.errors.tolist() == pytest.approx(expected, abs=1e-6)
    assert isinstance(agent.experts, ConstantPool)
    assert agent.experts.n_splits == (agent.genealogy().split_step >= 0).sum() > 2


def test_a_config_as_json_holds_every_number() -> None:
    config = replace(LEARNERS, drive=Curriculum(), choice=Softmax(0.5), shadows={"knn": Constant()})
    written = config.to_json()
    assert written.keys() == {f.name for f in fields(IACConfig)}
    assert json.loads(json.dumps(written)) == written
    assert written["experts"] == {
        "kind": "MLPExperts",
        **{f.name: getattr(config.experts, f.name) for f in fields(MLPExperts)},
        "hidden": [8],
    }
    assert config.meta is not None
    assert written["meta"].keys() == {"kind"} | {f.name for f in fields(config.meta)}
    assert written["drive"]["stages"][0] == {
        "kind": "Stage",
        "dimension": "sound",
        "low": 2 / 3,
        "high": 1.0,
        "until": 1000,
    }
    assert written["choice"] == {"kind": "Softmax", "temperature": 0.5}
    assert written["shadows"] == {"knn": {"kind": f"{__name__}:Constant", "answer": 0.25}}
    assert (written["window"], written["inherit_history"]) == (8, True)
    assert SMALL.to_json()["meta"] is None


@pytest.mark.parametrize(
    ("factory", "written"),
    [
        (MLP((4, 5)), {"kind": "MLP", "hidden": [4, 5]}),
        (Breaking, {"object": f"{__name__}:Breaking"}),
        (nn.Linear, {"object": "torch.nn.modules.linear:Linear"}),
    ],
)
def test_a_users_module_is_written_by_its_name(factory: Any, written: Any) -> None:
    config = IACConfig(experts=NetworkExperts(module=factory))
    assert config.to_json()["experts"]["module"] == written
    json.dumps(config.to_json())


def test_tensors_are_answered_with_tensors(space: SensorimotorSpace) -> None:
    array, tensor = IAC(space, SMALL), IAC(space, SMALL)
    sensors = np.zeros((1, 2), np.float32)
    by_array, by_tensor = array.act(sensors), tensor.act(torch.zeros(1, 2))
    assert isinstance(by_array, np.ndarray)
    assert isinstance(by_tensor, torch.Tensor)
    assert by_array.tolist() == by_tensor.tolist()


def test_what_the_world_does_to_its_buffer_changes_nothing(space: SensorimotorSpace) -> None:
    agent = IAC(space, SMALL)
    sensors = np.full((1, 2), 0.5, np.float32)
    agent.act(sensors)
    sensors[:] = 1.5
    step = agent.observe(sensors)
    assert step.sensors.tolist() == [[0.5, 0.5]]
    sensors[:] = 0.0
    assert step.outcomes.tolist() == [[1.5]]


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        ([[np.nan, 0.0]], r"near must lie in \[0, 2\], got nan from agent 0"),
        ([[0.0, 3.5]], r"far must lie in \[-1, 3\], got 3.5 from agent 0"),
        ([[0.0]], r"sensors must have the shape \(agents, sensors\) = \(1, 2\), got \(1, 1\)"),
    ],
)
def test_bad_sensors_are_refused_and_nothing_is_lost(
    space: SensorimotorSpace, sensors: list[list[float]], message: str
) -> None:
    agent = IAC(space, SMALL)
    good, bad = np.zeros((1, 2), np.float32), np.array(sensors, np.float32)
    with pytest.raises(ValueError, match=message):
        agent.act(bad)
    agent.act(good)
    with pytest.raises(ValueError, match=message):
        agent.observe(bad)
    assert agent.observe(good).number == 0


def test_observing_needs_an_action_first(space: SensorimotorSpace) -> None:
    agent = IAC(space, SMALL)
    with pytest.raises(
        RuntimeError, match="needs an action to learn from: call act first, or set_actions"
    ):
        agent.observe(np.zeros((1, 2), np.float32))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"epsilon": 1.3}, r"epsilon must lie in \[0, 1\], got 1.3"),
        ({"balance": 0.6}, r"balance must lie in \[0, 0.5\], got 0.6"),
        ({"epsilon": float("nan")}, r"epsilon must lie in \[0, 1\], got nan"),
        ({"n_candidates": 0}, "n_candidates must be at least 1, got 0"),
        ({"max_examples": 1}, "max_examples must be at least 2, got 1"),
        ({"window": 0}, "window must be at least 1, got 0"),
        ({"delay": -3}, "delay must be at least 1, got -3"),
        ({"error": "cubic"}, "error must be absolute or squared, got cubic"),
    ],
)
def test_numbers_out_of_range_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        IACConfig(**values)


def test_agents_need_seeds_and_a_device_that_is_there(space: SensorimotorSpace) -> None:
    with pytest.raises(ValueError, match="seeds must name at least one agent, got none"):
        IAC(space, SMALL, seeds=[])
    with pytest.raises(ValueError, match="device must be"):
        IAC(space, SMALL, device="abacus")
    if not torch.cuda.is_available():
        with pytest.raises(ValueError, match="device must be one that this machine has"):
            IAC(space, SMALL, device="cuda")


def test_on_a_gpu_bad_sensors_are_refused_when_the_decision_ends(space: SensorimotorSpace) -> None:
    good, bad = torch.zeros(1, 2), torch.tensor([[0.0, 3.5]])
    for before, after in ((bad, good), (good, bad)):
        agent = IAC(space, SMALL)
        agent._asks_late = True
        agent.act(before)
        with pytest.raises(ValueError, match=r"far must lie in \[-1, 3\], got 3.5"):
            agent.observe(after)
