"""A search whose simulations the caller runs: `ask` for trials, simulate them, `tell` the results.

A study needs neither coordinator nor database; `save` keeps its state in a file.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from brink.python.campaign import known_from, start_of
from brink.python.frames import archive_frame, parameter_columns, typed_frame
from brink.search.algorithm import (
    AnyAlgorithm,
    Candidate,
    Failed,
    Overlapping,
    Question,
    Scored,
    Seeded,
    WarmStarts,
)
from brink.search.analysis.boundary import distinct_boundary
from brink.search.analysis.pairs import find_pairs
from brink.search.archive import Archive
from brink.search.errors import DocumentError, OrderError, UnsupportedSpace
from brink.search.shorthand import DeclaredSpace, flat_values, space_from, space_of
from brink.search.space import SearchSpace
from brink.search.streams import episode_seed
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_EPS, DEFAULT_PAIRS_D_TH, DEFAULT_T_B
from brink.server.findings.boundary import table as boundary_table
from brink.server.problems.catalogue import make_algorithm, make_params
from brink.user_file import read_text

if TYPE_CHECKING:
    import pandas as pd

_VERSION: Final = 1
_LARGEST_BYTES: Final = 256 * 1024**2


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A combination of parameters to simulate.

    Attributes:
        number: Number in its study, counted from 0.
        values: The parameters by name (by component.name, if two components have the same name).
        seed: Seed of the simulation, if chance has a part in it: trials that are to be compared share one.
    """

    number: int
    values: Mapping[str, Any]
    seed: int


class Study:
    """A search for the boundary that proposes trials with `ask` and receives their results with `tell`.

    Args:
        space: The parameters; see `brink.search`.
        algorithm: Id of the algorithm.
        simulations: Number of trials.
        seed: Seed of the search.
        params: Parameters of the algorithm that differ from their defaults.
        start_from: What is known already: a data frame with a column for each parameter and one for ``robustness``.
        constraints: Conditions that every trial meets, such as ``gap > 2 * speed / 3.6``.

    Raises:
        SpaceError: A parameter or a constraint is not written as expected.
        InvalidInput: The algorithm or one of its parameters does not exist.
        ConfigError: A parameter of the algorithm does not fit.
        UnsupportedSpace: The algorithm does not support the space.

    Example:
        >>> from brink import Study
        >>> study = Study({"speed": (0.0, 40.0), "distance": (0.0, 100.0)}, algorithm="random@1", simulations=60)
        >>> while trials := study.ask():
        ...     for trial in trials:
        ...         study.tell(trial, trial.values["distance"] - trial.values["speed"] ** 2 / 16.0)
        >>> len(study.to_pandas())
        60
    """

    def __init__(
        self,
        space: DeclaredSpace,
        algorithm: str = "edge@1",
        *,
        simulations: int = 500,
        seed: int = 1,
        params: Mapping[str, Any] | None = None,
        start_from: "Mapping[str, Any] | pd.DataFrame | None" = None,
        constraints: Sequence[str] = (),
    ) -> None:
        self._algorithm: AnyAlgorithm = make_algorithm(algorithm)
        if isinstance(self._algorithm, Seeded):
            raise UnsupportedSpace(
                f"{algorithm} asks for seeds, which a study cannot give: run it as a campaign"
            )
        if getattr(self._algorithm, "needs_measures", False):
            raise UnsupportedSpace(
                f"{algorithm} needs measures, which a study cannot give: run it as a campaign"
            )
        self._space = space_of(space, constraints)
        self._id, self._seed, self._simulations = algorithm, seed, simulations
        self._config = make_params(self._algorithm.config_type, dict(params or {}), "/params")
        self._algorithm.check(self._space, self._config, budget=simulations)
        self._start = None if start_from is None else start_of(start_from, lambda: self._space)
        self._state = self._started(seed, simulations)
        self._params = dict(params or {})
        self._flight: list[tuple[Candidate, ...]] = []
        self._told: dict[int, Scored | Failed] = {}
        self._results: dict[int, Scored | Failed] = {}
        self._seeds: dict[int, int] = {}

    def _started(self, seed: int, budget: int) -> Any:
        if self._start is None:
            return self._algorithm.start(self._space, self._config, seed=seed, budget=budget)
        if not isinstance(self._algorithm, WarmStarts):
            raise UnsupportedSpace(f"{self._id} cannot start from what is known already")
        known = known_from(self._start, self._space)
        return self._algorithm.start_with(self._space, self._config, seed=seed, budget=budget, known=known)

    @property
    def space(self) -> SearchSpace:
        """The search space."""
        return self._space

    @property
    def archive(self) -> Archive:
        """All trials with a verdict, of the generations that are complete."""
        archive: Archive = self._state.archive
        return archive

    @property
    def finished(self) -> bool:
        """Whether the budget is spent and all results have been told."""
        return not self._flight and self._algorithm.finished(self._state)

    @property
    def open(self) -> list[Trial]:
        """Trials that were asked for and not yet told."""
        return [
            self._trial(candidate)
            for generation in self._flight
            for candidate in generation
            if candidate.number not in self._told
        ]

    def ask(self) -> list[Trial]:
        """Return the next trials, which may be simulated in any order or at the same time.

        Returns:
            One generation; none once the study has finished.

        Raises:
            OrderError: The search has to be told results first; the message says of which trials.
        """
        if self.finished:
            return []
        if not self._can_ask():
            waiting = [trial.number for trial in self.open]
            shown = ", ".join(map(str, waiting[:5])) + (", …" if len(waiting) > 5 else "")
            raise OrderError(f"ask: tell the results of {len(waiting)} trials first: {shown}")
        self._state, candidates = self._algorithm.ask(self._state)
        if any(candidate.question is not Question.EPISODE for candidate in candidates):
            raise UnsupportedSpace(f"{self._id} measures on a data set, which a study cannot do")
        self._flight.append(candidates)
        for candidate in candidates:
            shared = candidate.number if candidate.seed_number is None else candidate.seed_number
            self._seeds[candidate.number] = episode_seed(self._seed, shared)
        return [self._trial(candidate) for candidate in candidates]

    def tell(
        self, trial: Trial | int, robustness: float | None, objectives: Mapping[str, float] | None = None
    ) -> None:
        """Tell the result of a trial.

        Args:
            trial: The trial, or its number.
            robustness: Distance to a violation, negative if the requirement is violated; None if the simulation
                failed, which is neither safe nor unsafe.
            objectives: Objectives to minimise, for algorithms with several.

        Raises:
            OrderError: The trial was not asked for, or has been told already.
            ValueError: The robustness is not a finite number.
        """
        number = trial if isinstance(trial, int) else trial.number
        asked = {candidate.number for generation in self._flight for candidate in generation}
        if number not in asked or number in self._told:
            raise OrderError(f"tell: trial {number} was not asked for, or has been told already")
        self._told[number] = self._results[number] = _evaluation(robustness, objectives)
        self._advance()

    def _can_ask(self) -> bool:
        if isinstance(self._algorithm, Overlapping):
            return self._algorithm.can_ask(self._state)
        return not self._flight and not self._algorithm.finished(self._state)

    def _advance(self) -> None:
        """Pass on the oldest generations while they are complete; an overlapping search is asked first."""
        while self._flight and all(candidate.number in self._told for candidate in self._flight[0]):
            if isinstance(self._algorithm, Overlapping) and self._algorithm.can_ask(self._state):
                return  # the contract: everything that may be asked for is asked for before anything is told
            generation = self._flight.pop(0)
            evaluations = {candidate.number: self._told.pop(candidate.number) for candidate in generation}
            self._state = self._algorithm.tell(self._state, evaluations)

    def to_pandas(self) -> "pd.DataFrame":
        """Return all trials with a verdict as a data frame; see `Result.to_pandas`."""
        return archive_frame(self.archive, self._space)

    def boundary(self, t_b: float = DEFAULT_T_B, d_th: float = DEFAULT_D_TH) -> "pd.DataFrame":
        """Return the distinct boundary solutions as a data frame, best first.

        Args:
            t_b: Maximum fitness of a boundary solution.
            d_th: Minimum distance between two of them.
        """
        frame = self.to_pandas()
        return frame.iloc[distinct_boundary(self.archive, t_b, d_th)].reset_index(drop=True)

    def pairs(self, eps: float = DEFAULT_EPS, d_th: float = DEFAULT_PAIRS_D_TH) -> "pd.DataFrame":
        """Return the distinct pairs across the boundary as a data frame, nearest first.

        Args:
            eps: Largest distance between the sides of a pair.
            d_th: Smallest distance between two distinct pairs.
        """
        seeds = np.array([self._seeds[number] for number in self.archive.numbers.tolist()], np.int64)
        found = find_pairs(self.archive, self._space, eps=eps, d_th=d_th, seeds=seeds)
        names = parameter_columns(self._space)
        rows = {int(number): place for place, number in enumerate(self.archive.numbers)}
        table = []
        for pair in found.pairs:
            row: dict[str, Any] = {"distance": pair.distance}
            for side, content in (("safe", pair.safe), ("unsafe", pair.unsafe)):
                place = rows[content.number]
                values = flat_values(self._space.decode(self._space.split(self.archive.vectors[place])))
                row[f"{side}.number"] = content.number
                row[f"{side}.robustness"] = float(self.archive.robustness[place])
                row |= {
                    f"{side}.{name}": values.get(name, values.get(name.rpartition(".")[2])) for name in names
                }
            table.append(row)
        kinds = zip(names, boundary_table.parameter_columns(self._space).values(), strict=True)
        of_a_side = {"number": int, "robustness": float, **dict(kinds)}
        sides = {f"{side}.{name}": kind for side in ("safe", "unsafe") for name, kind in of_a_side.items()}
        return typed_frame(table, {"distance": float, **sides})

    def save(self, path: str | Path) -> Path:
        """Write the study to a JSON file with every result that was told; `load` continues it."""
        target = Path(path)
        partial = target.with_name(f"{target.name}.partial")
        document = {
            "version": _VERSION,
            "space": self._space.describe(),
            "algorithm": self._id,
            "simulations": self._simulations,
            "seed": self._seed,
            "params": self._params,
            "start_from": None if self._start is None else self._start.model_dump(mode="json"),
            "results": [
                [number, *([None] if isinstance(one, Failed) else [one.robustness, dict(one.objectives)])]
                for number, one in sorted(self._results.items())
            ],
        }
        partial.write_text(json.dumps(document, allow_nan=False) + "\n", encoding="utf-8")
        return partial.replace(target)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the study that `save` wrote. The search is repeated with its results, which takes a moment.

        Raises:
            DocumentError: The file is not a study.
        """
        try:
            document = json.loads(read_text(path, _LARGEST_BYTES))
            if document["version"] != _VERSION:
                raise DocumentError(f"{path}: expected version {_VERSION}, got {document['version']!r}")
            study = cls(
                space_from(document["space"]),
                document["algorithm"],
                simulations=document["simulations"],
                seed=document["seed"],
                params=document["params"],
                start_from=document["start_from"],
            )
            study._repeat({number: rest for number, *rest in document["results"]})
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError, OrderError) as error:
            if isinstance(error, DocumentError):
                raise
            raise DocumentError(f"{path}: expected a saved study: {error}") from None
        return study

    def _repeat(self, results: Mapping[int, Sequence[Any]]) -> None:
        """Ask and tell as before, until no result is left."""
        left = dict(results)
        while left:
            for trial in self.open or self.ask():
                if trial.number in left:
                    self.tell(trial, *left.pop(trial.number))
            if left and all(trial.number not in left for trial in self.open) and not self._can_ask():
                raise OrderError(f"the results of {len(left)} trials do not belong to this search")

    def _trial(self, candidate: Candidate) -> Trial:
        return Trial(
            number=candidate.number,
            values=flat_values(self._space.decode(candidate.vectors)),
            seed=self._seeds[candidate.number],
        )


def _evaluation(robustness: float | None, objectives: Mapping[str, float] | None) -> Scored | Failed:
    if robustness is None:
        return Failed(reason="told so")
    value = float(robustness)
    if not math.isfinite(value):
        raise ValueError(f"expected a finite robustness, or None for a failed trial, got {robustness!r}")
    return Scored(unsafe=value < 0, robustness=value, objectives=dict(objectives or {}))
