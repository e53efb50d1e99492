"""Resolves the parameters and choices that the settings of `tolerance@1` name."""

from collections.abc import Sequence

from brink.search.errors import ConfigError, SpaceError
from brink.search.parameters import Categorical, did_you_mean
from brink.search.space import SearchSpace


class Names:
    """Finds the parameters, and the codes of the choices, that settings name.

    Attributes:
        columns: Names of the space's columns.
        parameters: Their parameters.
    """

    def __init__(self, space: SearchSpace) -> None:
        self.columns = space.column_names()
        self.parameters = space.parameters

    def column(self, setting_name: str, name: str) -> int:
        """Return the column of a parameter, given its name or the last parts of it."""
        matching = [
            place
            for place, column in enumerate(self.columns)
            if column == name or column.endswith("." + name)
        ]
        exact = [place for place in matching if self.columns[place] == name]
        matching = exact or matching
        if len(matching) == 1:
            return matching[0]
        if not matching:
            short = {column.split(".", 1)[-1] for column in self.columns}
            raise ConfigError(
                setting_name, f"unknown parameter {name!r}{did_you_mean(name, [*self.columns, *short])}"
            )
        meant = ", ".join(self.columns[place] for place in matching)
        raise ConfigError(setting_name, f"{name!r} may be any of {meant}: expected one of these")

    def value(self, setting_name: str, name: str, value: str | float) -> float:
        """Return the code of a parameter's value."""
        parameter = self.parameters[self.column(setting_name, name)]
        try:
            return parameter.encode(value)
        except SpaceError as error:
            raise ConfigError(setting_name, str(error)) from None

    def codes(self, setting_name: str, column: int, name: str, choices: Sequence[str]) -> tuple[float, ...]:
        """Return the codes of a categorical parameter's choices."""
        if not isinstance(self.parameters[column], Categorical):
            raise ConfigError(setting_name, f"expected a parameter with choices, got {name}")
        if not choices or len(set(choices)) < len(choices):
            raise ConfigError(setting_name, f"{name}: expected one or more distinct choices, got {choices!r}")
        return tuple(self.value(setting_name, name, choice) for choice in choices)
