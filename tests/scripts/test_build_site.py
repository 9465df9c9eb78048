"""The site is built with its warnings as errors, and its links lead somewhere."""

import re
import tomllib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

for package in ("zensical", "mkdocstrings", "nbconvert"):
    pytest.importorskip(package, reason="the extra `docs` is not installed")

from scripts.docs import build_site  # noqa: E402

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("build")
    return build_site.build(folder)


def test_every_page_is_in_the_navigation_and_every_link_leads_somewhere(site: Path) -> None:
    config = tomllib.loads(build_site.CONFIG.read_text())["project"]
    named = set(targets(config["nav"]))
    pages = {path.relative_to(site.parent / "pages").as_posix() for path in _pages(site)}
    assert named == pages
    assert list(build_site.broken_links(site)) == []


def targets(entries: Any) -> list[str]:
    if isinstance(entries, str):
        return [entries]
    parts = entries.values() if isinstance(entries, dict) else entries
    return [target for part in parts for target in targets(part)]


def _pages(site: Path) -> list[Path]:
    return list((site.parent / "pages").rglob("*.md"))


def test_every_public_name_is_in_the_reference(site: Path) -> None:
    text = "".join(path.read_text() for path in (site / "reference").glob("*.html"))
    for module, name in build_site.public_names():
        assert f'id="torch_iac.{module}.{name}"' in text, name


def test_a_link_that_leads_nowhere_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text('<h1 id="top"></h1><a href="b.html#there">b</a>')
    (tmp_path / "b.html").write_text('<a href="a.html#top">a</a><img src="c.png">')
    assert sorted(build_site.broken_links(tmp_path)) == ["a.html: b.html#there", "b.html: c.png"]


def test_links_out_of_the_site_lead_to_the_repository() -> None:
    text = "[a](../torch_iac/agent.py#L3) [b](words.md#x) ![c](images/room.png) [d](https://e.org)"
    source, place = ROOT / "docs" / "code.md", Path("code.md")
    found = build_site.with_links(text, source, place, build_site.places())
    assert found == (
        f"[a]({build_site.address()}/blob/main/torch_iac/agent.py#L3) [b](words.md#x) "
        "![c](images/room.png) [d](https://e.org)"
    )


def test_the_address_of_the_repository_is_the_same_everywhere() -> None:
    address = build_site.address()
    for name in ("README.md", "CONTRIBUTING.md", "CITATION.cff"):
        found = re.findall(r"https://github\.com/\S+/torch_iac", (ROOT / name).read_text())
        assert set(found) == {address}, name


def test_the_packages_description_has_links_that_lead_somewhere_from_elsewhere(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: dict[str, Any] = {}
    monkeypatch.setattr("setuptools.setup", lambda **arguments: given.update(arguments))
    spec = spec_from_file_location("setup", ROOT / "setup.py")
    assert spec is not None
    assert spec.loader is not None
    spec.loader.exec_module(module_from_spec(spec))
    links = re.findall(r'(?:\]\(|src=")([^)"]+)', given["long_description"])
    assert len(links) > 30
    assert [link for link in links if not link.startswith("https://")] == []
    assert f"{build_site.address()}/raw/main/docs/images/room.png" in links
