"""Checks of a driving system: whether ten streets are driven, and the same drive is the same whenever it is driven.

All drives run in simulation processes, as those of campaigns do: a system that hangs or crashes ends only such a
process. The streets are driven with the ground truth, so what goes wrong is the driving system's doing.
"""

import statistics
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Self

import numpy as np

from brink.sim.driving_systems.option import DrivingOption, wrong_settings
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode
from brink.sim.testing import ContractBroken
from brink.sim.trace import Trace
from brink.sim.urban.options import DriveOptions
from brink.sim.world.scenario import SCENARIO_CHOICES, UrbanScenario, words_of_scenario
from brink.worker.errors import ChildFailedToStart
from brink.worker.process import EpisodeProcess, episode_result
from brink.worker.wire import JobFailed

REQUIREMENTS: Final = ("no-collision@1", "lane-keeping@1", "red-light@1", "speed-limit@1")
DURATION_S: Final = 20.0
TIMEOUT_S: Final = 60.0
MANY: Final = 0.5
"""From this share of the streets on, standing is worth a remark: somebody may be in the way in some."""
_STANDS_S: Final = 12.0
"""About as long as a red light."""
_ROWS: Final = (
    ("noon", "clear", 0, "straight", 0, 1, "follow_road"),
    ("noon", "clear", 18, "straight", 1, 0, "follow_road"),
    ("noon", "cloudy", 0, "right", 0, 1, "follow_road"),
    ("sunset", "clear", 0, "left", 0, 1, "follow_road"),
    ("noon", "wet", 18, "left", 2, 0, "follow_road"),
    ("noon", "clear", 0, "crossroad", 0, 0, "follow_road"),
    ("night", "clear", 18, "crossroad", 1, 0, "follow_road"),
    ("noon", "clear", 0, "straight", 0, 0, "first_exit"),
    ("noon", "soft_rain", 0, "straight", 2, 0, "second_exit"),
    ("noon", "clear", 18, "crossroad", 2, 1, "first_exit"),
)
"""Values of the scenario's parameters, in the order of `SCENARIO_CHOICES`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreetDrive:
    """One street.

    Attributes:
        street: The street in words.
        way_m: How far the ego came.
        stood_s: How long it stood.
        ended: How the drive ended: ``goal``, ``collision`` or ``time``.
        violated_s: When each violated requirement was first violated.
        failed: Why there is no verdict; None if there is one.
    """

    street: str
    way_m: float = 0.0
    stood_s: float = 0.0
    ended: str = ""
    violated_s: Mapping[str, float] = field(default_factory=dict)
    failed: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingCheck:
    """What a check found.

    Attributes:
        drives: One for each street, up to the first that hangs.
        faults: What breaks the contract of driving systems.
        remarks: What looks wrong in how it drives, though it may be meant.
    """

    drives: Sequence[StreetDrive]
    faults: Sequence[str]
    remarks: Sequence[str]


def check_driving_system(
    system: str,
    settings: Mapping[str, Json] | None = None,
    *,
    plugins: Collection[str] = (),
    streets: int = len(_ROWS),
    timeout_s: float = TIMEOUT_S,
) -> DrivingCheck:
    """Check that a driving system fulfils its contract, for tests of your own.

    Clauses: it can be made; all its decisions are valid; each drive takes less than the time limit; the same drive is
    the same when it is driven again, after other streets, and in another process.

    Args:
        system: Id of a registered driving system, or ``module:Factory``.
        settings: Its settings.
        plugins: Modules to load, besides those in ``BRINK_PLUGINS``.
        streets: Number of streets, 1 to 10.
        timeout_s: Wall-clock limit of a drive.

    Raises:
        ContractBroken: A clause is broken.
        InvalidEpisode: The settings are not JSON.
    """
    check = drive_streets(system, settings, plugins=plugins, streets=streets, timeout_s=timeout_s)
    if check.faults:
        raise ContractBroken("; ".join(check.faults))
    return check


def drive_streets(
    system: str,
    settings: Mapping[str, Json] | None = None,
    *,
    plugins: Collection[str] = (),
    streets: int = len(_ROWS),
    timeout_s: float = TIMEOUT_S,
) -> DrivingCheck:
    """Drive some streets, several times each, and return what is wrong; see `check_driving_system`.

    Raises:
        InvalidEpisode: The settings are not JSON.
    """
    if (why := wrong_settings(settings or {})) is not None:
        raise InvalidEpisode(f"settings: {why}")
    specs = _specs(DrivingOption(system=system, settings=settings or {}))[:streets]
    try:
        with _Drives(plugins, timeout_s) as drive:
            first = drive.all(specs)
            if failed := [one for one in first if isinstance(one, str)]:
                return _check(specs, first, list(dict.fromkeys(failed)))
            twice = drive.all(specs[-1:])
            backwards = drive.all(specs[::-1])[::-1]
        with _Drives(plugins, timeout_s) as drive:
            elsewhere = drive.all(specs[::-2])
    except ChildFailedToStart as error:
        return _check(specs, [], [str(error)])
    repeats = [
        ("driven again at once", specs[-1:], first[-1:], twice),
        ("driven again after other streets", specs, first, backwards),
        ("driven in another process", specs[::-2], first[::-2], elsewhere),
    ]
    faults = [_difference(*repeat) for repeat in repeats]
    return _check(specs, first, [fault for fault in faults if fault is not None])


def _check(
    specs: Sequence[EpisodeSpec], first: Sequence[EpisodeResult | str], faults: Sequence[str]
) -> DrivingCheck:
    drives = [_street_drive(spec, one) for spec, one in zip(specs, first, strict=False)]
    return DrivingCheck(drives=drives, faults=faults, remarks=_remarks(drives))


def _specs(option: DrivingOption) -> list[EpisodeSpec]:
    scenarios = [UrbanScenario.from_json(dict(zip(SCENARIO_CHOICES, row, strict=True))) for row in _ROWS]
    return [
        EpisodeSpec(
            simulator="brink-drive@3",
            scenario=scenario.to_json(),
            behaviour={"mode": "oracle"},
            requirements=REQUIREMENTS,
            seed=number,
            duration_s=DURATION_S,
            options={**DriveOptions().to_json(), **option.to_options()},
        )
        for number, scenario in enumerate(scenarios, start=1)
    ]


class _Drives:
    """A simulation process that drives. A context manager."""

    def __init__(self, plugins: Collection[str], timeout_s: float) -> None:
        self._process = EpisodeProcess(plugins=tuple(plugins))
        self._timeout_s = timeout_s

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._process.close()

    def all(self, specs: Sequence[EpisodeSpec]) -> list[EpisodeResult | str]:
        """Return the result of each drive, or why there is none; the first that hangs is the last one."""
        results: list[EpisodeResult | str] = []
        for spec in specs:
            outcome = self._process.run(spec.to_json(), record=True, timeout_s=self._timeout_s)
            results.append(outcome.message if isinstance(outcome, JobFailed) else episode_result(outcome))
            if isinstance(outcome, JobFailed) and outcome.reason == "timeout":
                break
        return results


def _difference(
    how: str,
    specs: Sequence[EpisodeSpec],
    before: Sequence[EpisodeResult | str],
    after: Sequence[EpisodeResult | str],
) -> str | None:
    """Describe in how many streets a repeated drive differs from the first one; None if it does in none."""
    found = []
    for spec, old, new in zip(specs, before, after, strict=False):
        assert not isinstance(old, str)
        if isinstance(new, str):
            found.append((spec, f"it fails: {new.splitlines()[0]}"))
        elif (old.verdicts, old.objectives, old.features, old.trace) != (
            new.verdicts,
            new.objectives,
            new.features,
            new.trace,
        ):
            found.append((spec, _first_difference(old, new)))
    if not found:
        return None
    spec, words = found[0]
    return (
        f"{how}, {len(found)} of {len(specs)} drives are not the same: in street {spec.seed}, {words}. Keep nothing "
        "from one drive to the next, read no clock, and draw random numbers from start.seed alone"
    )


def _first_difference(old: EpisodeResult, new: EpisodeResult) -> str:
    """Describe from when on the ego of two drives is elsewhere."""
    assert old.trace is not None
    assert new.trace is not None
    before, after = Trace.from_bytes(old.trace), Trace.from_bytes(new.trace)
    steps = min(len(before.time_s), len(after.time_s))
    moved = np.flatnonzero((before.ego[:steps] != after.ego[:steps]).any(axis=1))
    if not moved.size:
        return "the ego moves in the same way, but what the system says of its plan or objects differs"
    at = int(moved[0])
    far_m = float(np.hypot(*(before.ego[:steps, :2] - after.ego[:steps, :2]).T).max())
    far = f"{far_m:.2g}" if far_m < 1.0 else f"{far_m:.0f}"
    return f"the ego moves otherwise from {before.time_s[at]:.1f} s on, and gets up to {far} m away"


def _street_drive(spec: EpisodeSpec, outcome: EpisodeResult | str) -> StreetDrive:
    street = words_of_scenario(spec.scenario)
    if isinstance(outcome, str):
        return StreetDrive(street=street, failed=outcome)
    violated = {
        name: one.violated_at_s for name, one in outcome.verdicts.items() if one.violated_at_s is not None
    }
    way_m, stood_s, ended = (outcome.features[name] for name in ("way_m", "stood_s", "ended"))
    assert isinstance(way_m, float | int)
    assert isinstance(stood_s, float | int)
    return StreetDrive(street=street, way_m=way_m, stood_s=stood_s, ended=str(ended), violated_s=violated)


_VIOLATIONS: Final[Mapping[str, str]] = {
    "no-collision@1": "hits somebody or something",
    "lane-keeping@1": "leaves its lane, after {:.1f} s in the median; angles and offsets are positive to the left",
    "red-light@1": "runs a red light; observation.light says where to stop",
    "speed-limit@1": "drives too fast, after {:.1f} s in the median; start.route.speed_limit_mps is in m/s",
}


def _remarks(drives: Sequence[StreetDrive]) -> list[str]:
    """Describe what many drives have in common, and what should not happen with the ground truth."""
    return list(_found_remarks([one for one in drives if one.failed is None]))


def _found_remarks(driven: Sequence[StreetDrive]) -> Iterator[str]:
    count = len(driven)
    if not count:
        return
    standing = sum(one.stood_s > _STANDS_S for one in driven)
    if standing >= MANY * count:
        yield f"in {standing} of {count} streets it stands for more than {_STANDS_S:g} s of {DURATION_S:g} s"
    for name, words in _VIOLATIONS.items():
        times_s = [one.violated_s[name] for one in driven if name in one.violated_s]
        if times_s:
            yield f"in {len(times_s)} of {count} streets it {words.format(statistics.median(times_s))}"
