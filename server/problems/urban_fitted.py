"""The problem `urban-fitted@1`: an urban scenario and a detector with errors fitted to a recording.

The scenario is that of `urban-camera@1`, so that the same drives can be driven by both. The errors are those that
`brink errors fit` wrote; they are part of the campaign. Each episode draws one replicate of the fit by its seed, so
that the results carry how uncertain the fit is. See docs/adr/0071.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from brink.search.errors import ConfigError
from brink.search.streams import Stream, generator
from brink.server.problems.requirements import Stated, requirement_setting
from brink.server.problems.urban_camera import UrbanScenarios
from brink.server.problems.urban_injected import REQUIREMENTS, UrbanParams
from brink.sim.episode import Json
from brink.sim.errors import InvalidEpisode
from brink.sim.urban.error_process import MODE, ErrorProcess, FittedErrors

SIMULATOR = "brink-drive-fitted@2"


@dataclass(frozen=True, slots=True, kw_only=True)
class UrbanFittedParams(UrbanParams):
    """Parameters of the problem."""

    requirement: Stated = requirement_setting(["front-gap@1", "no-collision@1"], REQUIREMENTS)  # noqa: RUF009
    errors: dict[str, Any] = field(
        default_factory=dict,
        metadata={"help": "The output of brink errors fit; without it, the detector makes no errors."},
    )

    def __post_init__(self) -> None:
        UrbanParams.__post_init__(self)
        self.fitted()

    def fitted(self) -> FittedErrors | None:
        """Return the fit; None if there is none.

        Raises:
            ConfigError: It is not what `brink errors fit` writes.
        """
        if not self.errors:
            return None
        try:
            return FittedErrors.from_document("errors", self.errors)
        except InvalidEpisode as error:
            raise ConfigError("errors", str(error)) from None


class UrbanFitted(UrbanScenarios):
    """Urban driving with an obstacle detector whose errors are fitted to a recording."""

    id: ClassVar[str] = "urban-fitted@1"
    summary: ClassVar[str] = "Urban driving with the errors of a recorded detector: 7 parameters."
    params_type: ClassVar[type[Any]] = UrbanFittedParams
    about_component = (
        "The detector's errors are random, as frequent and as long as in its recording at the same distances, "
        "whatever the road user and wherever it is."
    )
    simulator: ClassVar[str] = SIMULATOR
    params: UrbanFittedParams

    def __init__(self, params: UrbanFittedParams) -> None:
        super().__init__(params)
        fitted = params.fitted()
        self.measured_detector = "the truth" if fitted is None else fitted.detector
        processes = (ErrorProcess.perfect(),) if fitted is None else fitted.replicates or (fitted.process,)
        self._processes: list[list[Json]] = [process.to_json() for process in processes]

    def replicate(self, seed: int) -> int:
        """Return the number of the replicate that the episode with a seed draws."""
        return int(generator(seed, Stream.ERRORS).integers(len(self._processes)))

    def behaviour(self, seed: int) -> Mapping[str, Json]:
        """Return the process from which an episode draws errors."""
        number = self.replicate(seed)
        return {"mode": MODE, "replicate": number, "process": self._processes[number]}
