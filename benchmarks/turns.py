"""How many of 64 workers are used, by how campaigns take turns: job by job, or four jobs a worker (ADR 32).

A simulation of the dealing alone, without a coordinator: no overhead, only the waiting for the ends of generations.

    python benchmarks/turns.py
"""

import heapq
import random
import statistics

WORKERS = 64
SIGMA = 0.5
"""Of the logarithm of an episode's length, whose mean is 1."""
SEEDS = 20


def used(generation: int, campaigns: int, turn: int, *, generations: int, seed: int) -> float:
    """Return the share of the workers' time in episodes until the first campaign has told so many generations.

    Args:
        generation: Jobs a generation of each campaign.
        campaigns: How many there are.
        turn: Jobs that a campaign hands out before the next one's turn.
        generations: When to stop.
        seed: Of the episodes' lengths.
    """
    rng = random.Random(seed)
    now, free = 0.0, WORKERS
    running: list[tuple[float, float, int]] = []
    queued, left_open, told, served = ([value] * campaigns for value in (generation, generation, 0, 0))
    turns = list(range(campaigns))
    busy = 0.0
    while max(told) < generations:
        while free and (waiting := [one for one in range(campaigns) if queued[one]]):
            one = min(waiting, key=turns.__getitem__)
            queued[one] -= 1
            served[one] += 1
            if served[one] >= turn:
                turns[one], served[one] = max(turns) + 1, 0
            heapq.heappush(running, (now + rng.lognormvariate(-(SIGMA**2) / 2, SIGMA), now, one))
            free -= 1
        now, began, one = heapq.heappop(running)
        busy += now - began
        free += 1
        left_open[one] -= 1
        if left_open[one] == 0:
            told[one] += 1
            queued[one] = left_open[one] = generation
            turns[one], served[one] = max(turns) + 1, 0
    return (busy + sum(now - began for _, began, _ in running)) / (WORKERS * now)


def main() -> None:
    """Print a line a generation size, number of campaigns and length of the search."""
    print("generation  campaigns  generations  job by job  four a worker")
    for generation, campaigns in ((100, 1), (100, 2), (100, 4), (256, 1), (256, 2), (256, 4)):
        for generations in (4, 32):
            shares = [
                statistics.mean(
                    used(generation, campaigns, turn, generations=generations, seed=seed)
                    for seed in range(SEEDS)
                )
                for turn in (1, 4 * WORKERS)
            ]
            print(f"{generation:10}  {campaigns:9}  {generations:11}  {shares[0]:10.1%}  {shares[1]:13.1%}")


if __name__ == "__main__":
    main()
