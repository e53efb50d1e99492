"""Every registered algorithm keeps its contract on every kind of space that it supports."""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.bisection import Bisection, BisectionConfig

from brink.search.algorithm import AnyAlgorithm, Candidate, Evaluation, Failed, Scored
from brink.search.algorithms.random_search import RandomSearch, RandomSearchConfig, RandomSearchState
from brink.search.document import Document
from brink.search.errors import DocumentError, UnsupportedSpace
from brink.search.odd import limited
from brink.search.slots import Slots
from brink.search.space import Categorical, Component, Dormant, Real, SearchSpace
from brink.search.testing import ContractBroken, check_algorithm, example_spaces
from brink.search.traffic.constraint import Participants
from brink.sim.catalogue import load_plugin, plugin_ids

pytestmark = pytest.mark.usefixtures("smaller_library")
GROUP = "brink.algorithms"
SIMOOD = "simood-ga@1"
REPEAT = "repeat@1"
EDGE = "edge@1"
THRESHOLDS = "edge@2"
MINIMISE = "minimise@1"
SHARPEN = "sharpen@1"
SUITE = "suite@1"
TOLERANCE = "tolerance@1"
NEAREST = "nearest-opposite@1"
RATE = "rate@1"
SUBSET = "subset@1"
REPEATING = {REPEAT, SUITE, EDGE, THRESHOLDS, MINIMISE, SHARPEN, TOLERANCE, NEAREST, RATE, SUBSET, "qd@1"}
NEEDS: dict[str, tuple[type[Any], str]] = {
    SIMOOD: (Slots, "slots"),
    "nsga2@1": (Participants, "participants"),
    "mosat@1": (Participants, "participants"),
    "mumoea@1": (Participants, "participants"),
}
"""Constraint that a space must have for an algorithm, and what the error names."""
ERRORS = SearchSpace(
    (
        Component("scenario", (Categorical("weather", ("dry", "wet")), Real("gap", 1.0, 60.0, "m"))),
        Component(
            "behaviour",
            (
                Categorical("type", ("none", "miss", "late")),
                Real("onset", 0.0, 12.0, "s"),
                Real("severity", 0.0, 1.0),
            ),
            (Dormant("type", "none", ("onset", "severity")),),
        ),
    )
)
SPACES = {
    **example_spaces(),
    "errors": ERRORS,
    "mixed within an ODD": limited(
        example_spaces()["mixed"],
        {
            "scenario.weather": ["wet", "fog"],
            "behaviour.start": {"min": 20},
            "behaviour.delay": 0.5,
            "behaviour.left": {"min": 100, "max": 130},
            "behaviour.right": {"max": 170},
        },
    ),
    "traffic within an ODD": limited(
        example_spaces()["traffic"],
        {"participants.p*.kind": ["none", "car"], "participants.p*.speed_mps": {"min": 5, "max": 8}},
    ),
}


def algorithm(plugin_id: str) -> AnyAlgorithm:
    made: Any = load_plugin(GROUP, plugin_id)
    instance: AnyAlgorithm = made()
    return instance


def test_the_projects_own_algorithms_are_registered() -> None:
    known = {
        "mlcshe@1",
        "ga@1",
        "random@1",
        "simood-ga@1",
        "nsga2@1",
        "mosat@1",
        "mumoea@1",
        EDGE,
        THRESHOLDS,
    }
    known |= {"deepjanus@1", "straddle@1", "bsv@1", NEAREST}
    assert known <= set(plugin_ids(GROUP))


def config_for(checked: AnyAlgorithm, space: SearchSpace) -> Any:
    """Return an algorithm's default settings; where there are none, some solutions or pairs."""
    if checked.id in (MINIMISE, SHARPEN):
        rng = np.random.default_rng(1)
        rows = [[space.join(space.sample(rng)).tolist() for _ in range(4)] for _ in range(2)]
        return checked.config_type(safe=rows[0], unsafe=rows[1])
    if checked.id == TOLERANCE:
        return checked.config_type(
            cells={"type": ["miss", "late"]},
            truth={"type": "none"},
            without_error=10,
            conditions=[{"weather": "dry"}, {"weather": "wet"}],
            generation_size=30,
        )
    if checked.id == RATE:
        return checked.config_type(pool=5, in_flight=2)
    if checked.id == SUBSET:
        return checked.config_type(chains=5, length=4, in_flight=2)
    if checked.id not in (REPEAT, SUITE):
        return checked.config_type()
    rng = np.random.default_rng(1)
    count = 3 if checked.id == REPEAT else 12  # of so many, some simulations fail, so there is a second round
    return checked.config_type(solutions=[space.join(space.sample(rng)).tolist() for _ in range(count)])


def supports(plugin_id: str, space: SearchSpace) -> bool:
    if plugin_id == TOLERANCE:
        return space is ERRORS
    if plugin_id == SHARPEN:
        return not space.categorical.all()
    needed = NEEDS.get(plugin_id)
    rules = [rule for component in space.components for rule in component.constraints]
    return needed is None or any(isinstance(rule, needed[0]) for rule in rules)


LONG = [
    *itertools.product(
        ("mumoea@1", "mosat@1", EDGE, THRESHOLDS, NEAREST, "deepjanus@1", "straddle@1", "bsv@1"), ("traffic",)
    ),
    *itertools.product((EDGE, THRESHOLDS, SHARPEN), ("traffic within an ODD",)),
    *itertools.product((EDGE,), ("mixed", "numeric")),
    (SHARPEN, "traffic"),
]
"""Combinations that take seconds; NSGA-II, on which two of them build, and edge@1 on other spaces run every time."""


@pytest.mark.parametrize(
    ("plugin_id", "name"),
    [
        pytest.param(*pair, marks=pytest.mark.long("takes seconds") if pair in LONG else ())
        for pair in itertools.product(plugin_ids(GROUP), SPACES)
        if pair[1] != "errors" or pair[0] == TOLERANCE  # others have "mixed" and "declared"
    ],
)
@pytest.mark.usefixtures("few_trees", "small_pools")
def test_algorithm_keeps_its_contract(plugin_id: str, name: str) -> None:
    space = SPACES[name]
    checked = algorithm(plugin_id)
    assert checked.id == plugin_id
    if not supports(plugin_id, space):
        others = {TOLERANCE: "severity", SHARPEN: "differ in a number"}
        needed = others[plugin_id] if plugin_id in others else NEEDS[plugin_id][1]
        with pytest.raises(UnsupportedSpace, match=needed):
            checked.check(space, checked.config_type(), budget=170)
        return
    budget = 100 if plugin_id == EDGE else 170  # each of its many small generations grows trees
    run = check_algorithm(
        checked,
        space,
        budget=budget,
        config=config_for(checked, space),
        ends_itself=plugin_id in {SIMOOD, MINIMISE, SHARPEN, SUITE, SUBSET},
        repeats=plugin_id in REPEATING,
    )
    assert len(run.generations) >= 2


@pytest.mark.parametrize("plugin_id", plugin_ids(GROUP))
def test_state_of_another_algorithm_is_refused(plugin_id: str) -> None:
    checked = algorithm(plugin_id)
    space = next(space for space in SPACES.values() if supports(plugin_id, space))
    config = config_for(checked, space)
    state = checked.start(space, config, seed=1, budget=170)
    stored = checked.dump(state)
    for foreign in (replace(stored, kind="other@1"), replace(stored, version=stored.version + 1)):
        with pytest.raises(DocumentError):
            checked.load(space, config, Document.from_bytes(foreign.to_bytes()), state.archive)


class Repeating(RandomSearch):
    """Asks one solution twice."""

    def ask(self, state: RandomSearchState) -> tuple[RandomSearchState, tuple[Candidate, ...]]:
        state, candidates = super().ask(state)
        doubled = (*candidates[:-1], replace(candidates[-1], vectors=candidates[0].vectors))
        ledger = replace(state.ledger, flight=(*state.ledger.flight[:-1], doubled))
        return replace(state, ledger=ledger), doubled


class Forgetful(RandomSearch):
    """Loses its place when it is stored."""

    def load(self, space: SearchSpace, config: RandomSearchConfig, document: Document, archive: Any) -> Any:
        state = super().load(space, config, document, archive)
        return replace(state, ledger=replace(state.ledger, seed=state.ledger.seed + 1))


class Erratic(RandomSearch):
    """Draws other solutions in each campaign."""

    campaigns = itertools.count(1)

    def start(self, space: SearchSpace, config: Any, *, seed: int, budget: int) -> RandomSearchState:
        return super().start(space, config, seed=seed + next(self.campaigns), budget=budget)


class Impatient(RandomSearch):
    """Depends on the order in which evaluations arrive."""

    def tell(self, state: RandomSearchState, evaluations: Any) -> RandomSearchState:
        first: int = next(iter(evaluations), 0)
        ledger = replace(state.ledger, seed=first)
        return super().tell(replace(state, ledger=ledger), evaluations)


class Optimist(RandomSearch):
    """Counts failures as safe."""

    def tell(self, state: RandomSearchState, evaluations: Any) -> RandomSearchState:
        safe: dict[int, Evaluation] = {
            number: Scored(unsafe=False, robustness=1.0) if isinstance(evaluation, Failed) else evaluation
            for number, evaluation in evaluations.items()
        }
        return super().tell(state, safe)


class Writable(RandomSearch):
    """Hands out vectors that others can change."""

    def ask(self, state: RandomSearchState) -> tuple[RandomSearchState, tuple[Candidate, ...]]:
        state, candidates = super().ask(state)
        loose = tuple(replace(c, vectors=tuple(np.array(v) for v in c.vectors)) for c in candidates)
        ledger = replace(state.ledger, flight=(*state.ledger.flight[:-1], loose))
        return replace(state, ledger=ledger), loose


@pytest.mark.parametrize(
    ("broken", "promise"),
    [
        (Repeating(), "duplicates"),
        (Forgetful(), "load"),
        (Erratic(), "same seed"),
        (Impatient(), "order in which evaluations arrive"),
        (Optimist(), "every solution that did not fail"),
        (Writable(), "read-only"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_contract_catches_what_breaks_it(broken: AnyAlgorithm, promise: str) -> None:
    with pytest.raises(ContractBroken, match=promise):
        check_algorithm(broken, SPACES["mixed"], budget=150)


@pytest.mark.parametrize("space", SPACES)
def test_a_toy_algorithm_with_settings_of_its_own_keeps_the_contract(space: str) -> None:
    check_algorithm(Bisection(), SPACES[space], config=BisectionConfig(draws=8), budget=30, ends_itself=True)
