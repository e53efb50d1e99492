"""The specification of an episode, its result, and the validation of their JSON fields.

Both are plain values that travel as JSON. An `EpisodeSpec` holds everything that determines the episode, so its hash
identifies the simulation: equal hashes mean the same simulation.
"""

import difflib
import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Self, TypeAlias, TypeVar

from brink.sim.errors import InvalidEpisode

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"
JsonObject: TypeAlias = "dict[str, Json]"

COMMAND_PREFIX = "command-"
"""Beginning of the ids of simulators that run a program of a user; the digest of its definition follows."""
FMU_PREFIX = "fmu-"
"""Beginning of the ids of simulators that step an FMU of a user; the digest of its file follows."""
MAX_SEED = 2**53 - 1
"""Largest episode seed: every integer up to it survives JSON parsers that store numbers as doubles."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeSpec:
    """Everything that determines an episode.

    Attributes:
        simulator: Versioned plug-in id, such as ``brink-drive@3``.
        scenario: The world, in terms that the simulator defines.
        behaviour: What the machine-learned component does, in terms that the simulator defines.
        requirements: Ids of the requirements to evaluate, or their names in `formulas`, in order.
        seed: Seed of all random draws of the episode, in [0, 2**53).
        duration_s: Simulated time, > 0.
        options: Further settings of the simulator (fidelity, mode, ...).
        sources: Digests of the sources of the plug-ins that it names, except Brink's own; see
            `brink.sim.catalogue.named_sources`.
        formulas: Requirements in signal temporal logic by name; see `brink.sim.formula_requirement`.
    """

    simulator: str
    scenario: Mapping[str, Json]
    behaviour: Mapping[str, Json]
    requirements: tuple[str, ...]
    seed: int
    duration_s: float
    options: Mapping[str, Json] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)
    formulas: Mapping[str, Json] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not 0 <= self.seed <= MAX_SEED:
            raise InvalidEpisode(f"seed: expected an integer in [0, 2**53), got {self.seed!r}")
        if not (math.isfinite(self.duration_s) and self.duration_s > 0):
            raise InvalidEpisode(
                f"duration_s: expected a positive number of seconds, got {self.duration_s!r}"
            )

    def check_for(self, simulator: str, longest_s: float) -> None:
        """Check that the episode names the given simulator and does not exceed its maximum duration.

        Raises:
            InvalidEpisode: It names another simulator, or is too long.
        """
        if self.simulator != simulator:
            raise InvalidEpisode(f"simulator: expected {simulator}, got {self.simulator!r}")
        if self.duration_s > longest_s:
            raise InvalidEpisode(
                f"duration_s: expected at most {longest_s:g} seconds, got {self.duration_s!r}"
            )

    def to_json(self) -> JsonObject:
        """Return the specification as a JSON object."""
        return {
            "simulator": self.simulator,
            "scenario": dict(self.scenario),
            "behaviour": dict(self.behaviour),
            "requirements": list(self.requirements),
            "seed": self.seed,
            "duration_s": self.duration_s,
            "options": dict(self.options),
            **({"sources": dict(self.sources)} if self.sources else {}),
            **({"formulas": dict(self.formulas)} if self.formulas else {}),
        }

    @classmethod
    def from_json(cls, document: Mapping[str, Json]) -> Self:
        """Parse a specification from a JSON object.

        Raises:
            InvalidEpisode: A field is missing, unknown or of the wrong type.
        """
        expected: dict[str, tuple[type, ...]] = {
            "simulator": (str,),
            "scenario": (dict,),
            "behaviour": (dict,),
            "requirements": (list,),
            "seed": (int,),
            "duration_s": (int, float),
            "options": (dict,),
            "sources": (dict,),
            "formulas": (dict,),
        }
        unknown = sorted(set(document) - set(expected))
        if unknown:
            raise InvalidEpisode(
                f"unknown field {unknown[0]!r} in the episode; expected {', '.join(expected)}"
            )
        for name, types in expected.items():
            if name not in document:
                if name in ("options", "sources", "formulas"):
                    continue
                raise InvalidEpisode(f"{name}: missing")
            if not isinstance(document[name], types) or isinstance(document[name], bool):
                names = " or ".join(t.__name__ for t in types)
                raise InvalidEpisode(f"{name}: expected {names}, got {document[name]!r}")
        values = dict(document)
        requirements = values["requirements"]
        assert isinstance(requirements, list)
        if not all(isinstance(item, str) for item in requirements):
            raise InvalidEpisode(f"requirements: expected a list of ids, got {requirements!r}")
        values["requirements"] = tuple(requirements)  # type: ignore[assignment]
        values["duration_s"] = float(values["duration_s"])  # type: ignore[arg-type]
        return cls(**values)  # type: ignore[arg-type]

    def canonical_json(self) -> str:
        """Return the canonical JSON text of this specification: sorted keys, shortest floats, no spaces."""
        return json.dumps(self.to_json(), sort_keys=True, separators=(",", ":"), allow_nan=False)

    def digest(self) -> str:
        """Return the SHA-256 of the canonical JSON, as 64 hexadecimal digits."""
        return digest_of(self.canonical_json())


def digest_of(canonical_json: str) -> str:
    """Return the digest of a specification whose canonical JSON is known."""
    return hashlib.sha256(canonical_json.encode()).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The verdict of a requirement on an episode.

    Attributes:
        robustness: Distance to violation in `unit`; negative if violated, zero satisfies.
        unit: ``m``, ``s``, ``m/s``, ...
        violated_at_s: Simulated time of the first violation, or None.
    """

    robustness: float
    unit: str
    violated_at_s: float | None

    @property
    def violated(self) -> bool:
        """Whether the requirement is violated."""
        return self.robustness < 0


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeResult:
    """The outcome of an episode.

    Attributes:
        verdicts: One per requirement of the specification, by id.
        objectives: Objectives of the search by name, all minimised.
        features: Additional facts about the episode, by name.
        provenance: Versions, instruction-set fingerprint, CPU time, simulated time.
        trace: The compact trace (`brink.sim.trace.Trace.to_bytes`), if it was requested.
    """

    verdicts: Mapping[str, Verdict]
    objectives: Mapping[str, float]
    features: Mapping[str, Json]
    provenance: Mapping[str, Json]
    trace: bytes | None = None


_Choice = TypeVar("_Choice", bound=StrEnum)


def nearest(word: object, known: tuple[str, ...]) -> str:
    """Return the hint `` (did you mean '...'?)`` if a word is close to a known one, else an empty string."""
    close = difflib.get_close_matches(str(word), known, n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def parse_choice(where: str, value: Json, choices: Iterable[_Choice]) -> _Choice:
    """Parse one of several words.

    Args:
        where: Name of the field in error messages, such as ``scenario.weather``.
        value: What was given.
        choices: The words, such as an enumeration.

    Raises:
        InvalidEpisode: It is none of them.
    """
    known = {choice.value: choice for choice in choices}
    if isinstance(value, str) and value in known:
        return known[value]
    words = tuple(known)
    raise InvalidEpisode(
        f"{where}: expected one of {', '.join(words)}; got {value!r:.80}{nearest(value, words)}"
    )


def parse_number(where: str, value: Json, low: float, high: float, unit: str = "") -> float:
    """Parse a number in a range.

    Args:
        where: Name of the field in error messages, such as ``options.hold_s``.
        value: What was given.
        low: Smallest number allowed.
        high: Largest number allowed.
        unit: Their unit.

    Raises:
        InvalidEpisode: It is not a number, or out of range.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        expected = f"[{low:g}, {high:g}] {unit}".rstrip()
        raise InvalidEpisode(f"{where}: expected a number in {expected}, got {value!r:.80}")
    return float(value)


def parse_integer(where: str, value: Json, low: int, high: int) -> int:
    """Parse an integer in a range; the arguments are those of `parse_number`.

    Raises:
        InvalidEpisode: It is not an integer, or out of range.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise InvalidEpisode(f"{where}: expected an integer in [{low}, {high}], got {value!r:.80}")
    return value


def check_fields(where: str, document: Mapping[str, Json], expected: tuple[str, ...]) -> None:
    """Check that a JSON object has exactly the expected fields.

    Args:
        where: Name of the object in error messages, such as ``scenario``.
        document: The object.
        expected: Names of its fields.

    Raises:
        InvalidEpisode: A field is missing or unknown.
    """
    for name in document:
        if name not in expected:
            raise InvalidEpisode(
                f"{where}: unknown field {name!r}{nearest(name, expected)}; expected {', '.join(expected)}"
            )
    for name in expected:
        if name not in document:
            raise InvalidEpisode(f"{where}.{name}: missing; expected {', '.join(expected)}")
