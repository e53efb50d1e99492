"""Simulator, analysis and replays agree on who may avoid a violation, and in what words they say so."""

from dataclasses import replace

import pytest
from support.traces import make_trace

from brink.pictures.reference import avoidable_words
from brink.search.analysis.avoidable import Avoidable, AvoidedBy, avoidable_of, avoided_by_of
from brink.sim.encounter.reference import NOBODY, Avoidance, Driver
from brink.sim.encounter.simulator import AVOIDED_BY
from brink.sim.trace import AVOIDABLE


def test_the_analysis_knows_every_answer_of_the_simulator() -> None:
    answers = [*(driver.value for driver in Driver), NOBODY]
    assert [avoidable_of({AVOIDABLE: answer}) for answer in answers] == list(Avoidable)


def test_the_analysis_knows_how_the_simulator_says_that_a_violation_is_avoided() -> None:
    assert [avoided_by_of({AVOIDED_BY: how.value}) for how in Avoidance] == list(AvoidedBy)
    assert [avoided_by_of(one) for one in ({}, {AVOIDED_BY: "luck"})] == [None, None]


@pytest.mark.parametrize("answer", Avoidable)
def test_replays_say_it_as_tables_do(answer: Avoidable) -> None:
    trace = replace(make_trace(), about={AVOIDABLE: {"no-collision@1": answer.value}})
    assert avoidable_words(trace, "no-collision@1") == answer.words
