"""Writes parameter values as an OpenSCENARIO distribution file: one value set for each episode."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from datetime import datetime


def value_sets(
    scenario: str, sets: Sequence[Mapping[str, str]], *, description: str, created_at: datetime
) -> bytes:
    """Return a distribution file of OpenSCENARIO XML 1.2 that assigns each set of values in turn.

    Args:
        scenario: Path of the scenario, relative to the file.
        sets: Value of each parameter, by name; at least one set with at least one parameter.
        description: What they are.
        created_at: When the file was made.
    """
    root = ET.Element("OpenSCENARIO")
    ET.SubElement(
        root,
        "FileHeader",
        revMajor="1",
        revMinor="2",
        date=created_at.isoformat(timespec="seconds"),
        description=description,
        author="Brink",
    )
    distribution = ET.SubElement(root, "ParameterValueDistribution")
    ET.SubElement(distribution, "ScenarioFile", filepath=scenario)
    together = ET.SubElement(
        ET.SubElement(distribution, "Deterministic"), "DeterministicMultiParameterDistribution"
    )
    listed = ET.SubElement(together, "ValueSetDistribution")
    for values in sets:
        one = ET.SubElement(listed, "ParameterValueSet")
        for name, value in values.items():
            ET.SubElement(one, "ParameterAssignment", parameterRef=name, value=value)
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"
