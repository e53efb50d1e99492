"""Small OpenSCENARIO files with every kind of parameter, constraint and distribution, and what they mean.

All are written after the standard's documentation.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any

SCENARIO = """<?xml version="1.0" encoding="UTF-8"?>
<OpenSCENARIO>
  <FileHeader revMajor="1" revMinor="3" date="2026-01-01T00:00:00" description="test" author="Brink"/>
  <ParameterDeclarations>
{declarations}
  </ParameterDeclarations>
  <CatalogLocations/>
  <RoadNetwork/>
  <Entities/>
  <Storyboard>
    <Init><Actions/></Init>
    <Story name="{{{{ braces }} ${{name}}">
      <Act name="act">
        <ManeuverGroup name="group" maximumExecutionCount="1">
          <Actors selectTriggeringEntities="false"/>
        </ManeuverGroup>
        <StartTrigger/>
      </Act>
    </Story>
    <StopTrigger/>
  </Storyboard>
</OpenSCENARIO>
"""
DISTRIBUTION = """<?xml version="1.0" encoding="UTF-8"?>
<OpenSCENARIO>
  <FileHeader revMajor="1" revMinor="3" date="2026-01-01T00:00:00" description="test" author="Brink"/>
  <ParameterValueDistribution>
    <ScenarioFile filepath="scenario.xosc"/>
{content}
  </ParameterValueDistribution>
</OpenSCENARIO>
"""


def declared(name: str, kind: str, value: str, *groups: str) -> str:
    """Return a declaration; a group is its constraints such as ``greaterThan 3; lessThan ${$v}``."""
    rules = [[one.strip().split(" ", 1) for one in group.split("; ")] for group in groups]
    inner = "".join(
        "<ConstraintGroup>"
        + "".join(f'<ValueConstraint rule="{rule}" value="{escape(limit)}"/>' for rule, limit in group)
        + "</ConstraintGroup>"
        for group in rules
    )
    opened = f'<ParameterDeclaration name="{name}" parameterType="{kind}" value="{value}">'
    return f"    {opened}{inner}</ParameterDeclaration>"


def elements(*values: str) -> str:
    """Return a set of values; ``value*weight`` has a weight."""
    parts = [one.partition("*") for one in values]
    return "".join(
        f'<Element value="{value}"' + (f' weight="{weight}"/>' if weight else "/>")
        for value, _, weight in parts
    )


def limits(low: float, high: float) -> str:
    """Return a range."""
    return f'<Range lowerLimit="{low}" upperLimit="{high}"/>'


def single(name: str, content: str) -> str:
    """Return a deterministic distribution of one parameter."""
    return (
        f'<DeterministicSingleParameterDistribution parameterName="{name}">{content}'
        "</DeterministicSingleParameterDistribution>"
    )


def value_set(name: str, *values: str) -> str:
    """Return a deterministic set of values."""
    return single(name, f"<DistributionSet>{elements(*values)}</DistributionSet>")


def steps(name: str, low: float, high: float, step: float) -> str:
    """Return a deterministic range in steps."""
    return single(name, f'<DistributionRange stepWidth="{step}">{limits(low, high)}</DistributionRange>')


def together(*rows: Mapping[str, str]) -> str:
    """Return value sets of several parameters."""
    sets = "".join(
        "<ParameterValueSet>"
        + "".join(
            f'<ParameterAssignment parameterRef="{name}" value="{value}"/>' for name, value in row.items()
        )
        + "</ParameterValueSet>"
        for row in rows
    )
    return (
        f"<DeterministicMultiParameterDistribution><ValueSetDistribution>{sets}</ValueSetDistribution>"
        "</DeterministicMultiParameterDistribution>"
    )


def likely(name: str, content: str) -> str:
    """Return a stochastic distribution of one parameter."""
    return f'<StochasticDistribution parameterName="{name}">{content}</StochasticDistribution>'


def deterministic(*parts: str) -> str:
    """Return a deterministic distribution file."""
    return DISTRIBUTION.format(content=f"<Deterministic>{''.join(parts)}</Deterministic>")


def stochastic(*parts: str) -> str:
    """Return a stochastic distribution file."""
    opened = '<Stochastic numberOfTestRuns="100" randomSeed="3">'
    return DISTRIBUTION.format(content=f"{opened}{''.join(parts)}</Stochastic>")


@dataclass(frozen=True, kw_only=True)
class Case:
    """A scenario, perhaps with a distribution file, and what they mean.

    Attributes:
        declarations: Its parameters.
        distribution: The distribution file; None without one.
        ranges: Ranges given beside the files.
        space: The search space, as a campaign file declares it.
        constraints: Its constraints.
        laws: Laws of its parameters.
        fixed: Values that the files fix.
    """

    declarations: tuple[str, ...]
    distribution: str | None = None
    ranges: Mapping[str, str] = field(default_factory=dict)
    space: Mapping[str, Any]
    constraints: tuple[str, ...] = ()
    laws: Mapping[str, Any] = field(default_factory=dict)
    fixed: Mapping[str, str] = field(default_factory=dict)

    @property
    def scenario(self) -> str:
        """The scenario file."""
        return SCENARIO.format(declarations="\n".join(self.declarations))


V, N = declared("v", "double", "20.0"), declared("n", "int", "2")
GAP = {"min": 5.0, "max": 60.0}
CASES: Mapping[str, Case] = {
    "double": Case(
        declarations=(declared("v", "double", "20", "greaterOrEqual 10; lessOrEqual 35"),),
        space={"v": {"min": 10.0, "max": 35.0}},
    ),
    "open-ends": Case(
        declarations=(declared("v", "double", "20", "greaterThan 0; lessThan 35"),),
        space={"v": {"min": 0.0, "max": 35.0}},
        constraints=("v > 0.0 and v < 35.0",),
    ),
    "int": Case(
        declarations=(declared("n", "int", "2", "greaterThan -3; lessThan 4.5"),),
        space={"n": {"min": -2, "max": 4, "step": 1}},
    ),
    "integer": Case(
        declarations=(declared("n", "integer", "2", "greaterOrEqual 1; lessOrEqual 4"),),
        space={"n": {"min": 1, "max": 4, "step": 1}},
    ),
    "unsignedInt": Case(
        declarations=(declared("n", "unsignedInt", "2"),),
        ranges={"n": "0:10:5"},
        space={"n": {"min": 0, "max": 10, "step": 5}},
    ),
    "unsignedShort": Case(
        declarations=(declared("n", "unsignedShort", "2", "lessOrEqual 3; greaterOrEqual 0"),),
        space={"n": {"min": 0, "max": 3, "step": 1}},
    ),
    "boolean": Case(
        declarations=(declared("wet", "boolean", "0"),), space={"wet": {"values": ["false", "true"]}}
    ),
    "string": Case(
        declarations=(declared("car", "string", "a b", "equalTo a b", 'equalTo van & "x"'),),
        space={"car": {"values": ["a b", 'van & "x"']}},
    ),
    "dateTime": Case(
        declarations=(declared("t", "dateTime", "2026-01-01T12:00:00"),),
        ranges={"t": "2026-01-01,2026-06-01T12:00:00"},
        space={"t": {"values": ["2026-01-01", "2026-06-01T12:00:00"]}},
    ),
    "alternatives": Case(
        declarations=(
            declared("v", "double", "3", "greaterOrEqual 0; lessOrEqual 5", "greaterOrEqual 9; lessThan 12"),
        ),
        space={"v": {"min": 0.0, "max": 12.0}},
        constraints=("(v >= 0.0 and v <= 5.0) or (v >= 9.0 and v < 12.0)",),
    ),
    "not-equal": Case(
        declarations=(declared("n", "int", "2", "greaterOrEqual 0; lessOrEqual 3; notEqualTo 1"),),
        space={"n": {"min": 0, "max": 3, "step": 1}},
        constraints=("n >= 0.0 and n <= 3.0 and n != 1.0",),
    ),
    "expressions": Case(
        declarations=(
            declared("v", "double", "20", "greaterOrEqual 10; lessOrEqual 35"),
            declared("v_mps", "double", "${$v / 3.6}"),
            declared(
                "gap",
                "double",
                "9",
                "greaterOrEqual ${pow($v_mps, 2) / 8}; lessOrEqual ${round(60.4)}; greaterOrEqual 5",
            ),
        ),
        ranges={"gap": "5:60"},
        space={"v": {"min": 10.0, "max": 35.0}, "gap": GAP},
        constraints=("gap >= (v / 3.6) ** 2.0 / 8.0 and gap <= floor(60.4 + 0.5) and gap >= 5.0",),
    ),
    "reserved-names": Case(
        declarations=(
            declared("seed", "double", "1", "greaterOrEqual 0; lessOrEqual 2"),
            declared("_seed", "double", "1", "greaterOrEqual $seed; lessOrEqual 3; greaterOrEqual 0"),
            declared("lambda", "int", "1", "greaterOrEqual 0; lessOrEqual 2"),
        ),
        space={
            "seed_": {"min": 0.0, "max": 2.0},
            "seed__": {"min": 0.0, "max": 3.0},
            "lambda_": {"min": 0, "max": 2, "step": 1},
        },
        constraints=("seed__ >= seed_ and seed__ <= 3.0 and seed__ >= 0.0",),
    ),
    "set": Case(
        declarations=(V, declared("car", "string", "van")),
        distribution=deterministic(value_set("v", "10", "12", "20"), value_set("car", "bus", "truck")),
        space={"v": {"values": ["10", "12", "20"]}, "car": {"values": ["bus", "truck"]}},
    ),
    "even-set": Case(
        declarations=(V, N),
        distribution=deterministic(value_set("v", "60", "30", "45"), value_set("n", "3")),
        space={"v": {"min": 30.0, "max": 60.0, "step": 15.0}},
        fixed={"n": "3"},
    ),
    "range": Case(
        declarations=(V, N, declared("kept", "double", "1.5")),
        distribution=deterministic(steps("v", 10, 35, 0.1), steps("n", 1, 6, 2)),
        space={"v": {"min": 10.0, "max": 35.0, "step": 0.1}, "n": {"min": 1, "max": 5, "step": 2}},
    ),
    "value-sets": Case(
        declarations=(V, N, declared("car", "string", "van"), declared("gap", "double", "9")),
        distribution=deterministic(
            together({"v": "10", "n": "1", "car": "bus"}, {"v": "15.5", "n": "1", "car": "&lt;bus&gt;"}),
            steps("gap", 5, 60, 5),
        ),
        space={
            "values": {"values": ["1", "2"], "gives": {"v": ["10", "15.5"], "car": ["bus", "<bus>"]}},
            "gap": GAP | {"step": 5.0},
        },
        fixed={"n": "1"},
    ),
    "incomplete-value-sets": Case(
        declarations=(V, N),
        distribution=deterministic(together({"v": "10"}, {"v": "15", "n": "7"})),
        space={"values": {"values": ["1", "2"], "gives": {"v": ["10", "15"], "n": ["2", "7"]}}},
    ),
    "constrained-value-sets": Case(
        declarations=(
            declared("v", "double", "20", "lessOrEqual 30"),
            declared("gap", "double", "9", "greaterOrEqual ${$v / 2}"),
        ),
        distribution=deterministic(
            together(*({"v": value} for value in ("10", "20", "40"))), steps("gap", 5, 60, 5)
        ),
        space={"values": {"values": ["1", "2"], "gives": {"v": ["10", "20"]}}, "gap": GAP | {"step": 5.0}},
        constraints=("values != '2' or gap >= 20.0 / 2.0",),
    ),
    "filtered-set": Case(
        declarations=(declared("v", "double", "20", "lessThan 20; notEqualTo 12"),),
        distribution=deterministic(value_set("v", "10", "12", "15.5", "20")),
        space={"v": {"values": ["10", "15.5"]}},
    ),
    "user-defined": Case(
        declarations=(V,),
        distribution=deterministic(
            single("v", '<UserDefinedDistribution type="sobol">10 to 35</UserDefinedDistribution>')
        ),
        ranges={"v": "10:35"},
        space={"v": {"min": 10.0, "max": 35.0}},
    ),
    "stochastic-user-defined": Case(
        declarations=(V, N),
        distribution=stochastic(
            likely("v", '<UserDefinedDistribution type="gumbel">1</UserDefinedDistribution>'),
            likely("n", f"<UniformDistribution>{limits(0.5, 4.5)}</UniformDistribution>"),
        ),
        ranges={"v": "10:35:5"},
        space={"v": {"min": 10.0, "max": 35.0, "step": 5.0}, "n": {"min": 1, "max": 4, "step": 1}},
        laws={"n": {"kind": "uniform", "min": 1, "max": 4}},
    ),
    "probability-set": Case(
        declarations=(declared("car", "string", "van"),),
        distribution=stochastic(
            likely(
                "car",
                f"<ProbabilityDistributionSet>{elements('bus*1', 'van*3', 'tram*0')}</ProbabilityDistributionSet>",
            )
        ),
        space={"car": {"values": ["bus", "van"]}},
        laws={"car": {"kind": "weights", "weights": {"bus": 0.25, "van": 0.75}}},
    ),
    "uniform": Case(
        declarations=(V,),
        distribution=stochastic(likely("v", f"<UniformDistribution>{limits(10, 35)}</UniformDistribution>")),
        space={"v": {"min": 10.0, "max": 35.0}},
        laws={"v": {"kind": "uniform", "min": 10.0, "max": 35.0}},
    ),
    "normal": Case(
        declarations=(V,),
        distribution=stochastic(
            likely(
                "v",
                f'<NormalDistribution expectedValue="20" variance="9">{limits(10, 35)}</NormalDistribution>',
            )
        ),
        space={"v": {"min": 10.0, "max": 35.0}},
        laws={"v": {"kind": "normal", "mean": 20.0, "sd": 3.0, "min": 10.0, "max": 35.0}},
    ),
    "unbounded-normal": Case(
        declarations=(V,),
        distribution=stochastic(likely("v", '<NormalDistribution expectedValue="20" variance="9"/>')),
        ranges={"v": "8:32"},
        space={"v": {"min": 8.0, "max": 32.0}},
        laws={"v": {"kind": "normal", "mean": 20.0, "sd": 3.0, "min": 8.0, "max": 32.0}},
    ),
    "log-normal": Case(
        declarations=(V,),
        distribution=stochastic(
            likely(
                "v",
                f'<LogNormalDistribution expectedValue="2" variance="1">{limits(0, 9)}</LogNormalDistribution>',
            )
        ),
        space={"v": {"min": 0.0, "max": 9.0}},
        laws={"v": {"kind": "lognormal", "mean": 2.0, "sd": 1.0, "min": 0.0, "max": 9.0}},
    ),
    "poisson": Case(
        declarations=(N, V),
        distribution=stochastic(
            likely("n", f'<PoissonDistribution expectedValue="3">{limits(0, 12)}</PoissonDistribution>'),
            likely("v", f'<PoissonDistribution expectedValue="2">{limits(1, 8)}</PoissonDistribution>'),
        ),
        space={"n": {"min": 0, "max": 12, "step": 1}, "v": {"min": 1.0, "max": 8.0, "step": 1.0}},
        laws={
            "n": {"kind": "poisson", "mean": 3.0, "min": 0, "max": 12},
            "v": {"kind": "poisson", "mean": 2.0, "min": 1.0, "max": 8.0},
        },
    ),
    "histogram": Case(
        declarations=(V,),
        distribution=stochastic(
            likely(
                "v",
                f'<Histogram><Bin weight="1">{limits(20, 30)}</Bin><Bin weight="2">{limits(0, 10)}</Bin>'
                f'<Bin weight="3">{limits(10, 15)}</Bin></Histogram>',
            )
        ),
        space={"v": {"min": 0.0, "max": 30.0}},
        laws={
            "v": {
                "kind": "histogram",
                "edges": [0.0, 10.0, 15.0, 20.0, 30.0],
                "weights": [2.0, 3.0, 0.0, 1.0],
                "min": 0.0,
                "max": 30.0,
            }
        },
    ),
    "mixed": Case(
        declarations=(
            V,
            N,
            declared("wet", "boolean", "false"),
            declared("gap", "double", "9", "greaterOrEqual ${$v / 2 + ceil($n / 2)}"),
        ),
        distribution=stochastic(
            likely("v", f"<UniformDistribution>{limits(10, 35)}</UniformDistribution>"),
            likely(
                "wet",
                f"<ProbabilityDistributionSet>{elements('1*1', 'false*4')}</ProbabilityDistributionSet>",
            ),
            likely(
                "gap",
                f'<NormalDistribution expectedValue="30" variance="100">{limits(5, 60)}</NormalDistribution>',
            ),
        ),
        space={"v": {"min": 10.0, "max": 35.0}, "wet": {"values": ["true", "false"]}, "gap": GAP},
        constraints=("gap >= v / 2.0 + -floor(-(2.0 / 2.0))",),
        laws={
            "v": {"kind": "uniform", "min": 10.0, "max": 35.0},
            "wet": {"kind": "weights", "weights": {"true": 0.2, "false": 0.8}},
            "gap": {"kind": "normal", "mean": 30.0, "sd": 10.0, "min": 5.0, "max": 60.0},
        },
    ),
}
