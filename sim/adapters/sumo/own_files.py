"""A road network and its demand from the user's own files: locating, reading and checking them.

Only the digest of the two files, not their path, says what was simulated: an episode whose files have changed since
it was specified does not run.
"""

import hashlib
import math
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final, Self
from xml.etree import ElementTree

import numpy as np

from brink.sim.episode import Json, JsonObject, check_fields, nearest
from brink.sim.errors import InvalidEpisode
from brink.user_file import read_file

MAX_BYTES: Final = 64 * 1024**2
"""Limit on the size of a file, packed and unpacked."""
_PACKED: Final = b"\x1f\x8b"
_UNSAFE: Final = (b"<!DOCTYPE", b"<!ENTITY")
_RATES: Final = ("vehsPerHour", "probability", "perHour")
_EDGES: Final = ("edges", "from", "to", "via", "edge")
"""Attributes of a demand that name edges."""
_READS_MORE: Final = ("input", "additional-files", "include")


class OwnFilesError(Exception):
    """A file is missing or is not what it should be; the message says what was expected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnFiles:
    """A network and a demand.

    Attributes:
        network: Path of a network in SUMO's format (``.net.xml``, possibly with ``.gz``).
        demand: Path of a demand with routes (``.rou.xml``, possibly with ``.gz``).
        ego: Id of the vehicle under test.
        digest: Digest of both files, 16 hexadecimal digits.
    """

    network: str
    demand: str
    ego: str
    digest: str

    @classmethod
    def read(cls, network: str, demand: str, ego: str) -> Self:
        """Return a network and a demand after checking them.

        Raises:
            OwnFilesError: A file is unusable, or the demand lacks the ego.
        """
        check_edges(demand, network)
        vehicles = vehicle_ids(demand)
        if ego not in vehicles:
            few = ", ".join(vehicles[:5])
            raise OwnFilesError(
                f"expected a vehicle of {demand}, such as {few}; got {ego!r}{nearest(ego, vehicles)}"
            )
        return cls(network=network, demand=demand, ego=ego, digest=digest_of(network, demand))

    def to_json(self) -> JsonObject:
        """Return them as a JSON object."""
        return {"network": self.network, "demand": self.demand, "ego": self.ego, "digest": self.digest}

    @classmethod
    def from_json(cls, where: str, document: Json) -> Self:
        """Parse them without opening the files.

        Raises:
            InvalidEpisode: A field is missing, unknown, or no text.
        """
        if not isinstance(document, Mapping):
            raise InvalidEpisode(f"{where}: expected an object, got {document!r:.80}")
        check_fields(where, document, ("network", "demand", "ego", "digest"))
        for name, value in document.items():
            if not isinstance(value, str) or not value:
                raise InvalidEpisode(f"{where}.{name}: expected text, got {value!r:.80}")
        return cls(**{name: str(value) for name, value in document.items()})

    def check_unchanged(self) -> None:
        """Check that the files exist and are the ones with which the episode was specified.

        Raises:
            InvalidEpisode: One is missing, or another one now.
        """
        try:
            found = digest_of(self.network, self.demand)
        except OwnFilesError as error:
            raise InvalidEpisode(f"scenario.files: {error}; workers need the same files") from None
        if found != self.digest:
            raise InvalidEpisode(
                f"scenario.files: {self.network} and {self.demand} have digest {found}, expected {self.digest}: "
                "they have changed since the campaign was submitted; submit it again"
            )


def digest_of(network: str, demand: str) -> str:
    """Return the digest of two files, 16 hexadecimal digits.

    Raises:
        OwnFilesError: A file cannot be read.
    """
    parts = (hashlib.sha256(_bytes(path)).digest() for path in (network, demand))
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]


def edge_ids(path: str) -> frozenset[str]:
    """Return the ids of the edges of a network in SUMO's format.

    Raises:
        OwnFilesError: The file is no such network.
    """
    root = _parse(path, "net", "a network in SUMO's format, as netconvert writes it")
    edges = [edge for edge in root.iterfind("edge") if edge.get("function") != "internal"]
    if not any(True for edge in edges for _ in edge.iterfind("lane")):
        raise OwnFilesError(f"{path}: expected at least one edge with lanes")
    return frozenset(str(edge.get("id")) for edge in root.iterfind("edge"))


def vehicle_ids(path: str) -> tuple[str, ...]:
    """Return the ids of the vehicles that a demand lists one by one; SUMO generates the ids of flows' vehicles.

    Raises:
        OwnFilesError: The file is not a demand, or refers to further files.
    """
    root = _parse(path, "routes", "a demand in SUMO's format, with vehicles and their routes")
    for element in root.iter():
        if element.tag in _READS_MORE:
            raise OwnFilesError(f"{path}: expected everything in one file, got <{element.tag}>")
    _check_order(path, root)
    found = tuple(
        str(element.get("id"))
        for element in root
        if element.tag in ("vehicle", "trip") and element.get("id") and element.get("depart")
    )
    if not found:
        raise OwnFilesError(f"{path}: expected at least one vehicle with an id and a time of departure")
    return found


def check_edges(path: str, network: str) -> None:
    """Check that a demand uses edges of its network alone: vehicles, persons, containers, and where they stop.

    Args:
        path: The demand.
        network: The network.

    Raises:
        OwnFilesError: It names another edge, with which SUMO would not start.
    """
    known = edge_ids(network)
    for traveller in _parse(path, "routes", "a demand"):
        for element in traveller.iter():
            named = " ".join(element.get(name, "") for name in _EDGES).split()
            if (lane := element.get("lane")) is not None and element.tag == "stop":
                named.append(lane.rpartition("_")[0])
            for edge in named:
                if edge not in known:
                    raise OwnFilesError(
                        f"{path}: expected edges of the network in <{traveller.tag}> {traveller.get('id', '')!r}, "
                        f"got {edge!r}{nearest(edge, tuple(known))}"
                    )


def _check_order(path: str, root: ElementTree.Element) -> None:
    """Check that departures are in chronological order: SUMO ignores any that come too late."""
    latest, before = -math.inf, ""
    for element in root:
        name = str(element.get("id"))
        text = element.get("begin") if element.tag == "flow" else element.get("depart")
        try:
            depart_s = float(text) if text is not None else latest
        except ValueError:  # such as 01:30:00
            continue
        if depart_s < latest:
            raise OwnFilesError(
                f"{path}: expected vehicles and flows in order of departure, got {name!r} after {before!r}"
            )
        latest, before = depart_s, name


def _parse(path: str, root: str, what: str) -> ElementTree.Element:
    text = _bytes(path)
    if any(mark in text for mark in _UNSAFE):
        raise OwnFilesError(f"{path}: expected XML without a document type and entities")
    try:
        found = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise OwnFilesError(f"{path}: expected {what}; it is not XML: {error}") from None
    if found.tag != root:
        raise OwnFilesError(f"{path}: expected {what} (<{root}>), got <{found.tag}>")
    return found


def _bytes(path: str) -> bytes:
    """Return the content of a file, decompressed."""
    file = Path(path)
    try:
        if not file.is_file():
            raise OwnFilesError(f"{path}: {'expected a file' if file.exists() else 'no such file'}")
        status = file.stat()
        if status.st_size > MAX_BYTES:
            raise OwnFilesError(f"{path}: expected at most {MAX_BYTES} bytes, got {status.st_size}")
        return _read(file, status.st_mtime_ns, status.st_size)
    except (OSError, ValueError) as error:
        raise OwnFilesError(f"{path}: {getattr(error, 'strerror', None) or error}") from None


@lru_cache(maxsize=4)
def _read(file: Path, _modified_ns: int, _size: int) -> bytes:
    raw = read_file(file, MAX_BYTES)
    if not raw.startswith(_PACKED):
        return raw
    unpacker = zlib.decompressobj(wbits=31)
    try:
        text = unpacker.decompress(raw, MAX_BYTES)
    except zlib.error as error:
        raise OwnFilesError(f"{file}: expected a file packed by gzip: {error}") from None
    if unpacker.unconsumed_tail or not unpacker.eof:
        raise OwnFilesError(f"{file}: expected a complete file of at most {MAX_BYTES} bytes, unpacked")
    return text


def thinned_demand(files: OwnFiles, share: float, rng: np.random.Generator) -> bytes:
    """Return the demand with a random share of its vehicles, always including the ego.

    Of flows, which have no vehicles of their own yet, the rate is reduced.

    Args:
        files: The files.
        share: The share, in [0, 1].
        rng: Draws which vehicles stay.
    """
    root = ElementTree.fromstring(_bytes(files.demand))
    for element in list(root):
        if element.tag in ("vehicle", "trip"):
            stays = rng.random() < share
            if not stays and element.get("id") != files.ego:
                root.remove(element)
        elif element.tag == "flow":
            _thin_flow(element, share, root)
    return ElementTree.tostring(root)


def _thin_flow(flow: ElementTree.Element, share: float, root: ElementTree.Element) -> None:
    if share <= 0.0:
        root.remove(flow)
        return
    for name in _RATES:
        if (value := flow.get(name)) is not None:
            flow.set(name, repr(float(value) * share))
    if (period := flow.get("period")) is not None:
        # ``exp(0.2)`` is a rate, a plain number is the time between two vehicles.
        rate = re.fullmatch(r"exp\((.+)\)", period.strip())
        flow.set("period", f"exp({float(rate[1]) * share!r})" if rate else repr(float(period) / share))
    if (number := flow.get("number")) is not None:
        flow.set("number", str(max(1, round(float(number) * share))))
