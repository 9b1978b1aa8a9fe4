"""Run benchmarks and compare their ratios with those of the last release, in ratios.json.

    python scripts/benchmarks/compare.py [NAME ...] [--write]

A ratio says how many times faster this package is than a reference measured in the same run, so that it can be compared
between machines. --write keeps the new ones.
"""

from __future__ import annotations

import argparse
import importlib
import json
from pathlib import Path

BENCHMARKS = ("compliance", "robots", "dynamics")
RATIOS = Path(__file__).with_name("ratios.json")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=list(BENCHMARKS), help=f"some of {', '.join(BENCHMARKS)}")
    parser.add_argument("--write", action="store_true", help="keep the new ratios")
    arguments = parser.parse_args()
    before = json.loads(RATIOS.read_text(encoding="utf-8")) if RATIOS.is_file() else {}
    after = before | {name: importlib.import_module(name).main() for name in arguments.names}
    print(f"\n{'ratio':<60} {'last release':>12} {'now':>8} {'change':>8}")
    for name in arguments.names:
        for what, ratio in after[name].items():
            earlier = before.get(name, {}).get(what)
            change = f"{100.0 * (ratio / earlier - 1.0):+7.0f} %" if earlier else "new"
            print(f"{name + ', ' + what:<60} {earlier or float('nan'):12.2f} {ratio:8.2f} {change:>8}")
    if arguments.write:
        rounded = {name: {what: round(ratio, 2) for what, ratio in found.items()} for name, found in after.items()}
        RATIOS.write_text(json.dumps(rounded, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
