"""Which regions have curves in TensorBoard, and what they are called."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.synthetic_run import SPACE, ZONES
from torch_iac.runs.followed_regions import N_FOLLOWED, Family, Followed, Visits

Lives = list[list[tuple[int, int]]]
"""For each log, cuts (which leaf) and visits (which leaf), as numbers to be taken modulo."""

LIVES = st.lists(st.lists(st.tuples(st.integers(0, 99), st.integers(0, 99)), max_size=30))


class Tree:
    """A family that grows."""

    def __init__(self) -> None:
        self.parents, self.dimensions, self.values = [-1], [-1], [np.nan]
        self.leaves = [0]

    def cut(self, region: int, dimension: int = 1, value: float = 0.5) -> None:
        self.leaves.remove(region)
        self.dimensions[region], self.values[region] = dimension, value
        self.leaves += [len(self.parents), len(self.parents) + 1]
        self.parents += [region, region]
        self.dimensions += [-1, -1]
        self.values += [np.nan, np.nan]

    def family(self) -> Family:
        leaves = np.array(sorted(self.leaves))
        return Family(self.parents, leaves, np.array(self.dimensions), np.array(self.values))


def visit(visits: Visits, regions: list[int], zones: list[int]) -> None:
    visits.add(np.array(regions, np.int32), np.array(zones, np.int8))


def test_a_name_says_number_zone_cut_and_parent() -> None:
    tree, visits, followed = Tree(), Visits(3), Followed(SPACE, ZONES)
    visit(visits, [0, 0, 0], [0, 1, 2])
    assert followed.choose(tree.family(), visits) == [0]
    tree.cut(0, dimension=1, value=2 / 3)
    tree.cut(2, dimension=0, value=0.75)
    visit(visits, [1] * 3 + [3] * 2 + [4], [1, 0, 1, 2, 2, 0])
    assert followed.choose(tree.family(), visits) == [1, 3, 4]
    assert followed.names == {
        0: "region 0",
        1: "region 1 f2: sound <= 0.667, of 0",
        3: "region 3 f3: left_wheel <= 0.5, of 2",
        4: "region 4 f1: left_wheel > 0.5, of 2",
    }


def test_a_region_of_several_zones_is_in_none() -> None:
    visits = Visits(2)
    visit(visits, [0, 0, 0, 1, 1, 3], [0, 1, 0, 1, 0, 1])
    assert visits.zones(6).tolist() == [0, -1, -1, 1, -1, -1]
    assert visits.totals(6).tolist() == [3, 2, 0, 1, 0, 0]
    assert Visits(0).zones(2).tolist() == [-1, -1]


@given(LIVES)
def test_those_with_curves_are_the_most_visited_and_stay_while_they_are_visited(
    lives: Lives,
) -> None:
    tree, visits, followed = Tree(), Visits(0), Followed(SPACE, ())
    resumed = Followed(SPACE, ())
    for log in lives:
        before, recent = list(followed.present), dict.fromkeys(range(1000), 0)
        for cut, place in log:
            if cut % 3 == 0:
                tree.cut(tree.leaves[cut % len(tree.leaves)])
            region = tree.leaves[place % len(tree.leaves)]
            recent[region] += 1
            visits.add(np.array([region], np.int32), None)
        followed.choose(tree.family(), visits)
        resumed.choose(tree.family(), visits)
        present = followed.present
        stay = [region for region in before if region in tree.leaves and recent[region]]
        visited = [region for region in tree.leaves if recent[region]]
        assert present[: len(stay)] == stay
        assert len(present) == min(N_FOLLOWED, len(visited))
        assert set(present) <= set(visited)
        least = min((recent[region] for region in present[len(stay) :]), default=0)
        assert all(recent[region] <= least for region in visited if region not in present) or (
            len(present) == len(stay)
        )
        assert set(present) <= set(followed.names)
        state, resumed = resumed.state(), Followed(SPACE, ())
        resumed.load_state(state)
        assert (resumed.present, resumed.names) == (present, followed.names)
