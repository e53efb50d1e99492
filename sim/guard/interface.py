"""The interface of a guard: what it receives at each control step, and what it answers.

A guard runs in the car beside the driving system. It receives what the driving system receives and commands, never
the truth, and answers with the probability that the requirement will be violated within each of its horizons, and
with an alarm. Create a new one for each drive.

Values created at every step are named tuples, as in `brink.sim.driving.interface`. Create them with keywords.
"""

from typing import NamedTuple, Protocol

from brink.sim.driving.interface import Command, Observation, PlanState


class RangeScan(NamedTuple):
    """One scan of a coarse forward range sensor.

    Attributes:
        distances_m: Distance from the front bumper to the nearest obstacle in each sector, from left to right;
            infinite if nothing is in range, NaN if the sector was not measured.
    """

    distances_m: tuple[float, ...]


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
        ...

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
        ...
