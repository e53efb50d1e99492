"""Pictures and films of a pair: the same moment in both drives, what differs, and what happened."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import av
import numpy as np
import pytest
from support.traces import filmed, make_trace, ragged

from brink.pictures import DrivePair, ReplayError, Side, render_pair
from brink.pictures.pair import middles, pair_story
from brink.pictures.pair_view import STILL_WIDTH_PX, chip_words, pair_still
from brink.pictures.scene import gap_words
from brink.sim.trace import BOX_COLUMNS, PERCEIVED_COLUMNS, Trace


def reporting_from(trace: Trace, from_s: float, to_s: float = 9.0) -> Trace:
    box = (1.0, 400.0, 480.0, 280.0, 400.0)
    rows: list[list[tuple[float, ...]]] = [
        [box] if from_s <= time_s < to_s else [] for time_s in trace.time_s.tolist()
    ]
    return replace(trace, given_boxes=ragged(BOX_COLUMNS, rows))


def a_pair(**changes: object) -> DrivePair:
    safe = reporting_from(make_trace(violated=False), 4.05)
    unsafe = reporting_from(make_trace(violated=True), 4.45)
    pair = DrivePair(
        safe=Side(number=7, trace=safe),
        unsafe=Side(number=9, trace=unsafe),
        change="the person is reported from 4.5 s instead of 4.1 s",
        requirement="front-gap@1",
    )
    return replace(pair, **changes)  # type: ignore[arg-type]


@cache
def still() -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Return the still image of `a_pair`."""
    return np.asarray(pair_still(a_pair()))


def test_the_moment_is_the_unsafe_drives_violation_and_reports_differ_where_the_boxes_do() -> None:
    story = pair_story(a_pair())
    series = np.asarray(story.pair.unsafe.trace.robustness["front-gap@1"])
    assert story.moment_s == pytest.approx(0.1 * int(np.flatnonzero(series < 0)[0]), abs=1e-3)
    assert [(span.start_s, span.end_s) for span in story.differing] == [pytest.approx((4.1, 4.5), abs=1e-3)]
    window = story.window()
    assert window.start_s < 4.1 < story.moment_s < window.end_s <= story.end_s


def test_without_a_change_of_the_reports_the_window_shows_what_leads_to_the_moment() -> None:
    pair = a_pair()
    story = pair_story(
        replace(pair, safe=replace(pair.safe, trace=reporting_from(make_trace(violated=False), 4.45)))
    )
    assert story.differing == ()
    assert story.report_moment_s() is None
    window = story.window()
    assert window.end_s - window.start_s >= 11.9
    assert window.start_s < story.moment_s < window.end_s


def test_reports_that_differ_in_position_alone_differ() -> None:
    trace = make_trace(violated=False)
    moved = replace(trace.given_boxes, rows=trace.given_boxes.rows + np.array([0, 3, 3, 0, 0], np.float32))
    pair = a_pair(
        safe=Side(number=7, trace=replace(trace, given_boxes=moved)),
        unsafe=Side(number=9, trace=make_trace()),
    )
    assert pair_story(pair).differing[0].start_s == pytest.approx(3.1, abs=0.05)


def test_both_maps_show_the_same_place_until_the_cars_are_far_apart() -> None:
    story = pair_story(a_pair())
    safe, unsafe = middles(story, story.moment_s, 0.0)
    assert np.allclose(safe, unsafe)
    shifted = story.pair.unsafe.trace
    far = replace(shifted, ego=shifted.ego - np.array([60, 0, 0, 0, 0], np.float32))
    story = pair_story(a_pair(unsafe=Side(number=9, trace=far)))
    safe, unsafe = middles(story, story.moment_s, 0.0)
    assert safe[0] - unsafe[0] > 30


def perceiving(trace: Trace, label: float, dx_m: float, dy_m: float) -> Trace:
    """Return a drive that perceives nothing but one obstacle, so far from the centre of the vehicle ahead."""
    lead = trace.actors[0].motion
    rows: list[list[tuple[float, ...]]] = [
        [(1.0, label, float(x_m) + dx_m, float(y_m) + dy_m, 0.0, 0.0, 4.5, 1.8)] for x_m, y_m in lead[:, :2]
    ]
    return replace(trace, perceived=ragged(PERCEIVED_COLUMNS, rows))


@pytest.mark.parametrize(
    ("label", "dx_m", "dy_m", "words"),
    [
        (0.0, 0.0, 0.0, "reported"),
        (1.0, 1.0, 0.5, "reported as a person"),
        (0.0, 0.0, 2.2, "not reported"),  # beside it, though close
        (0.0, 20.0, 0.0, "not reported"),
    ],
)
def test_the_vehicle_ahead_is_reported_only_if_a_perceived_obstacle_lies_on_it(
    label: float, dx_m: float, dy_m: float, words: str
) -> None:
    pair = a_pair()
    unsafe = perceiving(pair.unsafe.trace, label, dx_m, dy_m)
    story = pair_story(replace(pair, unsafe=replace(pair.unsafe, trace=unsafe)))
    assert story.target is not None
    assert unsafe.actors[story.target.actor].name == "lead"
    assert story.target.words == words
    assert story.target.gap is not None
    assert story.target.gap.too_short


def test_the_camera_shows_when_the_boxes_differ_most_but_not_after_the_violation() -> None:
    pair = a_pair()

    def growing(trace: Trace, px_per_s: float) -> Trace:
        rows: list[list[tuple[float, ...]]] = [
            [(1.0, 400.0, 480.0 + px_per_s * t, 280.0, 400.0)] for t in trace.time_s.tolist()
        ]
        return replace(trace, given_boxes=ragged(BOX_COLUMNS, rows))

    safe = replace(pair.safe, trace=growing(pair.safe.trace, 0.0))
    story = pair_story(
        replace(pair, safe=safe, unsafe=replace(pair.unsafe, trace=growing(pair.unsafe.trace, 5.0)))
    )
    assert story.report_moment_s() == pytest.approx(story.moment_s, abs=0.11)
    assert pair_story(pair).report_moment_s() == pytest.approx(4.1, abs=1e-3)


@pytest.mark.parametrize(
    ("gap_m", "words"), [(1.4, "1.4 m"), (1.496, "1.496 m"), (1.5, "1.5 m"), (38.61, "38.6 m")]
)
def test_a_gap_that_is_too_short_never_looks_long_enough(gap_m: float, words: str) -> None:
    assert gap_words(gap_m) == words


def test_a_safe_drive_that_violated_another_requirement_is_not_called_held() -> None:
    trace = make_trace(violated=False)
    late = np.where(trace.time_s > 15, -0.5, 5.0).astype(np.float32)
    slow = replace(trace, robustness={**trace.robustness, "progress@1": late})
    pair = a_pair(safe=Side(number=7, trace=slow))
    story = pair_story(pair)
    assert chip_words(story.parts[0]) == ("HELD, BUT", "stood still too long at 15.1 s (front gap held)")
    assert chip_words(pair_story(a_pair()).parts[0]) == ("HELD", "front gap held")


@pytest.mark.parametrize("extension", [".mp4", ".gif"])
def test_the_film_has_a_frame_for_each_tenth_of_a_second(tmp_path: Path, extension: str) -> None:
    pair = a_pair(
        safe=Side(number=7, trace=make_trace(samples=8, violated=False)),
        unsafe=Side(number=9, trace=make_trace(samples=6)),
    )
    path = render_pair(pair, tmp_path / f"pair{extension}")
    with av.open(str(path)) as film:
        frames = list(film.decode(video=0))
    assert len(frames) == (8 + 10 if extension == ".mp4" else 8)  # a GIF joins the last one's equal frames
    assert (frames[0].width, frames[0].height) == ((1280, 720) if extension == ".mp4" else (960, 540))


def test_drives_with_recorded_camera_images_show_both() -> None:
    pair = a_pair(
        safe=Side(number=7, trace=filmed(make_trace(violated=False))),
        unsafe=Side(number=9, trace=filmed(make_trace())),
    )
    assert pair_still(pair).width == STILL_WIDTH_PX


def test_drives_without_reports_and_with_scripts_are_drawn_too() -> None:
    pair = a_pair(
        safe=Side(number=7, trace=reporting_from(make_trace(violated=False), 99)),
        unsafe=Side(number=9, trace=reporting_from(make_trace(), 99)),
    )
    assert pair_still(pair).width == STILL_WIDTH_PX


def test_a_requirement_that_the_traces_do_not_record_is_named() -> None:
    with pytest.raises(ReplayError, match=r"front-gap@1.*got 'red-light@1'"):
        pair_still(a_pair(requirement="red-light@1"))
