"""The settings of `tolerance@1`."""

from dataclasses import dataclass, field

from brink.search.algorithms.ledger import LedgerConfig
from brink.search.settings import setting


@dataclass(frozen=True, slots=True, kw_only=True)
class ToleranceConfig(LedgerConfig):
    """Settings of the search for tolerances."""

    cells: dict[str, list[str]] = field(
        default_factory=dict,
        metadata={
            "help": "Parameters, such as type and target, and those of their choices to study in combination."
        },
    )
    conditions: list[dict[str, str | list[str]]] = field(
        default_factory=lambda: [{}],
        metadata={
            "help": "Conditions to tell apart: for each, a name and the choices that parameters are limited to, such "
            "as {name: by night, time_of_day: night}. No two conditions may have a drive in common."
        },
    )
    limit: float = setting(
        0.05,
        help="Share of drives with a violation that the error causes: the highest that is tolerated.",
        gt=0,
        lt=1,
    )
    confidence: float = setting(0.9, help="Probability that an interval covers the truth.", gt=0, lt=1)
    width: float = setting(
        0.0,
        help="The search ends when every interval of the tolerated severity is narrower than this.",
        ge=0,
        le=1,
    )
    without_error: int = setting(
        40,
        help="Drives without an error that each condition begins with, for each kind of scenario that cells need.",
        ge=1,
        le=100_000,
    )
    grossest: dict[str, str] = field(
        default_factory=dict,
        metadata={
            "help": "The choice that, at severity 1, stands for the most severe error: drives that hold with it are "
            "assumed to hold with the errors that it covers."
        },
    )
    covers: dict[str, list[str]] = field(
        default_factory=dict,
        metadata={"help": "Choices that stand for errors that the most severe one covers."},
    )
    audit: float = setting(
        0.25,
        help="Share of the simulations of covered errors in drives that are assumed to hold. With 0, this is not "
        "checked, and the intervals rely on it.",
        ge=0,
        le=0.5,
    )
    explore: float = setting(
        0.05,
        help="Share of the simulations at any severity, rather than where the limit may be reached.",
        ge=0,
        le=1,
    )
    design: str = setting(
        "adaptive",
        help="Where to simulate: adaptive; uniform for equally many drives at equally spaced severities, a baseline "
        "to compare with; or random for equally many at random severities, to check a requirement.",
        choices=("adaptive", "uniform", "random"),
    )
    levels: int = setting(8, help="Severities of the uniform design; a divisor of 32.", ge=1, le=32)
    severity: str = setting("severity", help="The parameter for the severity of the error, from 0 to 1.")
    fixed: dict[str, str | float] = field(
        default_factory=dict,
        metadata={"help": "Values of other parameters; those that are not given are drawn for every drive."},
    )
    truth: dict[str, str] = field(
        default_factory=dict, metadata={"help": "Choices that stand for no error at all."}
    )
    needs: dict[str, dict[str, list[str]]] = field(
        default_factory=dict,
        metadata={
            "help": "What the scenario must contain for a choice to be meaningful, such as {target=pedestrian: "
            "{pedestrians: ['18']}}."
        },
    )
    generation_size: int = setting(60, help="Candidates per generation.", ge=1, le=10_000)
    in_flight: int = setting(
        3,
        help="Generations in flight at a time. With more, more workers are busy; with fewer, each choice is "
        "based on more results.",
        ge=1,
        le=1000,
    )
