"""Problems whose candidates are described by nothing but the values of their parameters."""

from collections.abc import Collection, Mapping
from types import MappingProxyType

from brink.search.parameters import ABSENT, Categorical
from brink.search.shorthand import flat_values
from brink.server.problems.base import SimulatedProblem, SimulatedSolution, Vectors
from brink.server.problems.changes import instead
from brink.sim.episode import EpisodeSpec, Json


class PlainValues(SimulatedProblem):
    """A simulated problem that knows no more of its parameters than their names and units.

    Attributes:
        duration_s: Duration of an episode, > 0.
        options: Options of an episode.
    """

    duration_s: float
    options: Mapping[str, Json] = MappingProxyType({})

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode that evaluates a candidate."""
        return EpisodeSpec(
            simulator=self.needs,
            scenario={name: dict(part) for name, part in self.space.decode(tuple(vectors)).items()},
            behaviour={},
            requirements=self.requirements,
            seed=seed,
            duration_s=self.duration_s,
            options=self.options,
        )

    def words(self, vectors: Vectors) -> str:
        """Return the values of a candidate."""
        values = flat_values(self.space.decode(tuple(vectors)))
        return ", ".join(
            f"{name} {value:.4g} {self._unit(name)}".rstrip()
            if isinstance(value, float)
            else f"{name} {value}"
            for name, value in values.items()
        )

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Return the values that differ, the unsafe one last."""
        sides = [flat_values(self.space.decode(tuple(side.vectors))) for side in (safe, unsafe)]
        own_names = {name.rpartition(".")[2] for name in changed}
        return ", ".join(
            f"{name} {instead(sides[0].get(name, ABSENT), sides[1].get(name, ABSENT), self._unit(name))}"
            for name in sides[0] | sides[1]
            if name in own_names
        )

    def _unit(self, name: str) -> str:
        for component in self.space.components:
            for parameter in component.parameters:
                if parameter.name == name and not isinstance(parameter, Categorical) and parameter.unit:
                    return parameter.unit
        return ""
