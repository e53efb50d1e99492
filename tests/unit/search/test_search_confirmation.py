"""Whether a pair holds when its sides are simulated again with other seeds."""

import pytest

from brink.search.analysis.confirmation import Confirmation, Share, confirmation_of
from brink.search.fitness import wilson_interval


@pytest.mark.parametrize(
    ("safe", "unsafe", "expected"),
    [
        ((0, 0), (0, 0), Confirmation.NOT_TRIED),
        ((0, 4), (10, 10), Confirmation.TOO_FEW),
        ((0, 10), (0, 0), Confirmation.TOO_FEW),
        ((2, 10), (8, 10), Confirmation.CONFIRMED),
        ((3, 10), (10, 10), Confirmation.NOT_CONFIRMED),
        ((0, 10), (7, 10), Confirmation.NOT_CONFIRMED),
        # Missing drives may have had either verdict.
        ((0, 9), (9, 9), Confirmation.CONFIRMED),
        ((0, 8), (8, 8), Confirmation.CONFIRMED),
        ((0, 7), (10, 10), Confirmation.TOO_FEW),
        ((2, 9), (10, 10), Confirmation.TOO_FEW),
        ((3, 9), (10, 10), Confirmation.NOT_CONFIRMED),
        ((0, 10), (6, 9), Confirmation.NOT_CONFIRMED),
        ((0, 10), (7, 9), Confirmation.TOO_FEW),
    ],
)
def test_a_pair_is_confirmed_by_clear_shares_of_both_sides(
    safe: tuple[int, int], unsafe: tuple[int, int], expected: Confirmation
) -> None:
    assert confirmation_of(Share.of(*safe), Share.of(*unsafe)) is expected


def test_a_pair_is_pending_until_enough_drives_are_in() -> None:
    def state(safe: tuple[int, int], unsafe: tuple[int, int]) -> Confirmation:
        return confirmation_of(Share.of(*safe), Share.of(*unsafe), pending=True)

    assert state((0, 0), (0, 0)) is Confirmation.PENDING
    assert state((0, 9), (10, 10)) is Confirmation.PENDING
    assert state((0, 10), (10, 10)) is Confirmation.CONFIRMED
    assert state((9, 10), (10, 10)) is Confirmation.NOT_CONFIRMED


def test_a_share_has_a_wilson_interval() -> None:
    share = Share.of(8, 10)
    assert share.probability == 0.8
    assert (share.low, share.high) == tuple(float(limit) for limit in wilson_interval(8, 10))
    nothing = Share.of(0, 0)
    assert (nothing.probability, nothing.low, nothing.high) == (None, 0.0, 1.0)
