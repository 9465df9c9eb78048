"""What a user sees of runs and comparisons in a real TensorBoard, in a real browser."""

from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from playwright.sync_api import Page, expect

from scripts.docs.draw_tensorboard import CHART, PATIENCE, browse, find_browser, open_tab, serve
from tests.synthetic_run import ZONES, write_run
from torch_iac import Experiment, IACConfig
from torch_iac.compare.plan import Comparison, Variant
from torch_iac.compare.report import save_report
from torch_iac.runs.tensorboard_images import MAP_PIXELS

BROWSER = find_browser()
N_RUNS = 3
N_MEASURES_SHOWN = 5
"""HParams hides columns beyond these until they are ticked."""

pytestmark = [
    pytest.mark.skipif(BROWSER is None, reason="neither Chromium nor Chrome is installed"),
    pytest.mark.xdist_group("tensorboard"),  # one server and one browser for all
]

TABLE = """cells => {
  const rows = new Map();
  for (const cell of cells) {
    const place = cell.assignedSlot?.closest("th, td");
    const row = place?.closest("tr");
    if (!row || row.hidden) continue;
    if (!rows.has(row)) rows.set(row, []);
    rows.get(row)[place.cellIndex] = cell.innerText.trim();
  }
  return [...rows.values()];
}"""
"""Puts the cells of a grid, which are beside each other in the page, into their rows."""


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    """Two variants with a made-up run each, beside one run of somebody else's."""
    folder = tmp_path_factory.mktemp("runs")
    write_run(folder / "alone", shadows={"mlp": 2.0}, meta=True)
    narrow = Experiment(config=IACConfig(window=75))
    variants = (Variant("wide", Experiment()), Variant("narrow", narrow, ("--window", "75")))
    comparison = Comparison(folder / "windows", variants, n_seeds=1)
    for job in comparison.jobs():
        write_run(job.folder, numbers={"window": 75 if job.variant == "narrow" else 150})
    save_report(comparison)
    return comparison


@pytest.fixture(scope="module")
def page(comparison: Comparison) -> Iterator[Page]:
    """TensorBoard's first page, in a window high enough for what is open on it."""
    assert BROWSER is not None
    expect.set_options(timeout=PATIENCE)
    with (
        serve(comparison.folder.parent) as address,
        browse(address, BROWSER, width=1600, height=3000) as page,
    ):
        yield page


def test_the_first_page_begins_with_what_robots_do_and_how_well_they_predict(page: Page) -> None:
    groups = page.locator("metrics-card-groups .card-group")
    expect(groups.locator(".group-title")).to_have_text(
        [
            "development",
            "error",
            "measures",
            "mp_calibration",
            "progress",
            "region_error",
            "region_progress",
            "top_progress",
        ]
    )
    time = [f"development/time_in_{name}" for name in ZONES]
    maps = ["development/map"] * N_RUNS
    titles = "tb-truncated-path"
    expect(groups.nth(0).locator(titles)).to_have_text([*maps, "development/n_regions", *time])
    expect(groups.nth(1).locator(titles)).to_have_text(
        ["error/expected", "error/mean", "error/mlp"]
    )
    expect(groups.nth(2).locator(titles)).to_have_count(0)  # closed, as are those below


def test_the_map_is_there_to_look_at(page: Page) -> None:
    height, width = MAP_PIXELS
    pictures = page.locator("image-card img")
    expect(pictures).to_have_count(N_RUNS)
    for picture in pictures.all():
        expect(picture).to_have_js_property("naturalWidth", width)
        expect(picture).to_have_js_property("naturalHeight", height)


def test_custom_scalars_are_four_charts_with_all_their_curves(page: Page) -> None:
    open_tab(page, "custom_scalars")
    charts = page.locator(CHART)
    expect(charts.locator("[itemprop=name]")).to_have_text(
        [
            "Share of time in each zone",
            "Learning progress of the best regions",
            "Prediction errors: the experts, what MP expected of them, their shadows",
            "Number of regions",
        ]
    )
    for place, n_curves in ((0, len(ZONES) * N_RUNS), (2, N_RUNS + 2), (3, N_RUNS)):
        expect(charts.nth(place).get_by_text(f"Matches ({n_curves})")).to_be_visible()


def test_images_are_the_map_and_the_calibration(page: Page) -> None:
    open_tab(page, "images")
    board = page.locator("tf-image-dashboard")
    expect(board.locator(".category-name")).to_have_text(["development", "mp_calibration"])
    board.locator("button.heading", has_text="mp_calibration").click()
    expect(board.locator("tf-image-loader [itemprop=name]")).to_have_text(
        ["development/map"] * N_RUNS + ["mp_calibration/deciles"]
    )
    expect(board.locator("tf-image-loader [itemprop=run]")).to_have_text(
        ["alone", "windows/narrow/seed-000", "windows/wide/seed-000", "alone"]
    )


def test_hparams_have_a_row_a_run_and_a_column_a_setting_or_measure(
    page: Page, comparison: Comparison
) -> None:
    open_tab(page, "hparams")
    grid = page.locator("tf-hparams-table-view")
    expect(grid.get_by_text("windows/narrow/seed-000")).to_be_visible()
    head, *rows = grid.locator("vaadin-grid-cell-content").evaluate_all(TABLE)
    settings = ["seed", "variant", "window"]
    measures = pq.read_table(Path(comparison.folder) / "measures.parquet").to_pylist()
    names = [name for name in measures[0] if "/" in name or name in ("error", "n_regions")]
    names = names[:N_MEASURES_SHOWN]
    assert head == ["Trial ID", "Show Metrics", *settings, *names]
    shown = {row[0]: dict(zip(head, row, strict=False)) for row in rows}
    assert list(shown) == ["windows/narrow/seed-000", "windows/wide/seed-000"]
    for of in measures:
        cells = shown[f"windows/{of['variant']}/seed-000"]
        assert cells["variant"] == of["variant"]
        assert cells["seed"] == str(of["seed"])
        assert float(cells["window"]) == (75 if of["variant"] == "narrow" else 150)
        for name in names:
            assert float(cells[name]) == pytest.approx(of[name], rel=1e-3), name
