# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Fill the tables of doc/performance.md from the last full run, and that of the viewer.

Everything between <!-- bench:NAME --> and <!-- /bench:NAME --> is made anew, so that no figure is
ever typed by hand.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from suite.plots import save_all
from suite.results import Results
from suite.tables import fill

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "doc/performance.md"


def main() -> int:
    """Read the results and write the page; with --check only tell whether they agree."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    default = ROOT / "benchmark/results/full.json"
    parser.add_argument("results", nargs="?", type=Path, default=default, help="(%(default)s)")
    parser.add_argument(
        "--check", action="store_true", help="write nothing; status 1 if they differ"
    )
    args = parser.parse_args()
    results = Results.load_all(args.results)
    text = PAGE.read_text(encoding="utf-8")
    filled = fill(text, results)
    differs = filled != text
    if differs:
        print(f"{PAGE.name}: {'differs' if args.check else 'filled'}")
    if args.check:
        return int(differs)
    PAGE.write_text(filled, encoding="utf-8")
    save_all(results, args.results.parent, args.results.stem)
    return 0


if __name__ == "__main__":
    sys.exit(main())
