"""Follow-ups on pairs: is the component to blame, and which differences matter?

Both simulate the very episodes of the campaign, with one thing changed. They therefore have its seed, and name for
each candidate the number of the solution whose episode seed it shares.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from sqlalchemy import Connection

from brink.search.algorithms.minimise import (
    Minimise,
    MinimiseConfig,
    Reduced,
    Reductions,
    most_trials,
    replay,
)
from brink.search.algorithms.repeats import Repeats
from brink.search.analysis.pairs import Pair
from brink.search.archive import Archive
from brink.search.space import FloatArray
from brink.search.streams import episode_seed
from brink.server.campaigns import view_store
from brink.server.campaigns.plan import Plan, prepare_campaign, with_truth
from brink.server.campaigns.repeats import (
    EVERY_D_TH,
    EVERY_T_B,
    MOST,
    REDUCTION,
    SINGLE,
    PlannedRepeats,
    StoredRepeats,
    follow_up_body,
)
from brink.server.campaigns.store import Campaign
from brink.server.errors import Conflict

MOST_PAIRS_FOLLOWED = MOST // 2
"""Maximum number of pairs in a follow-up, checked ones first."""


def sides_of(pairs: Sequence[Pair]) -> list[int]:
    """Return the numbers of both sides of pairs, each once."""
    return list(dict.fromkeys(side.number for pair in pairs for side in (pair.safe, pair.unsafe)))


def plan_component(
    campaign: Campaign, plan: Plan, archive: Archive, pairs: Sequence[Pair], seeds: Mapping[int, int]
) -> PlannedRepeats:
    """Plan the episodes of the unsafe sides of pairs with ground truth in place of the component.

    Args:
        campaign: The campaign.
        plan: Its plan.
        archive: Its archive.
        pairs: At least one pair.
        seeds: Episode seed of each unsafe side, by number.

    Raises:
        InvalidInput: The problem has no component that can be replaced.
        Conflict: An episode seed is not one of the campaign.
    """
    with_truth(plan.problem)
    numbers = sorted({pair.unsafe.number for pair in pairs})
    rows = _rows(archive, numbers)
    return PlannedRepeats(
        of=campaign.id,
        t_b=EVERY_T_B,
        d_th=EVERY_D_TH,
        repeats=SINGLE,
        numbers=tuple(numbers),
        campaign=prepare_campaign(
            follow_up_body(
                campaign,
                plan,
                f"{_count(len(numbers), 'unsafe drive')} with ground truth",
                Repeats.id,
                len(numbers),
                {"solutions": rows.tolist(), "seed_numbers": _seed_numbers(campaign, numbers, seeds)},
            ).model_copy(update={"ground_truth": True})
        ),
    )


def plan_minimisation(
    campaign: Campaign, plan: Plan, archive: Archive, pairs: Sequence[Pair], seeds: Mapping[int, int]
) -> PlannedRepeats:
    """Plan the reduction of pairs to the differences that matter, under the episode seeds of the unsafe sides.

    Args:
        campaign: The campaign.
        plan: Its plan.
        archive: Its archive.
        pairs: At least one pair.
        seeds: Episode seed of each unsafe side, by number.

    Pairs whose sides were simulated with different seeds are left out: if the safe side is unsafe under the seed of
    the unsafe side, chance decides, and no difference matters.

    Raises:
        Conflict: No difference can be reverted, or an episode seed is not one of the campaign.
    """
    if not any(has_one_seed(plan, pair) for pair in pairs):
        raise Conflict(
            f"campaign {campaign.id}: the two sides of every pair have different seeds, so chance may explain the "
            "verdicts: differences are reverted only where both sides had one seed"
        )
    open_pairs, reduced = reducible(plan, archive, pairs)
    if not open_pairs:
        raise Conflict(
            f"campaign {campaign.id}: none of the differences of its pairs can be reverted alone: they are minimal"
        )
    numbers = [number for pair in open_pairs for number in (pair.safe.number, pair.unsafe.number)]
    params = {
        "safe": reduced.safe.tolist(),
        "unsafe": reduced.unsafe.tolist(),
        "seed_numbers": _seed_numbers(campaign, numbers[1::2], seeds),
    }
    return PlannedRepeats(
        of=campaign.id,
        t_b=EVERY_T_B,
        d_th=EVERY_D_TH,
        repeats=REDUCTION,
        numbers=tuple(numbers),
        campaign=prepare_campaign(
            follow_up_body(
                campaign,
                plan,
                f"{_count(len(open_pairs), 'pair')} minimised",
                Minimise.id,
                most_trials(reduced),
                params,
            )
        ),
    )


def has_one_seed(plan: Plan, pair: Pair) -> bool:
    """Return whether only the differences between the sides of a pair can explain their verdicts, not the seeds."""
    return pair.same_seed or plan.problem.ignores_seeds


def reducible(plan: Plan, archive: Archive, pairs: Sequence[Pair]) -> tuple[list[Pair], Reductions]:
    """Return the pairs with a difference that can be reverted, and their reductions before the first trial.

    The sides of these pairs were simulated with one seed.
    """
    space, pairs = plan.problem.space, [pair for pair in pairs if has_one_seed(plan, pair)]
    safe, unsafe = (
        _rows(archive, numbers)
        for numbers in ([pair.safe.number for pair in pairs], [pair.unsafe.number for pair in pairs])
    )
    open_pairs = sorted({trial.pair for trial in Reductions.of(space, safe, unsafe).trials()})
    return [pairs[place] for place in open_pairs], Reductions.of(space, safe[open_pairs], unsafe[open_pairs])


def _rows(archive: Archive, numbers: Sequence[int]) -> FloatArray:
    places = {number: place for place, number in enumerate(archive.numbers.tolist())}
    rows: FloatArray = archive.vectors[[places[number] for number in numbers]]
    return rows


def _seed_numbers(campaign: Campaign, numbers: Sequence[int], seeds: Mapping[int, int]) -> list[int]:
    """Return, for each solution, the number of the candidate whose episode seed it had.

    Raises:
        Conflict: A seed is not that of any candidate.
    """
    known = {episode_seed(campaign.body.seed, number): number for number in numbers}
    if any(seeds[number] not in known for number in numbers):
        last = max(*numbers, campaign.completed)
        known |= {episode_seed(campaign.body.seed, number): number for number in range(last + 1)}
    for number in numbers:
        if seeds[number] not in known:
            raise Conflict(
                f"campaign {campaign.id}: solution {number} shares the episode of another campaign, so it cannot be "
                "followed up here: ask about that campaign's pairs instead"
            )
    return [known[seeds[number]] for number in numbers]


def read_seeds(connection: Connection, campaign_id: str, numbers: Sequence[int]) -> dict[int, int]:
    """Return the episode seeds of solutions, by number."""
    return {row.number: row.seed for row in view_store.read_solutions(connection, campaign_id, set(numbers))}


def read_reduced(connection: Connection, plan: Plan, stored: StoredRepeats) -> Reduced:
    """Return the progress of a follow-up that reduces pairs, from its stored verdicts.

    Args:
        connection: Read connection.
        plan: Plan of the follow-up's campaign.
        stored: The follow-up.
    """
    config = plan.config
    assert isinstance(config, MinimiseConfig)
    given = Reductions.of(
        plan.problem.space, np.asarray(config.safe, np.float64), np.asarray(config.unsafe, np.float64)
    )
    verdicts: dict[int, bool | None] = dict(zip(stored.evaluated, stored.unsafe, strict=True))
    failed = view_store.read_failed(connection, stored.campaign.id)
    return replay(given, verdicts | dict.fromkeys(failed), stored.campaign.budget)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
