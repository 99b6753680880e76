"""Identify servo-driven joints and robots from motor torque and the commanded reference alone.

Where to begin, after `import jointid as ji`:

- `ji.twin("L19")` makes a record to try things on, and the loop that it was simulated with.
- `ji.read(path, columns)` reads a log as a `ji.Record`; `ji.inspect(path)` shows what a file holds, and
  `ji.diagnose(record, loop)` what is wrong with a record.
- `ji.ClosedLoop(joint, controller)` describes the drive, with `ji.RigidJoint`, `ji.FlexibleJoint` or `ji.robots.Robot`;
  `ji.load(path)` reads it from a joint file or a robot file.
- `ji.identify(record, loop)` returns a `ji.Estimate`: print it, then `ji.validate` it with another record.

`ji.controller`, `ji.friction`, `ji.spring` and `ji.robots` hold the classes that these take, `ji.figures` the charts.
Every public name is listed in `__init__.pyi` and loaded when it is first used: the import itself loads nothing.
"""

__version__ = "0.3.0"


def __getattr__(name):
    """Return a public name; what finds them all is loaded with the first."""
    import lazy_loader

    find, names, every = lazy_loader.attach_stub(__name__, __file__)
    globals().update(__getattr__=find, __dir__=names, __all__=every)
    return every if name == "__all__" else find(name)


def __dir__():
    """Return the public names."""
    return __getattr__("__all__")
