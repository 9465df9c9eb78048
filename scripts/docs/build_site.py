"""Build the site of the documentation: pages, notebooks and a reference made from the docstrings.

    python -m scripts.docs.build_site

gathers the README, `docs/`, the notebooks with what they show, and a page of the reference for each
part of the library in `build/pages`, lets Zensical make `build/site` of them with its warnings as
errors, and checks every link within the site. Open `build/site/index.html`, or serve that folder.
"""

import ast
import configparser
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from html.parser import HTMLParser
from os.path import relpath
from pathlib import Path
from urllib.parse import unquote, urlsplit

import nbformat
from nbconvert import MarkdownExporter

ROOT = Path(__file__).parents[2]
CONFIG = Path(__file__).with_name("zensical.toml")

REFERENCE: Mapping[str, tuple[str, ...]] = {
    "runs": ("experiment", "runs.reader", "training"),
    "agents": ("agent", "config", "space", "records", "meta_predictor"),
    "experts": ("experts",),
    "drives": ("drives",),
    "rewards": ("reward",),
    "saving": ("internal.state",),
}
"""The pages of the reference, each with the modules whose public names it explains."""

FURTHER: Mapping[str, tuple[str, ...]] = {
    "runs": ("torch_iac.runs.recorder.Recorder", "torch_iac.compare.engine.run_variants"),
    "rewards": (),
}
"""What the pages explain besides: names that are imported from their own modules."""

LINK = re.compile(r'(?P<before>\]\(|(?:src|href)=")(?P<target>[^)"\s]+)')
"""A link or a picture in Markdown or HTML."""


def main() -> None:
    """Build the site and check it."""
    site = build(ROOT / "build")
    broken = sorted(set(broken_links(site)))
    if broken:
        sys.exit("\n".join(["These links lead nowhere:", *broken]))
    print(f"Open {site / 'index.html'}")


def build(folder: Path) -> Path:
    """Build the site in a folder, and return where it is.

    Raises:
        subprocess.CalledProcessError: Zensical has found something wrong, and said what.
    """
    pages, site = folder / "pages", folder / "site"
    for old in (pages, site):
        shutil.rmtree(old, ignore_errors=True)
    gather(pages)
    config = folder / "zensical.toml"
    text = CONFIG.read_text().replace("ADDRESS", address()).replace("REPOSITORY", str(ROOT))
    config.write_text(text)
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean", "-f", str(config)]
    subprocess.run(command, check=True, cwd=folder)
    return site


def address() -> str:
    """Return where the repository is, as `setup.cfg` says."""
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    return setup["metadata"]["url"]


def gather(pages: Path) -> None:
    """Write all pages, and the pictures that they show."""
    shutil.copytree(ROOT / "docs" / "images", pages / "images")
    sources = places()
    for source, place in sources.items():
        target = pages / place
        target.parent.mkdir(parents=True, exist_ok=True)
        text = notebook(source, target) if source.suffix == ".ipynb" else source.read_text()
        target.write_text(with_links(text, source, place, sources))
    for name, modules in REFERENCE.items():
        target = pages / "reference" / f"{name}.md"
        target.parent.mkdir(exist_ok=True)
        target.write_text(reference(name, modules))


def places() -> dict[Path, Path]:
    """Return which file of the repository becomes which page."""
    pages = {ROOT / "README.md": Path("index.md"), ROOT / "CHANGELOG.md": Path("changelog.md")}
    docs = (ROOT / "docs").rglob("*.md")
    pages |= {path: path.relative_to(ROOT / "docs") for path in sorted(docs)}
    notebooks = sorted((ROOT / "notebooks").glob("*.ipynb"))
    return pages | {path: Path("notebooks") / f"{path.stem}.md" for path in notebooks}


def notebook(path: Path, target: Path) -> str:
    """Return a notebook as Markdown; its pictures are written beside the page."""
    exporter = MarkdownExporter()  # type: ignore[no-untyped-call]
    resources = {"output_files_dir": f"{target.stem}_files", "unique_key": target.stem}
    text, found = exporter.from_notebook_node(nbformat.read(path, as_version=4), resources)
    for name, data in found["outputs"].items():
        picture = target.parent / name
        picture.parent.mkdir(parents=True, exist_ok=True)
        picture.write_bytes(data)
    return str(text)


def with_links(text: str, source: Path, place: Path, sources: Mapping[Path, Path]) -> str:
    """Return a page whose links lead to pages of the site, or else to the repository.

    Args:
        text: The page as it is in the repository.
        source: Where it is there.
        place: Where it is in the site.
        sources: All pages.
    """

    def moved(link: re.Match[str]) -> str:
        target, hash_sign, anchor = link["target"].partition("#")
        path = (source.parent / target).resolve()
        if not target or urlsplit(target).scheme or not path.is_relative_to(ROOT):
            return link[0]
        if path in sources:
            new = relpath(sources[path], place.parent)
        elif path.is_relative_to(ROOT / "docs" / "images"):
            new = relpath(path.relative_to(ROOT / "docs"), place.parent)
        elif path.exists():
            kind = "tree" if path.is_dir() else "blob"
            new = f"{address()}/{kind}/main/{path.relative_to(ROOT).as_posix()}"
        else:  # what a notebook has written beside itself
            return link[0]
        return f"{link['before']}{new}{hash_sign}{anchor}"

    return LINK.sub(moved, text)


def reference(name: str, modules: tuple[str, ...]) -> str:
    """Return a page that explains the public names of some modules."""
    names = [
        f"torch_iac.{module}.{public}"
        for module, public in public_names()
        if any(module == of or module.startswith(f"{of}.") for of in modules)
    ]
    blocks = [f"::: {each}" for each in (*names, *FURTHER.get(name, ()))]
    return "\n\n".join([f"# {name.capitalize()}", *blocks]) + "\n"


def public_names() -> list[tuple[str, str]]:
    """Return the names that `import torch_iac` gives, each after its module."""
    tree = ast.parse((ROOT / "torch_iac" / "__init__.pyi").read_text())
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    return [
        (node.module or "", alias.name)
        for node in imports
        for alias in node.names
        if not alias.name.startswith("_")
    ]


class Links(HTMLParser):
    """The links of a page, and the places in it that links can lead to."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors = {""}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what an element links to, and what it is called."""
        named = dict(attrs)
        self.links += [
            named[key] or "" for key in ("href", "src") if key in named and tag != "link"
        ]
        self.anchors |= {named[key] or "" for key in ("id", "name") if key in named}


def broken_links(site: Path) -> Iterator[str]:
    """Yield the links within a site that lead nowhere, each after its page."""
    pages = {}
    for path in site.rglob("*.html"):
        pages[path] = Links()
        pages[path].feed(path.read_text())
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or path.name == "404.html":
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            known = pages[target].anchors if target in pages else {unquote(parts.fragment)}
            if not target.exists() or unquote(parts.fragment) not in known:
                yield f"{path.relative_to(site)}: {link}"


if __name__ == "__main__":
    main()
