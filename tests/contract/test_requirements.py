"""Every registered requirement passes the contract suite, and the suite rejects broken requirements."""

import math
from collections.abc import Callable, Mapping
from typing import cast

import pytest

from brink.sim.catalogue import (
    REQUIREMENTS,
    load_plugin,
    make_requirement,
    make_requirements,
    register,
    requirement_ids,
)
from brink.sim.episode import Json, Verdict
from brink.sim.errors import InvalidEpisode
from brink.sim.requirements import FrontGap, Requirement, WorldSample
from brink.sim.testing import ContractBroken, check_requirement

SHIPPED = {
    "front-gap@1",
    "front-gap@2",
    "no-collision@1",
    "lane-keeping@1",
    "red-light@1",
    "speed-limit@1",
    "progress@1",
}


def test_the_shipped_requirements_are_registered() -> None:
    assert set(requirement_ids()) >= SHIPPED


@pytest.mark.parametrize("requirement_id", requirement_ids())
def test_passes_the_contract_suite(requirement_id: str) -> None:
    check_requirement(cast(Callable[[], Requirement], load_plugin(REQUIREMENTS, requirement_id)))


def test_an_unknown_id_is_rejected_with_the_closest_known_id() -> None:
    with pytest.raises(InvalidEpisode, match="did you mean 'front-gap@2'"):
        make_requirement("front_gap")


def test_requirements_are_made_in_the_order_of_their_ids() -> None:
    assert list(make_requirements(("red-light@1", "front-gap@1"))) == ["red-light@1", "front-gap@1"]


def test_a_duplicate_requirement_is_rejected() -> None:
    with pytest.raises(InvalidEpisode, match="listed twice"):
        make_requirements(("front-gap@1", "front-gap@1"))


def test_a_plug_in_without_an_entry_point_can_be_registered() -> None:
    register(REQUIREMENTS, "wide-gap@1", lambda: FrontGap(required_gap_m=5.0))
    requirement = make_requirement("wide-gap@1")
    check_requirement(lambda: FrontGap(required_gap_m=5.0))
    assert requirement.unit == "m"


class _Endless(FrontGap):
    """Returns infinite robustness when nobody is ahead."""

    def observe(self, sample: WorldSample) -> float:
        robustness = super().observe(sample)
        return math.inf if sample.front_gap_m is None else robustness


class _Optimist(FrontGap):
    """Returns a verdict that hides the violation."""

    def verdict(self) -> Verdict:
        return Verdict(robustness=1.0, unit="m", violated_at_s=None)


class _Chatty(FrontGap):
    """Returns features that are not valid JSON."""

    def features(self) -> Mapping[str, Json]:
        return {"gap": math.nan}


class _Furlongs(FrontGap):
    """Has an unknown unit."""

    unit = "furlong"


class _Shared(FrontGap):
    """Shares state between its instances."""

    _seen: list[float] = []  # noqa: RUF012  (the defect under test)

    def observe(self, sample: WorldSample) -> float:
        self._seen.append(super().observe(sample))
        return min(self._seen)


@pytest.mark.parametrize("broken", [_Endless, _Optimist, _Chatty, _Furlongs, _Shared])
def test_the_contract_suite_rejects_a_broken_requirement(broken: Callable[[], Requirement]) -> None:
    with pytest.raises(ContractBroken, match="expected"):
        check_requirement(broken)
