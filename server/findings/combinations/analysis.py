"""The hazardous chains of techniques of a campaign."""

from collections.abc import Mapping, Sequence

import numpy as np

from brink.search.algorithms.simood import ALPHA, SimoodConfig
from brink.search.analysis.combinations import (
    MIN_PLACES,
    Combination,
    Tally,
    combinations,
    tally_by_step,
    variants_at,
    verdicts_by_chain,
)
from brink.search.archive import Archive
from brink.search.errors import UnsupportedSpace
from brink.search.interaction import added_harm, interacts
from brink.search.parameters import Categorical
from brink.search.slots import Chain, ChainGenome, Step, slots_of
from brink.search.space import SearchSpace
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.store import Campaign
from brink.server.errors import NotFound
from brink.server.findings.combinations.views import (
    ChainTally,
    Combinations,
    CombinationView,
    StepTally,
    TechniqueLevel,
    Variant,
)
from brink.server.findings.sources import Sources


class TechniqueNames:
    """Names of the techniques of a search space.

    Raises:
        UnsupportedSpace: The space has no technique slots.
    """

    def __init__(self, space: SearchSpace) -> None:
        index, self._slots = slots_of(space)
        first = self._slots.pairs[0][0]
        (technique,) = [p for p in space.components[index].parameters if p.name == first]
        assert isinstance(technique, Categorical)
        self._choices = technique.choices

    def step(self, step: Step) -> TechniqueLevel:
        """Return the schema of a technique at a level."""
        return TechniqueLevel(
            technique=self._choices[step.technique],
            level=step.level,
            levels=self._slots.levels[step.technique] - 1,
        )

    def words(self, chain: Chain) -> str:
        """Describe a chain in words, such as ``snow 3/5, then brightness 10/10``."""
        named = [self.step(step) for step in chain]
        return (
            ", then ".join(f"{one.technique.replace('_', ' ')} {one.level}/{one.levels}" for one in named)
            or "unperturbed"
        )


def alphas_of(
    space: SearchSpace, measured: Sequence[tuple[bytes, Mapping[str, float]]]
) -> dict[Chain, float]:
    """Return the alphas of measured solutions, given as their vectors and objectives, by chain.

    Raises:
        UnsupportedSpace: The problem has no ordered techniques.
    """
    genome = ChainGenome.of(space)
    part = space.slices[genome.index]
    return {
        genome.chain(np.frombuffer(vector, "<f8")[part]): objectives[ALPHA]
        for vector, objectives in measured
        if ALPHA in objectives
    }


async def find_combinations(sources: Sources, campaign: Campaign, read: ReadArchive) -> Combinations:
    """Return the tallies of all chains of a campaign, the most informative ones first.

    Args:
        sources: Where findings are read from.
        campaign: The campaign.
        read: Its archive.

    Raises:
        NotFound: The problem has no ordered techniques.
    """
    measured = await sources.pages.read(sources.engines, lambda c: view_store.read_measured(c, campaign.id))
    config = read.plan.config if isinstance(read.plan.config, SimoodConfig) else None
    space = read.plan.problem.space
    try:
        return await sources.analyses.run(
            lambda: combinations_view(space, read.archive, alphas_of(space, measured), config)
        )
    except UnsupportedSpace:
        raise _no_techniques(campaign) from None


async def find_variants(sources: Sources, campaign: Campaign, number: int) -> list[Variant]:
    """Return the parts and reorderings of a solution that were simulated with the same scenario, itself last.

    Args:
        sources: Where findings are read from.
        campaign: The campaign.
        number: The solution.

    Raises:
        NotFound: The problem has no ordered techniques, or the campaign no such solution.
    """
    read = await sources.archives.get(campaign)
    try:
        return await sources.analyses.run(
            lambda: variants_view(read.plan.problem.space, read.archive, number)
        )
    except UnsupportedSpace:
        raise _no_techniques(campaign) from None
    except KeyError:
        raise NotFound(f"campaign {campaign.id} has no evaluated solution {number}") from None


def _no_techniques(campaign: Campaign) -> NotFound:
    return NotFound(f"campaign {campaign.id}: problem {campaign.body.problem.id} has no ordered techniques")


def combinations_view(
    space: SearchSpace,
    archive: Archive,
    alphas: Mapping[Chain, float] | None = None,
    config: SimoodConfig | None = None,
) -> Combinations:
    """Return the tallies of all chains, the most informative ones first.

    Args:
        space: Search space of the problem.
        archive: All evaluated solutions.
        alphas: What was measured on a data set, by chain.
        config: Settings of the search, for the sense of alpha and the margin; None if it was not SiMOOD.

    Raises:
        UnsupportedSpace: The problem has no ordered techniques.
    """
    names = TechniqueNames(space)
    verdicts = verdicts_by_chain(space, archive)
    steps = [
        StepTally(
            step=names.step(step),
            words=names.words((step,)),
            alone_unsafe=alone.unsafe,
            alone_trials=alone.trials,
            joined_unsafe=joined.unsafe,
            joined_trials=joined.trials,
        )
        for step, (alone, joined) in tally_by_step(verdicts).items()
    ]
    known, settings = alphas or {}, config or SimoodConfig()
    qualities = {chain: settings.quality(alpha) for chain, alpha in known.items()}
    margin = None if config is None else config.margin
    chains = [
        _combination_view(names, one, known.get(one.chain), added_harm(one.chain, qualities), margin)
        for one in combinations(verdicts)
    ]
    return Combinations(
        words=_combinations_words(chains),
        margin=margin,
        explanation=_explanation_words(chains, settings, margin),
        steps=steps,
        combinations=chains,
    )


def _explanation_words(chains: Sequence[CombinationView], config: SimoodConfig, margin: float | None) -> str:
    """Explain added harm in sentences; empty if it is unknown for every chain."""
    if all(one.added_harm is None for one in chains):
        return ""
    worse = "by how much lower mAP is" if config.alpha == "quality" else "how many more errors there are"
    interacts = "" if margin is None else f" From {margin:g}, a chain interacts."
    return (
        f"Added harm: {worse} on the data set with the chain than with its most harmful part alone. "
        f"Effects that merely add up count; it says nothing about hazards in drives.{interacts}"
    )


def _combinations_words(chains: Sequence[CombinationView]) -> str:
    """Return a sentence on how many chains are hazardous, and how."""
    hazardous = sum(one.hazardous for one in chains)
    together = sum(one.only_together for one in chains)
    ordered = sum(one.order_matters for one in chains)
    places = sum(len(one.together) for one in chains)
    if chains and all(one.trials < MIN_PLACES for one in chains):
        return f"none of {len(chains)} chains was simulated in {MIN_PLACES} scenarios, so none counts as hazardous"
    told = f"{hazardous} of {len(chains)} chains {'is' if hazardous == 1 else 'are'} hazardous"
    if together or ordered:
        told += (
            f"; of these, {together} only together (each part alone is safe) and {ordered} in one order but not in "
            "another"
        )
    elif hazardous:
        told += ", none of them only together (each part alone is safe) or in one order but not in another"
    if places:
        drives = "1 simulation was" if places == 1 else f"{places} simulations were"
        told += f"; {drives} unsafe where every part alone was safe"
    return told


def variants_view(space: SearchSpace, archive: Archive, number: int) -> list[Variant]:
    """Return the parts and reorderings of a solution with the same scenario, fewest techniques first, itself last.

    Args:
        space: Search space of the problem.
        archive: All evaluated solutions.
        number: The solution.

    Raises:
        UnsupportedSpace: The problem has no ordered techniques.
        KeyError: The archive has no such solution.
    """
    names = TechniqueNames(space)
    verdicts = verdicts_by_chain(space, archive)
    chain = next((c for c, seen in verdicts.items() if any(v.number == number for v in seen.values())), None)
    if chain is None:
        raise KeyError(number)
    found = variants_at(verdicts, chain, number)
    order = sorted(found, key=lambda one: (one == chain, len(one)))
    return [
        Variant(
            number=found[one].number,
            unsafe=found[one].unsafe,
            chain=[names.step(step) for step in one],
            words=names.words(one),
        )
        for one in order
    ]


def _combination_view(
    names: TechniqueNames, one: Combination, alpha: float | None, harm: float | None, margin: float | None
) -> CombinationView:
    return CombinationView(
        chain=[names.step(step) for step in one.chain],
        words=names.words(one.chain),
        unsafe=one.tally.unsafe,
        trials=one.tally.trials,
        parts=_tallies(names, one.parts),
        orders=_tallies(names, one.orders),
        hazardous=one.hazardous,
        minimal=one.minimal,
        only_together=one.only_together,
        order_matters=one.order_matters,
        alpha=alpha,
        added_harm=harm,
        interacts=None if harm is None or margin is None else interacts(harm, margin),
        together=list(one.joint_hazards),
        turned=list(one.order_hazards),
    )


def _tallies(names: TechniqueNames, tallies: Mapping[Chain, Tally]) -> list[ChainTally]:
    return [
        ChainTally(
            chain=[names.step(step) for step in chain],
            words=names.words(chain),
            unsafe=tally.unsafe,
            trials=tally.trials,
        )
        for chain, tally in tallies.items()
    ]
