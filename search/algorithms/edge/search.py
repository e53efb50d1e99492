"""The algorithm `edge@1`."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

from brink.extras import install_command
from brink.search.algorithm import Evaluation
from brink.search.algorithms.edge.brackets import learnt
from brink.search.algorithms.edge.documents import content_of, restored_state
from brink.search.algorithms.edge.planning import planned
from brink.search.algorithms.edge.prior import Prior
from brink.search.algorithms.edge.state import EdgeConfig, EdgeState, varied_columns
from brink.search.algorithms.ledger import Ledger, WarmLedgerAlgorithm
from brink.search.document import Document
from brink.search.errors import ConfigError, SpaceError
from brink.search.pairs import Steps
from brink.search.space import SearchSpace
from brink.search.surrogate import EXTRA, is_available


class Edge(WarmLedgerAlgorithm[EdgeConfig, EdgeState]):
    """The search for pairs across the boundary."""

    id = "edge@1"
    finds = ("pairs", "boundary")
    minimises = ""
    without_chance: ClassVar[Mapping[str, float]] = {"checks": 0, "margin": 0.0, "eps": 0.005, "d_th": 0.1}
    """Settings that suit a function without chance, whose boundary is sharp."""
    summary = (
        "Pairs across the boundary: a safe and an unsafe neighbour, and the change between them. edge@2 also says "
        "where along a number it turns."
    )
    config_type = EdgeConfig
    layout = 2

    def _min_budget(self, space: SearchSpace, config: EdgeConfig) -> int:
        if not is_available():
            raise ConfigError("id", f"edge@1 needs scikit-learn: {install_command(EXTRA)}")
        try:
            varied_columns(space, config)
        except SpaceError as error:
            raise ConfigError("vary", f"expected all or the name of a component; {error}") from None
        return 1

    def _first_state(self, ledger: Ledger, config: EdgeConfig) -> EdgeState:
        prior = Prior.of(ledger.known, Steps(ledger.space), config.eps)
        return planned(EdgeState(config=config, ledger=ledger, seeds={}, tries={}, prior=prior))

    def _refilled(self, state: EdgeState) -> EdgeState:
        return planned(state)

    def tell(self, state: EdgeState, evaluations: Mapping[int, Evaluation]) -> EdgeState:
        """Return the state after the pending generation was evaluated."""
        pending = state.ledger.pending
        evaluated = replace(state, ledger=state.ledger.tell(evaluations), jobs=state.jobs[len(pending) :])
        return planned(learnt(evaluated, pending, state.jobs[: len(pending)], evaluations))

    def _content(self, state: EdgeState) -> tuple[dict[str, Any], dict[str, Any]]:
        return content_of(state)

    def _restored(self, ledger: Ledger, config: EdgeConfig, document: Document) -> EdgeState:
        return restored_state(ledger, config, document)
