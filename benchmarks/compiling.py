"""Processor seconds that each kernel takes to compile, in a process of its own with an empty cache.

    python -m benchmarks.compiling

A kernel's time includes the functions that are compiled into it and nothing else needs; `forms` counts how often Numba
compiled it for arguments of other types.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from typing import Any

CHILD = "--child"


def measure() -> None:
    """Compile all kernels here, and print one line for each."""
    import numba.core.event as events

    from jointid.simulation.warm_up import PARTS

    open_calls: list[tuple[str, float]] = []
    found: dict[str, list[float]] = {}

    class Listener(events.Listener):
        """Add up the times of kernels that nothing else is compiling."""

        def on_start(self, event: Any) -> None:
            function = event.data["dispatcher"].py_func
            open_calls.append((f"{function.__module__}.{function.__name__}", time.process_time()))

        def on_end(self, event: Any) -> None:
            name, began = open_calls.pop()
            if name.startswith("jointid.") and not open_calls:
                found.setdefault(name, []).append(time.process_time() - began)

    events.register("numba:compile", Listener())
    for compile_part in PARTS.values():
        compile_part()
    print("| kernel | forms | s |\n|---|---|---|")
    for name, times in sorted(found.items(), key=lambda item: -sum(item[1])):
        print(f"| `{name.removeprefix('jointid.')}` | {len(times)} | {sum(times):.1f} |")
    print(f"| all | {sum(map(len, found.values()))} | {sum(map(sum, found.values())):.1f} |")


def main() -> None:
    """Measure in a fresh process."""
    if CHILD in sys.argv:
        measure()
        return
    with tempfile.TemporaryDirectory() as empty:
        command = [sys.executable, "-m", "benchmarks.compiling", CHILD]
        subprocess.run(command, env={**os.environ, "NUMBA_CACHE_DIR": empty}, check=True)


if __name__ == "__main__":
    main()
