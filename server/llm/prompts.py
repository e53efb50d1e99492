"""Prompts for seeds. Identical requests give identical messages, so that stored calls are found by their prompt hash.

The structure is the paper's: a starting prompt, an explanation of the task with one worked example, rule 1 for
seeds that differ, rule 2 for those that did not differ enough. A repair prompt quotes our own errors and our
rendering of the accepted solutions; text that a model wrote is never sent back. The wording must not change, or
campaigns that were started before could not be resumed.

Source: Tian et al., "An LLM-Empowered Adaptive Evolutionary Algorithm for Multi-Component Deep Learning Systems".
"""

import json
from collections.abc import Sequence
from typing import Final

from brink.search.algorithm import SeedRequest
from brink.search.traffic.constraint import KERB_ROOM_M, WAITS_M
from brink.search.traffic.participants import (
    MAGNITUDES,
    MAX_ACTIONS,
    MAX_DURATION_S,
    MAX_SPEEDS_MPS,
    MIN_ACTIONS,
    MIN_DURATION_S,
    PEDESTRIAN_ACTIONS,
    REACH_M,
    SIZES_M,
    VEHICLE_ACTIONS,
    Action,
    Gene,
    Kind,
    Participant,
    RoadLimits,
    Solution,
)
from brink.server.errors import FieldError
from brink.server.llm.protocol import Message, Messages
from brink.server.llm.replies import SCHEMA, apart_m, kept_clear_m, pointed, to_text

MAX_SHOWN: Final = 10
"""Maximum number of known solutions of each kind in a prompt."""
MAX_ERRORS: Final = 20
_SYSTEM_CHARS: Final = 400


def example(road: RoadLimits, max_participants: int) -> Solution:
    """Return the worked example: a car overtakes and cuts in while a pedestrian steps onto the road."""
    overtakes = Participant(
        kind=Kind.CAR,
        ds_m=-12.0,
        dd_m=round(road.lane_width_m, 2),
        dyaw_rad=0.0,
        speed_mps=11.0,
        genes=(
            Gene(action=Action.ACCELERATE, duration_s=2.0, magnitude=1.5),
            Gene(action=Action.CUT_IN, duration_s=1.5, magnitude=1.5),
            Gene(action=Action.BRAKE, duration_s=2.0, magnitude=6.0),
        ),
    )
    steps_out = Participant(
        kind=Kind.PEDESTRIAN,
        ds_m=26.0,
        dd_m=round(road.right_kerb_m - 0.5, 2),
        dyaw_rad=0.0,
        speed_mps=1.0,
        genes=(
            Gene(action=Action.KEEP, duration_s=1.0, magnitude=0.0),
            Gene(action=Action.CROSS, duration_s=3.0, magnitude=1.9),
        ),
    )
    return (overtakes, steps_out)[:max_participants]


def question(request: SeedRequest, road: RoadLimits, max_participants: int, system: str) -> Messages:
    """Return the prompt that asks for solutions.

    Args:
        request: Number of solutions, and the known ones.
        road: The road.
        max_participants: Maximum number of participants in a solution.
        system: Short description of the system under test.
    """
    parts = [_understanding(road, max_participants), _worked(road, max_participants)]
    if request.exposed or request.silent:
        parts.append(_rule_1(request))
    if request.rejected:
        parts.append(_rule_2(request))
    parts.append(_order(request.count, max_participants))
    return Message("system", _start(request.count, system)), Message("user", "\n\n".join(parts))


def repair(
    asked: Messages, accepted: Sequence[Solution], errors: Sequence[FieldError], count: int
) -> Messages:
    """Return the prompt that asks for the missing solutions after a reply with errors.

    Args:
        asked: The original prompt.
        accepted: The valid solutions of the reply.
        errors: The errors of the other items.
        count: Number of solutions still wanted.
    """
    lines = [f"- {pointed(error)}" for error in errors[:MAX_ERRORS]]
    if len(errors) > MAX_ERRORS:
        lines.append(f"- and {len(errors) - MAX_ERRORS} more")
    text = "\n".join(
        (
            "Of your answer only the solutions above can be used. Errors, by JSON pointer into what you wrote:",
            *lines,
            f"Give {count} further {_solutions(count)} without these errors, in the same form and different from all "
            "above. Answer with the JSON object alone.",
        )
    )
    return *asked, Message("assistant", to_text(accepted)), Message("user", text)


def _solutions(count: int) -> str:
    return "solution" if count == 1 else "solutions"


def _people(max_participants: int) -> str:
    return f"1 to {max_participants} participants" if max_participants > 1 else "1 participant"


def _start(count: int, system: str) -> str:
    words = " ".join("".join(c if c.isprintable() else " " for c in system).split())[:_SYSTEM_CHARS]
    return (
        "You are an expert in testing automated driving systems. In simulation only, you design traffic scenarios "
        f"that make a system under test violate its safety requirements. The system under test, the ego: {words}. "
        f"You will be asked for {count} {_solutions(count)} and answer with one JSON object."
    )


def _understanding(road: RoadLimits, max_participants: int) -> str:
    kinds = "; ".join(
        f"{kind} ({SIZES_M[kind][0]:g} m long, {SIZES_M[kind][1]:g} m wide, at most {MAX_SPEEDS_MPS[kind]:g} m/s)"
        for kind in Kind
    )
    return "\n".join(
        (
            "# Task",
            f"A solution is {_people(max_participants)}: other road users who act by a timed script around the ego.",
            _road(road),
            "# Parameters of a participant",
            f"- kind: {kinds}.",
            f"- ds_m: station at which it starts, from {-REACH_M:g} to {REACH_M:g} m; positive is ahead of the ego.",
            f"- dd_m: offset at which it starts, from {-REACH_M:g} to {REACH_M:g} m; positive is to the left.",
            "- heading: with_ego (drives or walks the ego's way), oncoming (the other way), across (vehicles only: "
            "comes out of a crossing street).",
            "- speed_mps: speed at the start, from 0 m/s to the most of its kind.",
            f"- actions: {MIN_ACTIONS} to {MAX_ACTIONS} actions, one after the other. Each has a duration_s from "
            f"{MIN_DURATION_S:g} to {MAX_DURATION_S:g} s and a magnitude:",
            *_actions(),
            f"  Vehicles can do: {', '.join(VEHICLE_ACTIONS)}. Pedestrians can do: {', '.join(PEDESTRIAN_ACTIONS)}.",
            "# What makes a solution elite",
            "- It disturbs the ego's path: somebody brakes, cuts in, crosses, pulls out or comes towards it where "
            "and when the ego gets there. Work out where the ego is by then.",
            "- Its participants differ from each other in kind, place, direction and actions, and work together.",
            "- Their waypoints span lanes: over their actions they go from one lane, pavement or street to another.",
            "- It is physically possible: nobody starts on anybody else or where the road has no room.",
        )
    )


def _road(road: RoadLimits) -> str:
    lane_m, right_m, left_m = road.lane_width_m, road.right_kerb_m, road.left_kerb_m
    walk_m = road.pavement_m - KERB_ROOM_M
    low_m, high_m = kept_clear_m(Kind.VAN, road)
    lines = [
        "# Road",
        "- Stations run along the middle of the ego's lane, offsets across it. The ego starts at station 0, "
        "offset 0, at about 6 to 8 m/s, and traffic keeps to the right.",
        f"- Two lanes of {lane_m:g} m: the ego's own lane around dd_m 0, the oncoming lane around dd_m {lane_m:g}. "
        "On the oncoming lane a vehicle may be oncoming, or with_ego while it overtakes; nobody starts oncoming on "
        "the ego's own lane.",
        f"- On the ego's own lane no vehicle starts from ds_m {low_m:.1f} to {high_m:.1f}. Vehicles that start on "
        f"the same lane are {apart_m(Kind.VAN):.1f} m apart or more.",
        f"- Pavements, for pedestrians alone: dd_m from {right_m - walk_m:.2f} to {right_m - KERB_ROOM_M:.2f} on the "
        f"right, from {left_m + KERB_ROOM_M:.2f} to {left_m + walk_m:.2f} on the left. Pedestrians start there, "
        "with_ego or oncoming, and go onto the road with the action cross.",
    ]
    return "\n".join([*lines, *_streets(road)])


def _streets(road: RoadLimits) -> list[str]:
    """Return lines that say where vehicles may come out of crossing streets."""
    half_m = 0.5 * road.lane_width_m
    sides = (
        ("right", half_m, f"dd_m {road.right_kerb_m - WAITS_M:.2f} or less"),
        ("left", -half_m, f"dd_m {road.left_kerb_m + WAITS_M:.2f} or more"),
    )
    lines = []
    for side, aside_m, offset in sides:
        lanes = [middle_m + aside_m for middle_m in road.streets_m if abs(middle_m + aside_m) <= REACH_M]
        if lanes:
            stations = " or ".join(f"{lane_m:.2f}" for lane_m in lanes)
            lines.append(
                f"- A crossing street: from the {side}, vehicles with heading across come out of it at ds_m "
                f"{stations}; they start at {offset}."
            )
    return lines or [
        "- No street crosses the road nearby: no vehicle starts off the two lanes, none has heading across."
    ]


def _actions() -> list[str]:
    lines = []
    for action in Action:
        room = MAGNITUDES[action]
        values = f", {room.low:g} to {room.high:g} {room.unit}" if room.unit else "; write 0"
        lines.append(f"  - {action}: {room.meaning}{values}.")
    return lines


def _worked(road: RoadLimits, max_participants: int) -> str:
    shown = example(road, max_participants)
    story = "a car overtakes on the oncoming lane, cuts in before the ego and brakes"
    if len(shown) > 1:
        story += ", while a pedestrian steps onto the road ahead"
    return f"# Example\nOne solution: {story}.\n{to_text([shown])}"


def _rule_1(request: SeedRequest) -> str:
    exposed, silent = request.exposed[:MAX_SHOWN], request.silent[:MAX_SHOWN]
    lines = ["# Known solutions"]
    if exposed:
        lines += ["SE exposed a violation; such solutions are wanted:", to_text(exposed)]
    if silent:
        lines += ["SN exposed none; such solutions are not wanted:", to_text(silent)]
    differ = " and differ from those in SE: other participants, places, directions and orders of actions"
    lines.append(f"Rule 1: give solutions that expose violations{differ if exposed else ''}.")
    return "\n".join(lines)


def _rule_2(request: SeedRequest) -> str:
    return "\n".join(
        (
            "# Not different enough",
            "Rule 2: these, which you gave before, are not different enough from the known solutions. Do not give "
            "them, or any like them, again:",
            to_text(request.rejected[:MAX_SHOWN]),
        )
    )


def _order(count: int, max_participants: int) -> str:
    return "\n".join(
        (
            "# Answer",
            f"Give {count} {_solutions(count)} of {_people(max_participants)} each, all different from each other "
            "and from the example.",
            'Answer with one JSON object {"solutions": [...]} and nothing else: no text around it, no comments, '
            "plain numbers. It must comply with this JSON schema:",
            json.dumps(SCHEMA, separators=(",", ":")),
        )
    )
