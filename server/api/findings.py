"""Routes of findings besides the boundary: types of violations, hazardous combinations."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Path, Query, Response
from pydantic import BaseModel, ConfigDict, Field

from brink.search.algorithms.simood import ALPHA, SimoodConfig
from brink.search.analysis.avoidable import EXPLANATION, Avoidable, AvoidedBy, avoidable_first, by_words
from brink.search.analysis.combinations import (
    MIN_PLACES,
    Combination,
    Tally,
    combinations,
    tally_by_step,
    variants_at,
    verdicts_by_chain,
)
from brink.search.analysis.violations import (
    RULES_VERSION,
    FoundViolation,
    ViolationType,
    by_type,
    is_at_fault,
)
from brink.search.archive import Archive
from brink.search.errors import UnsupportedSpace
from brink.search.interaction import added_harm, interacts
from brink.search.parameters import Categorical
from brink.search.slots import Chain, ChainGenome, Step, slots_of
from brink.search.space import SearchSpace
from brink.server.api.context import Context, Services
from brink.server.api.responses import json_response
from brink.server.api.schemas import (
    ChainTally,
    Combinations,
    CombinationView,
    StepTally,
    TechniqueLevel,
    TypeView,
    Variant,
    Violations,
    ViolationView,
)
from brink.server.api.solutions import Number
from brink.server.campaigns import view_store
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.violations import read_violations, set_name
from brink.server.db.engine import read
from brink.server.errors import NotFound
from brink.server.problems.base import ReportsViolations

violations_router = APIRouter(prefix="/campaigns/{campaign_id}/violations", tags=["violations"])

Requirement = Annotated[str, Path(max_length=64)]


class NameBody(BaseModel):
    """A name for a violation."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f]+$")]


@violations_router.get("", response_model=Violations)
async def get_violations(
    campaign_id: str,
    services: Services,
    types_only: Annotated[bool, Query(description="Return the types only.")] = False,
    avoidable: Annotated[
        Avoidable | None,
        Query(
            description="Return only violations that this driver would have avoided (`no` for neither), and the "
            "types with one, even if another driver would have avoided others of the type. Counts are those of these "
            "violations, but `avoided` says of how many solutions."
        ),
    ] = None,
) -> Response:
    """Return the violations of a campaign, grouped by type; those that a careful driver would have avoided first."""
    campaign = await services.campaigns.get(campaign_id)
    found = await _found(services, campaign)
    archive = (await services.archives.get(campaign)).archive

    def respond() -> Response:
        chosen = found if avoidable is None else [one for one in found if one.avoidable is avoidable]
        view = Violations(
            rules_version=RULES_VERSION,
            words=violations_words(found),
            explanation=EXPLANATION,
            types=_seen_again(violation_types(chosen, found), archive),
            violations=[] if types_only else [_violation_view(one) for one in chosen],
        )
        return json_response(view)

    return await services.pages.run(respond)


@violations_router.put("/{number}/{requirement}/name", status_code=204)
async def put_name(
    campaign_id: str, number: Number, requirement: Requirement, body: NameBody, services: Services
) -> Response:
    """Name a violation by hand; it then belongs to the type of that name."""
    await _name(services, campaign_id, number, requirement, body.name)
    return Response(status_code=204)


@violations_router.delete("/{number}/{requirement}/name", status_code=204)
async def delete_name(
    campaign_id: str, number: Number, requirement: Requirement, services: Services
) -> Response:
    """Remove the name of a violation; it then has the type that the rules assign."""
    await _name(services, campaign_id, number, requirement, None)
    return Response(status_code=204)


async def _name(services: Context, campaign_id: str, number: int, requirement: str, name: str | None) -> None:
    campaign = await services.campaigns.get(campaign_id)
    found = await _found(services, campaign)
    known = [str(one.circumstances["requirement"]) for one in found if one.number == number]
    if requirement not in known:
        raise NotFound(
            f"campaign {campaign.id}: solution {number} has no violation of {requirement[:64]!r}; "
            f"it has {', '.join(known) or 'none'}"
        )
    await services.campaigns.writer.write(
        lambda connection: set_name(connection, campaign.id, number, requirement, name)
    )


async def _found(services: Context, campaign: Campaign) -> list[FoundViolation]:
    problem = (await services.archives.get(campaign)).plan.problem
    if not isinstance(problem, ReportsViolations):
        raise NotFound(
            f"campaign {campaign.id}: violations are sorted into types only where other traffic causes them, as for "
            f"npc-actions@1, not for {campaign.body.problem.id}; see what it found with: brink report {campaign.id}"
        )
    return await services.pages.read(services.engines, lambda c: read_violations(c, campaign.id, problem))


def violation_types(
    found: Sequence[FoundViolation], among: Sequence[FoundViolation] | None = None
) -> list[TypeView]:
    """Return the types of violations, each with an example of its own where it has one.

    First come those that a person named, then those that a careful driver would have avoided; each by frequency.

    Args:
        found: The violations.
        among: All violations, if `found` is a choice among them.
    """
    solutions: dict[str, set[int]] = {}
    for one in found if among is None else among:
        solutions.setdefault(one.type, set()).add(one.number)
    types = [_type_view(kind, len(solutions[kind.words])) for kind in by_type(found)]
    types.sort(
        key=lambda kind: (not kind.named, avoidable_first(kind.avoidable), -kind.solutions, kind.first)
    )
    return _with_examples(types, found)


def _with_examples(types: Sequence[TypeView], found: Sequence[FoundViolation]) -> list[TypeView]:
    """Return types, each with the first fitting solution as its example that is not the example of an earlier type.

    Where there is none, it is the first fitting one: a drive may violate two requirements at once.
    """
    fitting: dict[tuple[str, Avoidable | None], set[int]] = {}
    for one in found:
        fitting.setdefault((one.type, one.avoidable), set()).add(one.number)
    taken: set[int] = set()
    chosen = []
    for kind in types:
        numbers = fitting[kind.type, kind.avoidable]
        example = min(numbers - taken or numbers)
        taken.add(example)
        chosen.append(kind.model_copy(update={"example": example}))
    return chosen


def _seen_again(types: Sequence[TypeView], archive: Archive) -> list[TypeView]:
    """Return types, each with the number of further drives of its solutions, and of those that had the type, too."""
    if not types:
        return []
    _, which = np.unique(archive.vectors, axis=0, return_inverse=True)
    drives = np.bincount(which.reshape(-1))
    solution = dict(zip(archive.numbers.tolist(), which.reshape(-1).tolist(), strict=True))
    told = []
    for kind in types:
        mine = [solution[number] for number in kind.numbers if number in solution]
        further = int(sum(drives[one] - 1 for one in set(mine)))
        words = f"{len(mine) - len(set(mine)):,} of {further:,}" if further else ""
        told.append(kind.model_copy(update={"again": words}))
    return told


def violations_words(found: Sequence[FoundViolation]) -> str:
    """Return how many types of violations a careful driver would have avoided, of how many, in a sentence."""
    if not found:
        return "no violations"
    types = len({one.type for one in found})
    solutions = len({one.number for one in found})
    all_types = f"{types:,} {'type' if types == 1 else 'types'} of violations"
    all_solutions = f"{solutions:,} {'solution' if solutions == 1 else 'solutions'}"
    if all(one.avoidable is None for one in found):
        return f"{all_types} in {all_solutions}; not measured whether a careful driver would have avoided any"
    careful = [one for one in found if one.avoidable is Avoidable.CAREFUL]
    if not careful:
        return f"a careful driver would have avoided none of {all_types}, in {all_solutions}"
    avoided = len({one.type for one in careful})
    numbers = len({one.number for one in careful})
    return (
        f"a careful driver would have avoided {avoided:,} of {all_types}, {_by_braking(careful)}in {numbers:,} of "
        f"{all_solutions} with violations"
    )


def _by_braking(careful: Sequence[FoundViolation]) -> str:
    """Return how many types of violations a careful driver avoids by braking; empty if that was not recorded."""
    if any(one.avoided_by is None for one in careful):
        return ""
    braking = len({one.type for one in careful if one.avoided_by is AvoidedBy.BRAKING})
    return f"{braking:,} of them by braking, "


def _type_view(kind: ViolationType, solutions: int) -> TypeView:
    violations = kind.violations
    numbers = sorted({violation.number for violation in violations})
    faults = {is_at_fault(violation.circumstances) for violation in violations}
    counts = Counter(violation.avoidable for violation in violations)
    return TypeView(
        type=kind.words,
        solutions=len(numbers),
        avoided=_avoided_words(kind, solutions),
        instances=kind.instances,
        first=numbers[0],
        example=numbers[0],
        numbers=numbers,
        named=sum(violation.name is not None for violation in violations),
        avoidable=kind.avoidable,
        avoider=by_words(kind.avoidable),
        avoided_by=kind.avoided_by,
        avoidable_by={one: counts[one] for one in Avoidable},
        at_fault=faults.pop() if len(faults) == 1 else None,
    )


def _avoided_words(kind: ViolationType, solutions: int) -> str:
    """Return in how many of a type's solutions the violation is as avoidable as the type."""
    avoided = len({one.number for one in kind.violations if one.avoidable is kind.avoidable})
    nobody = kind.avoidable in (None, Avoidable.NO)
    return f"{solutions:,}" if nobody and avoided == solutions else f"{avoided:,} of {solutions:,}"


def _violation_view(one: FoundViolation) -> ViolationView:
    return ViolationView(
        number=one.number,
        requirement=str(one.circumstances["requirement"]),
        time_s=float(one.circumstances["time_s"]),
        type=one.type,
        name=one.name,
        avoidable=one.avoidable,
        avoided_by=one.avoided_by,
        at_fault=is_at_fault(one.circumstances),
        signature=one.signature.to_json(),
        circumstances=dict(one.circumstances),
    )


combinations_router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["solutions"])


@combinations_router.get("/combinations")
async def get_combinations(campaign_id: str, services: Services) -> Combinations:
    """Return the hazardous chains of techniques, and which of them need all their techniques or a certain order."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    measured = await read(services.engines, lambda c: view_store.read_measured(c, campaign.id))
    config = found.plan.config if isinstance(found.plan.config, SimoodConfig) else None

    def build_view() -> Combinations:
        space = found.plan.problem.space
        return combinations_view(space, found.archive, alphas_of(space, measured), config)

    try:
        return await services.analyses.run(build_view)
    except UnsupportedSpace:
        raise _no_techniques(campaign) from None


@combinations_router.get("/solutions/{number}/variants")
async def get_variants(campaign_id: str, number: Number, services: Services) -> list[Variant]:
    """Return the parts and reorderings of a solution that were simulated with the same scenario, itself last."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    try:
        return await services.analyses.run(
            lambda: variants_view(found.plan.problem.space, found.archive, number)
        )
    except UnsupportedSpace:
        raise _no_techniques(campaign) from None
    except KeyError:
        raise NotFound(f"campaign {campaign.id} has no evaluated solution {number}") from None


def _no_techniques(campaign: Campaign) -> NotFound:
    return NotFound(f"campaign {campaign.id}: problem {campaign.body.problem.id} has no ordered techniques")


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
    """Return what added harm means, in sentences; empty if it is unknown of every chain."""
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
