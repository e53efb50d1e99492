"""The protocol `brink-driving/1` between Brink and a driving system in a process of its own.

Each message is a line of JSON in UTF-8, an object with one key that names the message. The program says ``hello``.
Then it answers each ``start`` with ``ready``, and each ``step`` with ``decision``, or either with ``error``. Values
have the names and units of `Start`, `Observation` and `Decision`; null and absent are the same. JSON carries each
float exactly, so a system drives in a process as it would here.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Final

from brink.sim.driving.interface import Observation, ObstacleLabel, PerceivedObstacle, Route, SeenObject
from brink.sim.driving_systems.interface import Decision, Needs, Start, TrajectoryPoint
from brink.sim.errors import DrivingSystemFailed, InvalidEpisode

PROTOCOL: Final = "brink-driving/1"
MAX_WORD_CHARS: Final = 80
_encode: Final = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), check_circular=False).encode
_DECISION: Final = frozenset(field.name for field in fields(Decision))
_HELLO: Final = ("protocol", "name", "version", "needs")
_NEEDS: Final[Mapping[str, Needs]] = {"boxes": "boxes", "objects": "objects"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Hello:
    """What a program says of itself.

    Attributes:
        name: Name of the driving system.
        version: Its version.
        needs: Whether it gets boxes or objects.
    """

    name: str
    version: str
    needs: Needs


def start_message(start: Start) -> bytes:
    """Return the message that begins a drive."""
    camera = start.camera
    return _line(
        "start",
        {
            "interface": start.interface,
            "route": _route(start.route),
            "car": asdict(start.car),
            "camera": {
                "focal_px": camera.focal_px,
                "height_m": camera.height_m,
                "forward_m": camera.forward_m,
            },
            "control_s": start.control_s,
            "perception_s": start.perception_s,
            "settings": dict(start.settings),
            "seed": start.seed,
        },
    )


def _route(route: Route) -> dict[str, Any]:
    return {
        "start_pose": route.start_pose,
        "pieces": route.pieces,
        "length_m": route.length_m,
        "lane_width_m": route.lane_width_m,
        "speed_limit_mps": route.speed_limit_mps,
        "stop_line_stations_m": route.stop_line_stations_m,
        "oncoming": route.oncoming,
        "crossings": [one._asdict() for one in route.crossings],
    }


def step_message(observation: Observation) -> bytes:
    """Return the message of a control step."""
    boxes, objects, light = observation.boxes, observation.objects, observation.light
    return _line(
        "step",
        {
            "time_s": observation.time_s,
            "ego": observation.ego._asdict(),
            "light": None if light is None else light._asdict(),
            "boxes": None if boxes is None else [box._asdict() for box in boxes],
            "objects": None if objects is None else [one._asdict() for one in objects],
            "seen_s": observation.seen_s,
        },
    )


def _line(name: str, content: Mapping[str, Any]) -> bytes:
    return _encode({name: content}).encode() + b"\n"


def read_hello(line: bytes) -> Hello:
    """Return what a program says of itself.

    Raises:
        InvalidEpisode: It speaks another protocol.
    """
    hello = _content(line, "hello")
    if not isinstance(hello, dict) or hello.get("protocol") != PROTOCOL:
        got = hello.get("protocol") if isinstance(hello, dict) else hello
        raise InvalidEpisode(f"hello: expected protocol {PROTOCOL!r}, got {got!r:.80}")
    words = {name: hello.get(name) for name in _HELLO}
    for name, word in words.items():
        if not isinstance(word, str) or not word.isprintable() or not 1 <= len(word) <= MAX_WORD_CHARS:
            raise InvalidEpisode(
                f"hello: expected {name} in 1 to {MAX_WORD_CHARS} printable characters, got {word!r:.80}"
            )
    if words["needs"] not in _NEEDS:
        raise InvalidEpisode(
            f"hello: expected needs to be one of {', '.join(_NEEDS)}; got {words['needs']!r}"
        )
    return Hello(name=str(words["name"]), version=str(words["version"]), needs=_NEEDS[str(words["needs"])])


def read_ready(line: bytes) -> None:
    """Check the answer to `start_message`.

    Raises:
        DrivingSystemFailed: It is another one.
    """
    _content(line, "ready")


def read_decision(line: bytes) -> Decision:
    """Return the decision that answers `step_message`. Its numbers are not checked yet.

    Raises:
        DrivingSystemFailed: It is none.
    """
    given = _content(line, "decision")
    if not isinstance(given, dict) or not given.keys() <= _DECISION:
        names = sorted(given.keys() - _DECISION) if isinstance(given, dict) else given
        raise DrivingSystemFailed(
            f"decision: expected an object with {', '.join(sorted(_DECISION))}; got {names!r:.120}"
        )
    values = {name: value for name, value in given.items() if value is not None}
    if "trajectory" in values:
        points = _objects("trajectory", values["trajectory"])
        values["trajectory"] = tuple(_point(index, point) for index, point in enumerate(points))
    if "objects" in values:
        values["objects"] = [_object(one) for one in _objects("objects", values["objects"])]
    return Decision(**values)


def _content(line: bytes, name: str) -> Any:
    """Return the content of a message.

    Raises:
        DrivingSystemFailed: It is another message, or an error that the program reports.
    """
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        message = None
    if isinstance(message, dict):
        if name in message:
            return message[name]
        if "error" in message:
            raise DrivingSystemFailed(f"it reports an error: {message['error']!s:.2000}")
    text = line.decode(errors="replace").rstrip()
    raise DrivingSystemFailed(f'expected a line of JSON, {{"{name}": …}}; got {text!r:.200}')


def _objects(name: str, value: object) -> list[dict[str, Any]]:
    if not isinstance(value, list) or not all(isinstance(one, dict) for one in value):
        raise DrivingSystemFailed(f"{name}: expected a list of objects, got {value!r:.120}")
    return value


def _point(index: int, point: dict[str, Any]) -> TrajectoryPoint:
    try:
        return TrajectoryPoint(**point)
    except TypeError:
        raise DrivingSystemFailed(
            f"trajectory[{index}]: expected {', '.join(TrajectoryPoint._fields)}; got {point!r:.120}"
        ) from None


def _object(one: dict[str, Any]) -> SeenObject | PerceivedObstacle:
    kind = PerceivedObstacle if "track" in one else SeenObject
    try:
        return kind(**{**one, "label": ObstacleLabel(one["label"])})
    except (KeyError, TypeError, ValueError):
        labels = " or ".join(ObstacleLabel)
        raise DrivingSystemFailed(
            f"objects: expected {', '.join(kind._fields)}, with label {labels}; got {one!r:.160}"
        ) from None
