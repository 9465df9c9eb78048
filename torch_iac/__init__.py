"""Intelligent Adaptive Curiosity in PyTorch: robots that seek what they learn fastest.

What is public stands in `__init__.pyi`. A name is imported when it is first used, so that one who
needs few of them, such as the command's help, does not wait for all.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
