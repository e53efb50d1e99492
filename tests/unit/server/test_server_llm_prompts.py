"""Prompts are complete and reproducible, and quote no text that a model wrote."""

import math
from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from brink.search.algorithm import SeedRequest
from brink.search.traffic.participants import MAX_PARTICIPANTS, RoadLimits
from brink.server.errors import FieldError
from brink.server.llm.prompts import MAX_ERRORS, example, question, repair
from brink.server.llm.protocol import Messages, prompt_hash
from brink.server.llm.replies import RoadChecker, parse, to_text

ROAD = RoadLimits(streets_m=(-60.0, 30.0))
SYSTEM = "a car that keeps its lane with a camera"
FIRST = SeedRequest(number=0, count=10)

roads = st.builds(
    RoadLimits,
    lane_width_m=st.floats(2.5, 5.0),
    strip_m=st.floats(0.0, 3.0),
    pavement_m=st.floats(1.0, 5.0),
    streets_m=st.lists(st.floats(-80.0, 80.0), max_size=3).map(lambda middles: tuple(sorted(middles))),
    clear_behind_m=st.floats(0.0, 20.0),
    clear_ahead_m=st.floats(0.0, 30.0),
)


def asked(request: SeedRequest = FIRST, road: RoadLimits = ROAD, most: int = 4) -> Messages:
    return question(request, road, most, SYSTEM)


def text_of(messages: Messages) -> str:
    return "\n".join(message.content for message in messages)


@given(roads, st.integers(1, MAX_PARTICIPANTS))
@settings(max_examples=60, deadline=None)
def test_the_example_is_valid_on_every_road(road: RoadLimits, most: int) -> None:
    checker = RoadChecker(road, most)
    shown = example(road, most)
    assert len(shown) == min(2, most)
    placed = checker.place(shown, "")
    assert placed == shown
    read_back = parse(to_text([shown]), checker, 1)
    assert read_back.errors == ()
    assert read_back.solutions == (shown,)


def test_rules_show_the_known_solutions() -> None:
    exposed = example(ROAD, 4)
    silent = (replace(exposed[0], ds_m=-20.0, dyaw_rad=math.pi),)
    rejected = (replace(exposed[0], ds_m=-30.0),)
    request = SeedRequest(
        number=3, count=1, exposed=(exposed,), silent=(silent,), rejected=(rejected,), round=1
    )
    text = text_of(asked(request))
    assert f"SE exposed a violation; such solutions are wanted:\n{to_text([exposed])}" in text
    assert f"SN exposed none; such solutions are not wanted:\n{to_text([silent])}" in text
    assert "Rule 1: give solutions that expose violations and differ from those in SE" in text
    assert "Rule 2" in text
    assert to_text([rejected]) in text
    assert "Give 1 solution of" in text
    only_silent = text_of(asked(replace(request, exposed=(), rejected=())))
    assert "SE" not in only_silent
    assert "Rule 2" not in only_silent


def test_equal_requests_give_equal_messages() -> None:
    assert asked() == asked()
    assert prompt_hash(asked()) == prompt_hash(asked())
    assert prompt_hash(asked()) != prompt_hash(asked(most=3))
    assert prompt_hash(asked()) != prompt_hash(asked(SeedRequest(number=0, count=11)))


def test_the_system_description_is_limited_to_one_short_line() -> None:
    system, _ = question(FIRST, ROAD, 4, "a\ncar\x00\u2028" + "y" * 10_000)
    assert "a car" in system.content
    assert "\n" not in system.content
    assert len(system.content) < 1000


def test_a_repair_prompt_lists_a_limited_number_of_errors() -> None:
    errors = [FieldError(pointer=f"/solutions/{place}", message="wrong") for place in range(MAX_ERRORS + 7)]
    text = repair(asked(), (), errors, 2)[3].content
    assert text.count("wrong") == MAX_ERRORS
    assert "and 7 more" in text
