"""Random solutions of traffic participants: patterns, mutation and crossover, and conversion to rows of a space.

All functions are pure; what they return may need repair. `TrafficGenome` repairs solutions and converts them to and
from rows of a search space.

Sources: Tian et al., adaptive crossover and mutation, and seeding; Tian et al., "MOSAT: Finding Safety Violations of
Autonomous Driving Systems using Multi-objective Genetic Algorithm", ESEC/FSE 2022, for the motifs.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np

from brink.search.operators import mutated
from brink.search.space import FloatArray, SearchSpace
from brink.search.traffic.constraint import Participants, participants_of
from brink.search.traffic.motion import Distance, Rollouts
from brink.search.traffic.participants import (
    MAGNITUDES,
    MAX_ACTIONS,
    MAX_DURATION_S,
    MAX_SPEEDS_MPS,
    MIN_DURATION_S,
    PEDESTRIAN_ACTIONS,
    REACH_M,
    VEHICLE_ACTIONS,
    Action,
    Gene,
    Kind,
    Participant,
    RoadLimits,
    Solution,
    magnitude_of,
)

Pattern: TypeAlias = Callable[[RoadLimits, np.random.Generator], Solution]

STEP_SHARE: Final = 0.1
"""Standard deviation of a small change, as a share of the number's range."""

_CHANGED_SHARE: Final = 0.5
"""Share of the numbers that a small change modifies."""

_OTHERS_MUTATE: Final = 0.05
"""Probability that a parameter of another component mutates in a child."""


@dataclass(frozen=True, slots=True)
class TrafficGenome:
    """The participants of a space as a genome.

    Attributes:
        space: The space.
        index: Index of the traffic-participants component.
        rule: Its constraint.
    """

    space: SearchSpace
    index: int
    rule: Participants

    @classmethod
    def of(cls, space: SearchSpace) -> "TrafficGenome":
        """Return the genome of a space.

        Raises:
            UnsupportedSpace: The space has no participants.
        """
        return cls(space, *participants_of(space))

    @property
    def road(self) -> RoadLimits:
        """The road that the participants are on."""
        return self.rule.road

    @property
    def max_participants(self) -> int:
        """Largest number of participants."""
        return self.rule.count

    def solution(self, row: FloatArray) -> Solution:
        """Return the participants in a row of the space, shape ``(d,)``."""
        return self.rule.decode(row[self.space.slices[self.index]])

    def sample(self, rng: np.random.Generator) -> Solution:
        """Draw random participants."""
        return self.rule.decode(self.space.sample_component(self.index, rng))

    def repaired(self, solution: Solution, rng: np.random.Generator) -> Solution:
        """Return the nearest valid solution."""
        return self.rule.decode(self._vector(solution, rng))

    def _vector(self, solution: Solution, rng: np.random.Generator) -> FloatArray:
        vector = self.rule.encode(solution[: self.max_participants])
        return self.space.repair_component(self.index, vector, rng)

    def row(self, solution: Solution, parent: FloatArray | None, rng: np.random.Generator) -> FloatArray:
        """Return a row of the space with the repaired participants.

        Args:
            solution: The participants.
            parent: Row that provides the other components, slightly mutated; None draws them at random.
            rng: Source of all randomness.

        Returns:
            A valid row, shape ``(d,)``.
        """
        participants = self._vector(solution, rng)
        vectors = []
        for index, component in enumerate(self.space.components):
            if index == self.index:
                vectors.append(participants)
            elif parent is None:
                vectors.append(component.sample(rng))
            else:
                inherited = component.unset_dormant(parent[self.space.slices[index]])
                vectors.append(component.repair(mutated(component, inherited, _OTHERS_MUTATE, rng), rng))
        return self.space.join(vectors)

    def roll_out(self, solutions: Iterable[Solution], measure: Distance = Distance.TIME) -> Rollouts:
        """Return the roll-outs of solutions, whose distances are measured in the given way."""
        return Rollouts.of(solutions, self.max_participants, self.road, measure)

    def roll_out_rows(self, rows: Iterable[FloatArray], measure: Distance = Distance.TIME) -> Rollouts:
        """Return the roll-outs of the participants in rows of the space."""
        return self.roll_out((self.solution(row) for row in rows), measure)


def random_gene(participant: Participant, rng: np.random.Generator) -> Gene:
    """Draw a random action that fits a participant."""
    actions = PEDESTRIAN_ACTIONS if participant.on_foot else VEHICLE_ACTIONS
    action = actions[int(rng.integers(len(actions)))]
    return Gene(
        action=action,
        duration_s=float(rng.uniform(MIN_DURATION_S, MAX_DURATION_S)),
        magnitude=magnitude_of(action, float(rng.random())),
    )


def _nudged(value: float, low: float, high: float, rng: np.random.Generator) -> float:
    step = float(rng.standard_normal()) * STEP_SHARE * (high - low)
    if rng.random() >= _CHANGED_SHARE:
        return value
    return min(max(value + step, low), high)


def small_change(participant: Participant, rng: np.random.Generator) -> Participant:
    """Return a participant with some numbers changed slightly; its actions stay the same."""
    genes = []
    for gene in participant.genes:
        limits = MAGNITUDES[gene.action]
        genes.append(
            replace(
                gene,
                duration_s=_nudged(gene.duration_s, MIN_DURATION_S, MAX_DURATION_S, rng),
                magnitude=_nudged(gene.magnitude, limits.low, limits.high, rng),
            )
        )
    return replace(
        participant,
        ds_m=_nudged(participant.ds_m, -REACH_M, REACH_M, rng),
        speed_mps=_nudged(participant.speed_mps, 0.0, MAX_SPEEDS_MPS[participant.kind], rng),
        genes=tuple(genes),
    )


def major_change(participant: Participant, rng: np.random.Generator) -> Participant:
    """Return a participant with a shifted start, and actions shuffled, inserted, or replaced from a random one on."""
    genes = list(participant.genes)
    choice = int(rng.integers(3))
    if choice == 0 and len(genes) > 1:
        genes = [genes[position] for position in rng.permutation(len(genes))]
    elif choice == 1 and len(genes) < MAX_ACTIONS:
        genes.insert(int(rng.integers(len(genes) + 1)), random_gene(participant, rng))
    else:
        start = int(rng.integers(len(genes)))
        genes[start:] = [random_gene(participant, rng) for _ in genes[start:]]
    return replace(
        participant,
        ds_m=min(max(participant.ds_m + float(rng.normal(0.0, 0.2 * REACH_M)), -REACH_M), REACH_M),
        genes=tuple(genes),
    )


def prolonged(participant: Participant, rng: np.random.Generator) -> Participant:
    """Return a participant with a random number of random actions appended."""
    more = int(rng.integers(MAX_ACTIONS - len(participant.genes) + 1))
    return replace(
        participant, genes=(*participant.genes, *(random_gene(participant, rng) for _ in range(more)))
    )


def crossed_genes(
    first: Participant, second: Participant, rng: np.random.Generator
) -> tuple[Participant, Participant]:
    """Return two participants with the tails of their actions swapped (single-point crossover).

    The cut is the same in both, so each child has as many actions as one of its parents, and no action is lost.

    Args:
        first: A participant with two or more actions.
        second: A participant with two or more actions.
        rng: Source of all randomness.
    """
    cut = int(rng.integers(1, min(len(first.genes), len(second.genes))))
    return (
        replace(first, genes=first.genes[:cut] + second.genes[cut:]),
        replace(second, genes=second.genes[:cut] + first.genes[cut:]),
    )


def crossed_uniformly(
    first: Solution, second: Solution, rng: np.random.Generator
) -> tuple[Solution, Solution]:
    """Return two solutions with participants swapped at random.

    Where a pair of like kind is not swapped, individual actions are swapped at random instead.

    Args:
        first: A solution with one or more participants.
        second: A solution with one or more participants.
        rng: Source of all randomness.
    """
    ones, others = list(first), list(second)
    for place in range(min(len(ones), len(others))):
        if rng.random() < 0.5:
            ones[place], others[place] = others[place], ones[place]
        elif ones[place].on_foot == others[place].on_foot:
            ones[place], others[place] = _swapped_genes(ones[place], others[place], rng)
    longer, shorter = (ones, others) if len(ones) > len(others) else (others, ones)
    for participant in longer[len(shorter) :]:
        if rng.random() < 0.5:
            longer.remove(participant)
            shorter.append(participant)
    return tuple(ones), tuple(others)


def _swapped_genes(
    first: Participant, second: Participant, rng: np.random.Generator
) -> tuple[Participant, Participant]:
    ones, others = list(first.genes), list(second.genes)
    for place in range(min(len(ones), len(others))):
        if rng.random() < 0.5:
            ones[place], others[place] = others[place], ones[place]
    return replace(first, genes=tuple(ones)), replace(second, genes=tuple(others))


def mutated_randomly(
    solution: Solution, newcomer: Participant, max_participants: int, rng: np.random.Generator
) -> Solution:
    """Return a solution with one random change: a small or major one, or a participant added, removed or replaced.

    Args:
        solution: The solution to change.
        newcomer: The participant to add or to replace another with.
        max_participants: Largest number of participants.
        rng: Source of all randomness.
    """
    changed = list(solution)
    place = int(rng.integers(len(changed)))
    choice = int(rng.integers(5))
    if choice == 0:
        changed[place] = small_change(changed[place], rng)
    elif choice == 1:
        changed[place] = major_change(changed[place], rng)
    elif choice == 2 and len(changed) < max_participants:
        changed.append(newcomer)
    elif choice == 3 and len(changed) > 1:
        del changed[place]
    else:
        changed[place] = newcomer
    return tuple(changed)


def _gene(action: Action, low_s: float, high_s: float, rng: np.random.Generator, least: float = 0.0) -> Gene:
    """Draw an action's duration from a range, and its magnitude from the range that starts at the share `least`."""
    return Gene(
        action=action,
        duration_s=float(np.clip(rng.uniform(low_s, high_s), MIN_DURATION_S, MAX_DURATION_S)),
        magnitude=magnitude_of(action, float(rng.uniform(least, 1.0))),
    )


def _vehicle(
    rng: np.random.Generator, ds_m: float, dd_m: float, speed_mps: float, *genes: Gene, oncoming: bool = False
) -> Participant:
    kind = Kind.VAN if rng.random() < 0.25 else Kind.CAR
    heading = math.pi if oncoming else 0.0
    return Participant(
        kind=kind, ds_m=ds_m, dd_m=dd_m, dyaw_rad=heading, speed_mps=speed_mps, genes=tuple(genes)
    )


def brake_ahead(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Draw a vehicle ahead of the ego that brakes hard without a reason."""
    return (
        _vehicle(
            rng,
            float(rng.uniform(14.0, 32.0)),
            0.0,
            float(rng.uniform(7.0, 11.0)),
            _gene(Action.KEEP, 0.5, 4.0, rng),
            _gene(Action.BRAKE, 1.5, 4.0, rng, 0.5),
        ),
    )


def cut_in(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Draw a vehicle beside or ahead of the ego that moves into its lane and slows down."""
    return (
        _vehicle(
            rng,
            float(rng.uniform(4.0, 22.0)),
            road.lane_width_m,
            float(rng.uniform(7.0, 11.0)),
            _gene(Action.KEEP, 0.5, 3.0, rng),
            _gene(Action.CUT_IN, 1.0, 2.5, rng, 0.3),
            _gene(Action.BRAKE, 1.0, 3.0, rng),
        ),
    )


def overtaken(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Draw a vehicle that approaches from behind, overtakes and cuts in."""
    return (
        _vehicle(
            rng,
            float(rng.uniform(-30.0, -10.0)),
            road.lane_width_m,
            float(rng.uniform(9.0, 13.0)),
            _gene(Action.ACCELERATE, 1.0, 3.0, rng),
            _gene(Action.CUT_IN, 1.0, 2.5, rng, 0.3),
            _gene(Action.BRAKE, 1.0, 3.0, rng),
        ),
    )


def from_behind(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Draw a vehicle behind the ego that accelerates towards it."""
    return (
        _vehicle(
            rng,
            float(rng.uniform(-35.0, -12.0)),
            0.0,
            float(rng.uniform(8.0, 12.0)),
            _gene(Action.ACCELERATE, 1.0, 4.0, rng, 0.3),
            _gene(Action.KEEP, 1.0, 4.0, rng),
        ),
    )


def oncoming_overtake(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Draw an oncoming vehicle that overtakes a slower one through the ego's lane."""
    ahead_m = float(rng.uniform(34.0, 48.0))
    return (
        _vehicle(
            rng, ahead_m, road.lane_width_m, float(rng.uniform(8.0, 12.0)),
            _gene(Action.KEEP, 0.5, 1.5, rng), _gene(Action.CHANGE_LEFT, 1.0, 2.0, rng, 0.5),
            _gene(Action.KEEP, 0.5, 2.5, rng), _gene(Action.CHANGE_RIGHT, 1.0, 2.0, rng, 0.5), oncoming=True,
        ),
        _vehicle(
            rng, ahead_m - float(rng.uniform(8.0, 16.0)), road.lane_width_m, float(rng.uniform(4.0, 7.0)),
            _gene(Action.KEEP, 2.0, 6.0, rng), _gene(Action.KEEP, 2.0, 6.0, rng), oncoming=True,
        ),
    )  # fmt: skip


def person_crosses(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Draw a pedestrian who steps onto the road and may stop in the middle of it."""
    right = rng.random() < 0.6
    second = _gene(Action.BRAKE, 0.5, 3.0, rng) if rng.random() < 0.4 else _gene(Action.CROSS, 1.0, 5.0, rng)
    first = _gene(Action.CROSS, 1.0, 3.0, rng, 0.2)
    genes = (_gene(Action.KEEP, 0.5, 3.0, rng), first, second)
    return (
        Participant(
            kind=Kind.PEDESTRIAN,
            ds_m=float(rng.uniform(8.0, 40.0)),
            dd_m=road.right_kerb_m - 0.5 if right else road.left_kerb_m + 0.5,
            dyaw_rad=0.0,
            speed_mps=float(rng.uniform(0.0, 1.5)),
            genes=genes,
        ),
    )


def squeeze(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Draw an oncoming vehicle that drifts into the ego's lane while a pedestrian steps onto the road."""
    drifts = _vehicle(
        rng,
        float(rng.uniform(30.0, 48.0)),
        road.lane_width_m,
        float(rng.uniform(6.0, 10.0)),
        _gene(Action.CHANGE_LEFT, 1.0, 3.0, rng),
        _gene(Action.KEEP, 1.0, 4.0, rng),
        oncoming=True,
    )
    return drifts, *person_crosses(road, rng)


def from_street(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Draw a vehicle that pulls out of a side street; without side streets, one that brakes ahead."""
    if not road.streets_m:
        return brake_ahead(road, rng)
    right = rng.random() < 0.5
    street_m = road.streets_m[int(rng.integers(len(road.streets_m)))]
    (vehicle,) = brake_ahead(road, rng)
    return (
        Participant(
            kind=vehicle.kind,
            ds_m=street_m,
            dd_m=float(rng.uniform(8.0, 35.0)) * (-1.0 if right else 1.0),
            dyaw_rad=0.5 * math.pi,
            speed_mps=float(rng.uniform(4.0, 11.0)),
            genes=(_gene(Action.KEEP, 1.0, 4.0, rng), _gene(Action.ACCELERATE, 1.0, 4.0, rng)),
        ),
    )


PATTERNS: Final[tuple[Pattern, ...]] = (
    brake_ahead,
    cut_in,
    overtaken,
    from_behind,
    oncoming_overtake,
    person_crosses,
    squeeze,
    from_street,
)
MOTIFS: Final[tuple[Pattern, ...]] = (brake_ahead, cut_in, from_behind, overtaken)
"""MOSAT's motifs: brake ahead; cut in from the side; accelerate behind; overtake and cut in."""


def hostile_solution(road: RoadLimits, max_participants: int, rng: np.random.Generator) -> Solution:
    """Draw a solution from one to three hand-written patterns; it may need repair.

    Args:
        road: The road.
        max_participants: Largest number of participants.
        rng: Source of all randomness.
    """
    participants: list[Participant] = []
    for _ in range(int(rng.integers(1, 4))):
        participants.extend(PATTERNS[int(rng.integers(len(PATTERNS)))](road, rng))
    return tuple(participants[:max_participants])


def motif(road: RoadLimits, rng: np.random.Generator) -> Participant:
    """Draw a participant from one of MOSAT's motifs."""
    return MOTIFS[int(rng.integers(len(MOTIFS)))](road, rng)[0]
