"""Contract test suites for plug-ins, to be run from your own tests."""

import json
import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from brink.sim.catalogue import Simulator
from brink.sim.driving.interface import LightState
from brink.sim.episode import EpisodeResult, EpisodeSpec
from brink.sim.errors import InvalidEpisode
from brink.sim.requirements import Collision, CollisionKind, Requirement, WorldSample
from brink.sim.trace import Trace

_UNITS = ("m", "s", "m/s", "m/s²", "m/s^2", "rad", "1")
_STEPS = 200


class ContractBroken(AssertionError):
    """A plug-in breaks its contract; the message states the clause and shows what was returned."""


def check_requirement(make: Callable[[], Requirement], *, seeds: tuple[int, ...] = (0, 1, 2)) -> None:
    """Check that a requirement fulfils its contract on quiet, empty and chaotic episodes.

    Clauses: the unit is known; the horizon is positive and finite; before any sample, the robustness is the horizon
    and nothing is violated; every robustness is finite and within the horizon; the verdict is the smallest robustness
    observed; it is violated if and only if a robustness was negative, since the time of the first; features are JSON
    without NaN; equal samples give equal results; instances share no state.

    Args:
        make: Returns a new requirement, as registered.
        seeds: Seeds of the chaotic episodes.

    Raises:
        ContractBroken: A clause is broken.
    """
    _check_untouched(make())
    episodes = [list(_empty_episode()), *(list(_chaotic_episode(seed)) for seed in seeds)]
    for samples in episodes:
        first, again = make(), make()
        bystander = make()
        series = [_observed(first, sample) for sample in samples]
        _check_verdict(first, series, [sample.time_s for sample in samples])
        _check_features(first)
        _require(
            series == [again.observe(sample) for sample in samples] and first.verdict() == again.verdict(),
            "equal samples give equal answers",
            again,
        )
        _check_untouched(bystander)


def check_simulator(
    make: Callable[[], Simulator], specs: Sequence[EpisodeSpec], *, invalid: Sequence[EpisodeSpec] = ()
) -> None:
    """Check that a simulator fulfils its contract on some episodes.

    Clauses: a result has a verdict for each requirement, in order; robustness and objectives are finite; a verdict
    says when it was violated only if it was, and always if the simulator records traces; verdicts, objectives and
    features are JSON without NaN; equal specifications give equal results, from the same simulator and from another
    one, right away and after all other episodes; so do their traces, byte by byte, and recording one changes
    nothing else; a trace can be read, and records each requirement; a specification for another simulator, or one
    that can never run, raises `InvalidEpisode`, after which the simulator still works.

    Provenance is not compared. To check other processes as well, call this in a fresh one, or compare results.

    Args:
        make: Returns a new simulator, as registered.
        specs: Episodes that differ from each other, at least two.
        invalid: Specifications that can never run.

    Raises:
        ContractBroken: A clause is broken.
        ValueError: There are fewer than two episodes, or two are equal.
    """
    if len({spec.digest() for spec in specs}) < max(2, len(specs)):
        raise ValueError(f"specs: expected at least two different episodes, got {len(specs)}")
    simulator = make()
    first = [simulator.run(spec) for spec in specs]
    for spec, result in zip(specs, first, strict=True):
        _check_result(spec, result)
    for spec in (replace(specs[0], simulator="no-such-simulator@1"), *invalid):
        _check_refused(simulator, spec)
    other = make()
    for index in reversed(range(len(specs))):
        spec, wanted = specs[index], _compared(first[index])
        recorded, elsewhere = simulator.run(spec, record=True), other.run(spec, record=True)
        for result in (recorded, simulator.run(spec), elsewhere):
            _require(
                _compared(result) == wanted,
                f"equal results of equal specifications: {wanted}",
                _compared(result),
            )
        _check_trace(spec, recorded)
        _require(
            elsewhere.trace == recorded.trace, "equal traces of equal specifications", spec.canonical_json()
        )


def _compared(result: EpisodeResult) -> tuple[object, ...]:
    """Return the parts of a result that must be equal for equal specifications."""
    return dict(result.verdicts), dict(result.objectives), dict(result.features)


def _check_result(spec: EpisodeSpec, result: EpisodeResult) -> None:
    _require(
        tuple(result.verdicts) == spec.requirements,
        f"a verdict for each of {', '.join(spec.requirements)}, in order",
        tuple(result.verdicts),
    )
    for name, verdict in result.verdicts.items():
        _require(math.isfinite(verdict.robustness), f"{name}: a finite robustness", verdict)
        _require(
            verdict.violated or verdict.violated_at_s is None,
            f"{name}: no time of a violation without one",
            verdict,
        )
    for name, value in result.objectives.items():
        _require(math.isfinite(value), f"{name}: a finite objective", value)
    for what, facts in (("features", result.features), ("provenance", result.provenance)):
        try:
            text = json.dumps(dict(facts), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ContractBroken(f"expected: {what} are JSON without NaN; got {facts!r}: {error}") from error
        _require(json.loads(text) == facts, f"{what} survive JSON", facts)
    _require(result.trace is None, "no trace unless it is recorded", spec.canonical_json())


def _check_trace(spec: EpisodeSpec, result: EpisodeResult) -> None:
    """Check the trace of a recorded episode; a simulator may have none."""
    if result.trace is None:
        return
    for name, verdict in result.verdicts.items():
        _require(
            verdict.violated == (verdict.violated_at_s is not None),
            f"{name}: violated if and only if it says when, as there is a trace",
            verdict,
        )
    try:
        trace = Trace.from_bytes(result.trace)
    except InvalidEpisode as error:
        raise ContractBroken(f"expected: a trace that can be read; got {error}") from error
    _require(
        set(trace.robustness) == set(spec.requirements),
        f"a trace that records {', '.join(spec.requirements)}",
        tuple(trace.robustness),
    )


def _check_refused(simulator: Simulator, spec: EpisodeSpec) -> None:
    try:
        result = simulator.run(spec)
    except InvalidEpisode:
        return
    except Exception as error:
        raise ContractBroken(
            f"expected: InvalidEpisode for {spec.canonical_json()}; got {type(error).__name__}: {error}"
        ) from error
    raise ContractBroken(f"expected: InvalidEpisode for {spec.canonical_json()}; got {result!r:.200}")


def _require(holds: bool, clause: str, shown: object) -> None:
    if not holds:
        raise ContractBroken(f"expected: {clause}; got {shown!r}")


def _check_untouched(requirement: Requirement) -> None:
    _require(requirement.unit in _UNITS, f"unit is one of {', '.join(_UNITS)}", requirement.unit)
    horizon = requirement.horizon
    _require(math.isfinite(horizon) and horizon > 0, "the horizon is finite and positive", horizon)
    verdict = requirement.verdict()
    _require(
        verdict.robustness == horizon and verdict.violated_at_s is None and verdict.unit == requirement.unit,
        "before any sample the robustness is the horizon, and nothing is violated",
        verdict,
    )


def _observed(requirement: Requirement, sample: WorldSample) -> float:
    robustness = requirement.observe(sample)
    _require(
        isinstance(robustness, float) and abs(robustness) <= requirement.horizon,
        "every robustness is a finite float within the horizon",
        robustness,
    )
    return robustness


def _check_verdict(requirement: Requirement, series: list[float], times_s: list[float]) -> None:
    verdict = requirement.verdict()
    _require(
        verdict.robustness == min(series), f"the verdict is the smallest robustness {min(series)}", verdict
    )
    first_s = next((time_s for time_s, value in zip(times_s, series, strict=True) if value < 0), None)
    _require(verdict.violated_at_s == first_s, f"first violated at {first_s}", verdict)
    _require(verdict.violated == (first_s is not None), "violated if and only if negative", verdict)
    _require(verdict.unit == requirement.unit, "the verdict has the requirement's unit", verdict)


def _check_features(requirement: Requirement) -> None:
    features = dict(requirement.features())
    try:
        text = json.dumps(features, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ContractBroken(f"expected: features are JSON without NaN; got {features!r}: {error}") from error
    _require(json.loads(text) == features, "features survive JSON", features)


def _empty_episode() -> Iterator[WorldSample]:
    """Yield an empty road: no other road users, no light, all optional fields left out."""
    for step in range(_STEPS):
        yield _sample(step, speed_mps=8.0)


def _chaotic_episode(seed: int) -> Iterator[WorldSample]:
    """Yield an episode with every kind of event, and with extreme values."""
    rng = random.Random(seed)
    for step in range(_STEPS):
        gap_m = rng.choice((None, 0.0, rng.uniform(0.0, 60.0), 1e9))
        stop_line_gap_m = rng.choice((None, 0.0, rng.uniform(-6.0, 40.0)))
        yield _sample(
            step,
            speed_mps=rng.choice((0.0, rng.uniform(-1.0, 15.0))),
            offset_m=rng.uniform(-4.0, 4.0),
            heading_error_rad=rng.uniform(-math.pi, math.pi),
            front_gap_m=gap_m,
            nearest_gap_m=rng.choice((None, 0.0, rng.uniform(0.0, 30.0))),
            collision=_collision(rng) if step == _STEPS - 1 else None,
            light=None if stop_line_gap_m is None else rng.choice(tuple(LightState)),
            stop_line_gap_m=stop_line_gap_m,
            may_wait=rng.random() < 0.5,
            in_conflict_area=rng.random() < 0.3,
            goal_reached=rng.random() < 0.1,
        )


def _collision(rng: random.Random) -> Collision:
    kind = rng.choice(tuple(CollisionKind))
    return Collision(kind=kind, counterpart="somebody", impact_speed_mps=rng.uniform(0.0, 12.0))


def _sample(
    step: int,
    *,
    speed_mps: float,
    offset_m: float = 0.0,
    heading_error_rad: float = 0.0,
    front_gap_m: float | None = None,
    nearest_gap_m: float | None = None,
    collision: Collision | None = None,
    light: LightState | None = None,
    stop_line_gap_m: float | None = None,
    may_wait: bool = False,
    in_conflict_area: bool = False,
    goal_reached: bool = False,
) -> WorldSample:
    return WorldSample(
        time_s=0.05 * step,
        x_m=0.4 * step,
        y_m=0.0,
        yaw_rad=0.0,
        speed_mps=speed_mps,
        station_m=0.4 * step,
        offset_m=offset_m,
        heading_error_rad=heading_error_rad,
        ego_length_m=4.5,
        ego_width_m=1.8,
        lane_left_m=1.75,
        lane_right_m=-1.75,
        speed_limit_mps=8.33,
        front_gap_m=front_gap_m,
        nearest_gap_m=nearest_gap_m,
        collision=collision,
        light=light,
        stop_line_gap_m=stop_line_gap_m,
        may_wait=may_wait,
        in_conflict_area=in_conflict_area,
        goal_reached=goal_reached,
    )
