from fractions import Fraction

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import oracle
from torch_iac import IAC, Dimension, IACConfig, SensorimotorSpace
from torch_iac.internal.scaling import UNIT_STEP
from torch_iac.regions.cuts import Cut, best_cut
from torch_iac.regions.tree import COMPACT_FROM, NONE, RegionTree

CPU = torch.device("cpu")


def check_against_brute_force(
    situations: list[list[float]], outcomes: list[list[float]], balance: float
) -> None:
    cut = best_cut(torch.tensor([situations]), torch.tensor([outcomes]), balance)
    expected = oracle.best_cut(list(zip(situations, outcomes, strict=True)), balance)
    found = (int(cut.dimension), float(cut.value)) if cut.found else None
    assert found == expected


@st.composite
def examples(draw: st.DrawFn) -> tuple[list[list[float]], list[list[float]]]:
    """Situations and outcomes on grids from coarse (many ties) to the finest."""
    n, d, k = draw(st.integers(2, 12)), draw(st.integers(1, 3)), draw(st.integers(1, 2))
    grids = st.sampled_from([1, 3, 17, 2**23])
    x_steps, y_steps = draw(grids), draw(grids)

    def table(width: int, steps: int) -> list[list[float]]:
        unit = 1 / UNIT_STEP
        values = st.integers(0, steps).map(lambda i: (i * unit // steps) * UNIT_STEP)
        return draw(
            st.lists(st.lists(values, min_size=width, max_size=width), min_size=n, max_size=n)
        )

    return table(d, x_steps), table(k, y_steps)


@given(examples(), st.sampled_from([0.0, 0.15, 0.3, 0.5]))
@settings(max_examples=400)
def test_the_best_cut_is_that_of_brute_force(
    data: tuple[list[list[float]], list[list[float]]], balance: float
) -> None:
    check_against_brute_force(*data, balance)


@pytest.mark.parametrize("kind", ["random", "tied", "constant", "mirrored", "tiny"])
@pytest.mark.parametrize("seed", range(3))
def test_the_best_cut_of_a_full_region_is_that_of_brute_force(kind: str, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    situations = torch.rand(251, 4, generator=generator).div(UNIT_STEP).round() * UNIT_STEP
    outcomes = torch.rand(251, 1, generator=generator).div(UNIT_STEP).round() * UNIT_STEP
    if kind == "tied":
        situations, outcomes = (situations * 4).round() / 4, outcomes.round()
    if kind == "constant":
        outcomes = torch.full_like(outcomes, 0.3).div(UNIT_STEP).round() * UNIT_STEP
    if kind == "mirrored":  # every cut of one dimension parts the examples like one of another
        situations[:, 1], situations[:, 3] = 1 - situations[:, 0], situations[:, 0]
    if kind == "tiny":  # neighbours one step apart, outcomes that hardly differ
        situations[:, 2] = torch.arange(251) * UNIT_STEP + 0.75
        outcomes = 0.5 + (outcomes * 3).round() * UNIT_STEP
    check_against_brute_force(situations.tolist(), outcomes.tolist(), 0.15)


def test_a_known_cut() -> None:
    situations = [[0.0, 0.0], [0.25, 1.0], [0.5, 0.0], [0.75, 1.0]]
    cut = best_cut(torch.tensor([situations]), torch.tensor([[[0.0], [0], [0.5], [1]]]), 0.25)
    assert (cut.found.item(), cut.dimension.item(), cut.value.item()) == (True, 0, 0.375)
    assert oracle.squared_deviations([[0], [0]]) + oracle.squared_deviations(
        [[4], [8]]
    ) == Fraction(8)


def test_equal_situations_cannot_be_cut() -> None:
    cut = best_cut(torch.zeros(1, 5, 2), torch.rand(1, 5, 1), 0.0)
    assert not cut.found


def test_several_regions_are_cut_as_each_alone() -> None:
    generator = torch.Generator().manual_seed(0)
    situations, outcomes = (torch.rand(7, 30, n, generator=generator) for n in (3, 2))
    together = best_cut(situations, outcomes, 0.15)
    for i in range(7):
        alone = best_cut(situations[i : i + 1], outcomes[i : i + 1], 0.15)
        assert alone.dimension[0] == together.dimension[i]
        assert alone.value[0] == together.value[i]


def test_balance_outside_its_range_is_refused() -> None:
    with pytest.raises(ValueError, match=r"balance must lie in \[0, 0.5\], got 0.6"):
        best_cut(torch.zeros(1, 5, 2), torch.zeros(1, 5, 1), 0.6)


def grow(n_agents: int, n_splits: int, situation_dim: int, seed: int) -> RegionTree:
    """Trees whose leaves are split at random, at random places inside their boxes."""
    generator = torch.Generator().manual_seed(seed)
    tree = RegionTree(n_agents, CPU)
    for step in range(n_splits):
        leaves = tree.leaves()
        chosen = torch.randperm(len(leaves), generator=generator)
        nodes = leaves[chosen]
        first_of_agent = torch.stack(
            [nodes[tree.agent[nodes] == agent][0] for agent in range(n_agents)]
        )
        nodes = first_of_agent[torch.rand(n_agents, generator=generator) < 0.7]
        if not len(nodes):
            continue
        lows, highs = (bounds[nodes] for bounds in tree.boxes(situation_dim))
        dimension = torch.randint(situation_dim, (len(nodes),), generator=generator)
        share = 0.2 + 0.6 * torch.rand(len(nodes), generator=generator)
        low, high = (b.gather(1, dimension[:, None])[:, 0] for b in (lows, highs))
        cut = Cut(torch.ones(len(nodes), dtype=torch.bool), dimension, low + share * (high - low))
        tree.split(nodes, cut, torch.full((len(nodes),), 250), step)
    return tree


@pytest.mark.parametrize("n_situations", [200, COMPACT_FROM])
@pytest.mark.parametrize("seed", range(5))
def test_every_situation_is_in_the_box_of_its_leaf_and_in_no_other(
    seed: int, n_situations: int
) -> None:
    tree = grow(n_agents=3, n_splits=80, situation_dim=2, seed=seed)
    situations = torch.rand(3, n_situations, 2, generator=torch.Generator().manual_seed(seed))
    routed = tree.route(situations)
    leaves = tree.leaves()
    lows, highs = (bounds[leaves] for bounds in tree.boxes(2))
    points = situations[:, :, None]
    inside = ((points > lows) | (lows == 0)) & (points <= highs)  # (A, C, leaves, D)
    inside = inside.all(-1) & (tree.agent[leaves] == torch.arange(3)[:, None, None])
    assert (inside.sum(-1) == 1).all()
    assert torch.equal(leaves[inside.to(torch.int8).argmax(-1)], routed)


def test_a_value_on_the_cut_goes_left() -> None:
    tree = RegionTree(1, CPU)
    half = Cut(torch.tensor([True]), torch.tensor([0]), torch.tensor([0.5]))
    tree.split(torch.tensor([0]), half, torch.tensor([251]), 7)
    situations = torch.tensor([[[0.5, 0.9], [0.5 + UNIT_STEP, 0.1]]])
    assert tree.region[tree.route(situations)].tolist() == [[1, 2]]


@pytest.mark.parametrize("direction", [0, 1])
def test_a_deep_chain_of_cuts_routes_like_the_cuts_one_by_one(direction: int) -> None:
    tree = RegionTree(1, CPU)
    values = [0.5 ** (i + 1) for i in range(20)]
    for step, value in enumerate(values):
        at = value if direction == 0 else 1 - value
        leaf = tree.route(torch.tensor([[[0.0 if direction == 0 else 1.0]]]))[0]
        cut = Cut(torch.tensor([True]), torch.tensor([0]), torch.tensor([at]))
        tree.split(leaf, cut, torch.tensor([251]), step)
    for i, value in enumerate(values[:-1]):
        inside = value * 0.75
        point = inside if direction == 0 else 1 - inside
        leaf = tree.route(torch.tensor([[[point]]]))[0, 0]
        assert tree.depth[leaf] == i + 2


def test_the_genealogy_tells_how_each_region_came_about() -> None:
    tree = RegionTree(2, CPU)
    cut = Cut(torch.tensor([True]), torch.tensor([1]), torch.tensor([0.25]))
    tree.split(torch.tensor([1]), cut, torch.tensor([251]), 250)
    genealogy = tree.genealogy(counts=torch.tensor([7, 100, 151]))
    assert genealogy.agent.tolist() == [0, 1, 1, 1]
    assert genealogy.region.tolist() == [0, 0, 1, 2]
    assert genealogy.parent.tolist() == [NONE, NONE, 0, 0]
    assert genealogy.depth.tolist() == [0, 0, 1, 1]
    assert genealogy.born_step.tolist() == [0, 0, 250, 250]
    assert genealogy.split_step.tolist() == [NONE, 250, NONE, NONE]
    assert genealogy.cut_dimension.tolist() == [NONE, 1, NONE, NONE]
    assert genealogy.cut_value.nan_to_num(-1).tolist() == [-1, 0.25, -1, -1]
    assert genealogy.n_examples.tolist() == [7, 251, 100, 151]


@given(
    st.integers(1, 3),  # dimensions
    st.sampled_from([1, 2, 7, 2**23]),  # how fine the grid is on which situations lie
    st.sampled_from([0.0, 0.15, 0.5]),
    st.integers(2, 12),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=60)
def test_whatever_is_cut_leaves_part_the_cube_and_hold_their_own_examples(
    dim: int, steps: int, balance: float, max_examples: int, seed: int
) -> None:
    """Ties and duplicates included: a life of random examples on a grid, looked at in the end."""
    actions = tuple(Dimension(f"a{i}", 0.0, 1.0) for i in range(dim))
    sensor = Dimension("s", 0.0, 1.0)
    space = SensorimotorSpace(actions, (sensor,), (sensor,))
    config = IACConfig(n_candidates=1, max_examples=max_examples, balance=balance)
    agent = IAC(space, config, [seed, seed + 1])
    numbers = torch.Generator().manual_seed(seed)
    for _ in range(120):
        sensors = torch.randint(steps + 1, (2, 1), generator=numbers) / steps
        agent.act(sensors)
        agent.observe((sensors * 3) % 1)
    tree, leaves = agent.tree, agent.tree.leaves()
    lows, highs = (bounds[leaves].double() for bounds in tree.boxes(dim + 1))
    volumes = (highs - lows).prod(dim=1)
    for number in range(2):  # the leaves of each agent fill the cube
        assert volumes[tree.agent[leaves] == number].sum().item() == pytest.approx(1.0)
    for leaf, low, high in zip(leaves, lows, highs, strict=True):
        row, owner = tree.rows[leaf], int(tree.agent[leaf])
        held = agent.examples.situations[row, :, : agent.examples.counts[row]].T  # (n, D)
        assert len(held) <= max_examples
        assert (((held > low) | (low == 0)) & (held <= high)).all()
        if len(held):
            asked = held.expand(2, *held.shape)
            assert (tree.route(asked)[owner] == leaf).all()
    assert int(agent.examples.counts[: tree.n_rows].sum()) <= 2 * 120
