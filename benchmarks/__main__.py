"""`python -m benchmarks`."""

from brink.cli.main import run

if __name__ == "__main__":
    run("benchmarks.cli", "bench")
