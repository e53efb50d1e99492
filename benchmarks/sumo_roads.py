"""Builds the road networks that `sumo@1` ships with: ``python -m benchmarks.sumo_roads NETCONVERT``.

NETCONVERT is the program of that name from SUMO 1.28, for example from the package ``eclipse-sumo``. It turns the
nodes and edges below into the committed files in ``sim/adapters/sumo/roads/``: nobody else needs the program.
"""

import gzip
import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from brink.sim.adapters import sumo

ROADS: Final = Path(sumo.__file__).parent / "roads"
_OPTIONS: Final = (
    "--no-turnarounds",
    "--offset.disable-normalization",
    "--junctions.corner-detail",
    "5",
    "--no-warnings",
    "--tls.default-type",
    "static",
    "--default.lanewidth",
    "3.5",
    "--output.street-names",
    "false",
)
_HEADER: Final = re.compile(rb"<!--.*?-->\s*", re.DOTALL)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Nodes, edges and connections of a network, in SUMO's format."""

    nodes: tuple[str, ...]
    edges: tuple[str, ...]
    connections: tuple[str, ...] = ()


def node(*, name: str, x_m: float, y_m: float, kind: str = "priority") -> str:
    """Return a junction or an end of a road; its kind is one of SUMO's types, such as ``traffic_light``."""
    return f'<node id="{name}" x="{x_m:.2f}" y="{y_m:.2f}" type="{kind}"/>'


def edge(
    *,
    name: str,
    begin: str,
    end: str,
    lanes: int,
    speed_mps: float,
    priority: int = 1,
    shape: Sequence[tuple[float, float]] = (),
) -> str:
    """Return a road in one direction.

    Args:
        name: Its id.
        begin: The node where it begins.
        end: The node where it ends.
        lanes: Number of lanes.
        speed_mps: Speed limit.
        priority: A larger one has the right of way.
        shape: Points of its axis from `begin` to `end`, both included; a straight line if empty.
    """
    points = " ".join(f"{x:.2f},{y:.2f}" for x, y in shape)
    bent = f' shape="{points}"' if points else ""
    return (
        f'<edge id="{name}" from="{begin}" to="{end}" numLanes="{lanes}" '
        f'speed="{speed_mps:.2f}" priority="{priority}"{bent}/>'
    )


def motorway() -> Plan:
    """Return three lanes of a motorway with a slip road, which joins by an acceleration lane of 300 m."""
    nodes = (
        node(name="south", x_m=0.0, y_m=0.0),
        node(name="joins", x_m=1500.0, y_m=0.0),
        node(name="joined", x_m=1800.0, y_m=0.0, kind="zipper"),
        node(name="north", x_m=4200.0, y_m=0.0),
        node(name="slip", x_m=1100.0, y_m=-70.0),
    )
    edges = (
        edge(name="before", begin="south", end="joins", lanes=3, speed_mps=33.33, priority=3),
        edge(name="merge", begin="joins", end="joined", lanes=4, speed_mps=33.33, priority=3),
        edge(name="after", begin="joined", end="north", lanes=3, speed_mps=33.33, priority=3),
        edge(
            name="ramp", begin="slip", end="joins", lanes=1, speed_mps=22.22, priority=2,
            shape=((1100.0, -70.0), (1300.0, -45.0), (1420.0, -24.0), (1500.0, -14.0)),
        ),
    )  # fmt: skip
    connections = (
        *(_connection("before", lane, "merge", lane + 1) for lane in range(3)),
        _connection("ramp", 0, "merge", 0),
        *(_connection("merge", lane + 1, "after", lane) for lane in range(3)),
    )
    return Plan(nodes=nodes, edges=edges, connections=connections)


def arterial() -> Plan:
    """Return a road of two lanes each way with six signalled crossroads, 280 m apart."""
    spacing_m, reach_m, crossroads = 280.0, 200.0, 6
    nodes = [node(name="a0", x_m=0.0, y_m=0.0), node(name="a7", x_m=(crossroads + 1) * spacing_m, y_m=0.0)]
    edges: list[str] = []
    for index in range(1, crossroads + 1):
        x_m = index * spacing_m
        nodes += [
            node(name=f"a{index}", x_m=x_m, y_m=0.0, kind="traffic_light"),
            node(name=f"n{index}", x_m=x_m, y_m=reach_m),
            node(name=f"s{index}", x_m=x_m, y_m=-reach_m),
        ]
        for side in ("n", "s"):
            edges += _both_ways(f"{side}{index}", f"a{index}", lanes=1, speed_mps=13.89, priority=1)
    for index in range(crossroads + 1):
        edges += _both_ways(f"a{index}", f"a{index + 1}", lanes=2, speed_mps=16.67, priority=2)
    return Plan(nodes=tuple(nodes), edges=tuple(edges))


def grid() -> Plan:
    """Return five by five signalled crossroads, 140 m apart, with roads of one lane each way."""
    size, spacing_m = 5, 140.0
    nodes = []
    edges: list[str] = []
    for row in range(-1, size + 1):
        for column in range(-1, size + 1):
            inside = (0 <= row < size) + (0 <= column < size)
            if inside:
                nodes.append(
                    node(
                        name=_crossroad(column, row),
                        x_m=column * spacing_m,
                        y_m=row * spacing_m,
                        kind="traffic_light" if inside == 2 else "priority",
                    )
                )
    for line in range(size):
        for at in range(-1, size):
            for one, other in (((at, line), (at + 1, line)), ((line, at), (line, at + 1))):
                edges += _both_ways(
                    _crossroad(*one), _crossroad(*other), lanes=1, speed_mps=13.89, priority=1
                )
    return Plan(nodes=tuple(nodes), edges=tuple(edges))


def ring() -> Plan:
    """Return a circular road of one lane, 1,257 m long, in four quarters."""
    radius_m, quarters, points = 200.0, 4, 24
    nodes = []
    edges = []
    for quarter in range(quarters):
        x_m, y_m = _on_circle(radius_m, quarter / quarters)
        nodes.append(node(name=f"r{quarter}", x_m=x_m, y_m=y_m))
        shape = tuple(
            _on_circle(radius_m, (quarter + step / points) / quarters) for step in range(points + 1)
        )
        edges.append(
            edge(
                name=f"q{quarter}",
                begin=f"r{quarter}",
                end=f"r{(quarter + 1) % quarters}",
                lanes=1,
                speed_mps=22.22,
                shape=shape,
            )
        )
    return Plan(nodes=tuple(nodes), edges=tuple(edges))


PLANS: Final = {"motorway": motorway, "arterial": arterial, "grid": grid, "ring": ring}


def build(name: str, netconvert: str) -> bytes:
    """Return a network in SUMO's format, without the header that says when and where it was built.

    Args:
        name: Its key in `PLANS`.
        netconvert: Path of the program.

    Raises:
        subprocess.CalledProcessError: The program failed.
    """
    plan = PLANS[name]()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        _write(place / "a.nod.xml", "nodes", plan.nodes)
        _write(place / "a.edg.xml", "edges", plan.edges)
        _write(place / "a.con.xml", "connections", plan.connections)
        files = ("-n", "a.nod.xml", "-e", "a.edg.xml", "-x", "a.con.xml", "-o", "a.net.xml")
        subprocess.run([netconvert, *files, *_OPTIONS], cwd=place, check=True, stdout=subprocess.DEVNULL)
        return _HEADER.sub(b"", (place / "a.net.xml").read_bytes())


def _crossroad(column: int, row: int) -> str:
    return f"g{column + 1}{row + 1}"


def _connection(begin: str, lane: int, end: str, to_lane: int) -> str:
    return f'<connection from="{begin}" to="{end}" fromLane="{lane}" toLane="{to_lane}"/>'


def _on_circle(radius_m: float, turn: float) -> tuple[float, float]:
    return radius_m * math.cos(2 * math.pi * turn), radius_m * math.sin(2 * math.pi * turn)


def _both_ways(one: str, other: str, *, lanes: int, speed_mps: float, priority: int) -> Iterator[str]:
    for begin, end in ((one, other), (other, one)):
        yield edge(
            name=f"{begin}_{end}", begin=begin, end=end, lanes=lanes, speed_mps=speed_mps, priority=priority
        )


def _write(path: Path, root: str, items: Sequence[str]) -> None:
    path.write_text(f"<{root}>\n" + "\n".join(items) + f"\n</{root}>\n", encoding="utf-8")


def main() -> None:
    """Write every network."""
    if len(sys.argv) != 2:
        sys.exit(f"usage: python -m benchmarks.sumo_roads NETCONVERT\n\n{__doc__}")
    for name in PLANS:
        # No time of compression: equal networks are equal files.
        (ROADS / f"{name}.net.xml.gz").write_bytes(gzip.compress(build(name, sys.argv[1]), mtime=0))


if __name__ == "__main__":
    main()
