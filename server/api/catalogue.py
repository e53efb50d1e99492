"""Routes of the catalogue: which problems and algorithms there are."""

from fastapi import APIRouter

from brink.server.api.schemas import AlgorithmView, ProblemView
from brink.server.problems.catalogue import describe_algorithms, describe_problems

router = APIRouter(tags=["catalogue"])


@router.get("/problems")
def get_problems() -> list[ProblemView]:
    """List problems with the JSON schemas of their parameters."""
    return [ProblemView.model_validate(item) for item in describe_problems()]


@router.get("/algorithms")
def get_algorithms() -> list[AlgorithmView]:
    """List algorithms with the JSON schemas of their parameters."""
    return [AlgorithmView.model_validate(item) for item in describe_algorithms()]
