"""The interface of a guard: what it receives at each control step, and what it answers.

A guard runs in the car beside the driving system. It receives what the driving system receives and commands, never
the truth, and answers with the probability that the requirement will be violated within each of its horizons, and
with an alarm. Create a new one for each drive.

Values created at every step are named tuples, as in `brink.sim.driving.interface`. Create them with keywords.
"""

from typing import Final, NamedTuple, Protocol

from brink.sim.driving.interface import Command, Observation, PlanState

RANGE_M: Final = 60.0
SECTOR_EDGES_DEG: Final = (30.0, 12.0, 4.0, -4.0, -12.0, -30.0)
"""Edges of the sectors from left to right, counter-clockwise from straight ahead."""
SECTORS: Final = len(SECTOR_EDGES_DEG) - 1


class RangeScan(NamedTuple):
    """One scan of a coarse forward range sensor.

    Attributes:
        distances_m: Distance from the front bumper to the nearest obstacle in each sector, from left to right;
            infinite if nothing is in range, NaN if the sector was not measured.
    """

    distances_m: tuple[float, ...]


class KnownConditions(NamedTuple):
    """What a car knows about the time of day and the weather: fractions in [0, 1], or -1 if unknown.

    Attributes:
        rain: How hard it rains.
        wet: How wet the road is.
        dark: How dark it is.
    """

    rain: float = -1.0
    wet: float = -1.0
    dark: float = -1.0


class GuardReading(NamedTuple):
    """The answer of a guard.

    Attributes:
        probabilities: Probability of a violation within each of the guard's horizons, each in [0, 1].
        alarm: Whether the guard asks for the fallback. An alarm may persist after the probabilities have fallen.
    """

    probabilities: tuple[float, ...]
    alarm: bool


class Guard(Protocol):
    """A guard in one drive."""

    @property
    def horizons_s(self) -> tuple[float, ...]:
        """The horizons of the probabilities in seconds, ascending."""

    def step(
        self,
        observation: Observation,
        command: Command,
        plan: PlanState | None = None,
        scan: RangeScan | None = None,
    ) -> GuardReading:
        """Process one control step (20 Hz) and return the current reading.

        The reading changes at perception steps, where `observation.boxes` is not None. At the steps between, it is
        that of the last perception step.

        Args:
            observation: What the driving system received in this step.
            command: What the driving system commanded in this step, before any fallback changed it.
            plan: The planner's decision in this step, if known.
            scan: The range sensor's scan, at perception steps of a car that has one; None otherwise.
        """


class Fallback(Protocol):
    """What the car does while its guard asks for it. Create a new one for each drive.

    A class whose attribute `waits_for_alarm` is true promises to change nothing before the first alarm of a drive. A
    drive in which no alarm can occur then need not run again with it.
    """

    @property
    def active(self) -> bool:
        """Whether it intervened in the last control step."""

    def perceive(self, observation: Observation, reading: GuardReading) -> Observation:
        """Return the observation that the driving system receives; called once in each control step, before `step`.

        Args:
            observation: What was observed.
            reading: The guard's reading of the step before.
        """

    def step(self, observation: Observation, command: Command, reading: GuardReading) -> Command:
        """Return the command that the car executes.

        Args:
            observation: What was observed.
            command: What the driving system commands.
            reading: The guard's reading of this step.
        """
