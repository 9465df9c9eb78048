r"""Take pictures of TensorBoard's pages as a browser shows them, for docs/tensorboard.md.

    torch-iac train --world kinematic --seed 0 --steps 3000 --out runs/board/seed-0
    torch-iac compare runs/drives --seeds 8 --block 8 --variant "progress:" \
        --variant "error: --drive error" --variant "random: --drive random" \
        -- --world kinematic --no-mp --steps 3000
    python -m scripts.docs.draw_tensorboard --runs runs/board --comparison runs/drives

writes `timeseries.png`, `tensorboard.png` and `hparams.png` into `docs/images`. It needs
Playwright's Python package and a Chromium or Chrome of the system.
"""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import tyro
from playwright.sync_api import FloatRect, Page, sync_playwright

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
"""The programs that will do, the first that is there."""

BROWSER_OPTIONS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)

PATIENCE = 180_000
"""How long to wait for something to appear (ms); slow machines need tens of seconds."""

CHART = "tf-custom-scalar-multi-line-chart-card"
"""What TensorBoard calls a chart on its page of custom scalars."""

N_CHARTS = 7
"""How many there are at least: those of time and of learning progress."""

CHARTS = FloatRect(x=310, y=64, width=770, height=1010)
"""Where in the window they are; beside them stands the folder's path, which nobody wants to see."""


@dataclass(frozen=True)
class Pictures:
    """What to take pictures of."""

    runs: Path
    """A folder with one run."""
    comparison: Path
    """A comparison's folder."""
    out: Path = Path("docs/images")
    """Where the pictures go."""


def find_browser() -> str | None:
    """Return the path of a browser that will do; None if there is none."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


@contextmanager
def serve(folder: Path) -> Iterator[str]:
    """Start TensorBoard on a free port of this machine, and yield its address.

    It reads the folder once, before it gives its address.

    Raises:
        RuntimeError: It ended before.
    """
    once = ("--load_fast=false", "--reload_interval=0", "--reload_task=blocking", "--port=0")
    command = (sys.executable, "-m", "tensorboard.main", f"--logdir={folder}", *once)
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server:
        try:
            assert server.stderr is not None
            said = []
            for line in server.stderr:
                said.append(line)
                if " at http://" in line:
                    yield line.split(" at ")[1].split()[0]
                    return
            raise RuntimeError(f"TensorBoard must serve {folder}, but said: {''.join(said)}")
        finally:
            server.terminate()


@contextmanager
def browse(address: str, browser: str, width: int, height: int) -> Iterator[Page]:
    """Open a page in a browser without a window, and yield it."""
    with sync_playwright() as playwright:
        program = playwright.chromium.launch(
            executable_path=browser, args=BROWSER_OPTIONS, timeout=PATIENCE
        )
        try:
            page = program.new_page(viewport={"width": width, "height": height})
            page.set_default_timeout(PATIENCE)
            page.goto(address)
            yield page
        finally:
            program.close()


def open_tab(page: Page, plugin: str) -> None:
    """Choose one of TensorBoard's pages by the name of its plugin, as a user does by a click."""
    page.locator(f".plugin-name[data-plugin-id={plugin}]").first.click()


def draw(pictures: Pictures) -> None:
    """Write the pictures.

    Raises:
        FileNotFoundError: There is no browser.
    """
    browser = find_browser()
    if browser is None:
        raise FileNotFoundError(f"one of {', '.join(BROWSERS)} must be installed")
    pictures.out.mkdir(parents=True, exist_ok=True)
    with serve(pictures.runs) as address, browse(address, browser, 1400, 1460) as page:
        page.locator("image-card img").first.wait_for()
        page.get_by_role("button", name="Settings").first.click()  # which makes room
        _settle(page)
        page.screenshot(path=pictures.out / "timeseries.png")
        open_tab(page, "custom_scalars")
        page.locator(CHART).nth(N_CHARTS - 1).wait_for()
        _settle(page)
        page.screenshot(path=pictures.out / "tensorboard.png", clip=CHARTS)
    with serve(pictures.comparison) as address, browse(address, browser, 1600, 480) as page:
        open_tab(page, "hparams")
        page.locator("tf-hparams-table-view .table-cell").first.wait_for()
        _settle(page)
        page.screenshot(path=pictures.out / "hparams.png")


def _settle(page: Page) -> None:
    """Wait until all is loaded, and drawn twice more."""
    page.wait_for_load_state("networkidle", timeout=PATIENCE)
    page.evaluate("() => new Promise(done => setTimeout(done, 2000))")  # charts fade in


if __name__ == "__main__":
    draw(tyro.cli(Pictures, description=__doc__))
