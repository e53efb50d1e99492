import dataclasses
import math

import pytest

from brink.search.errors import ConfigError
from brink.search.settings import check_settings, setting


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    share: float = setting(0.5, help="A share.", ge=0, lt=1)
    count: int = setting(3, help="A count.", gt=0, le=10, unit="cars")
    name: str = setting("x", help="A name.")
    on: bool = setting(True, help="A switch.")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class MoreSettings(Settings):
    gap_m: float = setting(2.0, help="A gap.", gt=0, unit="m")
    mode: str = setting("fast", help="A mode.", choices=("fast", "exact"))


def test_fields_carry_what_a_catalogue_shows() -> None:
    share, count, *_ = dataclasses.fields(Settings)
    assert dict(share.metadata) == {"help": "A share.", "unit": "", "ge": 0, "lt": 1}
    assert count.metadata["unit"] == "cars"
    assert count.default == 3
    mode = dataclasses.fields(MoreSettings)[-1]
    assert mode.metadata["choices"] == ("fast", "exact")


def test_values_inside_their_bounds_are_taken() -> None:
    assert Settings(share=0, count=10).share == 0
    assert MoreSettings(gap_m=1).gap_m == 1


@pytest.mark.parametrize(
    ("changes", "field", "message"),
    [
        ({"share": 1.0}, "share", "share: expected a number >= 0 and < 1, got 1.0"),
        ({"share": -0.1}, "share", "got -0.1"),
        ({"share": math.nan}, "share", "got nan"),
        ({"share": math.inf}, "share", "got inf"),
        ({"share": 10**400}, "share", "got 1000"),
        ({"share": "0.5"}, "share", "got '0.5'"),
        ({"share": True}, "share", "got True"),
        ({"count": 0}, "count", r"count: expected a whole number > 0 and <= 10 \(cars\), got 0"),
        ({"count": 2.0}, "count", "got 2.0"),
        ({"count": 11}, "count", "got 11"),
        ({"name": 1}, "name", "name: expected a text, got 1"),
        ({"on": 1}, "on", "on: expected true or false, got 1"),
        ({"mode": "slow"}, "mode", "mode: expected one of fast, exact; got 'slow'"),
        ({"gap_m": 0.0}, "gap_m", r"gap_m: expected a number > 0 \(m\), got 0.0"),
    ],
)
def test_values_outside_are_refused_by_field(changes: dict[str, object], field: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        MoreSettings(**changes)  # type: ignore[arg-type]
    assert caught.value.field == field
