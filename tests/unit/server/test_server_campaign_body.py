"""What a campaign's document is known by."""

from typing import Any

from brink.server.campaigns.body import parse_body

PLAIN: dict[str, Any] = {
    "name": "night-rain",
    "problem": {"id": "mtq@1"},
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 100},
}


def test_a_campaign_without_what_came_later_is_known_by_the_hash_that_it_always_had() -> None:
    first = "d0fa27c9315a72b53172e656131079cb4ecccc805459d11ce25db46699fdf7ad"
    assert parse_body(PLAIN).document_hash() == first
    assert parse_body({**PLAIN, "repeats": 0}).document_hash() == first
    assert parse_body({**PLAIN, "repeats": 5}).document_hash() != first
