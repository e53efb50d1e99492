"""What a campaign on the ball must find: the search run on its own, without a coordinator."""

from typing import Any

from brink.search.archive import archive_digest
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import make_plan, new_solutions
from support.problems import Ball, simulated


def undisturbed_digest(document: dict[str, Any]) -> str:
    """Return the digest of the archive of a campaign on the ball that nothing disturbs."""
    body = parse_body(document)
    plan = make_plan(body)
    assert isinstance(plan.problem, Ball)
    algorithm = plan.algorithm
    state = algorithm.start(plan.problem.space, plan.config, seed=body.seed, budget=body.budget.simulations)
    while not algorithm.finished(state):
        state, candidates = algorithm.ask(state)
        specs = {
            c.number: plan.problem.episode(c.vectors, s.seed).to_json()
            for c, s in zip(
                candidates, new_solutions(plan.problem, candidates, state, body.seed), strict=True
            )
        }
        state = algorithm.tell(
            state,
            {number: plan.problem.evaluation(simulated(spec)) for number, spec in specs.items()},
        )
    return archive_digest(state.archive)
