"""Writes a road network as ASAM OpenDRIVE 1.7, with the library scenariogeneration.

The library knows neither controllers nor the bounds of the map, and writes the catalogue of signals in capitals,
which the schema rejects: its elements are completed here.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from datetime import datetime
from typing import Final

from scenariogeneration import xodr

from brink.scenarios.network import (
    Contact,
    Lane,
    LaneKind,
    Link,
    RoadNetwork,
    RoadObject,
    RoadPart,
    TrafficLight,
)
from brink.sim.world.scenario import TimeOfDay, Weather
from brink.sim.world.weather import conditions

VERSION: Final = "1.7"
LIGHT_TYPE: Final = "1000001"
"""OpenDRIVE's type of a traffic light with red, amber and green."""
SIGNAL_CATALOGUE: Final = "OpenDRIVE"
"""The catalogue of that type, in place of a country."""
LIGHT_HEIGHT_M: Final = 2.4
DRY_FRICTION: Final = conditions(TimeOfDay.NOON, Weather.CLEAR).friction
"""Friction coefficient of the dry road; the scenario scales it."""
MARGIN_M: Final = 50.0
_MPS_TO_KMPH: Final = 3.6


def opendrive(network: RoadNetwork, created_at: datetime) -> ET.Element:
    """Return the root element of an OpenDRIVE file.

    Args:
        network: The network.
        created_at: When the file was made.
    """
    document = xodr.OpenDrive(network.name, revMinor="7")
    for road in network.roads:
        document.add_road(_road(road))
    for junction in network.junctions:
        element = xodr.Junction(junction.name, junction.id)
        for incoming, connecting, sign in junction.connections:
            lanes = next(len(road.right) for road in network.roads if road.id == connecting)
            connection = xodr.Connection(incoming, connecting, xodr.ContactPoint.start)
            for index in range(1, lanes + 1):
                connection.add_lanelink(sign * index, -index)
            element.add_connection(connection)
        document.add_junction(element)
    root: ET.Element = document.get_element()
    _complete_header(root, network, created_at)
    _add_controllers(root, network)
    for signal in root.iter("signal"):
        signal.set("country", SIGNAL_CATALOGUE)
    return root


def _complete_header(root: ET.Element, network: RoadNetwork, created_at: datetime) -> None:
    ends = [road.line.pose_at(station_m) for road in network.roads for station_m in (0.0, road.line.length_m)]
    east = [x_m for x_m, _, _ in ends]
    north = [y_m for _, y_m, _ in ends]
    header = root.find("header")
    assert header is not None
    header.attrib.update(
        date=created_at.isoformat(timespec="seconds"),
        vendor="Brink",
        west=str(min(east) - MARGIN_M),
        east=str(max(east) + MARGIN_M),
        south=str(min(north) - MARGIN_M),
        north=str(max(north) + MARGIN_M),
    )


def _add_controllers(root: ET.Element, network: RoadNetwork) -> None:
    """Add the groups of traffic lights, which the format requires between roads and junctions."""
    first_junction = len(root.findall("header")) + len(root.findall("road"))
    for offset, group in enumerate(network.signal_groups):
        controller = ET.Element("controller", id=str(group.id), name=group.name, sequence=str(offset))
        for light in group.lights:
            ET.SubElement(controller, "control", signalId=str(light), type="0")
        root.insert(first_junction + offset, controller)
    for junction, element in zip(network.junctions, root.findall("junction"), strict=True):
        for sequence, group_id in enumerate(junction.signal_groups):
            ET.SubElement(element, "controller", id=str(group_id), type="0", sequence=str(sequence))


def _road(road: RoadPart) -> xodr.Road:
    element = xodr.Road(
        road.id,
        _plan_view(road),
        _lanes(road),
        road_type=-1 if road.junction is None else road.junction,
        name=road.name,
    )
    if road.predecessor is not None:
        element.add_predecessor(*_link(road.predecessor))
    if road.successor is not None:
        element.add_successor(*_link(road.successor))
    if road.speed_limit_mps is None:
        element.add_type(xodr.RoadType.town)
    else:
        limit_kmph = round(road.speed_limit_mps * _MPS_TO_KMPH, 6)
        element.add_type(xodr.RoadType.town, speed=limit_kmph, speed_unit="km/h")
    for height in road.elevations:
        element.add_elevation(height.from_m, height.a, height.b, height.c, height.d)
    # Appended, not added: `add_object` and `add_signal` share one set of ids among all documents of the process.
    element.objects.extend(_objects(road))
    element.signals.extend(_signal(light) for light in road.lights)
    return element


def _link(link: Link) -> tuple[xodr.ElementType, int, xodr.ContactPoint | None]:
    if link.contact is None:
        return xodr.ElementType.junction, link.id, None
    contact = xodr.ContactPoint.start if link.contact is Contact.START else xodr.ContactPoint.end
    return xodr.ElementType.road, link.id, contact


def _plan_view(road: RoadPart) -> xodr.PlanView:
    plan = xodr.PlanView()
    station_m = 0.0
    for piece in road.line.pieces:
        shape = (
            xodr.Line(piece.length_m)
            if piece.curvature_1pm == 0.0
            else xodr.Arc(piece.curvature_1pm, length=piece.length_m)
        )
        plan.add_fixed_geometry(shape, *road.line.pose_at(station_m))
        station_m += piece.length_m
    return plan


def _lanes(road: RoadPart) -> xodr.Lanes:
    middle = xodr.Lane()
    if road.middle is None:
        middle.add_roadmark(xodr.RoadMark(xodr.RoadMarkType.none))
    else:
        dashes = road.middle
        mark = xodr.RoadMark(
            xodr.RoadMarkType.broken,
            width=dashes.width_m,
            color=xodr.RoadMarkColor.white,
            laneChange=xodr.LaneChange.both,
        )
        first_m = dashes.first_m % (2.0 * dashes.dash_m)
        mark.add_specific_road_line(
            xodr.RoadLine(dashes.width_m, dashes.dash_m, dashes.dash_m, toffset=0.0, soffset=first_m)
        )
        middle.add_roadmark(mark)
    section = xodr.LaneSection(0.0, middle)
    for index, lane in enumerate(road.left):
        section.add_left_lane(_lane(road, road.left, index, lane))
    for index, lane in enumerate(road.right):
        section.add_right_lane(_lane(road, road.right, index, lane))
    lanes = xodr.Lanes()
    lanes.add_lanesection(section)
    return lanes


def _lane(road: RoadPart, side: tuple[Lane, ...], index: int, lane: Lane) -> xodr.Lane:
    element = xodr.Lane(getattr(xodr.LaneType, lane.kind.value), a=lane.width_m)
    if road.lane_signs is not None:
        come_from, lead_to = road.lane_signs
        element.add_link("predecessor", come_from * (index + 1))
        element.add_link("successor", lead_to * (index + 1))
    outside = side[index + 1].kind if index + 1 < len(side) else None
    if outside is LaneKind.SIDEWALK:
        mark = xodr.RoadMark(xodr.RoadMarkType.curb)
    elif outside is LaneKind.PARKING and road.lane_edge_m:
        mark = xodr.RoadMark(xodr.RoadMarkType.solid, width=road.lane_edge_m, color=xodr.RoadMarkColor.white)
    else:
        mark = xodr.RoadMark(xodr.RoadMarkType.none)
    element.add_roadmark(mark)
    if lane.kind is not LaneKind.SIDEWALK:
        element.add_lane_material(DRY_FRICTION, surface="asphalt")
    return element


def _objects(road: RoadPart) -> Iterable[xodr.Object]:
    for number, one in enumerate(road.objects):
        round_ = one.width_m == 0.0
        element = xodr.Object(
            one.s_m,
            one.t_m,
            Type=getattr(xodr.ObjectType, one.kind),
            id=str(1000 * road.id + number),
            name=one.name,
            hdg=one.heading_rad,
            height=one.height_m,
            width=None if round_ else one.width_m,
            length=None if round_ else one.length_m,
            radius=0.5 * one.length_m if round_ else None,
        )
        if one.height_m == 0.0:
            element.add_outline(_outline(one))
        yield element


def _outline(painted: RoadObject) -> xodr.Outline:
    """Return the outline of paint on the road, which some readers need in addition to its size."""
    half_m, half_width_m = 0.5 * painted.length_m, 0.5 * painted.width_m
    outline = xodr.Outline(closed=True, outer=True, id=0)
    for number, (u_m, v_m) in enumerate(
        ((half_m, half_width_m), (-half_m, half_width_m), (-half_m, -half_width_m), (half_m, -half_width_m))
    ):
        outline.add_corner(xodr.CornerLocal(u_m, v_m, 0.0, 0.0, id=number))
    return outline


def _signal(light: TrafficLight) -> xodr.Signal:
    lane = -1 if light.along else 1
    signal = xodr.Signal(
        light.s_m,
        light.t_m,
        SIGNAL_CATALOGUE,
        LIGHT_TYPE,
        subtype="-1",
        id=str(light.id),
        name=light.name,
        dynamic=xodr.Dynamic.yes,
        zOffset=LIGHT_HEIGHT_M,
        height=0.9,
        width=0.3,
        orientation=xodr.Orientation.positive if light.along else xodr.Orientation.negative,
    )
    signal.add_validity(lane, lane)
    return signal
