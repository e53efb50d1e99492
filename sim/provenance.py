"""A simulator's metadata: the header of a trace and the provenance of a result."""

import json
import math
import platform
import time
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version

from brink import __version__
from brink.sim.episode import EpisodeSpec, Json, JsonObject, Verdict
from brink.sim.trace import VIOLATED_AT_S


@cache
def versions_with(*packages: str) -> Mapping[str, str]:
    """Return the versions of Brink, Python, NumPy and the packages that a simulator builds on.

    Args:
        packages: Names of installed distributions, such as ``pybullet``.
    """
    return {
        "brink": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", *packages)},
    }


def trace_header(
    spec: EpisodeSpec, verdicts: Mapping[str, Verdict], versions: Mapping[str, str]
) -> JsonObject:
    """Return the header of every trace: the episode's specification and the time of each first violation.

    Args:
        spec: The specification.
        verdicts: The verdicts, by requirement.
        versions: Versions of everything that determines an episode.
    """
    moments = {name: one.violated_at_s for name, one in verdicts.items() if one.violated_at_s is not None}
    # From the canonical text, so that the trace does not depend on the order of fields.
    return {
        "spec": json.loads(spec.canonical_json()),
        "versions": dict(versions),
        VIOLATED_AT_S: dict(sorted(moments.items())),
    }


def provenance(simulator: str, cpu_s: float, versions: Mapping[str, str], **facts: Json) -> dict[str, Json]:
    """Return the provenance of a result.

    Args:
        simulator: Id of the simulator.
        cpu_s: CPU time of this process when the episode began.
        versions: Versions of everything that determines an episode.
        facts: Additional entries.
    """
    return {
        "simulator": simulator,
        **versions,
        "instruction_set": instruction_set(),
        "cpu_s": time.process_time() - cpu_s,
        **facts,
    }


@cache
def instruction_set() -> str:
    """Return the processor architecture with a fingerprint of its floating-point arithmetic.

    Machines with the same value give the same episodes. The fingerprint is made of the low bits of functions whose
    last digits may depend on the mathematics library and the processor.
    """
    probes = [math.sin(1e5 + 0.1 * i) * math.exp(0.37 * i) * math.atan2(i, 3.3) for i in range(1, 40)]
    digits = "".join(value.hex()[-8:] for value in probes)
    total = sum(ord(char) * (index + 1) for index, char in enumerate(digits))
    return f"{platform.machine()}-{total % 2**32:08x}"
