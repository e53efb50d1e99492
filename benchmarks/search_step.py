"""Time one generation step of a search at growing archive sizes: ``python benchmarks/search_step.py``."""

import argparse

from brink.bench.distances import SIZES, measure


def main() -> None:
    """Print a table: archive size, shortest and median time, target."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES), help="solutions before the step")
    parser.add_argument("--repeats", type=int, default=15, help="how often each step is taken")
    arguments = parser.parse_args()
    print(f"{'solutions':>10} {'new':>5} {'min ms':>9} {'median ms':>10} {'target ms':>10}")
    for row in measure(arguments.sizes, arguments.repeats):
        target = "-" if row.target_ms is None else f"{row.target_ms:g}"
        verdict = {None: "", True: "met", False: "MISSED"}[row.met]
        print(
            f"{row.solutions:>10} {row.new:>5} {row.min_ms:>9.2f} {row.median_ms:>10.2f} {target:>10} {verdict}"
        )


if __name__ == "__main__":
    main()
