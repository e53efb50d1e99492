"""CommonRoad files: known answers, files that are refused, and packed recordings of anybody."""

import base64
import json
import math
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.sim.commonroad.example import example_document
from brink.sim.commonroad.files import document_of, read_files
from brink.sim.commonroad.recording import Recording, RecordingError, packed, unpacked
from brink.sim.commonroad.roads import place_in, place_of
from brink.sim.errors import DefinitionError

FOLDER = Path(__file__).parents[4] / "examples" / "commonroad"
CUT_IN = (FOLDER / "cut-in.xml").read_text(encoding="utf-8")
BEND = (FOLDER / "bend.xml").read_text(encoding="utf-8")


def test_reads_2020a() -> None:
    recording = Recording.of(document_of(CUT_IN))
    assert (recording.name, recording.step_s, recording.duration_s) == ("cut-in", 0.2, 10.0)
    assert recording.start == (0.0, 0.0, 0.0, 8.0)
    assert [(one.id, one.kind, one.stands, len(one.states)) for one in recording.road_users] == [
        (10, "car", False, 51),
        (11, "truck", False, 51),
        (12, "pedestrian", False, 51),
        (13, "parkedVehicle", True, 1),
    ]
    assert recording.road_users[1].states[5].tolist() == [-16.5, 3.5, 0.0, 8.5]  # after 1 s at 8.5 m/s
    lanelet = recording.lanelets[1]
    assert lanelet.limit_mps == 13.89
    assert lanelet.neighbours[0] == (2, True)
    assert lanelet.neighbours[1] is None
    assert recording.goals[0].lanelets == (1,)
    assert recording.goals[0].steps == (50, 50)


def test_reads_2018b() -> None:
    recording = Recording.of(document_of(BEND))
    assert [one.kind for one in recording.road_users] == ["car", "bus"]
    assert recording.lanelets[1].successors == (2,)
    assert recording.lanelets[1].neighbours[0] == (4, False)
    assert recording.lanelets[3].limit_mps == 13.89
    headings = recording.road_users[1].states[:, 2]
    assert np.abs(np.diff(headings)).max() < 0.05  # unwrapped


def test_coordinates_of_a_country_keep_their_precision() -> None:
    far = BEND
    for name, origin in (("x", 690_000), ("y", 5_335_000)):
        parts = far.split(f"<{name}>")
        moved = [f"{float(one.partition('<')[0]) + origin:.2f}<{one.partition('<')[2]}" for one in parts[1:]]
        far = f"<{name}>".join([parts[0], *moved])
    assert document_of(far) == document_of(BEND)


def test_other_shapes_become_rectangles() -> None:
    corners = "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y in ((-1, -1), (3, -1), (3, 1), (-1, 1)))
    shape = "<rectangle><length>8.0</length><width>2.5</width></rectangle>"
    truck = Recording.of(document_of(CUT_IN.replace(shape, f"<polygon>{corners}</polygon>"))).road_users[1]
    assert (truck.length_m, truck.width_m) == (4.0, 2.0)
    assert truck.states[0].tolist() == [-24.0, 3.5, 0.0, 8.5]  # its middle is 1 m ahead of its position
    circle = Recording.of(document_of(CUT_IN.replace(shape, "<circle><radius>0.7</radius></circle>")))
    assert (circle.road_users[1].length_m, circle.road_users[1].width_m) == (1.4, 1.4)


GOAL = '<position><lanelet ref="1"/></position>'
AREA = "<position><circle><radius>2</radius><center><x>{x}</x><y>{y}</y></center></circle></position>"
REFUSED = {
    "no XML": ("not at all", None, "expected CommonRoad XML"),
    "another format": ("<OpenDRIVE/>", None, "<commonRoad>"),
    "unknown version": ('"2020a"', '"2017a"', "commonRoadVersion: expected 2018b or 2020a, got '2017a'"),
    "no planning problem": ("planningProblem", "planning", "expected a <planningProblem>"),
    "entities": ("<commonRoad ", '<!DOCTYPE a [<!ENTITY b "bb">]><commonRoad ', "without a document type"),
    "no number": ("<length>8.0</length>", "<length>nan</length>", "obstacle 11: expected a number"),
    "unknown lanelet": (GOAL, '<position><lanelet ref="7"/></position>', "a lanelet of the file, got 7"),
    "a goal beside the road": (GOAL, AREA.format(x=50, y=40), "goalState: expected a place on a lanelet"),
    "a goal behind": (GOAL, AREA.format(x=-50, y=0), "goalState: expected a goal that a chain of lanelets leads to"),
    "an ego beside the road": ("<x>0.00</x><y>0.00</y>", "<x>0.00</x><y>30.00</y>", "initial state on a lanelet"),
    "an ego inside a car": ("<x>14.00</x><y>3.50</y>", "<x>1.00</x><y>0.50</y>", "obstacle 10 is there"),
    "a missing state": ("<time><exact>7</exact>", "<time><exact>70</exact>", "a state at each step from 0 to 70"),
    "no trajectory": ("trajectory>", "occupancySet>", "a <trajectory>; occupancies are not supported"),
    "edges that differ": (
        "<leftBound><point><x>-60.00</x><y>1.75</y></point>",
        "<leftBound>",
        "lanelet 1: expected edges with the same number of points",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), REFUSED.values(), ids=REFUSED)
def test_refuses_what_cannot_be_driven(old: str, new: str | None, message: str) -> None:
    text = old if new is None else CUT_IN.replace(old, new)
    assert text != CUT_IN
    with pytest.raises(RecordingError) as error:
        place_of(Recording.of(document_of(text)))
    assert message in str(error.value)


def test_reads_the_files_of_a_campaign(tmp_path: Path) -> None:
    assert list(read_files({"scenarios": str(FOLDER)}, tmp_path)["scenarios"]) == ["bend", "cut-in"]
    (tmp_path / "one.xml").write_text(BEND, encoding="utf-8")
    read = read_files({"scenarios": ["one.xml"], "errors": 1}, tmp_path)
    assert read == {"scenarios": {"one": packed(document_of(BEND))}, "errors": 1}
    assert read_files(read, tmp_path) == read
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.xml").write_text("<commonRoad/>", encoding="utf-8")
    for named, message in (
        ("missing.xml", "missing.xml cannot be read: No such file"),
        ("empty", "got none"),
        ("bad.xml", "bad.xml: commonRoadVersion"),
        (["one.xml", str(tmp_path / "one.xml")], "different names"),
    ):
        with pytest.raises(DefinitionError, match=message) as error:
            read_files({"scenarios": named}, tmp_path)
        assert error.value.field == "scenarios"


def test_a_packed_recording_is_the_document() -> None:
    document = document_of(CUT_IN)
    assert unpacked(packed(document)) == document
    assert place_in(packed(document)) is place_in(packed(document))


def test_refuses_packed_bombs() -> None:
    bomb = base64.b64encode(zlib.compress(b"[" * 17_000_000, 9)).decode()
    for text in (bomb, "no base64", base64.b64encode(zlib.compress(b"[" * 100_000)).decode(), "A" * 10**6):
        with pytest.raises(RecordingError):
            unpacked(text)


PATHS = [
    ("step_s",),
    ("start",),
    ("start_step",),
    ("goals", 0, "steps"),
    ("goals", 0, "lanelets"),
    ("lanelets", 0, "left", 0),
    ("lanelets", 0, "next"),
    ("lanelets", 0, "limit"),
    ("lanelets", 0, "beside_left"),
    ("road_users", 0, "kind"),
    ("road_users", 0, "length_m"),
    ("road_users", 0, "states", 2),
]
ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=3),
    st.lists(st.integers() | st.floats() | st.none(), max_size=4),
)


@given(path=st.sampled_from(PATHS), value=ODD)
@settings(max_examples=40, deadline=None)
def test_a_document_of_anybody_is_a_recording_or_refused(path: tuple[Any, ...], value: Any) -> None:
    document = json.loads(json.dumps(example_document()))
    part = document
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    try:
        place = place_of(Recording.of(document))
    except RecordingError:
        return
    assert math.isfinite(place.route.length_m)
    assert math.isfinite(place.recording.duration_s)
