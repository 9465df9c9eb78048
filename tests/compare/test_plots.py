"""Pictures of a comparison can be read, in grey too."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.pictures import alike_in_grey, cut_off, looks_of, overlapping
from torch_iac.analysis.intervals import Estimate
from torch_iac.compare.plots import Curves, draw_errors, draw_improvements, draw_shares

ZONES = ("f1", "f2", "f3")
N_WINDOWS, N_SEEDS = 12, 3


def curves(n_variants: int, names: str = "variant {}") -> dict[str, Curves]:
    rng = np.random.default_rng(0)
    return {
        names.format(place): Curves(
            ZONES,
            250,
            rng.dirichlet(np.ones(3), (N_WINDOWS, N_SEEDS)),
            0.01 + rng.random((N_WINDOWS, N_SEEDS, 4)),
        )
        for place in range(n_variants)
    }


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.axes[-1].texts]


@pytest.mark.parametrize("n_variants", [1, 4, 8])
def test_lines_of_variants_can_be_told_apart(n_variants: int) -> None:
    for draw in (draw_shares, draw_errors):
        figure = draw(curves(n_variants))
        assert texts(figure) == [f"variant {place}" for place in range(n_variants)]
        assert not figure.legends
        assert overlapping(figure) == []
        assert cut_off(figure) == []
        looks = looks_of(figure)
        assert len(looks) == n_variants
        assert alike_in_grey(looks) == []


def test_long_names_are_in_a_legend() -> None:
    figure = draw_errors(curves(5, "a variant with a longer name, {}"))
    assert not texts(figure)
    assert len(figure.legends[0].get_texts()) == 5
    assert overlapping(figure) == []
    assert cut_off(figure) == []


def test_probabilities_of_improvement_do_not_overlap() -> None:
    found = {f"progress over variant {place}": Estimate(0.6, 0.4, 0.8, 9) for place in range(4)}
    figure = draw_improvements(dict.fromkeys(("error in f1", "error in f2", "regions"), found))
    assert overlapping(figure) == []
    assert cut_off(figure) == []
