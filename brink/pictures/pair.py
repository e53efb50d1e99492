"""A pair of drives, one safe and one unsafe: what differs between them, and the decisive moment.

The drives are two neighbouring solutions, or the system's drive and that of a reference driver in its
place (`brink.pictures.reference`). Both drives run on the same clock. The *moment* of a pair is the unsafe drive's
first violation; the safe drive is shown at the same time. Reports *differ* while the driving systems of the two
drives receive different boxes. What the moment is about is the road user that the unsafe drive hits, or to which its
front gap is too short; it is *reported* while a perceived obstacle lies on it.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from brink.pictures.motion import DRIVES, is_reference, plan_words
from brink.pictures.scene import (
    LABELS,
    TOUCHES_M,
    EpisodeScene,
    FrontGap,
    Points,
    ReplayError,
    found_at,
    front_gap,
    gap_to,
    is_injected,
    is_there,
    label_index,
    map_centres,
    obstacles_on,
    plain_name,
    spec_part,
)
from brink.pictures.story import Judged, Story, measured_words, no_needless_braking, story_of
from brink.sim.requirements import REQUIRED_GAP_M
from brink.sim.trace import FloatArray, Trace
from brink.sim.verdict import clock_words

SAFE, UNSAFE = "safe", "unsafe"

_SAME_PX: Final = 0.5
"""Boxes whose sides are this close are the same."""
_SAME_PLACE_M: Final = 0.05
_LAST_S: Final = 0.2
"""How long before the end of a trace the event that ends the drive may happen."""
_LEAD_UP_S: Final = 3.0
_FOLLOW_UP_S: Final = 5.0
_LEAST_WINDOW_S: Final = 12.0
_LOOK_BACK_S: Final = 1.5
"""How long before the moment the vehicle ahead may have been seen for the last time: a collision hides it."""
_EVERY: Final = 5
"""One in this many samples is checked for whether something is where it is reported."""
_ABSENT_PX: Final = 800.0
"""A box that is reported in one drive alone differs as much as two boxes at opposite sides of the image."""
_ALMOST: Final = 0.999
"""Of the times at which reports differ about as much as ever, the earliest one is shown."""
_MOST_DIGITS: Final = 4
_LOOK_AHEAD_M: Final = 7.0
"""How far ahead of its car the middle of a map lies."""
_MOST_SHIFT_M: Final = np.array([11.0, 4.0])
"""How far a map is shifted along and across its longer side to show the same place as the other one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """One drive of a pair.

    Attributes:
        trace: The drive.
        number: Number of the solution; None if it is not a solution of its own.
        name: What the drive is called, in one word; by default ``safe`` or ``unsafe``.
        car: What its car is called on a map; by default ``safe drive`` or ``unsafe drive``.
        chip: Word that pictures put before what happened, in capitals; by default whether it held the requirement.
        outcome: What happened, in words; by default according to the trace.
        again: What simulating it again with other seeds showed, in words; empty leaves that to the facts.
        shown_s: Time at which a still image shows it; by default the moment of the pair.
    """

    trace: Trace
    number: int | None = None
    name: str = ""
    car: str = ""
    chip: str = ""
    outcome: str = ""
    again: str = ""
    shown_s: float | None = None


class Mark(NamedTuple):
    """Another moment that a chart names."""

    time_s: float
    words: str


class Nearest(NamedTuple):
    """A point on the curve of the safe drive's distance, with its caption."""

    time_s: float
    gap_m: float
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivePair:
    """Two drives to compare, and the words that go with them.

    Attributes:
        safe: The safe drive.
        unsafe: The unsafe one.
        change: What differs between them, in words; each line is a line of the headline.
        findings: What the pair shows about the component and about chance, in sentences.
        facts: Further facts about the pair, such as its distance.
        requirement: Ids of the requirements that distinguish them; for the default see `story_of`.
        unsafe_first: Whether the unsafe drive is shown first.
        about_reports: Whether the drives differ in what is reported to the driving systems, which pictures then show.
        marks: Further moments of the safe drive to name.
        violated: Moments of the unsafe drive to name, that of the pair included; by default that one alone.
        nearest: How near the safe drive comes to whom the violation is about.
    """

    safe: Side
    unsafe: Side
    change: str
    findings: tuple[str, ...] = ()
    facts: tuple[str, ...] = ()
    requirement: Judged = None
    unsafe_first: bool = False
    about_reports: bool = True
    marks: tuple[Mark, ...] = ()
    violated: tuple[Mark, ...] = ()
    nearest: Nearest | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A span of time; `end_s` is the end of its last sample."""

    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """The road user that the unsafe drive's violation is about.

    Attributes:
        actor: Its index among the actors of the unsafe drive's trace.
        gap: The front gap to it at the moment; None if it was hit.
        reported: Labels of the perceived obstacles that lie on it at the moment.
        vehicle: Whether it is a vehicle.
    """

    actor: int
    gap: FrontGap | None
    reported: tuple[str, ...]
    vehicle: bool

    @property
    def words(self) -> str:
        """Describe how the detector reports it, such as ``not reported`` or ``reported as a person``."""
        own = LABELS[0 if self.vehicle else 1]
        if not self.reported:
            return "not reported"
        return "reported" if own in self.reported else f"reported as a {self.reported[0]}"


class Part(NamedTuple):
    """One drive of a pair as it is shown."""

    name: str
    side: Side
    story: Story
    is_unsafe: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class PairStory:
    """The story of a pair, as its pictures tell it.

    Attributes:
        pair: The pair.
        safe: Story of the safe drive.
        unsafe: Story of the unsafe drive.
        moment_s: Time of the unsafe drive's first violation, or of its lowest robustness if the trace has none.
        shown_s: Time of the sample that shows the moment: the next one, since a violation may lie between samples.
        target: What the violation is about; None if that is not a road user, or unknown.
        differing: When the reports of the drives differ; up to the end of the shorter drive.
        same_seed: Whether both drives have the same episode seed; None if a trace does not record it.
        same_road: Whether both drives use the same road, so that one map can show both.
        centres: Where the map of each drive is centred at each of its samples, in the order in which they are shown,
            shape ``(n, 2)`` each.
    """

    pair: DrivePair
    safe: Story
    unsafe: Story
    moment_s: float
    shown_s: float
    target: Target | None
    differing: tuple[Interval, ...]
    same_seed: bool | None
    same_road: bool
    centres: tuple[Points, Points]

    @property
    def sample_s(self) -> float:
        """Time of the sample that contains the robustness at the moment."""
        return float(self.pair.unsafe.trace.time_s[self.unsafe.decisive])

    @property
    def end_s(self) -> float:
        """Time at which the longer drive ends."""
        return max(float(side.trace.time_s[-1]) for side in (self.pair.safe, self.pair.unsafe))

    @property
    def parts(self) -> "tuple[Part, Part]":
        """The two drives in the order in which they are shown."""
        pair = self.pair
        safe = Part(pair.safe.name or SAFE, pair.safe, self.safe, is_unsafe=False)
        unsafe = Part(pair.unsafe.name or UNSAFE, pair.unsafe, self.unsafe, is_unsafe=True)
        return (unsafe, safe) if pair.unsafe_first else (safe, unsafe)

    def shown_at(self, index: int) -> float:
        """Return at what time a still image shows a drive."""
        own_s = self.parts[index].side.shown_s
        return self.shown_s if own_s is None else own_s

    @property
    def gap_required(self) -> str:
        """The front gap requirement that the unsafe drive violates, in words; empty if none."""
        names = {
            one.requirement for one in self.unsafe.violations if plain_name(one.requirement) == "front-gap"
        }
        if not names:
            return ""
        return f"{REQUIRED_GAP_M:g} m required" + ("" if "front-gap@1" in names else "\nwhile moving")

    def window(self) -> Interval:
        """Return the relevant span of time: from before the reports first differ until after the moment."""
        first_s = self.differing[0].start_s if self.differing else self.moment_s
        first_s = min([first_s, *(mark.time_s for mark in (*self.pair.marks, *self.pair.violated))])
        end_s = min(self.end_s, self.moment_s + _FOLLOW_UP_S)
        start_s = min(first_s - _LEAD_UP_S, self.moment_s - _LEAD_UP_S, end_s - _LEAST_WINDOW_S)
        start_s = max(0.0, start_s)
        return Interval(start_s=start_s, end_s=max(end_s, min(self.end_s, start_s + _LEAST_WINDOW_S)))

    def report_moment_s(self) -> float | None:
        """Return when, up to the moment, the reports differ most; None if they do not differ by then."""
        traces = self.pair.safe.trace, self.pair.unsafe.trace
        times = np.asarray(traces[1].time_s, dtype=np.float64)
        end_s = min(self.moment_s + 1e-3, *(float(trace.time_s[-1]) for trace in traces))
        times = times[times <= end_s]
        apart_px = np.array([_report_distance_px(*traces, float(at_s)) for at_s in times])
        if not apart_px.size or apart_px.max() <= _SAME_PX:
            return None
        return float(times[np.flatnonzero(apart_px >= _ALMOST * apart_px.max())[0]])


def pair_story(pair: DrivePair) -> PairStory:
    """Return the story of a pair.

    Raises:
        ReplayError: A trace is empty, or does not record the requirement.
    """
    unsafe = story_of(pair.unsafe.trace, pair.requirement)
    safe = story_of(pair.safe.trace, unsafe.requirement)
    moment_s, shown_s = _moment(pair.unsafe.trace, unsafe)
    safe_seed, unsafe_seed = (_seed(side.trace) for side in (pair.safe, pair.unsafe))
    shown = (pair.unsafe, pair.safe) if pair.unsafe_first else (pair.safe, pair.unsafe)
    return PairStory(
        pair=pair,
        safe=safe,
        unsafe=unsafe,
        moment_s=moment_s,
        shown_s=shown_s,
        target=_target(pair.unsafe.trace, unsafe, sample_at(pair.unsafe.trace, shown_s)),
        differing=_differing(pair.safe.trace, pair.unsafe.trace) if pair.about_reports else (),
        same_seed=None if safe_seed is None or unsafe_seed is None else safe_seed == unsafe_seed,
        same_road=_same_road(pair.safe.trace, pair.unsafe.trace),
        centres=(map_centres(shown[0].trace, _LOOK_AHEAD_M), map_centres(shown[1].trace, _LOOK_AHEAD_M)),
    )


def part_state_words(story: PairStory, part: Part, time_s: float) -> str:
    """Describe a drive at a time: speed, plan, and the margin of the requirement.

    Among the same road users, that is how far it is from the one that the violation is about; otherwise the margin of
    the requirement.
    """
    trace = part.side.trace
    if story.pair.about_reports or story.target is None:
        return state_words(part.side, part.story, time_s)
    motion, sample = motion_words(trace, time_s), sample_at(trace, time_s)
    gap = None if has_ended(trace, time_s) else gap_to(trace, sample, story.target.actor)
    if gap is None:
        return motion
    name = trace.actors[gap.actor].name
    return f"{motion}, {f'{gap.gap_m:.1f} m from {name}' if gap.gap_m >= TOUCHES_M else f'touches {name}'}"


def ended_words(trace: Trace) -> str:
    """Return how a drive ends, such as ``collision at 7.2 s`` or ``recorded until 20.5 s``."""
    end_s = float(trace.time_s[-1])
    kinds = [event.kind for event in trace.events if event.time_s > end_s - _LAST_S]
    if "collision" in kinds:
        return f"ends with the collision at {clock_words(end_s)}"
    return f"{'end of the route' if 'goal' in kinds else 'recorded until'} {clock_words(end_s)}"


def sample_at(trace: Trace, time_s: float) -> int:
    """Return the sample nearest to a time."""
    return int(np.abs(np.asarray(trace.time_s, dtype=np.float64) - time_s).argmin())


def has_ended(trace: Trace, time_s: float) -> bool:
    """Return whether a drive has ended by a time."""
    return time_s > float(trace.time_s[-1]) + 0.11


def outcome_words(side: Side, story: Story) -> str:
    """Return the outcome of a drive: its requirement first, then every other one that was violated."""
    return side.outcome or story.words


def state_words(side: Side, story: Story, time_s: float) -> str:
    """Describe a drive at a time: speed, plan, and the margin of the requirement."""
    motion = motion_words(side.trace, time_s)
    sample = sample_at(side.trace, time_s)
    value = float(side.trace.robustness[story.requirement][sample])
    if has_ended(side.trace, time_s) or not np.isfinite(value):
        return motion
    return f"{motion}, {_margin_words(story.title, value, story.unit)}"


def motion_words(trace: Trace, time_s: float) -> str:
    """Describe a drive at a time: speed and plan."""
    if has_ended(trace, time_s):
        return ended_words(trace)
    sample = sample_at(trace, time_s)
    does = plan_words(trace)[sample]
    speed = f"{float(trace.ego[sample, 3]):.1f} m/s".replace("-", "−")
    if is_reference(trace):
        return speed if does == DRIVES else f"{speed}, {does}"
    return f"{speed}, plan: {does}"


def _margin_words(title: str, value: float, unit: str) -> str:
    """Describe the measurement and the requirement, or else the margin to the limit."""
    if plain_name(title) == "front-gap":
        gap, note = measured_words(title, value, unit)
        return f"front gap {gap}, {note}" if note else gap
    if no_needless_braking(title, value):
        return measured_words(title, value, unit)[0]
    shown = next(
        (text for digits in range(1, _MOST_DIGITS) if float(text := f"{abs(value):.{digits}f}") > 0), "just"
    )
    margin = shown if shown == "just" else f"{shown} {unit}".strip()
    return f"{title.replace('-', ' ')}: {margin} {'too little' if value < 0 else 'to spare'}"


def reality_words(story: PairStory) -> str:
    """Describe in sentences whether the reported objects exist, and whether the vehicle ahead is reported.

    Both up to the moment. What detectors report without errors that were made up is not judged.
    """
    said = [*_about_lead(story), *_about_reports(story)]
    return " ".join(f"{words[:1].upper()}{words[1:]}." for words in said)


def _about_lead(story: PairStory) -> list[str]:
    if story.target is None or not story.target.vehicle:
        return []
    found = []
    for _, side, _, _ in story.parts:
        scene, flags = EpisodeScene.of(side.trace), []
        for sample in _until(side.trace, story.moment_s):
            gap = front_gap(side.trace, sample)
            if gap is not None:
                flags.append(bool(obstacles_on(scene, sample, gap.actor)))
        found.append(_how_much(flags))
    safe, unsafe = found
    if safe == unsafe or not safe:
        drives = "in both drives" if safe else "in the unsafe drive"
        return [f"{drives}, the vehicle ahead is {unsafe}"] if unsafe else []
    return [f"the vehicle ahead is {safe} in the safe drive, {unsafe or 'absent'} in the unsafe one"]


def _about_reports(story: PairStory) -> list[str]:
    if not all(is_injected(side.trace) for _, side, _, _ in story.parts):
        return []
    flags: dict[int, list[bool]] = {}
    for _, side, _, _ in story.parts:
        scene, perceived = EpisodeScene.of(side.trace), side.trace.perceived
        for sample in _until(side.trace, story.moment_s)[::_EVERY]:
            for row in range(perceived.first[sample], perceived.first[sample + 1]):
                label = label_index(float(perceived.rows[row, 1]))
                flags.setdefault(label, []).append(is_there(label, found_at(scene, sample, row)))
    return [_there(LABELS[label], sum(there) / len(there)) for label, there in sorted(flags.items())]


def _there(label: str, share: float) -> str:
    """Describe for which share of the time an object exists where it is reported."""
    who = f"no {label}" if share == 0 else f"a {label}"
    return f"there is {who} where one is reported{_part(share)}"


def _how_much(flags: list[bool]) -> str:
    """Return for how much of the time an object is reported; empty if it never exists."""
    if not flags:
        return ""
    share = sum(flags) / len(flags)
    return {0.0: "never reported", 1.0: "always reported"}.get(share, f"reported{_part(share)}")


def _part(share: float) -> str:
    """Return a share of the time in words; empty for none and for all."""
    return "" if share in (0, 1) else f" {min(0.99, max(0.01, share)):.0%} of the time"


def _until(trace: Trace, time_s: float) -> list[int]:
    """Return the samples of a drive up to a time."""
    samples: list[int] = np.flatnonzero(np.asarray(trace.time_s, dtype=np.float64) <= time_s + 1e-3).tolist()
    return samples


def middles(story: PairStory, time_s: float, turn_rad: float) -> list[Points]:
    """Return the middles of the two maps at a time, shape ``(2,)`` each, in the order in which they are shown.

    As long as the cars are close together, both maps show the same place, half-way between them; from then on, each
    map stays with its own car.

    Args:
        story: The pair.
        time_s: The time.
        turn_rad: Rotation of the maps, which are wider than high.
    """
    places = [
        centres[sample_at(side.trace, time_s)]
        for centres, (_, side, _, _) in zip(story.centres, story.parts, strict=True)
    ]
    if not story.same_road:
        return places
    half = (places[1] - places[0]) / 2
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[cosine, sine], [-sine, cosine]])
    shift = np.clip(half @ turn, -_MOST_SHIFT_M, _MOST_SHIFT_M) @ turn.T
    return [places[0] + shift, places[1] - shift]


def _moment(trace: Trace, story: Story) -> tuple[float, float]:
    """Return when the moment of a drive is, and when the sample that shows it."""
    at_s = float(trace.time_s[story.decisive])
    exact_s = story.violations[0].time_s if story.violated else at_s
    following = min(story.decisive + 1, len(trace.time_s) - 1)
    return exact_s, float(trace.time_s[following]) if exact_s > at_s + 1e-3 else at_s


def counterpart_of(trace: Trace, story: Story) -> int | None:
    """Return the road user that the violation of a drive is about; None if there is none, or it is unknown."""
    if story.title not in ("front-gap", "no-collision"):
        return None
    actor = _hit(trace) if story.title == "no-collision" else _ahead(trace, story.decisive)
    return _hit(trace) if actor is None else actor


def _target(trace: Trace, story: Story, shown: int) -> Target | None:
    """Return the target of a drive's violation, at the sample that shows the moment."""
    actor = counterpart_of(trace, story)
    if actor is None:
        return None
    gap = None
    if story.title == "front-gap":
        gap_m = float(trace.robustness[story.requirement][story.decisive]) + REQUIRED_GAP_M
        gap = gap_to(trace, shown, actor, gap_m)
    rows = obstacles_on(EpisodeScene.of(trace), shown, actor)
    labels = [LABELS[label_index(float(trace.perceived.rows[row, 1]))] for row in rows]
    return Target(
        actor=actor,
        gap=gap,
        reported=tuple(dict.fromkeys(labels)),
        vehicle=trace.actors[actor].kind == "vehicle",
    )


def _ahead(trace: Trace, sample: int) -> int | None:
    """Return the vehicle ahead at a sample or, if it cannot be determined then, shortly before."""
    for earlier in range(sample, -1, -1):
        if trace.time_s[sample] - trace.time_s[earlier] > _LOOK_BACK_S:
            break
        gap = front_gap(trace, earlier)
        if gap is not None:
            return gap.actor
    return None


def _hit(trace: Trace) -> int | None:
    """Return the road user of the first collision that names one."""
    names = {actor.name: index for index, actor in enumerate(trace.actors)}
    texts = (event.text for event in trace.events if event.kind == "collision")
    return next((names[word] for text in texts for word in text.split() if word in names), None)


def _seed(trace: Trace) -> int | None:
    spec = trace.about.get("spec")
    seed = spec.get("seed") if isinstance(spec, dict) else None
    return seed if isinstance(seed, int) else None


def _same_road(one: Trace, other: Trace) -> bool:
    if one.route.shape != other.route.shape or spec_part(one, "scenario").get("road_id") != spec_part(
        other, "scenario"
    ).get("road_id"):
        return False
    return bool(np.allclose(one.route, other.route, atol=_SAME_PLACE_M))


def _differing(safe: Trace, unsafe: Trace) -> tuple[Interval, ...]:
    """Return the spans in which the two driving systems receive different boxes."""
    shorter = min((safe, unsafe), key=lambda trace: len(trace.time_s))
    time_s = np.asarray(shorter.time_s, dtype=np.float64)
    if len(time_s) == 0:
        raise ReplayError("the trace has no samples: there is nothing to draw")
    differs = np.array([_reports_differ(safe, unsafe, float(at_s)) for at_s in time_s])
    edges = np.flatnonzero(np.diff(differs.astype(int), prepend=0, append=0)).reshape(-1, 2)
    return tuple(
        Interval(start_s=float(time_s[first]), end_s=float(time_s[min(last, len(time_s) - 1)]))
        for first, last in edges.tolist()
    )


def _reports_differ(safe: Trace, unsafe: Trace, time_s: float) -> bool:
    return _report_distance_px(safe, unsafe, time_s) > _SAME_PX


def _report_distance_px(safe: Trace, unsafe: Trace, time_s: float) -> float:
    """Return the difference between the reports of two drives at a time in pixels, at most the width of the image.

    Boxes of a label are compared in the order of their left edges; one without a counterpart differs completely.
    """
    one, other = (_sorted(trace.given_boxes.at(sample_at(trace, time_s))) for trace in (safe, unsafe))
    if one.shape != other.shape or not np.array_equal(one[:, 0], other[:, 0]):
        return _ABSENT_PX
    return float(min(np.abs(one - other).max(initial=0.0), _ABSENT_PX))


def _sorted(rows: FloatArray) -> FloatArray:
    return rows[np.lexsort(rows.T[::-1])]
