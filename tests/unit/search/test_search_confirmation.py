"""Whether a pair holds when its sides are simulated again with other seeds."""

import pytest

from brink.search.analysis.confirmation import Confirmation, Share, confirmation_of, is_judged
from brink.search.sequential import exact_interval


@pytest.mark.parametrize(
    ("safe", "unsafe", "expected"),
    [
        ((0, 0), (0, 0), Confirmation.NOT_TRIED),
        ((0, 15), (15, 15), Confirmation.CONFIRMED),
        ((0, 10), (10, 10), Confirmation.UNDECIDED),
        ((0, 14), (15, 15), Confirmation.UNDECIDED),
        ((0, 15), (0, 0), Confirmation.UNDECIDED),
        ((1, 27), (26, 27), Confirmation.CONFIRMED),
        ((1, 26), (27, 27), Confirmation.UNDECIDED),
        ((2, 10), (8, 10), Confirmation.UNDECIDED),
        ((4, 4), (15, 15), Confirmation.REFUTED),
        ((0, 15), (0, 4), Confirmation.REFUTED),
        ((0, 0), (4, 10), Confirmation.REFUTED),
        ((3, 10), (10, 10), Confirmation.UNDECIDED),
    ],
)
def test_a_pair_is_confirmed_if_both_sides_are_and_refuted_if_one_is(
    safe: tuple[int, int], unsafe: tuple[int, int], expected: Confirmation
) -> None:
    assert confirmation_of(Share.of(*safe), Share.of(*unsafe)) is expected


def test_a_pair_is_pending_while_it_is_undecided() -> None:
    def state(safe: tuple[int, int], unsafe: tuple[int, int]) -> Confirmation:
        return confirmation_of(Share.of(*safe), Share.of(*unsafe), pending=True)

    assert state((0, 0), (0, 0)) is Confirmation.PENDING
    assert state((0, 14), (15, 15)) is Confirmation.PENDING
    assert state((0, 15), (15, 15)) is Confirmation.CONFIRMED
    assert state((9, 10), (10, 10)) is Confirmation.REFUTED


def test_drives_that_failed_speak_against_every_claim() -> None:
    assert confirmation_of(Share.of(0, 15, 1), Share.of(15, 15)) is Confirmation.UNDECIDED
    assert confirmation_of(Share.of(4, 4, 2), Share.of(15, 15)) is Confirmation.UNDECIDED
    assert confirmation_of(Share.of(0, 0, 3), Share.of(0, 0)) is Confirmation.UNDECIDED


def test_a_pair_is_judged_with_enough_drives_of_each_side_to_confirm_it() -> None:
    assert not is_judged(Share.of(0, 15), Share.of(10, 10))
    assert is_judged(Share.of(2, 15), Share.of(15, 15)), "undecided all the same"
    assert is_judged(Share.of(0, 1), Share.of(0, 5)), "refuted"


def test_a_share_has_an_exact_interval() -> None:
    share = Share.of(8, 10)
    assert share.probability == 0.8
    assert (share.low, share.high) == exact_interval(8, 10)
    wider = Share.of(8, 10, confidence=0.95)
    assert (wider.low, wider.high) == exact_interval(8, 10, 0.95)
    nothing = Share.of(0, 0)
    assert (nothing.probability, nothing.low, nothing.high) == (None, 0.0, 1.0)
