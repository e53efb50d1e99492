"""Language models as a source of seeds: the plug-in of `brink.server.seeding`.

What makes calls is loaded when a coordinator starts, not when a campaign file is read.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from brink.server.errors import InvalidInput
from brink.server.llm.access import LlmAccess
from brink.server.llm.settings import LlmSettings
from brink.server.seeding import Seeder

if TYPE_CHECKING:
    from brink.server.db.engine import Engines
    from brink.server.db.writer import Writer
    from brink.server.llm.seeds import LlmSeeds
    from brink.server.problems.base import Problem

NAME: Final = "llm"
"""Value of the algorithm parameter `seeder` that requests seeds from a language model."""
EXPECTED: Final = "expected a language model, such as {endpoint: http://127.0.0.1:8000/v1, model: ...}"


class LanguageModels:
    """Implements `Seeder`."""

    settings_type = LlmSettings

    def check(
        self, settings: LlmSettings | None, config: object, algorithm_id: str, problem: "Problem"
    ) -> None:
        """Check that a language model is configured if and only if the algorithm requests seeds from one."""
        from brink.server.problems.base import SupportsSeeds

        uses_model = getattr(config, "seeder", None) == NAME
        if uses_model and settings is None:
            raise InvalidInput.at("/llm", EXPECTED)
        if settings is not None and not uses_model:
            message = (
                f"{algorithm_id} does not use a language model; expected algorithm.params.seeder: {NAME}"
            )
            raise InvalidInput.at("/llm", message)
        if uses_model and not isinstance(problem, SupportsSeeds):
            raise InvalidInput.at("/problem/id", f"{problem.id} cannot be described to a language model")

    def access(self, allowed: str) -> LlmAccess:
        """Return what the setting ``BRINK_LLM_ENDPOINTS`` allows."""
        return LlmAccess.parse(allowed)

    def source(
        self, engines: "Engines", writer: "Writer", on_seeds: Callable[[str], None], access: LlmAccess
    ) -> "LlmSeeds":
        """Return what asks language models on behalf of a coordinator's campaigns."""
        from brink.server.llm.seeds import LlmSeeds

        return LlmSeeds(engines, writer, on_seeds, access)


SEEDER: Final[Seeder] = LanguageModels()
