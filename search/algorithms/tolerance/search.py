"""The algorithm `tolerance@1`."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import Ledger, LedgerAlgorithm
from brink.search.algorithms.tolerance.layout import Layout
from brink.search.algorithms.tolerance.planning import FIRST_DRIVES, FIRST_SCREENED, planned
from brink.search.algorithms.tolerance.settings import ToleranceConfig
from brink.search.algorithms.tolerance.state import ToleranceState
from brink.search.curves import LEVELS
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError, UnsupportedSpace
from brink.search.space import SearchSpace


class Tolerance(LedgerAlgorithm[ToleranceConfig, ToleranceState]):
    """The search for tolerances."""

    id = "tolerance@1"
    finds = ("tolerances",)
    minimises = ""
    summary = "Tolerances: how severe an error may be before it makes a given share of drives violate."
    config_type = ToleranceConfig

    def _min_budget(self, space: SearchSpace, config: ToleranceConfig) -> int:
        names = space.column_names()
        if not any(name == config.severity or name.endswith("." + config.severity) for name in names):
            raise UnsupportedSpace(
                f"tolerance@1 needs a parameter for the severity of an error; {config.severity} is none of "
                f"{', '.join(names)}"
            )
        layout = Layout(space, config)
        if LEVELS % config.levels:
            raise ConfigError("levels", f"expected a divisor of {LEVELS}, got {config.levels}")
        first = {"adaptive": FIRST_DRIVES, "uniform": config.levels, "random": 1}[config.design]
        return (
            len(layout.populations) * config.without_error
            + len(layout.groups) * FIRST_SCREENED
            + len(layout.cells) * first
        )

    def _first_state(self, ledger: Ledger, config: ToleranceConfig) -> ToleranceState:
        state = ToleranceState(config=config, ledger=ledger, jobs=np.empty((0, 3), np.int64), roots=())
        return planned(state, Layout(ledger.space, config))

    def tell(self, state: ToleranceState, evaluations: Mapping[int, Evaluation]) -> ToleranceState:
        """Return the state after the pending generation was evaluated."""
        state = replace(state, ledger=state.ledger.tell(evaluations))
        return planned(state, Layout(state.ledger.space, state.config))

    def _refilled(self, state: ToleranceState) -> ToleranceState:
        return planned(state, Layout(state.ledger.space, state.config))

    def _content(self, state: ToleranceState) -> tuple[dict[str, Any], dict[str, Any]]:
        return {}, {"jobs": state.jobs, "roots": np.array(state.roots, np.int64)}

    def _restored(self, ledger: Ledger, config: ToleranceConfig, document: Document) -> ToleranceState:
        jobs, roots = (document.arrays.get(name) for name in ("jobs", "roots"))
        if jobs is None or jobs.dtype != np.int64 or jobs.ndim != 2 or jobs.shape[1] != 3:
            raise DocumentError(f"jobs: expected rows of 3 whole numbers, got {jobs!r:.80}")
        if roots is None or roots.dtype != np.int64 or roots.ndim != 1:
            raise DocumentError(f"roots: expected whole numbers, got {roots!r:.80}")
        return ToleranceState(config=config, ledger=ledger, jobs=jobs, roots=tuple(roots.tolist()))
