"""What `setup.cfg` cannot say: the README with links that also lead somewhere from elsewhere."""

import configparser
import re
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent


def with_addresses(text: str, url: str) -> str:
    """Return Markdown whose links and pictures have the repository's address."""
    text = re.sub(r'((?:!\[[^\]]*\]\(|src="))(?!https?:)', rf"\1{url}/raw/main/", text)
    return re.sub(r"((?<!!)\[[^\]]*\]\()(?!https?:|#)", rf"\1{url}/blob/main/", text)


settings = configparser.ConfigParser()
settings.read(ROOT / "setup.cfg")
address = settings["metadata"]["url"]
setup(
    long_description=with_addresses((ROOT / "README.md").read_text(encoding="utf-8"), address),
    long_description_content_type="text/markdown",
    project_urls={
        "Source": address,
        "Issues": f"{address}/issues",
        "Changelog": f"{address}/blob/main/CHANGELOG.md",
    },
)
