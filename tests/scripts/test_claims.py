"""How the papers' claims are judged: known answers."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from scripts.studies import claims
from scripts.studies.claims import (
    CLAIMS,
    Claim,
    catching_up,
    gaps,
    in_order,
    last_error,
    nearest,
    plateaus,
    ratio,
)
from tests.synthetic_run import write_run
from torch_iac.analysis.generalisation import F2, TESTS, Transitions
from torch_iac.analysis.intervals import Estimate
from torch_iac.internal.files import write_table
from torch_iac.runs.reader import Run, load_run


def claim(better: Any, bar: float, lesser: float) -> Claim:
    nothing = Estimate(0, 0, 0, 0)
    return Claim(2004, "it does", "somehow", lambda _: nothing, better, bar, lesser)


@pytest.mark.parametrize(
    ("better", "low", "high", "verdict"),
    [
        ("higher", 0.86, 1.0, "reproduced"),
        ("higher", 0.8, 1.0, "partly"),
        ("higher", 0.4, 1.0, "not"),
        ("lower", 0.1, 0.3, "reproduced"),
        ("lower", 0.1, 0.4, "partly"),
        ("lower", 0.1, 0.7, "not"),
    ],
)
def test_a_verdict_asks_the_whole_interval(
    better: str, low: float, high: float, verdict: str
) -> None:
    bars = {"higher": (0.85, 0.5), "lower": (0.35, 0.5)}[better]
    assert claim(better, *bars).verdict(Estimate((low + high) / 2, low, high, 10)) == verdict


def test_equal_errors_bear_out_neither_side() -> None:
    same = ratio(np.array([1.0, 2.0]), np.array([1.0, 2.0]))
    assert (same.value, same.low, same.high) == (1, 1, 1)
    assert claim("lower", 1.0, 1.0).verdict(same) == "not"


def test_a_ratio_is_paired_and_geometric() -> None:
    found = ratio(np.array([1.0, 400.0]), np.array([2.0, 200.0]))
    assert found.value == pytest.approx(1.0)
    # Of two logarithms, -0.69 and 0.69, Student's interval has a half width of 12.7 times 0.69.
    assert found.low == pytest.approx(2**-12.706, rel=1e-3)
    assert found.high == pytest.approx(2**12.706, rel=1e-3)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    """Made-up robots, which hear f3 first, then f2."""
    return [load_run(write_run(tmp_path_factory.mktemp("run"), 2, 3000))]


def test_made_up_robots_develop(runs: Sequence[Run]) -> None:
    assert in_order(runs).all()
    assert (claims.cut_steps(runs, 0) == claims.NS).all()
    assert np.allclose(claims.cuts_on_sound(runs, 0), 2 / 3, atol=1e-5)
    assert (claims.cut_steps(runs, 1) > claims.NS).all()


def test_a_robot_that_never_split_has_no_cut(tmp_path: Path) -> None:
    young = [load_run(write_run(tmp_path, 2, claims.NS))]
    assert np.isnan(claims.cut_steps(young, 0)).all()
    assert np.isnan(claims.cuts_on_sound(young, 0)).all()


def write_tests(run: Run, absolute: Sequence[float], squared: Sequence[float]) -> None:
    rows = [
        {"step": 100 * (i + 1), "seed": seed, "set": "met", "absolute": a, "squared": s}
        for i, (a, s) in enumerate(zip(absolute, squared, strict=True))
        for seed in reversed(run.seeds)
    ]
    (run.folder / TESTS).mkdir()
    write_table(run.folder / TESTS / "test-000000000000.parquet", pa.Table.from_pylist(rows))


def test_errors_fall_to_a_plateau(tmp_path: Path) -> None:
    run = load_run(write_run(tmp_path, 2, 300))
    errors = [1.0, 0.5, 0.2, *[0.1] * 7]
    write_tests(run, errors, errors)
    assert last_error([run], "met").tolist() == pytest.approx([0.1, 0.1])
    assert plateaus([run]).tolist() == [400, 400]
    assert catching_up([run], [run], "met").tolist() == [400, 400]


class Wheels:
    """A run of which only the wheels in f2 are known."""

    def __init__(self, cells: np.ndarray) -> None:
        self.seeds = (0,)
        middles = (np.stack([cells // 4, cells % 4]) + 0.5) / 4 * 2 - 1
        self._table = pa.table(
            {
                "action/left_wheel": middles[0],
                "action/right_wheel": middles[1],
                "zone": np.ones(len(cells), int),
                "random_action": np.zeros(len(cells), bool),
            }
        )

    def table(self, columns: Sequence[str], agent: int) -> pa.Table:
        assert agent == 0
        return self._table.select(list(columns))


def test_time_explains_wheels_that_take_turns_and_none_at_random() -> None:
    in_turn = Wheels(np.repeat(np.arange(16), 100))
    at_random = Wheels(np.random.default_rng(0).integers(0, 16, 1600))
    assert claims._organisation(in_turn, 0) > 0.9  # type: ignore[arg-type]
    assert abs(claims._organisation(at_random, 0)) < 0.01  # type: ignore[arg-type]


def test_every_claim_says_where_it_stands() -> None:
    assert len({(each.says, each.measured) for each in CLAIMS}) == len(CLAIMS)
    for each in CLAIMS:
        assert each.bars.startswith(("above", "below"))


def test_what_a_robot_did_in_f2_leaves_no_gap(tmp_path: Path) -> None:
    run = load_run(write_run(tmp_path / "run"))
    there = np.equal(run.column("zone")[:, 0], F2)
    columns = [run.column(name)[there, 0] for name in run.situation_columns]
    wheel, sound, beam, distance = (np.asarray(column, np.float32) for column in columns)
    outcome = np.asarray(run.column("outcome/toy_distance")[there], np.float32)
    # A beam and the sound decide nothing in f2.
    elsewhere = Transitions(np.c_[wheel, sound * 0], np.c_[beam * 0, distance], outcome)
    distances, errors = nearest(run, elsewhere)
    assert distances.shape == errors.shape == (1, there.sum())
    assert distances.max() == pytest.approx(0, abs=1e-6)
    assert gaps([run], elsewhere) == pytest.approx(0, abs=1e-6)
    farther = Transitions(np.c_[wheel * 0 + 1.5, sound], np.c_[beam, distance], outcome)
    assert gaps([run], farther) > 0.25  # the wheel's range is 2 wide
