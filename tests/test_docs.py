"""The Python in the README and in docs/ runs as it stands there."""

import re
from pathlib import Path

import pytest

from torch_iac.cli.main import main

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCKS = [
    pytest.param(block, id=f"{page.name}-{number}")
    for page in PAGES
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL))
]
LINKS = [
    pytest.param(page, link, id=f"{page.name}-{link}")
    for page in PAGES
    for link in re.findall(r"(?:\]\(|src=\")(?!http)([^)\"]+)", page.read_text())
]


def anchors(page: Path) -> set[str]:
    """Return what GitHub calls the headings of a page in links."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("block", BLOCKS)
def test_examples_run(
    block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    if "stable_baselines3" in block:
        pytest.importorskip("stable_baselines3", reason="needs SB3: pip install 'torch_iac[sb3]'")
    if "torchrl" in block:
        pytest.importorskip("torchrl", reason="needs TorchRL: pip install 'torch_iac[torchrl]'")
    if "runs/some-run" in block:
        main(["train", "--steps", "20", "--out", "runs/some-run"])
    exec(compile(block, "example", "exec"), {})
    capsys.readouterr()


@pytest.mark.parametrize(("page", "link"), LINKS)
def test_links_lead_somewhere(page: Path, link: str) -> None:
    path, _, anchor = link.partition("#")
    target = page.parent / path if path else page
    assert target.exists()
    assert not anchor or anchor in anchors(target)


def test_every_module_has_its_place_in_the_page_of_the_code() -> None:
    page = (ROOT / "docs" / "code.md").read_text()
    modules = [path.relative_to(ROOT).as_posix() for path in (ROOT / "torch_iac").rglob("[!_]*.py")]
    assert modules
    assert [name for name in modules if f"{name}`" not in page] == []
    package = ROOT / "torch_iac"
    places = (ROOT, package, package / "worlds", ROOT / "envs" / "torch_iac_envs")
    for name in re.findall(r"`([\w/]+\.pyi?)`", page):
        assert any((place / name).exists() for place in places), name
