"""`brink pairs --picture` and `--film`: of drives, of problems without drives, and what cannot be drawn."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from support.traces import make_trace
from typer.testing import CliRunner

import brink.report.pair_pictures
from brink.api.live import Steps
from brink.cli.commands import app
from brink.cli.pair_pictures import chosen_pair
from brink.pictures.pair_view import STILL_WIDTH_PX
from brink.plots.style import WIDTH_PX
from brink.report.pair_pictures import facts, findings, headline, share_words
from brink.search.analysis.confirmation import Confirmation
from brink.server.errors import InvalidInput
from brink.server.findings.follow_ups import ShareView
from brink.server.findings.pairs.views import (
    ComponentPart,
    ComponentView,
    ConfirmationView,
    Minimality,
    MinimalityView,
    PairsView,
)
from brink.sim.trace import Trace

CAMPAIGN = {
    "name": "disc",
    "problem": {"id": "mtq@1"},
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 300},
    "seed": 1,
}
WIDE = ["--eps", "0.05", "--d-th", "0.1"]


@pytest.fixture(scope="module")
def disc(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, list[str]]:
    """A finished campaign on a problem without drives: its id, and the options that name its database."""
    folder = tmp_path_factory.mktemp("disc")
    (folder / "disc.json").write_text(json.dumps(CAMPAIGN))
    database = f"sqlite:///{shutil.copyfile(sqlite_file, folder / 'disc.db')}"
    command = [
        "run",
        str(folder / "disc.json"),
        "--database",
        database,
        "--no-pictures",
        "--out",
        str(folder),
        "--json",
    ]
    ran = CliRunner().invoke(app, command)
    assert ran.exit_code == 0, ran.output
    return str(json.loads(ran.stdout)["campaign"]), ["--database", database]


def pairs(disc: tuple[str, list[str]], *options: str) -> Any:
    campaign, database = disc
    return CliRunner().invoke(app, ["pairs", campaign, *WIDE, *options, *database])


def view_of(disc: tuple[str, list[str]]) -> PairsView:
    return PairsView.model_validate_json(pairs(disc, "--json").stdout)


def test_a_problem_without_drives_is_drawn_in_its_plane(disc: tuple[str, list[str]], tmp_path: Path) -> None:
    picture = tmp_path / "pair.png"
    said = pairs(disc, "--picture", "1", str(picture))
    assert said.exit_code == 0, said.output
    assert said.stdout.strip() == str(picture)
    with Image.open(picture) as image:
        assert image.width == WIDTH_PX


def test_a_problem_without_drives_cannot_be_filmed(disc: tuple[str, list[str]], tmp_path: Path) -> None:
    said = pairs(disc, "--film", "1", str(tmp_path / "pair.mp4"))
    assert said.exit_code != 0
    assert "verdicts are computed, so there is no drive to film: ask for --picture" in str(said.exception)
    assert list(tmp_path.iterdir()) == []


def test_drives_are_drawn_with_the_words_of_the_pair(
    disc: tuple[str, list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = view_of(disc)
    safe = view.pairs[0].safe.number

    async def trace_of(_api: object, _campaign: str, number: int) -> Trace:
        return make_trace(samples=150, violated=number != safe)

    async def simulated(api: Any, campaign: str, **_: object) -> PairsView:
        return view.model_copy(update={"computed": False})

    async def front_gap(_api: object, _campaign: str) -> tuple[str, ...]:
        return ("front-gap@1",)

    monkeypatch.setattr(brink.report.pair_pictures, "run_episode", trace_of)
    monkeypatch.setattr(brink.report.pair_pictures, "fetch_requirements", front_gap)
    monkeypatch.setattr("brink.cli.pairs.fetch_pairs", simulated)
    picture = tmp_path / "pair.png"
    steps: list[tuple[str, int, int]] = []
    show = Steps.show

    def record(self: Steps, what: str, done: int = 0, total: int = 0) -> None:
        steps.append((what, done, total))
        show(self, what, done, total)

    monkeypatch.setattr(Steps, "show", record)
    said = pairs(disc, "--picture", "1", str(picture))
    assert said.exit_code == 0, said.output
    with Image.open(picture) as image:
        assert image.width == STILL_WIDTH_PX
    simulating = "simulating both drives of pair 1 again"
    assert steps[:3] == [(simulating, 0, 2), (simulating, 1, 2), (f"drawing {picture}", 0, 0)]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--picture", "999", "pair.png"], "expected the number of a pair from 1 to "),
        (["--picture", "0", "pair.png"], "got 0"),
        (["--picture", "1", "pair.mp4"], "pair.mp4: expected a file name that ends in .png"),
        (["--film", "1", "pair.png"], "pair.png: expected a file name that ends in .mp4 or .gif"),
        (["--film", "1", "nowhere/pair.gif"], "nowhere: no such folder"),
        (["--eps", "0", "--picture", "1", "pair.png"], "but there is none: no pair within eps 0"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_what_can(
    disc: tuple[str, list[str]],
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    said = pairs(disc, *options)
    assert said.exit_code != 0
    assert message in str(said.exception)
    assert list(tmp_path.iterdir()) == []


def test_a_pair_is_chosen_by_its_number_wherever_it_is_listed(disc: tuple[str, list[str]]) -> None:
    view = view_of(disc)
    turned = view.model_copy(update={"pairs": view.pairs[::-1]})
    assert chosen_pair(turned, 2, "--picture").place == 2
    few = view.model_copy(update={"pairs": view.pairs[1:]})
    with pytest.raises(
        InvalidInput, match=r"--picture: expected one of the \d+ pairs with the best evidence, got 1"
    ):
        chosen_pair(few, 1, "--picture")


@pytest.mark.parametrize("option", ["--picture", "--film"])
def test_an_option_that_is_given_twice_is_refused_before_anything_is_drawn(
    option: str, tmp_path: Path
) -> None:
    once = [option, "1", str(tmp_path / "a.gif")]
    said = CliRunner().invoke(app, ["pairs", "3f2a", *once, *once])
    assert said.exit_code == 2
    assert f"'{option}': expected it once; use one call for each" in said.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_headline_leaves_out_the_outcome_of_a_long_change(disc: tuple[str, list[str]]) -> None:
    pair = view_of(disc).pairs[0]
    assert headline(pair) == f"{pair.words[0].upper()}{pair.words[1:]}"
    long = pair.model_copy(update={"change": "a " * 90, "words": f"{'a ' * 90}: {'b ' * 40}"})
    assert headline(long) == f"A {'a ' * 89}"


def test_shares_and_facts_say_what_is_known(disc: tuple[str, list[str]]) -> None:
    view = view_of(disc)
    assert facts(view, view.pairs[0])[0].startswith(f"Pair 1 of {view.distinct} of disc.")
    minimal = view.pairs[0].model_copy(
        update={"minimality": MinimalityView(state=Minimality.MINIMAL, tried=2)}
    )
    assert facts(view, minimal)[-1] == "No part of the change can be left out (tried by simulation)."
    share = ShareView(evaluated=10, unsafe=1, probability=0.1, low=0.018, high=0.404)
    assert share_words(share) == (
        "unsafe in 1 of 10 simulations with other seeds: 10%, 90% interval 2 to 40%"
    )
    assert share_words(ShareView(evaluated=0, unsafe=0, probability=None, low=0.0, high=1.0)) == ""


@pytest.mark.parametrize(
    ("state", "outcome", "words"),
    [
        (ComponentPart.COMPONENT, "front gap held", "keeps the front gap: the component"),
        (
            ComponentPart.COMPONENT,
            "front gap held; stood still too long at 14.4 s",
            "keeps the front gap (but stood still too long at 14.4 s): the component",
        ),
        (
            ComponentPart.SCENARIO,
            "violated the front gap at 5.5 s",
            "is unsafe too (violated the front gap at 5.5 s): the scenario",
        ),
    ],
)
def test_the_findings_say_what_is_to_blame(
    disc: tuple[str, list[str]], state: ComponentPart, outcome: str, words: str
) -> None:
    pair = view_of(disc).pairs[0]
    assert findings(pair) == []
    known = pair.model_copy(update={"component": ComponentView(state=state, outcome=outcome)})
    assert findings(known) == [
        f"With true perception and the same seed, this drive {words} is to blame, judged with this one seed."
    ]


@pytest.mark.parametrize(
    ("state", "safe", "unsafe", "words"),
    [
        (Confirmation.CONFIRMED, 0, 10, "Confirmed with 10 other seeds each side."),
        (
            Confirmation.REFUTED,
            7,
            10,
            "Refuted, so chance has a part: with other seeds, the safe side was unsafe in 7 of 10.",
        ),
        (
            Confirmation.REFUTED,
            6,
            3,
            "Refuted, so chance has a part: with other seeds, the safe side was unsafe in 6 of 10 and the unsafe "
            "side in only 3 of 10.",
        ),
        (Confirmation.UNDECIDED, 1, 9, "Undecided with 10 other seeds each side: chance may decide."),
    ],
)
def test_the_findings_say_whether_other_seeds_confirm_the_pair(
    disc: tuple[str, list[str]], state: Confirmation, safe: int, unsafe: int, words: str
) -> None:
    shares = [
        ShareView(evaluated=10, unsafe=n, probability=n / 10, low=0.0, high=1.0) for n in (safe, unsafe)
    ]
    view = view_of(disc).model_copy(update={"computed": False})
    pair = view.pairs[0].model_copy(
        update={"confirmation": ConfirmationView(state=state, safe=shares[0], unsafe=shares[1])}
    )
    assert findings(pair) == [words]
    assert not any("search" in fact for fact in facts(view, pair)), "the search saw fewer drives"


@pytest.mark.parametrize("checked", [True, False])
def test_the_facts_say_how_often_the_search_simulated_both_sides(
    disc: tuple[str, list[str]], checked: bool
) -> None:
    view = view_of(disc)
    pair = view.pairs[0].model_copy(update={"checked": checked})
    assert not any("search" in fact for fact in facts(view, pair)), "chance has no part in computed verdicts"
    [told] = [fact for fact in facts(view.model_copy(update={"computed": False}), pair) if "search" in fact]
    assert ("both verdicts held" in told) is checked
    assert ("chance may decide" in told) is not checked
