"""Identify a servo-driven joint from motor torque and the commanded reference alone.

Every public name is listed in `__init__.pyi` and loaded when it is first used: the import itself loads nothing.
"""

__version__ = "0.2.0"


def __getattr__(name):
    """Return a public name; what finds them all is loaded with the first."""
    import lazy_loader

    find, names, every = lazy_loader.attach_stub(__name__, __file__)
    globals().update(__getattr__=find, __dir__=names, __all__=every)
    return every if name == "__all__" else find(name)


def __dir__():
    """Return the public names."""
    return __getattr__("__all__")
