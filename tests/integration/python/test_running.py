"""Campaigns, functions and results from Python, with real workers, on a database of their own."""

import inspect
import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.api import listening_coordinator
from support.circle import inside

import brink
from brink.api.client import CoordinatorError
from brink.python.result import CampaignUnfinished
from brink.search import surrogate
from brink.search.errors import SpaceError
from brink.server.errors import InvalidInput
from brink.server.states import CampaignStatus

HILLS = brink.Campaign(problem="mtq@1", algorithm="random@1", simulations=120, name="hills")
SPACE = {"x": (0.0, 1.0), "y": (0.0, 1.0, "m"), "side": ["left", "right"]}


def margin(pair: dict[Any, Any], side: str) -> float:
    """Return what the function returns for a side of a pair."""
    return inside(*(pair[f"{side}.parameters.{name}"] for name in ("x", "y", "side")))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patched:
        path = tmp_path_factory.mktemp("python")
        patched.chdir(path)
        yield path


@pytest.fixture(scope="module")
def circle(folder: Path) -> brink.Result:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(surrogate, "TREES", 15)
        return brink.search(inside, SPACE, algorithm="edge@1", simulations=300, progress=False)


def test_a_search_finds_the_known_boundary_of_a_function(circle: brink.Result) -> None:
    assert (circle.evaluated, circle.failed, circle.status) == (300, 0, CampaignStatus.FINISHED)
    pairs = circle.pairs()
    assert len(pairs) >= 6
    for pair in pairs.to_dict("records"):
        margins = [margin(pair, side) for side in ("safe", "unsafe")]
        assert margins[0] >= 0 > margins[1]
        assert margins == pytest.approx([pair["safe.robustness"], pair["unsafe.robustness"]])
        same = pair["safe.parameters.side"] == pair["unsafe.parameters.side"]
        assert not same or max(map(abs, margins)) < 0.02
    assert "instead of" in pairs["words"][0]
    assert pairs["words"][0][:40] in str(pairs), "print() shows what changed"
    assert circle.finding.startswith(f"{len(pairs)} distinct pairs across the boundary")


def test_a_data_frame_has_a_column_for_each_parameter(circle: brink.Result) -> None:
    frame = circle.to_pandas()
    assert list(frame.columns[:4]) == ["number", "x", "y", "side"]
    assert set(frame["side"]) == {"left", "right"}
    computed = [inside(*row) for row in frame[["x", "y", "side"]].to_numpy().tolist()]
    assert frame["robustness"].to_numpy() == pytest.approx(computed)
    assert (frame["unsafe"] == (frame["robustness"] < 0)).all()
    assert set(frame["outcome"]) == {"requirement held", "violated the requirement"}
    assert len(circle.violations()) == circle.unsafe == int(frame["unsafe"].sum())


@pytest.mark.long("runs a search with workers")
def test_a_search_finds_thresholds_by_default(folder: Path) -> None:
    def gap(speed: float, distance: float) -> float:
        return distance - speed**2 / 20.0

    result = brink.search(
        gap, {"speed": (1.0, 40.0), "distance": (1.0, 100.0)}, simulations=80, workers=1, progress=False
    )
    thresholds = result.findings("thresholds")
    assert len(thresholds) >= 3
    for row in thresholds.to_dict("records"):
        name, _, value = row["held"].removeprefix("held: ").partition(" ")
        turns = (20.0 * float(value)) ** 0.5 if name == "distance" else float(value) ** 2 / 20.0
        assert row["low"] - 0.5 * row["resolution"] <= turns <= row["high"] + 0.5 * row["resolution"]
    assert "thresholds of" in result.finding


@pytest.mark.long("runs a search with workers")
def test_a_search_without_pairs_says_what_to_try(folder: Path) -> None:
    options: dict[str, Any] = {"algorithm": "edge@1", "progress": False, "simulations": 20, "workers": 1}
    far = brink.search(inside, SPACE, params={"eps": 1e-6, "explore": 0.9}, **options)
    assert len(far.pairs()) == 0
    found = re.search(r"No pair within eps .* Try 80 simulations\. With eps=(\S+), the nearest", far.finding)
    assert found is not None, far.finding
    assert len(far.pairs(eps=float(found[1]))) > 0
    safe = brink.search(inside, {**SPACE, "x": (0.0, 0.1)}, **options)
    assert "Try 80 simulations. All verdicts are the same: search wider ranges" in safe.finding


@pytest.mark.long("runs a search with workers")
def test_a_choice_that_is_called_null_is_no_missing_value(folder: Path) -> None:
    def ghost(label: str, x: float) -> float:
        return x - 0.5 if label == "null" else 1.0

    space: dict[str, Any] = {"label": ["null", "person"], "x": (0.0, 1.0)}
    found = brink.search(ghost, space, algorithm="edge@1", simulations=80, workers=1, progress=False)
    labels = {*found.pairs()["safe.parameters.label"], *found.pairs()["unsafe.parameters.label"]}
    assert "null" in labels <= {"null", "person"}


@pytest.mark.long("runs a search with workers")
def test_a_function_with_chance_gets_the_seed_of_the_episode(folder: Path) -> None:
    def noisy(x: float, seed: int) -> dict[str, float]:
        return {"robustness": x - 0.5 + np.random.default_rng(seed).normal(0, 0.01), "effort": x}

    result = brink.search(
        noisy, {"x": (0.0, 1.0)}, algorithm="random@1", simulations=40, workers=1, progress=False
    )
    left_over = result.to_pandas()
    noise = left_over["robustness"] - (left_over["x"] - 0.5)
    assert 0.003 < noise.std() < 0.03


@pytest.mark.long("runs a search with workers")
def test_pairs_of_a_function_with_chance_are_simulated_again(folder: Path) -> None:
    def noisy(x: float, y: float, seed: int) -> float:
        return x - y + np.random.default_rng(seed).normal(0, 0.02)

    result = brink.search(
        noisy,
        {"x": (0.0, 1.0), "y": (0.0, 1.0)},
        algorithm="edge@1",
        simulations=150,
        workers=1,
        progress=False,
    )
    pairs = result.check_pairs(confirm=30)
    assert len(pairs) >= 2
    assert pairs["safe.again_evaluated"].between(4, 30).all()
    assert set(pairs["confirmation"]) <= {"confirmed", "refuted", "undecided"}
    stored = brink.connect(database="brink.db").campaign(result.id).result()
    with pytest.raises(
        CampaignUnfinished,
        match=r"waits for the Python program .*no worker of this machine is one.*brink.search\(\)",
    ):
        stored.check_pairs(confirm=31)


@pytest.mark.long("runs a search with workers")
def test_pairs_of_a_function_are_brought_to_thresholds(folder: Path) -> None:
    def noisy(x: float, y: float, seed: int) -> float:
        return x - y + np.random.default_rng(seed).normal(0, 0.003)

    result = brink.search(
        noisy,
        {"x": (0.0, 1.0), "y": (0.0, 1.0)},
        algorithm="nearest-opposite@1",
        params={"d_th": 0.2},
        simulations=120,
        workers=1,
        progress=False,
    )
    thresholds = result.check_pairs(sharpen=True, limit=2)
    assert set(thresholds["outcome"]) == {"threshold"}
    for held, low, middle, high in thresholds[["held", "low", "middle", "high"]].values.tolist():
        zero = float(held.split()[-1])  # the function is 0 where both coordinates are equal
        assert low <= middle <= high
        assert abs(middle - zero) < 0.02
    assert (result.check_pairs(sharpen=True, limit=2)["middle"] == thresholds["middle"]).all(), "asked once"
    with pytest.raises(InvalidInput, match="minimise=True or sharpen=True; got none of them"):
        result.check_pairs()


def test_an_exception_in_a_function_is_shown_and_stops_the_search(folder: Path) -> None:
    def broken(x: float) -> float:
        raise RuntimeError(f"no road at {x:.0f}")

    with pytest.raises(CampaignUnfinished) as caught:
        brink.search(
            broken, {"x": (0.0, 1.0)}, algorithm="random@1", simulations=400, workers=1, progress=False
        )
    found = re.match(
        r"broken: (\d+) of \1 calls failed, so the search was paused\. The first: ", str(caught.value)
    )
    assert found is not None, caught.value
    assert 5 <= int(found[1]) < 60, "it does not wait for a generation of 60"
    assert re.search(
        r"function raised RuntimeError: no road at \d, at test_running\.py, line \d+: "
        r'raise RuntimeError\(f"no road at \{x:\.0f\}"\); called with x=0\.\d+\. Correct the function',
        str(caught.value),
    )


@pytest.mark.long("runs a search with workers")
def test_a_function_that_fails_too_often_is_counted(folder: Path) -> None:
    def narrow(x: float) -> float:
        if x > 0.6:
            raise RuntimeError("no road here")
        return x - 0.5

    options: dict[str, Any] = {"algorithm": "random@1", "simulations": 60, "workers": 1, "progress": False}
    with pytest.raises(
        CampaignUnfinished, match=r"narrow: \d\d of 60 calls failed.*RuntimeError: no road here"
    ):
        brink.search(narrow, {"x": (0.0, 1.0)}, **options)
    result = brink.search(narrow, {"x": (0.0, 0.7)}, **options)
    assert result.failed + result.evaluated == 60
    assert 0 < result.failed <= 12


@pytest.mark.parametrize(
    ("function", "space", "words"),
    [
        (inside, {"x": (0.0, 1.0)}, "missing a required argument"),
        (inside, {**SPACE, "z": (0.0, 1.0)}, "unexpected keyword argument 'z'"),
        (inside, {"a": {"x": (0.0, 1.0)}, "b": {"x": (0.0, 1.0)}}, "expected different names"),
        (inside, {**SPACE, "side": [1, 2, 3, 4]}, "choices such as"),
        (inside, {**SPACE, "x": (1.0, 0.0)}, "low < high"),
        (inside, {}, "at least one parameter"),
        (inside, {**SPACE, "x": range(3, 4)}, "at least two ascending numbers"),
    ],
)
def test_a_space_that_does_not_fit_the_function_is_refused(function: Any, space: Any, words: str) -> None:
    with pytest.raises(SpaceError, match=words):
        brink.search(function, space)


def test_a_finished_campaign_is_returned_and_not_run_again(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = brink.run(HILLS, workers=1, progress=False)
    again = brink.run(HILLS.document())
    said = f"finished earlier, on {datetime.now(UTC):%Y-%m-%d} at "
    assert again.note.startswith(said)
    assert again.note.endswith(" UTC; nothing was simulated")
    for shown in (repr(again), again._repr_html_(), capsys.readouterr().err):
        assert again.note in shown
    assert first.note == ""
    assert "earlier" not in repr(first)
    another = brink.run(HILLS, workers=1, progress=False, resume=False)
    assert first.id == again.id != another.id
    assert another.note == ""
    assert first.digest == another.digest
    listed = brink.connect(database="brink.db").campaigns("finished")
    assert {first.id, another.id} <= {campaign.id for campaign in listed}


def test_bad_campaigns_are_refused_before_anything_starts(folder: Path) -> None:
    with pytest.raises(InvalidInput, match="did you mean"):
        brink.run({**HILLS.document(), "problem": {"id": "mtg@1"}})
    with pytest.raises(InvalidInput, match="budget"):
        brink.run({"name": "no budget", "problem": {"id": "mtq@1"}, "algorithm": {"id": "random@1"}})


def test_campaigns_of_a_coordinator_are_submitted_watched_and_fetched(database_url: str) -> None:
    with listening_coordinator(database_url) as http:
        client = brink.connect(str(http.base_url))
        campaign = client.submit(HILLS)
        result = campaign.wait(progress=False, timeout_s=60)
        assert (len(result.to_pandas()), result.id) == (120, campaign.id)
        assert client.campaign(campaign.id[:5]).result().digest == result.digest
        assert [one.id for one in client.campaigns("finished")] == [campaign.id]
        waiting = client.submit(brink.Campaign(problem="urban-injected@1", simulations=20))
        with pytest.raises(TimeoutError, match="0 of 20 simulations, no workers"):
            waiting.wait(progress=False, timeout_s=0.1)
        waiting.cancel()
        with pytest.raises(CampaignUnfinished, match="is cancelled"):
            waiting.wait(progress=False)


def test_nobody_at_an_address_is_said(folder: Path) -> None:
    with pytest.raises(CoordinatorError, match="no coordinator answers at"):
        brink.connect("http://127.0.0.1:9").campaigns()


@pytest.mark.parametrize(
    ("first", "second"), [(brink.Result, brink.AsyncResult), (brink.Client, brink.AsyncClient)]
)
def test_twins_have_the_same_methods_with_the_same_parameters(first: type, second: type) -> None:
    def methods(of: type) -> dict[str, inspect.Signature]:
        return {
            name: inspect.signature(value)
            for name, value in inspect.getmembers(of, inspect.isfunction)
            if not name.startswith("_")
        }

    sync, twins = methods(first), methods(second)
    twins.pop("archive", None)
    assert sync.keys() == twins.keys()
    for name, signature in sync.items():
        assert list(signature.parameters) == list(twins[name].parameters), name
