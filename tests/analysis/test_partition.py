"""How a space was divided, at any time of a run."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.synthetic_run import SPACE, write_run
from torch_iac.analysis.partition import Partition, partition_of, situation_at
from torch_iac.runs.reader import Run, load_run

N_AGENTS, N_DECISIONS = 2, 1600


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of two agents, which cut along the sound first and then along the left wheel."""
    return load_run(write_run(tmp_path_factory.mktemp("run"), N_AGENTS, N_DECISIONS))


def volumes(partition: Partition) -> np.ndarray:
    return np.asarray(np.prod(partition.highs - partition.lows, axis=1))


def test_at_first_one_region_is_all(run: Run) -> None:
    partition = partition_of(run, step=0)
    assert partition.regions.tolist() == [0]
    assert partition.progress.tolist() == [0.0]
    assert partition.lows.tolist() == [[-1.0, 0.0, 0.0, 0.0]]
    assert partition.highs.tolist() == [[1.0, 1.0, 4.0, 5.0]]


def test_the_decision_that_splits_a_region_is_the_last_that_finds_it_whole(run: Run) -> None:
    split = run.family()["split_step"][0].as_py()
    assert partition_of(run, split).regions.tolist() == [0]
    assert partition_of(run, split + 1).regions.tolist() == [1, 2]


def test_what_is_below_the_cut_is_the_first_childs(run: Run) -> None:
    partition = partition_of(run, run.family()["split_step"][0].as_py() + 1)
    lows, highs = partition.sides("sound")
    assert_allclose(lows, [0, 2 / 3])
    assert_allclose(highs, [2 / 3, 1])
    assert [side.tolist() for side in partition.sides("left_wheel")] == [[-1, -1], [1, 1]]


@pytest.mark.parametrize("step", [0, 300, 900, None])
def test_leaves_fill_the_space(run: Run, step: int | None) -> None:
    assert volumes(partition_of(run, step, agent=1)).sum() == pytest.approx(2 * 1 * 4 * 5)


@pytest.mark.parametrize("agent", range(N_AGENTS))
def test_every_decision_was_made_in_the_leaf_that_holds_it(run: Run, agent: int) -> None:
    regions, progress = run.column("region")[:, agent], run.column("progress")[:, agent]
    for step in range(0, N_DECISIONS, 23):
        found = partition_of(run, step, agent).through(situation_at(run, step, agent))
        assert found.regions.tolist() == [regions[step]]
        assert found.progress == pytest.approx(progress[step], abs=1e-12)


def test_some_leaf_has_progress_to_compare(run: Run) -> None:
    assert (run.column("progress") != 0).mean() > 0.3


def test_rectangles_fill_the_plane(run: Run) -> None:
    partition = partition_of(run).through({"beam": 1.0, "toy_distance": 2.0})
    lows, highs = (
        np.stack(sides, axis=1)
        for sides in zip(partition.sides("sound"), partition.sides("left_wheel"), strict=True)
    )
    assert len(partition.regions) > 3
    assert np.prod(highs - lows, axis=1).sum() == pytest.approx(1 * 2)


def test_a_cut_goes_to_the_lower_box_and_the_lowest_value_to_the_lowest(run: Run) -> None:
    partition = partition_of(run, run.family()["split_step"][0].as_py() + 1)
    cut = run.family()["cut_value"][0].as_py()
    for value, leaf in [(0.0, 1), (cut, 1), (np.nextafter(cut, 1), 2), (1.0, 2)]:
        assert partition.through({"sound": value}).regions.tolist() == [leaf]


def test_robots_that_inherit_nothing_know_the_progress_of_their_own_errors(tmp_path: Path) -> None:
    numbers = {"window": 20, "delay": 10, "inherit_history": False}
    run = load_run(write_run(tmp_path, n_decisions=900, numbers=numbers))
    partition = partition_of(run)
    errors, regions = run.column("error")[:, 0], run.column("region")[:, 0]
    for leaf, progress in zip(partition.regions, partition.progress, strict=True):
        own = errors[regions == leaf]
        last = own[-30:-10].mean() - own[-20:].mean() if len(own) >= 30 else 0.0
        assert progress == pytest.approx(last)
    assert (partition.progress != 0).any()


def test_a_situation_has_its_names(run: Run) -> None:
    situation = situation_at(run, 7, agent=1)
    assert tuple(situation) == SPACE.situation_names
    assert situation["sound"] == run.column("action/sound")[7, 1]


def test_what_is_not_there_is_named(run: Run) -> None:
    partition = partition_of(run)
    with pytest.raises(ValueError, match=r"a dimension must be one of left_wheel, .*, got smell"):
        partition.sides("smell")
    with pytest.raises(ValueError, match=r"sound must lie in \[0, 1\], got 1.3"):
        partition.through({"sound": 1.3})
    with pytest.raises(ValueError, match=r"step must lie in \[0, 1600\], got 1601"):
        partition_of(run, 1601)
    with pytest.raises(ValueError, match=r"step must lie in \[0, 1600\), got 1600"):
        situation_at(run, 1600)
    with pytest.raises(ValueError, match=r"agent must lie in \[0, 2\), got 2"):
        partition_of(run, agent=2)
