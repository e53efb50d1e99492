"""Follow-ups of pairs: do they hold, is the component to blame, and which differences matter?"""

import csv
import io
import json
from typing import Any

import httpx
import pytest
from rich.console import Console
from support.api import FakeWorker, await_erasure, ball, expect, finish, row_counts, solutions, submit
from support.urban_pairs import ICY_SAFE, ICY_UNSAFE, SAFE, UNSAFE, judged
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.cli.findings import print_finding
from brink.search.sequential import exact_interval
from brink.server.campaigns.body import parse_body
from brink.server.db.engine import Engines
from brink.server.findings.finding import Finding
from brink.server.findings.pairs.views import PairsView
from brink.server.problems.urban_injected import SIMULATOR
from brink.worker.wire import Completed, JobFailed, LeasedJob

API = "/api/v1/campaigns"


def by_chance(job: LeasedJob) -> Completed | JobFailed:
    """Return what `judged` does but, in hard rain, the opposite for two seeds in three."""
    outcome = judged(job)
    assert isinstance(outcome, Completed)
    if job.spec["scenario"]["weather"] != "hard_rain" or job.spec["seed"] % 3 == 0:
        return outcome
    verdict = outcome.verdicts["front-gap@1"]
    turned = verdict.model_copy(update={"robustness": -verdict.robustness})
    return outcome.model_copy(update={"verdicts": {**outcome.verdicts, "front-gap@1": turned}})


def body(*rows: list[float], **changes: Any) -> dict[str, Any]:
    """Return the body of a campaign that simulates given solutions of the urban problem once each."""
    return {
        "name": "given",
        "problem": {"id": "urban-injected@1"},
        "seed": 4,
        "budget": {"simulations": len(rows)},
        "algorithm": {"id": "repeat@1", "params": {"solutions": list(rows), **changes}},
    }


def worked(client: httpx.Client, campaign: str, judge: Any = judged) -> str:
    worker = FakeWorker(client, capabilities=(SIMULATOR,), judge=judge)
    assert worker.work(campaign)["status"] == "finished"
    return campaign


def finished(client: httpx.Client) -> str:
    """Return a campaign with two pairs, each simulated with one episode seed on both sides."""
    given = body(SAFE, UNSAFE, ICY_SAFE, ICY_UNSAFE, seed_numbers=[0, 0, 2, 2])
    return worked(client, submit(client, given))


def ask(client: httpx.Client, campaign: str, status: int = 201, **wanted: Any) -> dict[str, Any]:
    answer = client.post(f"{API}/{campaign}/pairs/follow-ups", json=wanted)
    found: dict[str, Any] = expect(answer, status)
    return found


def finding_of(client: httpx.Client, campaign: str, **settings: float) -> Finding:
    return Finding.model_validate(expect(client.get(f"{API}/{campaign}/findings/pairs", params=settings)))


def pairs_of(client: httpx.Client, campaign: str) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/{campaign}/pairs", params={"d_th": 0.01}))
    return found


def test_a_pair_that_keeps_its_verdicts_with_other_seeds_is_confirmed(client: httpx.Client) -> None:
    campaign = finished(client)
    asked = ask(client, campaign, kind="confirm", d_th=0.01)
    assert (asked["kind"], asked["budget"]) == ("confirm", 4 * 30)
    assert ask(client, campaign, 200, kind="confirm", d_th=0.01)["campaign"] == asked["campaign"]
    waiting = pairs_of(client, campaign)
    assert {pair["confirmation"]["state"] for pair in waiting["pairs"]} == {"pending"}
    assert (waiting["tried"], waiting["pending"]) == (0, 2)
    assert waiting["note"].endswith("; 2 being simulated again")
    worked(client, asked["campaign"], by_chance)
    view = pairs_of(client, campaign)
    by_weather = {pair["safe"]["parameters"]["scenario"]["weather"]: pair for pair in view["pairs"]}
    rain, clear = by_weather["hard_rain"], by_weather["clear"]
    assert clear["confirmation"]["state"] == "confirmed"
    safe, unsafe = (clear["confirmation"][side] for side in ("safe", "unsafe"))
    assert (safe["evaluated"], safe["unsafe"], unsafe["unsafe"]) == (15, 0, 15), "no more than it takes"
    assert (unsafe["low"], unsafe["high"]) == pytest.approx(exact_interval(15, 15))
    assert rain["confirmation"]["state"] == "refuted"
    assert (view["tried"], view["confirmed"], view["refuted"], view["undecided"]) == (2, 1, 1, 0)
    assert "of 2 simulated again with other seeds, 1 confirmed and 1 refuted" in view["note"]
    assert view["chance"] == [
        "After the search, 4 sides of pairs were simulated again with other seeds; 2 had the other verdict at least "
        "once"
    ]
    before, after = (
        [one["seed"] for one in solutions(client, name)] for name in (campaign, asked["campaign"])
    )
    assert len(set(after)) == len(after), "each with a seed of its own"
    assert not set(before) & set(after)

    more = ask(client, campaign, kind="confirm", repeats=10, d_th=0.01)
    worked(client, more["campaign"])
    last = pairs_of(client, campaign)
    clear = next(pair for pair in last["pairs"] if pair["confirmation"]["state"] == "confirmed")
    assert clear["confirmation"]["safe"]["evaluated"] == 25, "follow-ups of the same sides add up"
    assert [one["kind"] for one in last["follow_ups"]] == ["confirm", "confirm"]


def test_pairs_are_listed_by_evidence_and_keep_their_numbers(client: httpx.Client) -> None:
    campaign = finished(client)
    before = pairs_of(client, campaign)["pairs"]
    assert [pair["place"] for pair in before] == [1, 2]
    assert before[0]["safe"]["parameters"]["scenario"]["weather"] == "hard_rain", "the nearer one"
    asked = ask(client, campaign, kind="confirm", d_th=0.01, limit=1)
    worked(client, asked["campaign"], by_chance)
    after = pairs_of(client, campaign)["pairs"]
    assert [(pair["place"], pair["confirmation"]["state"]) for pair in after] == [
        (2, "not tried"),
        (1, "refuted"),
    ]
    best = expect(client.get(f"{API}/{campaign}/pairs", params={"d_th": 0.01, "limit": 1}))["pairs"]
    assert [pair["place"] for pair in best] == [2]
    again = ask(client, campaign, 200, kind="confirm", d_th=0.01, limit=1)
    assert again["campaign"] == asked["campaign"], "a limit is a number of a pair, whatever was found of it"
    table = client.get(f"{API}/{campaign}/pairs", params={"d_th": 0.01, "format": "csv"}).text
    assert [row["pair"] for row in csv.DictReader(io.StringIO(table))] == ["2", "1"]
    words = pairs_of(client, campaign)["legend"]
    assert [term.partition(":")[0] for term in words if term.startswith(("conf", "ref", "undec"))] == [
        "confirmed 0/15 26/27",
        "refuted",
        "confirmed pairs come first, refuted ones last; a pair keeps its number",
    ]


@pytest.mark.long("runs campaigns")
def test_a_pair_is_pending_while_it_is_undecided_and_drives_are_coming(client: httpx.Client) -> None:
    campaign = finished(client)
    few = expect(client.post(f"{API}/{campaign}/repeats", json={"numbers": [0, 1, 2, 3], "repeats": 5}), 201)
    worked(client, few["campaign"])

    def states() -> set[tuple[str, int]]:
        found = [pair["confirmation"] for pair in pairs_of(client, campaign)["pairs"]]
        return {(one["state"], one["safe"]["evaluated"]) for one in found}

    assert states() == {("undecided", 5)}
    asked = ask(client, campaign, kind="confirm", d_th=0.01)["campaign"]
    assert states() == {("pending", 5)}
    expect(client.post(f"{API}/{asked}/cancel"))
    assert states() == {("undecided", 5)}
    again = worked(client, ask(client, campaign, kind="confirm", d_th=0.01)["campaign"])
    assert states() == {("confirmed", 20)}
    wanted = {"numbers": [0, 1, 2, 3], "repeats": 30}
    more = expect(client.post(f"{API}/{campaign}/repeats", json=wanted), 201)["campaign"]
    assert more != again, "this one does not end earlier"
    worked(client, more)
    assert states() == {("confirmed", 50)}
    seeds = [one["seed"] for name in (again, more) for one in solutions(client, name)]
    assert len(set(seeds)) == len(seeds) == 4 * (15 + 30), "no episode counts twice"


def test_drives_that_failed_do_not_confirm_a_pair(client: httpx.Client) -> None:
    """They may have failed because of what happened in them."""
    campaign = finished(client)

    def fails(job: LeasedJob) -> Completed | JobFailed:
        if job.spec["seed"] % 4 == 0:
            return JobFailed(reason="invalid", message="no")
        return judged(job)

    asked = ask(client, campaign, kind="confirm", repeats=18, d_th=0.01)["campaign"]
    worker = FakeWorker(client, capabilities=(SIMULATOR,), judge=fails)
    while worker.work(asked)["status"] == "paused":
        expect(client.post(f"{API}/{asked}/resume"))
    for pair in pairs_of(client, campaign)["pairs"]:
        again = pair["confirmation"]
        assert again["safe"]["failed"] > 0, "else this shows nothing"
        assert again["safe"]["evaluated"] + again["safe"]["failed"] == 18, (
            "simulated as often as was asked for"
        )
        assert again["state"] == "undecided"


@pytest.mark.long("runs campaigns")
def test_differences_between_sides_with_different_seeds_are_not_called_minimal(client: httpx.Client) -> None:
    given = body(SAFE, UNSAFE, ICY_SAFE, ICY_UNSAFE, seed_numbers=[0, 1, 2, 2])
    campaign = worked(client, submit(client, given))
    view = pairs_of(client, campaign)
    states = {pair["safe"]["number"]: pair["minimality"]["state"] for pair in view["pairs"]}
    assert states == {0: "different seeds", 2: "minimal"}
    offer = next(one for one in view["offers"] if one["kind"] == "minimise")
    assert (offer["reason"], offer["left_out"]) == (
        "no difference can be reverted alone: all pairs are minimal",
        1,
    )
    apart = worked(client, submit(client, body(SAFE, UNSAFE, ICY_SAFE, ICY_UNSAFE)))
    assert "have different seeds" in ask(client, apart, 409, kind="minimise")["detail"]
    reasons = {one["kind"]: one["reason"] for one in pairs_of(client, apart)["offers"]}
    assert reasons["minimise"].startswith("the two sides of every pair have different seeds")

    some = worked(client, submit(client, body(SAFE, UNSAFE, ICY_SAFE, ICY_UNSAFE, seed_numbers=[0, 0, 2, 3])))
    asked = ask(client, some, kind="minimise", d_th=0.01)
    worked(client, asked["campaign"])
    states = {pair["safe"]["number"]: pair["minimality"]["state"] for pair in pairs_of(client, some)["pairs"]}
    assert states == {0: "not minimal", 2: "different seeds"}


def test_an_episode_of_another_campaign_is_not_followed_up(client: httpx.Client) -> None:
    campaign = worked(client, submit(client, body(SAFE, UNSAFE, seed_numbers=[50, 50])))
    detail = ask(client, campaign, 409, kind="component")["detail"]
    assert "solution 1 shares the episode of another campaign" in detail
    assert "ask about that campaign's pairs instead" in detail


@pytest.mark.long("runs campaigns")
def test_what_a_cancelled_follow_up_did_not_simulate_was_not_tried(client: httpx.Client) -> None:
    campaign = finished(client)
    for kind in ("component", "minimise"):
        asked = ask(client, campaign, kind=kind, d_th=0.01)["campaign"]
        expect(client.post(f"{API}/{asked}/cancel"))
    view = pairs_of(client, campaign)
    assert {pair["component"]["state"] for pair in view["pairs"]} == {"not tried"}
    assert sorted(pair["minimality"]["state"] for pair in view["pairs"]) == ["minimal", "not tried"]
    assert {one["kind"]: one["reason"] for one in view["offers"]} == dict.fromkeys(
        ("confirm", "component", "minimise", "sharpen"), ""
    )


def test_ground_truth_in_the_same_episode_tells_whose_hazard_it_is(client: httpx.Client) -> None:
    campaign = finished(client)
    asked = ask(client, campaign, kind="component", d_th=0.01)
    assert {pair["component"]["state"] for pair in pairs_of(client, campaign)["pairs"]} == {"pending"}
    worked(client, asked["campaign"])
    view = pairs_of(client, campaign)
    told = {pair["unsafe"]["parameters"]["scenario"]["weather"]: pair["component"] for pair in view["pairs"]}
    assert (told["clear"]["state"], told["hard_rain"]["state"]) == ("component", "scenario")
    assert told["clear"]["outcome"] == "front gap held"
    assert told["hard_rain"]["outcome"] == "violated the front gap at 16.1 s"
    assert (view["component"], view["scenario"]) == (1, 1)
    assert (
        "With ground truth in place of the component, in one drive each, the unsafe side of 1 of 2 held the front "
        "gap (the component's hazard), that of 1 violated the front gap all the same (the scenario's hazard)"
    ) in view["blame"]
    screen = Console(width=500, record=True, file=io.StringIO())
    print_finding(screen, finding_of(client, campaign, d_th=0.01))
    assert view["blame"] in screen.export_text(), "the terminal says whose hazard it is"
    before = {one["number"]: one["seed"] for one in solutions(client, campaign)}
    after = solutions(client, asked["campaign"])
    assert [one["seed"] for one in after] == [before[1], before[3]], "the very episodes of the unsafe sides"
    spec = expect(client.get(f"{API}/{asked['campaign']}/solutions/0"))["spec"]
    assert spec["behaviour"] == {"mode": "oracle"}
    assert "reported: the ground truth" in after[0]["words"]
    assert expect(client.get(f"{API}/{campaign}/repeats")) == [], "these are no repeats"


def test_differences_that_do_not_matter_are_reverted(client: httpx.Client) -> None:
    campaign = finished(client)
    before = pairs_of(client, campaign)
    states = {len(pair["changes"]): pair["minimality"]["state"] for pair in before["pairs"]}
    assert states == {1: "minimal", 3: "not tried"}, "a pair that differs in one number is minimal anyway"
    asked = ask(client, campaign, kind="minimise", d_th=0.01)
    worked(client, asked["campaign"])
    view = pairs_of(client, campaign)
    [told] = [pair for pair in view["pairs"] if len(pair["changes"]) == 3]
    found = told["minimality"]
    assert (found["state"], found["campaign"]) == ("not minimal", asked["campaign"])
    less = found["unsafe"]
    assert less["minimal"]
    assert [change["names"] for change in less["changes"]] == [["behaviour.trajectory_1.t0_step"]]
    assert less["change"] == "a person is reported from 14.8 s instead of 15.2 s"
    assert less["parameters"]["behaviour"]["trajectory_1.x_min_0_px"] == 300.0
    assert less["distance"] < told["distance"]
    assert less["outcome"] == "violated the front gap at 16.1 s"
    simulated = solutions(client, asked["campaign"])
    assert found["tried"] == len(simulated) == 4, "the beginning again after a difference went"
    [seed] = {one["seed"] for one in simulated}
    assert seed == told["unsafe"]["seed"], "the episode seed of the unsafe side"
    assert next(one for one in simulated if one["number"] == less["number"])["verdict"] == "unsafe"


@pytest.mark.long("runs campaigns")
def test_the_pairs_say_what_can_be_asked_and_what_it_takes(client: httpx.Client) -> None:
    def offers(campaign: str) -> dict[str, tuple[int, str]]:
        view = pairs_of(client, campaign)
        return {one["kind"]: (one["simulations"], one["reason"]) for one in view["offers"]}

    running = submit(client, body(SAFE, UNSAFE))
    reasons = {reason for _, reason in offers(running).values()}
    assert reasons == {"the campaign is running: wait until it has ended"}
    alone = worked(client, submit(client, body(SAFE)))
    assert {reason for _, reason in offers(alone).values()} == {"there is no pair"}

    campaign = finished(client)
    sharpening = offers(campaign)["sharpen"]
    assert sharpening[0] > 2 * (6 + 40)
    first = {"confirm": (4, ""), "component": (2, ""), "minimise": (6, ""), "sharpen": sharpening}
    assert offers(campaign) == first
    asked_of: dict[str, str] = {}
    for kind, (simulations, _) in offers(campaign).items():
        asked = ask(client, campaign, kind=kind, d_th=0.01)
        asked_of[kind] = asked["campaign"]
        assert asked["budget"] == simulations * (30 if kind == "confirm" else 1)
        same = f"this has been requested: campaign {asked['campaign']} is running"
        assert offers(campaign)[kind] == (0, same)
        worked(client, asked["campaign"])
    assert offers(campaign) == {
        "confirm": (4, ""),
        "component": (2, "all unsafe sides have been simulated with ground truth"),
        "minimise": (6, "the differences of all pairs have been reverted one by one"),
        "sharpen": (sharpening[0], f"all pairs have been sharpened: see campaign {asked_of['sharpen']}"),
    }
    minimal = worked(client, submit(client, body(ICY_SAFE, ICY_UNSAFE, seed_numbers=[0, 0])))
    assert offers(minimal)["minimise"][1] == "no difference can be reverted alone: all pairs are minimal"


@pytest.mark.long("runs campaigns")
def test_failed_simulations_claim_nothing(client: httpx.Client) -> None:
    campaign = finished(client)

    def fails(job: LeasedJob) -> Completed | JobFailed:
        return JobFailed(reason="invalid", message="no")

    for kind in ("component", "minimise"):
        asked = ask(client, campaign, kind=kind, d_th=0.01)["campaign"]
        worker = FakeWorker(client, capabilities=(SIMULATOR,), judge=fails)
        while worker.work(asked)["status"] == "paused":
            expect(client.post(f"{API}/{asked}/resume"))
    view = pairs_of(client, campaign)
    assert {pair["component"]["state"] for pair in view["pairs"]} == {"failed"}
    [told] = [pair["minimality"] for pair in view["pairs"] if len(pair["changes"]) == 3]
    assert (told["state"], told["unsafe"]) == ("undecided", None)


@pytest.mark.long("runs campaigns")
def test_computed_pairs_are_minimised_without_workers(client: httpx.Client) -> None:
    algorithm = {"id": "random@1", "params": {"generation_size": 100}}
    campaign = submit(
        client,
        {
            "name": "mtq",
            "problem": {"id": "mtq@1"},
            "algorithm": algorithm,
            "seed": 2,
            "budget": {"simulations": 400},
        },
    )
    assert FakeWorker(client).work(campaign)["status"] == "finished"
    params = {"eps": 0.1, "d_th": 0.1}
    view = expect(client.get(f"{API}/{campaign}/pairs", params=params))
    assert view["pairs"]
    asked = ask(client, campaign, kind="minimise", eps=0.1, d_th=0.1)
    assert FakeWorker(client).work(asked["campaign"])["status"] == "finished"
    view = expect(client.get(f"{API}/{campaign}/pairs", params=params))
    reasons = {one["kind"]: one["reason"] for one in view["offers"]}
    assert reasons["confirm"] == "mtq@1 is computed, not simulated: other seeds give the same verdicts"
    assert reasons["component"] == "mtq@1 has no component that ground truth can replace"
    states = {pair["minimality"]["state"] for pair in view["pairs"]}
    assert states <= {"minimal", "not minimal"}
    for kind, pointer in (("confirm", "/repeats"), ("component", "/ground_truth")):
        [error] = ask(client, campaign, 422, kind=kind, **params)["errors"]
        assert error["pointer"] == pointer


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"kind": "improve"}, "'confirm', 'component', 'minimise' or 'sharpen'"),
        ({"kind": "confirm", "repeats": 1}, "greater than or equal to 2"),
        ({"kind": "component", "repeats": 10}, "expected repeats only to confirm pairs"),
        ({"kind": "minimise", "eps": 2}, "less than or equal to 1"),
    ],
)
def test_questions_that_make_no_sense_are_refused(
    client: httpx.Client, wanted: dict[str, Any], message: str
) -> None:
    campaign = submit(client, ball())
    [error] = ask(client, campaign, 422, **wanted)["errors"]
    assert message in error["message"]


def test_only_pairs_of_an_ended_campaign_are_followed_up(client: httpx.Client) -> None:
    running = submit(client, ball())
    assert "is running: wait until it has ended" in ask(client, running, 409, kind="confirm")["detail"]
    without = finish(client, ball(simulations=20, problem={"id": "ball@1", "params": {"limit": 1e-9}}))
    assert "has no pair at eps 0.02, d_th 0.2" in ask(client, without, 409, kind="confirm")["detail"]
    balls = finish(client, ball(simulations=80))
    [error] = ask(client, balls, 422, kind="component", eps=0.2)["errors"]
    assert error["message"] == "ball@1 has no component that ground truth can replace"


def test_a_campaign_is_deleted_with_its_follow_ups(client: httpx.Client, engines: Engines) -> None:
    campaign = finished(client)
    again = ask(client, campaign, kind="component", d_th=0.01)["campaign"]
    expect(client.delete(f"{API}/{campaign}"), 409)
    worked(client, again)
    expect(client.delete(f"{API}/{campaign}"), 204)
    await_erasure(engines)
    counts = row_counts(engines)
    assert (counts["campaigns"], counts["follow_ups"], counts["solutions"]) == (0, 0, 0)


@pytest.mark.long("runs campaigns")
def test_the_command_asks_and_then_shows_what_came(listening_client: httpx.Client) -> None:
    campaign = finished(listening_client)
    options = ["--d-th", "0.01", "--confirm", "30", "--component", "--minimise"]

    def shown(*more: str) -> str:
        arguments = ["pairs", campaign, *options, *more, "--server", str(listening_client.base_url)]
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, result.output
        return result.output

    assert shown().count("the same command shows what is known so far") == 3
    for one in pairs_of(listening_client, campaign)["follow_ups"]:
        worked(listening_client, one["campaign"])
    text = " ".join(shown().split())
    assert "minimal change:" in text
    view = PairsView.model_validate(json.loads(shown("--json")))
    assert [one.status for one in view.follow_ups] == ["finished"] * 3
    assert "only the first 500 pairs are simulated again" in shown("--limit", "800")
    limited = shown("--limit", "1", "--confirm", "11")
    assert "simulates them" in limited
    confirms = [one for one in pairs_of(listening_client, campaign)["follow_ups"] if one["kind"] == "confirm"]
    assert confirms[-1]["budget"] == 22, "both sides of the first pair"
    assert {", ".join(pair.evidence) for pair in view.pairs} == {
        "found once, confirmed 0/15 15/15, component's hazard (one seed), 1 of 3 differences is enough",
        "found once, confirmed 0/15 15/15, scenario's hazard (one seed), minimal",
    }


def test_bodies_without_ground_truth_keep_their_hashes() -> None:
    plain = parse_body({**body(SAFE), "problem": {"id": "mtq@1"}, "algorithm": {"id": "random@1"}})
    assert plain.document_hash() == ("6847ab8a9ec407b4feed71c98fd97541849215b6e2d96ace70d9b67c97574644")
    assert plain.document_hash() != plain.model_copy(update={"ground_truth": True}).document_hash()
    older = plain.model_dump(mode="json")
    del older["ground_truth"]
    assert parse_body(older) == plain, "stored before there was ground truth"


def test_a_repeated_campaign_with_ground_truth_keeps_it(client: httpx.Client) -> None:
    truth = worked(client, submit(client, {**body(SAFE, ICY_SAFE), "ground_truth": True}))
    again = expect(client.post(f"{API}/{truth}/repeats", json={"repeats": 2, "numbers": [0]}), 201)
    worked(client, again["campaign"])
    specs = [expect(client.get(f"{API}/{name}/solutions/0"))["spec"] for name in (truth, again["campaign"])]
    assert [spec["behaviour"]["mode"] for spec in specs] == ["oracle", "oracle"]
    refused = expect(client.post(API, json={**ball(), "ground_truth": True}), 422)
    assert refused["errors"][0]["pointer"] == "/ground_truth"


def test_few_drives_refute_a_pair_but_confirm_none(client: httpx.Client) -> None:
    campaign = finished(client)
    worked(client, ask(client, campaign, kind="confirm", repeats=10, d_th=0.01)["campaign"], by_chance)
    view = pairs_of(client, campaign)
    assert sorted(pair["confirmation"]["state"] for pair in view["pairs"]) == ["refuted", "undecided"]
    assert "0 confirmed, 1 refuted and 1 undecided" in view["note"]
    words = view["legend"]
    assert any(term.startswith("undecided: neither") for term in words)


def test_intervals_of_pairs_are_exact_whatever_the_campaign_says(client: httpx.Client) -> None:
    given = body(SAFE, UNSAFE, seed_numbers=[0, 0], z=1.0)
    campaign = worked(client, submit(client, given))
    worked(client, ask(client, campaign, kind="confirm")["campaign"])
    [pair] = pairs_of(client, campaign)["pairs"]
    unsafe = pair["confirmation"]["unsafe"]
    assert (unsafe["low"], unsafe["high"]) == pytest.approx(exact_interval(15, 15))


def test_pairs_say_what_they_do_not_say_of_a_detector_of_ones_own(client: httpx.Client) -> None:
    campaign = finished(client)
    view = pairs_of(client, campaign)
    assert "not that yours does" in view["caveat"]
    assert "urban-camera@1" in view["caveat"]
    screen = Console(record=True, width=80)
    print_finding(screen, finding_of(client, campaign))
    assert view["caveat"] in screen.export_text()
    asked = ask(client, campaign, kind="component", d_th=0.01)
    worked(client, asked["campaign"])
    assert pairs_of(client, asked["campaign"])["caveat"] == "", "there is no component in these drives"
