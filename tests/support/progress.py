"""The progress of a campaign as the API gives it, for tests of what shows it."""

from typing import Any

from brink.server.states import CampaignStatus

PROGRESS: dict[str, Any] = {
    "id": "3f2a91bc",
    "name": "a campaign with a name",
    "status": CampaignStatus.RUNNING,
    "status_reason": "",
    "sequence": 1,
    "budget": 1300,
    "simulations": 254,
    "evaluated": 240,
    "unsafe": 80,
    "failed": 0,
    "measured": 0,
    "quarantined": 0,
    "queued": 6,
    "leased": 2,
    "generation": 12,
    "rate_per_s": 12.5,
    "remaining_s": 84.0,
    "elapsed_s": 20.0,
    "workers": 2,
    "unrunnable": {},
    "finds": ["boundary"],
    "origins": {},
    "asking": None,
    "trouble": None,
    "trouble_s": 0.0,
    "digest": None,
    "t_b": 0.1,
    "d_th": 0.2,
    "generations": [],
}
