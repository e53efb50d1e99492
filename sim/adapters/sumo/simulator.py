"""The simulator `sumo@1`: traffic in SUMO, in which automated vehicles perceive what is ahead with errors."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from brink.sim.adapters.sumo.demand import EGO, Stream, comfortable_braking_mps2, demand_xml, generator
from brink.sim.adapters.sumo.drawing import Drawing
from brink.sim.adapters.sumo.facts import SumoFacts, collision_of
from brink.sim.adapters.sumo.library import SUMO_STEP_S, CannotStart, Library, simulation
from brink.sim.adapters.sumo.own_files import thinned_demand
from brink.sim.adapters.sumo.perception import ALL_CHECKS, Perception, driver_state_options
from brink.sim.adapters.sumo.specification import HARDEST_BRAKING_MPS2, SIMULATOR_ID, Drive, Incident
from brink.sim.catalogue import make_requirements
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.formula_requirement import with_margins
from brink.sim.provenance import provenance, trace_header, versions_with
from brink.sim.requirements import Requirement, WorldSample, features_of, verdicts_of
from brink.sim.trace import WORDS

SETTLES_S: Final = 10.0
"""How long the traffic drives before the episode begins, on the networks that ship with Brink."""
STANDS_S: Final = 2.0
"""How long a lead that has braked stands still."""
LONGEST_WAIT_S: Final = 3600.0
"""How late the ego of the user's own demand may depart."""
_ROADS: Final = Path(__file__).parent / "roads"
_LIMITS_BRAKING: Final = 4
"""The check of SUMO's speed mode that keeps vehicles from braking as hard as the incident says."""
_EPISODE_ENDED: Final = "the ego left the network before the episode began"


@dataclass(slots=True, kw_only=True)
class _Outcome:
    """The result of an episode so far.

    Attributes:
        ended: ``time``, ``collision`` or ``goal``.
        ended_at_s: When.
        vehicles: Every vehicle that was in the network.
        crashes: Pairs of vehicles that collided.
    """

    ended: str = "time"
    ended_at_s: float = 0.0
    vehicles: set[str] = field(default_factory=set)
    crashes: set[tuple[str, str]] = field(default_factory=set)


class Sumo:
    """Runs episodes of traffic in SUMO, one after another."""

    id = SIMULATOR_ID

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Args:
            spec: The episode.
            record: Whether the result includes the trace.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: SUMO failed.
        """
        cpu_s = time.process_time()
        drive = Drive.of(spec)
        requirements = make_requirements(spec.requirements, spec.formulas)
        with TemporaryDirectory(prefix="brink-sumo-") as folder:
            options = [*_files(drive, spec, Path(folder)), *_conditions(drive, spec)]
            try:
                with simulation(options) as sumo:
                    episode = _Episode(sumo, spec, drive, requirements, record=record)
                    episode.run()
            except CannotStart as error:
                if drive.traffic.files is None:
                    raise
                raise InvalidEpisode(f"scenario.files: {error}") from error
        verdicts = verdicts_of(requirements)
        versions = versions_with("libsumo")
        trace = None
        if episode.drawing is not None:
            header = {**trace_header(spec, verdicts, versions), WORDS: drive.words}
            trace = with_margins(episode.drawing.trace(header), requirements).to_bytes()
        return EpisodeResult(
            verdicts=verdicts,
            objectives={f"{name}:robustness": verdict.robustness for name, verdict in verdicts.items()},
            features={**episode.features(), **features_of(requirements)},
            provenance=provenance(self.id, cpu_s, versions, simulated_s=episode.simulated_s),
            trace=trace,
        )


def _files(drive: Drive, spec: EpisodeSpec, folder: Path) -> list[str]:
    """Write the demand, and return the options that name it and the network."""
    demand, files = folder / "demand.rou.xml", drive.traffic.files
    if files is None:
        network = _ROADS / f"{drive.traffic.network}.net.xml.gz"
        text = demand_xml(drive, spec.seed, SETTLES_S + spec.duration_s)
        demand.write_text(text, encoding="utf-8")
    else:
        files.check_unchanged()
        network = Path(files.network).resolve()
        rng = generator(spec.seed, Stream.OWN_DEMAND)
        demand.write_bytes(thinned_demand(files, drive.traffic.demand, rng))
    return ["--net-file", str(network), "--route-files", str(demand)]


def _conditions(drive: Drive, spec: EpisodeSpec) -> list[str]:
    """Return the SUMO options for the start of the traffic, driver states and the random seed."""
    drawn = int(generator(spec.seed, Stream.SUMO).integers(2**31 - 1))
    options = ["--seed", str(drawn), *driver_state_options(drive.error)]
    traffic = drive.traffic
    if traffic.files is None:
        return [*options, "--begin", f"{traffic.begin_s:.2f}"]
    equipped = ["--device.driverstate.explicit", traffic.files.ego]
    return [*options, *equipped, "--device.driverstate.probability", repr(traffic.automated)]


class _Episode:
    """One episode in a running simulation.

    Attributes:
        drawing: The recorded samples; None if nothing is recorded.
        simulated_s: Simulated time, including that before the episode began.
    """

    def __init__(
        self,
        sumo: Library,
        spec: EpisodeSpec,
        drive: Drive,
        requirements: Mapping[str, Requirement],
        *,
        record: bool,
    ) -> None:
        self._sumo = sumo
        self._spec = spec
        self._drive = drive
        self._requirements = requirements
        self._ego = EGO if drive.traffic.files is None else drive.traffic.files.ego
        self._perception = Perception(sumo, drive.error, self._ego)
        self._incident = _LeadBrakes(sumo, drive)
        self._outcome = _Outcome()
        self._record = record
        self._facts: SumoFacts | None = None
        self.drawing: Drawing | None = None
        self.simulated_s = 0.0
        self._time_loss_s = 0.0

    def run(self) -> None:
        """Run the episode to its end."""
        begins_s = float(self._sumo.simulation.getTime())
        self._settle()
        self._prepare_ego()
        facts = self._facts = SumoFacts(self._sumo, self._ego)
        if self._record:
            self.drawing = Drawing(self._sumo, self._ego, tuple(self._requirements), facts)
        self._observe(facts.sample(0.0, None))
        steps = math.ceil(self._spec.duration_s / SUMO_STEP_S - 1e-6)
        for step in range(1, steps + 1):
            before_s = (step - 1) * SUMO_STEP_S
            self._perception.update(before_s)
            self._incident.update(before_s, facts.lead)
            self._step()
            self._outcome.ended_at_s = time_s = step * SUMO_STEP_S
            collision = collision_of(self._sumo, self._ego)
            if self._ego in self._sumo.simulation.getArrivedIDList():
                self._outcome.ended = "goal"
                break
            self._observe(facts.sample(time_s, collision))
            if collision is not None:
                self._outcome.ended = "collision"
                break
        self.simulated_s = float(self._sumo.simulation.getTime()) - begins_s
        self._time_loss_s = self._mean_time_loss_s()

    def _settle(self) -> None:
        """Let the traffic drive until the episode begins."""
        own = self._drive.traffic.files is not None
        for _ in range(round((LONGEST_WAIT_S if own else SETTLES_S) / SUMO_STEP_S)):
            self._step()
            if own and self._ego in self._outcome.vehicles:
                return
        if self._ego not in self._sumo.vehicle.getIDList():
            reason = f"the ego {self._ego!r} has not departed within {LONGEST_WAIT_S:g} s"
            raise InvalidEpisode(f"scenario.files: {reason}") if own else SimulationCrashed(_EPISODE_ENDED)

    def _prepare_ego(self) -> None:
        """Configure the ego as specified; on the networks that ship with Brink, the demand has already done so."""
        own, traffic = self._sumo.vehicle, self._drive.traffic
        if traffic.files is None:
            return
        hardest_mps2 = HARDEST_BRAKING_MPS2[traffic.surface]
        for vehicle in own.getIDList():
            self._brake_on(vehicle, hardest_mps2)
        own.setImperfection(self._ego, 0.0)
        own.setTau(self._ego, self._drive.headway_s)

    def _brake_on(self, vehicle: str, hardest_mps2: float) -> None:
        own = self._sumo.vehicle
        own.setEmergencyDecel(vehicle, min(hardest_mps2, own.getEmergencyDecel(vehicle)))
        own.setDecel(vehicle, min(comfortable_braking_mps2(hardest_mps2), own.getDecel(vehicle)))

    def _step(self) -> None:
        self._sumo.simulationStep()
        simulation_now = self._sumo.simulation
        for vehicle in simulation_now.getDepartedIDList():
            self._outcome.vehicles.add(vehicle)
            self._perception.enter(vehicle)
            if self._facts is not None and self._drive.traffic.files is not None:
                self._brake_on(vehicle, HARDEST_BRAKING_MPS2[self._drive.traffic.surface])
        for vehicle in simulation_now.getArrivedIDList():
            self._perception.leave(vehicle)
            self._incident.leave(vehicle)
        for one in simulation_now.getCollisions():
            self._outcome.crashes.add((min(one.collider, one.victim), max(one.collider, one.victim)))

    def _observe(self, sample: WorldSample) -> None:
        robustness = {name: one.observe(sample) for name, one in self._requirements.items()}
        if self.drawing is not None:
            self.drawing.sample(sample, robustness, self._perception.gap_state())

    def _mean_time_loss_s(self) -> float:
        """Return the mean time loss of the vehicles in the network, compared with empty roads."""
        own = self._sumo.vehicle
        losses_s = [float(own.getTimeLoss(vehicle)) for vehicle in own.getIDList()]
        return sum(losses_s) / max(1, len(losses_s))

    def features(self) -> dict[str, Json]:
        """Return facts about the episode that no requirement measures."""
        facts, outcome = self._facts, self._outcome
        assert facts is not None
        return {
            "ended": outcome.ended,
            "ended_at_s": outcome.ended_at_s,
            "least_front_gap_m": facts.smallest_gap_m,
            "least_time_to_collision_s": facts.smallest_ttc_s,
            "hardest_braking_mps2": facts.hardest_braking_mps2,
            "vehicles": len(outcome.vehicles),
            "crashes": len(outcome.crashes),
            "mean_time_loss_s": self._time_loss_s,
            "error_acted_at_s": self._perception.acted_at_s,
            "incident_at_s": self._incident.began_at_s,
        }


class _LeadBrakes:
    """The vehicle ahead of the ego brakes to a standstill, stands, and drives on.

    Attributes:
        began_at_s: When it began to brake; None if it never did.
    """

    def __init__(self, sumo: Library, drive: Drive) -> None:
        traffic = drive.traffic
        self._sumo = sumo
        self._at_s = traffic.incident_s if traffic.incident is Incident.LEAD_BRAKES else math.inf
        # Nobody can brake harder than the road allows.
        self._braking_mps2 = min(traffic.incident_mps2, HARDEST_BRAKING_MPS2[traffic.surface])
        self._lead: str | None = None
        self._brakes_until_s = math.inf
        self._stands_until_s = math.inf
        self.began_at_s: float | None = None

    def update(self, time_s: float, lead: str | None) -> None:
        """Begin, keep up or end the braking, before the step that begins at a time.

        Args:
            time_s: The time.
            lead: The vehicle ahead of the ego; the first one at or after the incident's time brakes.
        """
        own = self._sumo.vehicle
        due = self.began_at_s is None and time_s >= self._at_s - SUMO_STEP_S / 2
        if due and lead is not None and self._braking_mps2 > 0.0:
            self.began_at_s, self._lead = time_s, lead
            speed_mps = float(own.getSpeed(lead))
            brakes_s = max(SUMO_STEP_S, speed_mps / self._braking_mps2)
            own.setSpeedMode(lead, ALL_CHECKS - _LIMITS_BRAKING)
            own.slowDown(lead, 0.0, brakes_s)
            self._brakes_until_s = time_s + brakes_s
            self._stands_until_s = self._brakes_until_s + STANDS_S
        elif self._lead is not None and self.began_at_s is not None:
            if time_s >= self._stands_until_s:
                own.setSpeed(self._lead, -1.0)
                own.setSpeedMode(self._lead, ALL_CHECKS)
                self._lead = None
            elif time_s >= self._brakes_until_s:
                own.setSpeed(self._lead, 0.0)

    def leave(self, vehicle: str) -> None:
        """Forget a vehicle that has left the network."""
        if vehicle == self._lead:
            self._lead = None
