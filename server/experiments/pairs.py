"""Pairs across the boundary in experiments."""

from collections.abc import Iterator
from contextlib import contextmanager

from brink.search.analysis.confirmation import LEAST_DRIVES
from brink.server.campaigns.plan import check_repeatable, make_plan, with_truth
from brink.server.errors import FieldError, InvalidInput
from brink.server.experiments.body import ExperimentBody


def check_pairs(body: ExperimentBody) -> None:
    """Check that the pairs of an experiment, all of whose campaigns can run, can be followed up as it says.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    wanted = body.pairs
    if wanted is None:
        return
    if 0 < wanted.confirm < LEAST_DRIVES:
        raise InvalidInput.at(
            "/pairs/confirm",
            f"expected 0, or at least {LEAST_DRIVES} simulations of each side, got {wanted.confirm}: fewer confirm "
            "nothing",
        )
    for place in range(len(body.problems)):
        plan = make_plan(body.cells()[place * len(body.algorithms)].body)
        if wanted.confirm:
            with _pointing_at("/pairs/confirm"):
                check_repeatable(plan)
        if wanted.component:
            with _pointing_at("/pairs/component"):
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
