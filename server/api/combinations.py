"""Routes of combinations of perturbations: which are hazardous, and which only together or in one order."""

from collections.abc import Mapping

from fastapi import APIRouter

from brink.search.analysis.combinations import (
    Chain,
    Combination,
    Step,
    Tally,
    combinations,
    tally_by_step,
    variants_at,
    verdicts_by_chain,
)
from brink.search.archive import Archive
from brink.search.errors import UnsupportedSpace
from brink.search.parameters import Categorical
from brink.search.slots import slots_of
from brink.search.space import SearchSpace
from brink.server.api.context import Services
from brink.server.api.schemas import (
    ChainTally,
    Combinations,
    CombinationView,
    StepTally,
    TechniqueLevel,
    Variant,
)
from brink.server.api.solutions import Number
from brink.server.errors import NotFound

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["solutions"])


@router.get("/combinations")
async def get_combinations(campaign_id: str, services: Services) -> Combinations:
    """Return which chains of techniques are hazardous, and which only together or in one order."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    try:
        return combinations_view(found.plan.problem.space, found.archive)
    except UnsupportedSpace:
        raise NotFound(
            f"campaign {campaign.id}: {campaign.body.problem.id} has no ordered techniques"
        ) from None


@router.get("/solutions/{number}/variants")
async def get_variants(campaign_id: str, number: Number, services: Services) -> list[Variant]:
    """Return a solution's parts and other orders that were simulated in its place, itself last."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    try:
        return variants_view(found.plan.problem.space, found.archive, number)
    except UnsupportedSpace:
        raise NotFound(
            f"campaign {campaign.id}: {campaign.body.problem.id} has no ordered techniques"
        ) from None
    except KeyError:
        raise NotFound(f"campaign {campaign.id} has no evaluated solution {number}") from None


class Names:
    """Names the techniques of a space with slots.

    Raises:
        UnsupportedSpace: It has none.
    """

    def __init__(self, space: SearchSpace) -> None:
        index, self._slots = slots_of(space)
        first = self._slots.pairs[0][0]
        (technique,) = [p for p in space.components[index].parameters if p.name == first]
        assert isinstance(technique, Categorical)
        self._choices = technique.choices

    def step(self, step: Step) -> TechniqueLevel:
        """Return a technique at a level, named."""
        return TechniqueLevel(
            technique=self._choices[step.technique],
            level=step.level,
            levels=self._slots.levels[step.technique] - 1,
        )

    def words(self, chain: Chain) -> str:
        """Return a chain in words, such as ``snow 3/5, then brightness 10/10``."""
        named = [self.step(step) for step in chain]
        return (
            ", then ".join(f"{one.technique.replace('_', ' ')} {one.level}/{one.levels}" for one in named)
            or "nothing"
        )


def combinations_view(space: SearchSpace, archive: Archive) -> Combinations:
    """Return what a campaign found, the most telling combinations first.

    Raises:
        UnsupportedSpace: Its problem has no ordered techniques.
    """
    names = Names(space)
    verdicts = verdicts_by_chain(space, archive)
    steps = [
        StepTally(
            step=names.step(step), words=names.words((step,)),
            alone_unsafe=alone.unsafe, alone_trials=alone.trials,
            joined_unsafe=joined.unsafe, joined_trials=joined.trials,
        )
        for step, (alone, joined) in tally_by_step(verdicts).items()
    ]  # fmt: skip
    return Combinations(steps=steps, combinations=[_view(names, one) for one in combinations(verdicts)])


def variants_view(space: SearchSpace, archive: Archive, number: int) -> list[Variant]:
    """Return a solution's parts and other orders in its place, those with fewest techniques first, itself last.

    Raises:
        UnsupportedSpace: The problem has no ordered techniques.
        KeyError: The archive has no such solution.
    """
    names = Names(space)
    verdicts = verdicts_by_chain(space, archive)
    chain = next((c for c, seen in verdicts.items() if any(v.number == number for v in seen.values())), None)
    if chain is None:
        raise KeyError(number)
    found = variants_at(verdicts, chain, number)
    order = sorted(found, key=lambda one: (one == chain, len(one)))
    return [
        Variant(
            number=found[one].number, unsafe=found[one].unsafe,
            chain=[names.step(step) for step in one], words=names.words(one),
        )
        for one in order
    ]  # fmt: skip


def _view(names: Names, one: Combination) -> CombinationView:
    return CombinationView(
        chain=[names.step(step) for step in one.chain], words=names.words(one.chain),
        unsafe=one.tally.unsafe, trials=one.tally.trials,
        parts=_tallies(names, one.parts), orders=_tallies(names, one.orders),
        hazardous=one.hazardous, minimal=one.minimal, only_together=one.only_together,
        order_matters=one.order_matters, together=list(one.joint_hazards), turned=list(one.order_hazards),
    )  # fmt: skip


def _tallies(names: Names, tallies: Mapping[Chain, Tally]) -> list[ChainTally]:
    return [
        ChainTally(
            chain=[names.step(step) for step in chain],
            words=names.words(chain),
            unsafe=tally.unsafe,
            trials=tally.trials,
        )
        for chain, tally in tallies.items()
    ]
