"""Checks of the follow-ups that an experiment asks for, before any campaign is stored."""

from collections.abc import Iterator
from contextlib import contextmanager

from brink.search.sequential import FIRST
from brink.server.campaigns.plan import check_repeatable, make_plan, with_truth
from brink.server.errors import FieldError, InvalidInput
from brink.server.experiments.body import ExperimentBody


def check_follow_ups(body: ExperimentBody) -> None:
    """Check that what an experiment whose campaigns can all run finds can be followed up as requested.

    Problems whose verdicts are computed are left out, as there is nothing to follow up, unless all of them are.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    wanted = body.follow_ups()
    for section, one in wanted.items():
        if 0 < one.confirm < FIRST:
            raise InvalidInput.at(
                f"/{section}/confirm",
                f"expected 0, or at least {FIRST}, got {one.confirm}: a confirmation takes at least {FIRST} "
                "simulations of each side",
            )
    if not any(one.confirm or one.component for one in wanted.values()):
        return
    cells = body.cells()
    plans = [make_plan(cells[place * len(body.algorithms)].body) for place in range(len(body.problems))]
    plans = [plan for plan in plans if not plan.problem.ignores_seeds] or plans
    for section, one in wanted.items():
        for plan in plans:
            if one.confirm:
                with _pointing_at(f"/{section}/confirm"):
                    check_repeatable(plan)
            if one.component:
                with _pointing_at(f"/{section}/component"):
                    with_truth(plan.problem)


@contextmanager
def _pointing_at(pointer: str) -> Iterator[None]:
    """Turn an error in a campaign's body into one in a field of the experiment's."""
    try:
        yield
    except InvalidInput as error:
        raise InvalidInput(
            FieldError(pointer=pointer, message=item.message, nearest=item.nearest) for item in error.errors
        ) from None
