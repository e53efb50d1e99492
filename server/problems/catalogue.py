"""The available problems and algorithms, and the JSON schemas of their parameters.

Parameters are dataclasses whose fields carry their bounds (`brink.search.settings.setting`). They are converted to
pydantic models, which validate and describe the input. Every problem has three parameters more, `ODD` and
`CONSTRAINTS`, which limit its search space (`brink.search.odd`, `SearchSpace.constrained`), and `DISTRIBUTION`, which
says how often its solutions occur in operation (`brink.search.distribution`). The problem itself does not see them.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, asdict, fields
from functools import lru_cache, partial
from importlib.util import find_spec
from typing import Any, Final, Literal, TypeVar, cast, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError, create_model
from pydantic import Field as PydanticField

from brink.extras import install_command
from brink.search.algorithm import AnyAlgorithm, declared_finds
from brink.search.distribution import NUMBERS, distributed
from brink.search.errors import ConfigError, DistributionError, OddError, SpaceError, UnsupportedSpace
from brink.search.odd import limited, odd_of
from brink.search.space import SearchSpace
from brink.server.documents import invalid_input
from brink.server.errors import FieldError, InvalidInput, nearest
from brink.server.problems.base import InProcessProblem, Problem, SimulatedProblem
from brink.server.problems.requirements import ANY
from brink.server.user_code import CONSTRUCTION, IMPORT, USER_CODE, guarded
from brink.sim.catalogue import (
    REQUIREMENTS,
    is_own_plugin,
    load_plugin,
    plugin_ids,
    plugin_modules,
    requirement_ids,
    requirement_words,
)

T = TypeVar("T")

log = logging.getLogger(__name__)

PROBLEMS = "brink.problems"
ALGORITHMS = "brink.algorithms"
ODD: Final = "odd"
CONSTRAINTS: Final = "constraints"
DISTRIBUTION: Final = "distribution"
LIMITS: Final = (CONSTRAINTS, ODD, DISTRIBUTION)
"""Names of the parameters that all problems have."""
_MOST_CONSTRAINTS: Final = 50

_PARAMS: Final = "/problem/params"
_ABOUT_ODD: Final = (
    "Operational design domain: limits by component.parameter, each one value, a list of choices, or "
    '{"min": …, "max": …}. A * in a name stands for any characters.'
)

_ABOUT_CONSTRAINTS: Final = (
    "Conditions that every solution meets, such as gap > 2 * speed / 3.6; the others are never simulated."
)

_ABOUT_DISTRIBUTION: Final = (
    "Operational distribution: how the values of parameters occur in operation, by component.parameter, such as "
    '{"normal": {"mean": 12, "deviation": 3}} or {"weights": {"day": 8, "night": 2}}; all others are equally likely. '
    "Estimates of rates draw from it; searches for boundaries ignore it."
)

_BOUNDS = ("ge", "gt", "le", "lt")
_MODELS: dict[type[Any], type[BaseModel]] = {}


_SHOWN: Final = ("unit", "label", "main")
"""Metadata that forms need besides a JSON schema's own."""


def params_model(params_type: type[Any]) -> type[BaseModel]:
    """Return the pydantic model of a parameter dataclass, which is built on first use."""
    if params_type not in _MODELS:
        _MODELS[params_type] = _build_model(params_type)
    return _MODELS[params_type]


def _build_model(params_type: type[Any]) -> type[BaseModel]:
    hints = get_type_hints(params_type)
    definitions: dict[str, Any] = {}
    for item in fields(params_type):
        definitions[item.name] = (_annotation(item, hints[item.name]), _field(item))
    model: type[BaseModel] = create_model(
        params_type.__name__,
        __config__=ConfigDict(extra="forbid", strict=True, frozen=True),
        __doc__=params_type.__doc__,
        **definitions,
    )
    return model


def _annotation(item: Field[Any], hint: Any) -> Any:
    choices = item.metadata.get("choices")
    return Literal[tuple(choices)] if choices else hint


def _field(item: Field[Any]) -> Any:
    bounds = {name: item.metadata[name] for name in _BOUNDS if item.metadata.get(name) is not None}
    extra: dict[str, Any] = {name: item.metadata[name] for name in _SHOWN if item.metadata.get(name)}
    about = {"description": item.metadata.get("help"), **bounds}
    if item.default_factory is not MISSING:
        extra["default"] = item.default_factory()
        return PydanticField(default_factory=item.default_factory, json_schema_extra=extra, **about)
    default = ... if item.default is MISSING else item.default
    return PydanticField(default, json_schema_extra=extra or None, **about)


def make_params(params_type: type[Any], values: Mapping[str, Any], prefix: str) -> Any:
    """Validate parameters.

    Args:
        params_type: Dataclass of the parameters.
        values: The input.
        prefix: JSON pointer to the input, such as ``/algorithm/params``.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    model = params_model(params_type)
    try:
        checked = model.model_validate(dict(values))
    except ValidationError as error:
        raise invalid_input(error, model, prefix) from None
    try:
        return params_type(**{name: getattr(checked, name) for name in model.model_fields})
    except ConfigError as error:
        raise InvalidInput([config_field_error(error, prefix)]) from None


def config_field_error(error: ConfigError, prefix: str) -> FieldError:
    """Convert a configuration error to an error with a JSON pointer."""
    message = str(error).removeprefix(f"{error.field}: ")
    return FieldError(pointer=f"{prefix}/{error.field}", message=message, nearest=error.nearest)


def _load(group: str, plugin_id: str, pointer: str, what: str) -> Any:
    known = plugin_ids(group)
    if plugin_id not in known:
        loaded = ", ".join(plugin_modules())
        more = f"none of the plug-ins {loaded} registers it" if loaded else "no plug-in is loaded"
        message = (
            f"unknown {what} {plugin_id!r}; expected one of {', '.join(known)}, or one that a plug-in registers: "
            f"brink --plugin MODULE … ({more})"
        )
        raise InvalidInput([FieldError(pointer=pointer, message=message, nearest=nearest(plugin_id, known))])
    return run_plugin(group, plugin_id, IMPORT, lambda: load_plugin(group, plugin_id))


def run_plugin(group: str, plugin_id: str, what: str, run: Callable[[], T]) -> T:
    """Run code of a plug-in and return its result; limit it as `brink.server.user_code` does if a user brought it.

    Args:
        group: Group of the plug-in.
        plugin_id: Its id.
        what: What is done, for messages.
        run: The code.

    Raises:
        CodeStalled: It did not return in time.
    """
    return run() if is_own_plugin(group, plugin_id) else USER_CODE.call(plugin_id, what, run)


def make_algorithm(algorithm_id: str) -> AnyAlgorithm:
    """Return an algorithm by its id.

    Raises:
        InvalidInput: The id is unknown.
        CodeStalled: The plug-in did not return in time; so it may be with every method of the algorithm.
    """
    factory = cast(Callable[[], AnyAlgorithm], _load(ALGORITHMS, algorithm_id, "/algorithm/id", "algorithm"))
    if is_own_plugin(ALGORITHMS, algorithm_id):
        return factory()
    return _made_algorithm(algorithm_id, factory)


@lru_cache(maxsize=64)  # an instance holds no state, and lists of campaigns need one for each entry
def _made_algorithm(algorithm_id: str, factory: Callable[[], AnyAlgorithm]) -> AnyAlgorithm:
    return USER_CODE.call(algorithm_id, CONSTRUCTION, lambda: guarded(algorithm_id, factory()))


def former_settings(algorithm_id: str) -> Mapping[str, Any]:
    """Return what settings of an algorithm were before there were such settings; empty for one of a plug-in."""
    if algorithm_id not in plugin_ids(ALGORITHMS) or not is_own_plugin(ALGORITHMS, algorithm_id):
        return {}
    former: Mapping[str, Any] = getattr(make_algorithm(algorithm_id), "former", {})
    return former


def is_baseline(algorithm_id: str) -> bool:
    """Return whether an algorithm draws solutions at random, without a search; false if it is not installed."""
    try:
        return bool(getattr(make_algorithm(algorithm_id), "is_baseline", False))
    except InvalidInput:
        return False


def algorithms_that(supports: type[Any]) -> list[str]:
    """Return the ids of the algorithms that implement a protocol, without plug-ins that cannot be loaded."""
    able = []
    for algorithm_id in plugin_ids(ALGORITHMS):
        try:
            if isinstance(make_algorithm(algorithm_id), supports):
                able.append(algorithm_id)
        except Exception:
            if is_own_plugin(ALGORITHMS, algorithm_id):
                raise
            log.exception("plug-in cannot be loaded", extra={"plugin": algorithm_id})
    return able


def uses_user_code(problem_id: str, algorithm_id: str) -> bool:
    """Return whether a campaign with this problem and algorithm runs user code; loads nothing.

    Plug-ins that are not installed here count as such.
    """
    try:
        return not (is_own_plugin(PROBLEMS, problem_id) and is_own_plugin(ALGORITHMS, algorithm_id))
    except KeyError:
        return True


def problem_type(problem_id: str) -> type[Any]:
    """Return the class of a problem.

    Raises:
        InvalidInput: The id is unknown.
    """
    return cast(type[Any], _load(PROBLEMS, problem_id, "/problem/id", "problem"))


def make_problem(problem_id: str, params: Mapping[str, Any]) -> Problem:
    """Return a problem, whose search space is limited to the ODD if the parameters have one.

    Raises:
        InvalidInput: The id is unknown, or a parameter is invalid.
        TypeError: The plug-in is not a problem.
    """
    return spelled_out(problem_id, params)[0]


def spelled_out(problem_id: str, params: Mapping[str, Any]) -> tuple[Problem, dict[str, Any]]:
    """Return a problem with all its parameters spelled out; the ODD is among them only if it limits something.

    Args:
        problem_id: Id of the problem.
        params: Parameters that differ from their defaults.

    Raises:
        InvalidInput: The id is unknown, or a parameter is invalid.
        TypeError: The plug-in is not a problem.
        CodeStalled: The plug-in did not return in time; so it may be with every method of the problem.
    """
    kind = problem_type(problem_id)
    if is_own_plugin(PROBLEMS, problem_id):
        return _spelled_out(kind, problem_id, params)

    def construct() -> tuple[Problem, dict[str, Any]]:
        problem, everything = _spelled_out(kind, problem_id, params)
        return guarded(problem_id, problem), everything

    return USER_CODE.call(problem_id, CONSTRUCTION, construct)


def _spelled_out(
    kind: type[Any], problem_id: str, params: Mapping[str, Any]
) -> tuple[Problem, dict[str, Any]]:
    given = {name: value for name, value in params.items() if name not in LIMITS}
    own = make_params(kind.params_type, given, _PARAMS)
    problem = kind(own)
    if not isinstance(problem, SimulatedProblem | InProcessProblem):
        raise TypeError(
            f"plug-in {problem_id}: expected a subclass of SimulatedProblem or InProcessProblem of "
            f"brink.server.problems.base, got {kind.__name__}"
        )
    everything = asdict(own)
    if params.get(CONSTRAINTS):
        problem.space = _constrained(problem.space, params[CONSTRAINTS])
        everything |= {CONSTRAINTS: list(params[CONSTRAINTS])}
    if params.get(ODD):
        problem.space = _within_odd(problem.space, params[ODD])
        everything |= {ODD: odd} if (odd := odd_of(problem.space)) else {}
    if params.get(DISTRIBUTION):
        problem.space = _distributed(problem.space, params[DISTRIBUTION])
        everything |= {DISTRIBUTION: dict(params[DISTRIBUTION])}
    return problem, everything


def _constrained(space: SearchSpace, constraints: object) -> SearchSpace:
    if not isinstance(constraints, list) or len(constraints) > _MOST_CONSTRAINTS:
        message = f"expected a list of at most {_MOST_CONSTRAINTS} conditions, such as ['gap > 2 * speed']"
        raise InvalidInput.at(f"{_PARAMS}/{CONSTRAINTS}", message)
    try:
        return space.constrained(constraints)
    except SpaceError as error:
        raise InvalidInput.at(f"{_PARAMS}/{CONSTRAINTS}", str(error)) from None


def _within_odd(space: SearchSpace, odd: object) -> SearchSpace:
    if not isinstance(odd, Mapping):
        message = f"expected limits by parameter, such as {{{space.column_names()[0]}: …}}, got {odd!r:.80}"
        raise InvalidInput.at(f"{_PARAMS}/{ODD}", message)
    try:
        return limited(space, odd)
    except OddError as error:
        raise InvalidInput.at(f"{_PARAMS}/{ODD}{_below(error.name)}", str(error)) from None


def _distributed(space: SearchSpace, distribution: object) -> SearchSpace:
    if not isinstance(distribution, Mapping):
        first = space.column_names()[0]
        message = f"expected distributions by parameter, such as {{{first}: …}}, got {distribution!r:.80}"
        raise InvalidInput.at(f"{_PARAMS}/{DISTRIBUTION}", message)
    try:
        return distributed(space, distribution)
    except DistributionError as error:
        raise InvalidInput.at(f"{_PARAMS}/{DISTRIBUTION}{_below(error.name)}", str(error)) from None


def _below(name: str | None) -> str:
    """Return the rest of a JSON pointer to an entry; empty for none."""
    return "" if name is None else "/" + name.replace("~", "~0").replace("/", "~1")


def check_extra(problem: Problem) -> None:
    """Check that workers on this machine have the optional dependencies that a problem needs.

    Raises:
        InvalidInput: An optional dependency is not installed.
    """
    if any(find_spec(module) is None for module in problem.modules):
        message = (
            f"{problem.id} needs the {problem.extra} extra, which is not installed: "
            f"{install_command(problem.extra)}"
        )
        raise InvalidInput.at("/problem/id", message)


def describe_problems(reported: Callable[[Problem], list[str]]) -> list[dict[str, Any]]:
    """Describe all problems, with the schemas of their parameters and their default search spaces.

    Problems of users are left out, with a line in the log, if they cannot be described.

    Args:
        reported: Returns the kinds of findings that every campaign on a problem has.
    """
    return _described(PROBLEMS, partial(describe_problem, reported=reported))


def describe_algorithms() -> list[dict[str, Any]]:
    """Describe all algorithms, with the schemas of their parameters.

    Algorithms of users are left out, with a line in the log, if they cannot be described.
    """
    return _described(ALGORITHMS, describe_algorithm)


def _described(group: str, describe: Callable[[str], dict[str, Any]]) -> list[dict[str, Any]]:
    described = []
    for plugin_id in plugin_ids(group):
        if is_own_plugin(group, plugin_id):
            described.append(describe(plugin_id))
            continue
        try:
            described.append(USER_CODE.call(plugin_id, "description", describe, plugin_id))
        except Exception:  # one plug-in must not hide the others
            log.exception("plug-in cannot be described", extra={"plugin": plugin_id})
    return described


def describe_problem(problem_id: str, reported: Callable[[Problem], list[str]]) -> dict[str, Any]:
    """Describe one problem, as `describe_problems` does."""
    kind = problem_type(problem_id)
    problem = make_problem(problem_id, {})
    finds = reported(problem)
    return {
        "id": problem_id,
        "summary": kind.summary,
        "params": _problem_schema(kind, problem),
        "space": problem.space.describe(),
        "simulator": problem.needs if isinstance(problem, SimulatedProblem) else None,
        "finds": finds,
        "measures": [asdict(measure) for measure in problem.measures],
        "measures_detector": bool(problem.measured_detector),
        "algorithm_defaults": dict(problem.algorithm_defaults),
        "first_algorithm": _first_algorithm(problem, finds),
        "python_only": problem.python_only,
    }


def describe_algorithm(algorithm_id: str) -> dict[str, Any]:
    """Describe one algorithm, as `describe_algorithms` does."""
    algorithm = make_algorithm(algorithm_id)
    schema = params_model(algorithm.config_type).model_json_schema()
    for name in getattr(algorithm.config_type, "unused", ()):
        schema["properties"].pop(name, None)
    return {
        "id": algorithm_id,
        "summary": algorithm.summary,
        "params": schema,
        "finds": list(declared_finds(algorithm)),
        "internal": getattr(algorithm, "internal", False),
    }


def _problem_schema(kind: type[Any], problem: Problem) -> dict[str, Any]:
    """Return the JSON schema of a problem's parameters; a requirement has options, each with its meaning."""
    schema = params_model(kind.params_type).model_json_schema()
    schema["properties"][ODD] = {
        "type": "object",
        "title": "Odd",
        "label": "ODD",
        "by_parameter": "limits",
        "default": {},
        "description": _ABOUT_ODD,
    }
    schema["properties"][CONSTRAINTS] = {
        "type": "array",
        "items": {"type": "string"},
        "title": "Constraints",
        "default": [],
        "description": _ABOUT_CONSTRAINTS,
    }
    schema["properties"][DISTRIBUTION] = {
        "type": "object",
        "title": "Distribution",
        "label": "Operational distribution",
        "by_parameter": "distribution",
        "numbers": NUMBERS,
        "default": {},
        "description": _ABOUT_DISTRIBUTION,
    }
    requirement = schema["properties"].get("requirement")
    if requirement is not None and problem.requirements:
        requirement |= {"main": True, "options": _requirement_options(kind)}
    return schema


def _requirement_options(kind: type[Any]) -> list[dict[str, str]]:
    """Return the requirements that a problem takes, each with its meaning; among them `ANY` if it takes that."""
    options = [option for option in requirement_options() if takes_requirement(kind.id, option["value"])]
    if takes_requirement(kind.id, ANY):
        problem = make_problem(kind.id, {"requirement": ANY})
        names = ", ".join(name.split("@")[0].replace("-", " ") for name in problem.requirements)
        options.append({"value": ANY, "words": f"A violation of any of these counts: {names}."})
    return options


def takes_requirement(problem_id: str, requirement: str) -> bool:
    """Return whether a requirement, or `ANY`, can give the verdict of a problem.

    Raises:
        InvalidInput: The id of the problem is unknown.
    """
    kind = problem_type(problem_id)
    values = {"requirement": requirement}
    try:
        run_plugin(
            PROBLEMS, problem_id, "params_type", lambda: make_params(kind.params_type, values, _PARAMS)
        )
    except InvalidInput:
        return False
    return True


def requirement_options() -> list[dict[str, str]]:
    """Return the registered requirements, each with its meaning in words, from the documentation of its class."""
    return [
        {"value": name, "words": run_plugin(REQUIREMENTS, name, IMPORT, partial(requirement_words, name))}
        for name in requirement_ids()
    ]


_AMPLE: Final = 10**6
"""A budget that is enough for any algorithm."""


def _first_algorithm(problem: Problem, reported: Sequence[str]) -> str:
    """Return the algorithm to begin with.

    Of those that are suggested and that can search the problem's space, one for what the problem reports comes first.
    """
    own = [make_algorithm(name) for name in plugin_ids(ALGORITHMS) if is_own_plugin(ALGORITHMS, name)]
    suggested = [one for one in own if getattr(one, "suggested", None) is not None]
    suggested.sort(key=lambda one: (declared_finds(one)[0] not in reported, getattr(one, "suggested", None)))
    return next(one.id for one in suggested if _can_search(one, problem))


def _can_search(algorithm: AnyAlgorithm, problem: Problem) -> bool:
    """Return whether an algorithm can search a problem's space with the settings that the problem suggests."""
    known = set(algorithm.config_type.__dataclass_fields__)
    defaults = {key: value for key, value in problem.algorithm_defaults.items() if key in known}
    try:
        config = make_params(algorithm.config_type, defaults, "/algorithm/params")
        algorithm.check(problem.space, config, budget=_AMPLE)
    except (UnsupportedSpace, ConfigError, InvalidInput):
        return False
    return True
