"""Specifications of traffic in SUMO, the demand on the networks that ship with Brink, and files of one's own."""

import gzip
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from brink.sim.adapters.sumo.demand import EGO, ROADS, demand_xml
from brink.sim.adapters.sumo.own_files import OwnFiles, OwnFilesError, thinned_demand
from brink.sim.adapters.sumo.specification import (
    MAGNITUDES,
    Affected,
    Drive,
    ErrorType,
    Incident,
    Network,
    PerceptionError,
    RoadSurface,
    Traffic,
)
from brink.sim.episode import Json
from brink.sim.errors import InvalidEpisode

NETWORKS = Path(__file__).parents[4] / "sim" / "adapters" / "sumo" / "roads"
TRAFFIC = Traffic(
    network="motorway",
    files=None,
    demand=0.6,
    trucks=0.2,
    automated=0.3,
    imperfection=0.5,
    surface=RoadSurface.WET,
    signals_s=0.0,
    incident=Incident.LEAD_BRAKES,
    incident_s=4.25,
    incident_mps2=5.0,
)
DEMAND = """<routes>
  <route id="r" edges="before merge after"/>
  <vehicle id="one" route="r" depart="0"/>
  <flow id="many" route="r" begin="0" end="60" vehsPerHour="900"/>
  <flow id="regular" route="r" begin="0" end="60" period="4"/>
  <flow id="random" route="r" begin="0" end="60" period="exp(0.5)"/>
  <vehicle id="two" route="r" depart="1"/>
</routes>"""


def drive(network: Network, demand: float = 0.6, trucks: float = 0.2) -> Drive:
    traffic = replace(TRAFFIC, network=network.value, demand=demand, trucks=trucks)
    return Drive(traffic=traffic, error=None, headway_s=1.0)


def error_of(kind: ErrorType) -> PerceptionError:
    scale = MAGNITUDES[kind]
    return PerceptionError(
        type=kind,
        affected=Affected.FLEET,
        magnitude=scale.at(0.25),
        onset_s=4.2,
        duration_s=7.0 if scale.has_duration else scale.at(0.25),
    )


@pytest.mark.parametrize("kind", ErrorType)
def test_errors_survive_json(kind: ErrorType) -> None:
    error = error_of(kind)
    assert PerceptionError.from_json("error", error.to_json(), 30.0) == error


@pytest.mark.parametrize("incident", Incident)
def test_traffic_survives_json(incident: Incident) -> None:
    traffic = replace(TRAFFIC, incident=incident)
    if incident is Incident.NONE:
        traffic = replace(traffic, incident_s=0.0, incident_mps2=0.0)
    assert Traffic.from_json(traffic.to_json(), 30.0) == traffic


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (ErrorType.MISS, "every automated car perceives nothing ahead for 2.5 s"),
        (ErrorType.SHORT_RANGE, "every automated car perceives things ahead only within 112.5 m for 7.0 s"),
        (ErrorType.TOO_FAR, "every automated car perceives things ahead 225% too far away for 7.0 s"),
        (ErrorType.TOO_NEAR, "every automated car perceives things ahead 22% too near for 7.0 s"),
        (
            ErrorType.TOO_FAST,
            "every automated car perceives the vehicle ahead 2.5 m/s too fast per 10 m of distance for 7.0 s",
        ),
        (ErrorType.NOISE, "every automated car perceives distances with noise of 75% for 7.0 s"),
        (ErrorType.LATE, "every automated car perceives things ahead only every 1.2 s for 7.0 s"),
    ],
)
def test_errors_have_words(kind: ErrorType, words: str) -> None:
    assert error_of(kind).words == f"from 4.2 s on, {words}"


@pytest.mark.parametrize("network", Network)
def test_the_ego_always_begins_in_the_same_place(network: Network) -> None:
    egos = []
    for seed in range(3):
        root = ElementTree.fromstring(demand_xml(drive(network), seed, 60.0))
        egos.append(ElementTree.tostring(root.findall("vehicle")[0]))
        assert root.findall("vehicle")[0].get("id") == EGO
    assert len(set(egos)) == 1


@pytest.mark.parametrize("network", Network)
def test_equal_seeds_give_equal_demands_and_others_others(network: Network) -> None:
    texts = [demand_xml(drive(network), seed, 60.0) for seed in (1, 1, 2)]
    assert texts[0] == texts[1] != texts[2]


@pytest.mark.parametrize("network", Network)
def test_more_demand_is_more_vehicles_and_none_is_the_ego_alone(network: Network) -> None:
    counts = [
        len(ElementTree.fromstring(demand_xml(drive(network, demand), 0, 60.0)).findall("vehicle"))
        for demand in (0.0, 0.3, 1.0)
    ]
    assert counts[0] == 1 < counts[1] < counts[2]


def test_vehicles_that_begin_in_one_lane_do_not_overlap() -> None:
    for network in Network:
        root = ElementTree.fromstring(demand_xml(drive(network, 1.0, 0.4), 3, 60.0))
        lengths = {kind.get("id"): float(str(kind.get("length"))) for kind in root.iter("vType")}
        lanes: dict[tuple[str, str], list[tuple[float, float]]] = {}
        for vehicle in root.findall("vehicle"):
            place, route = str(vehicle.get("departPos")), vehicle.find("route")
            assert route is not None
            if place != "base":
                lane = str(route.get("edges")).split()[0], str(vehicle.get("departLane"))
                lanes.setdefault(lane, []).append((float(place), lengths[vehicle.get("type")]))
        for inside in lanes.values():
            inside.sort()
            for (behind_m, _), (ahead_m, length_m) in pairwise(inside):
                assert ahead_m - length_m - behind_m > 2.0


@pytest.mark.parametrize("network", Network)
def test_every_route_is_a_way_through_its_network(network: Network) -> None:
    with gzip.open(NETWORKS / f"{network.value}.net.xml.gz") as file:
        root = ElementTree.parse(file).getroot()
    edges = {edge.get("id") for edge in root.iterfind("edge")}
    joined = {(one.get("from"), one.get("to")) for one in root.iterfind("connection")}
    roads = ROADS[network]
    routes = {roads.ego.route, *(route for lane in (*roads.full, *roads.entries) for route in lane.routes)}
    for route in routes:
        assert edges.issuperset(route)
        assert joined.issuperset(pairwise(route))


def write(folder: Path, demand: str = DEMAND, network: bytes | None = None) -> tuple[str, str]:
    demand_file, network_file = folder / "demand.rou.xml", folder / "network.net.xml"
    demand_file.write_text(demand, encoding="utf-8")
    if network is None:
        network = gzip.decompress((NETWORKS / "motorway.net.xml.gz").read_bytes())
    network_file.write_bytes(network)
    return str(network_file), str(demand_file)


def test_own_files_are_read_packed_or_not_and_known_by_their_content(tmp_path: Path) -> None:
    network, demand = write(tmp_path)
    plain = OwnFiles.read(network, demand, "two")
    packed = tmp_path / "packed.rou.xml.gz"
    packed.write_bytes(gzip.compress(DEMAND.encode()))
    assert OwnFiles.read(network, str(packed), "two").digest == plain.digest
    assert OwnFiles.from_json("files", plain.to_json()) == plain
    plain.check_unchanged()
    Path(demand).write_text(DEMAND + "\n", encoding="utf-8")
    with pytest.raises(InvalidEpisode, match="have changed since the campaign was submitted"):
        plain.check_unchanged()


@pytest.mark.parametrize(
    ("demand", "network", "message"),
    [
        (
            DEMAND.replace(
                "</routes>", '<person id="p" depart="2"><walk edges="before nowhere"/></person></routes>'
            ),
            None,
            "expected edges of the network in <person> 'p', got 'nowhere'",
        ),
        (DEMAND.replace("merge", "marge"), None, "<route> 'r', got 'marge' .did you mean 'merge'"),
        (
            DEMAND.replace('depart="1"/>', 'depart="1"><stop lane="gone_0" duration="5"/></vehicle>'),
            None,
            "<vehicle> 'two', got 'gone'",
        ),
        ("<routes/>", None, "expected at least one vehicle with an id"),
        ("<additional/>", None, r"\(<routes>\), got <additional>"),
        ("<routes>", None, "it is not XML"),
        ("<!DOCTYPE a><routes/>", None, "without a document type"),
        ('<routes><include href="a.xml"/></routes>', None, "everything in one file, got <include>"),
        ("\x1f", b"\x1f\x8b nonsense", "packed by gzip"),
        (DEMAND.replace('"1"', '"-1"'), None, "in order of departure, got 'two' after 'random'"),
        (DEMAND, b"<net/>", "at least one edge with lanes"),
        (DEMAND, b"<routes/>", r"\(<net>\), got <routes>"),
        (DEMAND.replace('"two"', '"too"'), None, "such as one, too; got 'two' .did you mean 'too'"),
    ],
)
def test_files_that_are_none_are_refused(
    tmp_path: Path, demand: str, network: bytes | None, message: str
) -> None:
    with pytest.raises(OwnFilesError, match=message):
        OwnFiles.read(*write(tmp_path, demand, network), "two")


@pytest.mark.parametrize("path", ["missing.xml", ".", "\0"])
def test_a_path_that_is_no_file_is_refused(tmp_path: Path, path: str) -> None:
    with pytest.raises(OwnFilesError, match=r"no such file|expected a file|null"):
        OwnFiles.read(str(tmp_path / path), str(tmp_path / path), "two")


@pytest.mark.parametrize(
    ("document", "message"),
    [("files", "expected an object"), ({"network": "n"}, "demand: missing"), ({"ego": 3}, "missing|text")],
)
def test_a_specification_with_wrong_files_is_refused(document: Json, message: str) -> None:
    with pytest.raises(InvalidEpisode, match=message):
        OwnFiles.from_json("files", document)


def test_a_thinned_demand_keeps_the_ego_and_reduces_flows(tmp_path: Path) -> None:
    files = OwnFiles.read(*write(tmp_path), "two")
    rng = np.random.default_rng(0)
    root = ElementTree.fromstring(thinned_demand(files, 0.25, rng))
    assert "two" in [vehicle.get("id") for vehicle in root.findall("vehicle")]
    many, regular, drawn = root.findall("flow")
    assert (many.get("vehsPerHour"), regular.get("period"), drawn.get("period")) == (
        "225.0",
        "16.0",
        "exp(0.125)",
    )
    none = ElementTree.fromstring(thinned_demand(files, 0.0, rng))
    assert [child.get("id") for child in none] == ["r", "two"]
