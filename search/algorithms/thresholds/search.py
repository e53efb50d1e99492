"""The algorithm `edge@2`."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

from brink.extras import install_command
from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import Ledger, WarmLedgerAlgorithm
from brink.search.algorithms.thresholds.documents import content_of, restored_state
from brink.search.algorithms.thresholds.planning import planned
from brink.search.algorithms.thresholds.stages import learnt
from brink.search.algorithms.thresholds.state import ThresholdConfig, ThresholdState
from brink.search.document import Document
from brink.search.errors import ConfigError
from brink.search.space import SearchSpace
from brink.search.surrogate import EXTRA, is_available


class ThresholdSearch(WarmLedgerAlgorithm[ThresholdConfig, ThresholdState]):
    """The search for thresholds."""

    id = "edge@2"
    suggested = 1
    finds = ("thresholds", "pairs", "boundary")
    minimises = ""
    without_chance: ClassVar[Mapping[str, float]] = {"trials": 0, "in_flight": 1}
    """Settings that suit a function without chance, whose thresholds are sharp."""
    summary = (
        "Thresholds: the value of a parameter at which a drive turns from safe to unsafe, with an interval."
    )
    config_type = ThresholdConfig
    layout = 2

    def _min_budget(self, space: SearchSpace, config: ThresholdConfig) -> int:
        if not is_available():
            raise ConfigError("id", f"edge@2 needs scikit-learn: {install_command(EXTRA)}")
        return 1

    def _first_state(self, ledger: Ledger, config: ThresholdConfig) -> ThresholdState:
        return planned(ThresholdState(config=config, ledger=ledger))

    def _refilled(self, state: ThresholdState) -> ThresholdState:
        return planned(state)

    def tell(self, state: ThresholdState, evaluations: Mapping[int, Evaluation]) -> ThresholdState:
        """Return the state after the pending generation was evaluated."""
        pending = state.ledger.pending
        evaluated = replace(state, ledger=state.ledger.tell(evaluations), jobs=state.jobs[len(pending) :])
        return planned(learnt(evaluated, pending, state.jobs[: len(pending)], evaluations))

    def _content(self, state: ThresholdState) -> tuple[dict[str, Any], dict[str, Any]]:
        return content_of(state), {}

    def _restored(self, ledger: Ledger, config: ThresholdConfig, document: Document) -> ThresholdState:
        return restored_state(ledger, config, document)
