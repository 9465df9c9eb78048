"""Which version of the library is installed."""

from importlib.metadata import version

__version__ = version("torch_iac")
