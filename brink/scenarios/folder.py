"""Writes an exported drive: the scenario, the roads, and everything that the standards do not cover."""

import json
import math
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from brink import __version__
from brink.report.component import write_boxes
from brink.scenarios import opendrive, openscenario, replay_in_carla
from brink.scenarios.exportable import SCENARIO_FILE, EgoControl
from brink.scenarios.worlds import spec_of, world_of
from brink.sim.catalogue import make_requirements
from brink.sim.episode import Json, JsonObject
from brink.sim.trace import VIOLATED_AT_S, Trace

ROAD_FILE: Final = "road.xodr"
BOXES_FILE: Final = "boxes.csv"
VERDICTS_FILE: Final = "verdicts.json"
README_FILE: Final = "README.txt"
CARLA_FILE: Final = "replay_in_carla.py"


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """The origin of an exported drive.

    Attributes:
        campaign: Id of the campaign.
        name: Name of the campaign.
        number: Number of the solution.
        words: Description of the solution.
        deciding: Requirements that decide the campaign's verdict.
        odd: The campaign's operational design domain: limits by component.parameter; empty if it was not limited.
    """

    campaign: str
    name: str
    number: int
    words: str
    deciding: tuple[str, ...]
    odd: Mapping[str, Any] = field(default_factory=dict)


def write_openscenario(
    trace: Trace, origin: Origin, folder: Path, *, ego: EgoControl, created_at: datetime
) -> list[Path]:
    """Write a drive as OpenSCENARIO and OpenDRIVE, with its boxes and verdicts beside them.

    Args:
        trace: The drive.
        origin: Where it comes from.
        folder: Folder to write to; created if missing. Files of an earlier export are replaced.
        ego: What moves the ego.
        created_at: Time of the export, recorded in the files.

    Returns:
        The files.

    Raises:
        NotExportable: The drive's world has no roads that can be exported.
    """
    world = world_of(trace)
    title = f"Brink campaign {origin.campaign}, solution {origin.number}"
    folder.mkdir(parents=True, exist_ok=True)
    _write_xml(opendrive.opendrive(world.network, created_at), folder / ROAD_FILE)
    scenario = openscenario.openscenario(
        trace, world, ego=ego, road_file=ROAD_FILE, title=title, created_at=created_at
    )
    _write_xml(scenario, folder / SCENARIO_FILE)
    write_boxes(trace, folder / BOXES_FILE)
    verdicts = json.dumps(verdicts_document(trace, origin), indent=2, allow_nan=False)
    (folder / VERDICTS_FILE).write_text(f"{verdicts}\n", encoding="utf-8")
    shutil.copyfile(replay_in_carla.__file__, folder / CARLA_FILE)
    (folder / README_FILE).write_text(_readme(trace, origin, ego, created_at), encoding="utf-8")
    names = (README_FILE, SCENARIO_FILE, ROAD_FILE, BOXES_FILE, VERDICTS_FILE, CARLA_FILE)
    return [folder / name for name in names]


def _write_xml(root: ET.Element, file: Path) -> None:
    ET.indent(root)
    ET.ElementTree(root).write(file, encoding="utf-8", xml_declaration=True)


def verdicts_document(trace: Trace, origin: Origin) -> JsonObject:
    """Return the verdicts of a drive as a JSON object.

    Robustness is the smallest over the drive, null for a requirement that never applied.
    """
    spec = spec_of(trace)
    moments = trace.about.get(VIOLATED_AT_S)
    violated_at: Mapping[str, Json] = moments if isinstance(moments, dict) else {}
    requirements: JsonObject = {}
    for name, requirement in make_requirements(spec.requirements, spec.formulas).items():
        series = trace.robustness.get(name)
        least = float(series.min()) if series is not None and len(series) else math.inf
        requirements[name] = {
            "violated": name in violated_at,
            "violated_at_s": violated_at.get(name),
            "robustness": round(least, 6) if math.isfinite(least) else None,
            "unit": requirement.unit,
            "decides_the_verdict": name in origin.deciding,
        }
    return {
        "campaign": origin.campaign,
        "campaign_name": origin.name,
        "solution": origin.number,
        "words": origin.words,
        **({"odd": dict(origin.odd)} if origin.odd else {}),
        "requirements": requirements,
        "spec": spec.to_json(),
        "versions": trace.about.get("versions"),
    }


_WHO_DRIVES: Final = {
    EgoControl.RECORDED: "The ego follows its recorded trajectory, like all other road users.",
    EgoControl.CONTROLLED: "The ego is left to a controller of your simulator. The scenario gives its start, "
    "its speed and its route.\nAll other road users follow their recorded trajectories and do not react to it.",
}


def _readme(trace: Trace, origin: Origin, ego: EgoControl, created_at: datetime) -> str:
    spec = spec_of(trace)
    limits = "".join(f"\n  {name}: {json.dumps(limit)}" for name, limit in origin.odd.items())
    odd = f"\nThe campaign was limited to the operational design domain{limits}\n" if limits else ""
    return f"""A drive exported by Brink

Campaign {origin.campaign} ({origin.name}), solution {origin.number}
{origin.words}
{odd}
{_WHO_DRIVES[ego]}

Files
  {SCENARIO_FILE:20} ASAM OpenSCENARIO XML {openscenario.VERSION}: road users, trajectories, weather, traffic lights
  {ROAD_FILE:20} ASAM OpenDRIVE {opendrive.VERSION}: roads, lanes, junctions, signals, buildings, trees
  {BOXES_FILE:20} image boxes at each perception step, in pixels of an 800 x 600 image: "seen" is the
  {"":20} ground truth, "said" is what the obstacle detector reported to the driving system
  {VERDICTS_FILE:20} requirements: verdicts, smallest robustness, units; the specification of the drive
  {CARLA_FILE:20} replays the scenario in CARLA. It was written against CARLA's documentation and has
  {"":20} never been run in CARLA

Conventions
  Lengths in m, times in s, angles in rad; x forward at the start, y to the left, z up.
  The position of a vehicle is the middle of its rear axle, on the ground; that of everything else its middle.
  The axles of all vehicles but the ego are assumed: the wheelbase is 60% of the length.
  Lamps of a traffic light are listed as red;amber;green.

Made by
  Brink {__version__} with scenariogeneration {version("scenariogeneration")}
  simulator {spec.simulator}, seed {spec.seed}
  {created_at.isoformat(timespec="seconds")}
"""
