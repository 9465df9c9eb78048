"""Intelligent Adaptive Curiosity in PyTorch: robots that seek what they learn fastest.

The public names are in `__init__.pyi`. A name is imported when it is first used, so that importing
the package is fast.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
