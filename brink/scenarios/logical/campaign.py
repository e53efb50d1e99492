"""Writes campaign files for `command@1`, with comments that say what to edit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

from brink.scenarios.logical.laws import declared_law
from brink.scenarios.logical.space import Axis

EDIT = "EDIT"
"""Marks what is a guess."""
SCENARIO = "scenario"


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """A campaign file.

    Attributes:
        name: Name of the campaign.
        origin: What it was made from.
        command: Program and arguments.
        files: Templates: path of each, by its name in the working folder.
        copies: Files that are not changed, in the same way.
        axes: The parameters of the search space.
        constraints: Conditions on them.
        signals: Where the signals stand.
        requirements: The requirements.
        budget: Number of simulations.
        guesses: What of `command`, `signals` and `requirements` is a guess: why, by name.
        notes: What a reader should know.
    """

    name: str
    origin: str
    command: Sequence[str]
    files: Mapping[str, str] = field(default_factory=dict)
    copies: Mapping[str, str] = field(default_factory=dict)
    axes: Sequence[Axis]
    constraints: Sequence[str] = ()
    signals: Mapping[str, Any]
    requirements: Mapping[str, Any]
    budget: int
    guesses: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()

    @property
    def algorithm(self) -> str:
        """The algorithm: one for thresholds if there are numbers to find them in."""
        return "edge@2" if any(not axis.rows for axis in self.axes) else "random@1"

    @property
    def distribution(self) -> dict[str, Any]:
        """The operational distribution, by component.parameter; what is uniform is left out."""
        laws = {
            f"{SCENARIO}.{axis.name}": declared_law(axis.law) for axis in self.axes if axis.law is not None
        }
        return {name: law for name, law in laws.items() if law is not None}

    def params(self) -> dict[str, Any]:
        """Return the parameters of the problem."""
        params = {
            "command": list(self.command),
            "files": dict(self.files),
            "copies": dict(self.copies),
            "space": {SCENARIO: {axis.name: dict(axis.declared) for axis in self.axes}},
            "constraints": list(self.constraints),
            "distribution": self.distribution,
            "signals": dict(self.signals),
            "requirements": dict(self.requirements),
        }
        return {name: value for name, value in params.items() if value}

    def text(self) -> str:
        """Return the file."""
        params = self.params()
        lines = [
            f"# Made from {self.origin}.",
            f"# Lines marked {EDIT} are guesses: check them, then brink try this file.",
        ]
        lines += [f"# Note: {one}" for one in self.notes]
        lines += [f"name: {_flow(self.name)}", "problem:", "  id: command@1", "  params:"]
        for name in ("command", "files", "copies"):
            if name in params:
                lines.append(f"    {name}: {_flow(params[name])}{self._edit(name)}")
        lines += ["    space:", f"      {SCENARIO}:"]
        for axis in self.axes:
            about = f"   # {axis.about}" if axis.about else ""
            lines.append(f"        {_flow(axis.name)}: {_flow(dict(axis.declared))}{about}")
        if self.constraints:
            lines += ["    constraints:", *(f"      - {_flow(one)}" for one in self.constraints)]
        if distribution := self.distribution:
            lines.append(
                "    distribution:   # random@1 and rate@1 draw by it; searches for thresholds ignore it"
            )
            lines += [f"      {_flow(name)}: {_flow(law)}" for name, law in distribution.items()]
        lines.append(f"    signals: {_flow(params['signals'])}{self._edit('signals')}")
        lines.append("    requirements:" + self._edit("requirements"))
        lines += [f"      {_flow(name)}: {_flow(one)}" for name, one in self.requirements.items()]
        lines += [f"algorithm: {{id: {self.algorithm}}}", f"budget: {{simulations: {self.budget}}}"]
        return "\n".join(lines) + "\n"

    def _edit(self, name: str) -> str:
        return f"   # {EDIT}: {self.guesses[name]}" if name in self.guesses else ""


def _flow(value: Any) -> str:
    """Return a value as YAML in one line."""
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10**9)
    return text.removesuffix("\n").removesuffix("\n...")
