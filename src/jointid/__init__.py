"""Identify a servo-driven joint from motor torque and the commanded reference alone.

Every public name is listed in `__init__.pyi` and loaded when it is first used: the import itself is light.
"""

import lazy_loader

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
