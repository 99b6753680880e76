"""A fleet to try campaigns on, as large as asked for: many joints over many days, with faults that are known.

    jointid demo --fleet fleet
    python examples/fleet/make.py fleet --joints 20 --days 20

The second makes the records of the first anew, and more of them; see `jointid.apps.cli.demo.make_fleet`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from jointid.apps.cli.demo import make_fleet

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--joints", type=int, default=20)
    parser.add_argument("--days", type=int, default=20)
    parser.add_argument("--spoiled", type=float, default=0.05)
    parser.add_argument("--falling", type=int, default=3)
    parser.add_argument("--fall", type=float, default=0.1)
    parser.add_argument("--seed", type=int, default=1)
    make_fleet(**vars(parser.parse_args()))
