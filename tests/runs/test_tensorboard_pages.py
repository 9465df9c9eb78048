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
from torch_iac.runs.charts import SIZE

BROWSER = find_browser()
N_RUNS = 3
VIEWS = ("figure_2", "figure_3", "map", "progress")
CARDS_A_PAGE = 12
"""TensorBoard shows so many cards of a group at once."""
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
        browse(address, BROWSER, width=1600, height=4500) as page,
    ):
        yield page


def test_the_first_page_begins_with_what_robots_do_and_where_they_learn(page: Page) -> None:
    groups = page.locator("metrics-card-groups .card-group")
    expect(groups.locator(".group-title")).to_have_text(
        [
            "development",
            "learning_progress",
            "measures",
            "mp_calibration",
            "prediction_error",
        ]
    )
    time = [f"development/time_in_{name}" for name in ZONES]
    views = [f"development/view_{what}" for what in VIEWS for _ in range(N_RUNS)]
    titles = "tb-truncated-path"
    cards = ["development/n_regions", *time, *views]
    expect(groups.nth(0).locator(titles)).to_have_text(cards[:CARDS_A_PAGE])
    progress = [f"learning_progress/{of}" for of in ("best", "in_f1", "in_f2", "in_f3", "mean")]
    regions = [
        "learning_progress/region 0",
        "learning_progress/region 1 f2: sound <= 0.667, of 0",
        "learning_progress/region 3 f3: left_wheel <= 0, of 2",
    ]
    shown = groups.nth(1).locator(titles)
    expect(shown.nth(len(progress) + len(regions) - 1)).to_be_visible()
    assert [title.replace("\n", "") for title in shown.all_inner_texts()][:8] == [
        *progress,
        *regions,
    ]
    expect(groups.nth(2).locator(titles)).to_have_count(0)  # closed, as are those below


def test_pictures_are_there_to_look_at_and_not_made_smaller(page: Page) -> None:
    width, height = SIZE
    pictures = page.locator("image-card img")
    expect(pictures).to_have_count(CARDS_A_PAGE - 1 - len(ZONES))
    box = pictures.first.bounding_box()
    assert box is not None
    assert box["height"] >= height
    for picture in pictures.all():
        expect(picture).to_have_js_property("naturalWidth", width)
        expect(picture).to_have_js_property("naturalHeight", height)


def test_custom_scalars_have_one_curve_a_run_in_each_chart(page: Page) -> None:
    open_tab(page, "custom_scalars")
    charts = page.locator(CHART)
    in_zones = [f"in {name}" for name in ZONES]
    titles = [*in_zones, "of the best region", *in_zones]
    expect(charts.nth(len(titles) - 1)).to_be_visible()
    names = charts.locator("[itemprop=name]").all_inner_texts()
    assert [name.strip() for name in names][: len(titles)] == titles
    for place in range(len(titles)):
        expect(charts.nth(place).get_by_text(f"Matches ({N_RUNS})")).to_be_visible()


def test_images_are_views_and_the_calibration(page: Page) -> None:
    open_tab(page, "images")
    board = page.locator("tf-image-dashboard")
    expect(board.locator(".category-name")).to_have_text(["development", "mp_calibration"])
    board.locator("button.heading", has_text="mp_calibration").click()
    expect(board.locator("tf-image-loader [itemprop=name]")).to_have_text(
        [
            *(f"development/view_{what}" for what in VIEWS for _ in range(N_RUNS)),
            "mp_calibration/deciles",
        ]
    )
    runs = ["alone", "windows/narrow/seed-000", "windows/wide/seed-000"]
    expect(board.locator("tf-image-loader [itemprop=run]")).to_have_text(
        [*runs * len(VIEWS), "alone"]
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
