"""Coverage by simulation: how often intervals and tests are right when the truth is known."""

from benchmarks.coverage.study import Claim, Coverage, Study, measure, studies

__all__ = ["Claim", "Coverage", "Study", "measure", "studies"]
