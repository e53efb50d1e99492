"""Errors of the search package.

SearchError
├── SpaceError          a vector or a value does not fit the search space
├── ConfigError         a setting of an algorithm is out of range
├── UnsupportedSpace    the algorithm cannot work on that search space
├── OrderError          ask and tell were called out of order, or with the wrong candidates
├── DocumentError       a stored state is broken, or of a version that this code does not know
└── MissingExtra        an optional dependency is not installed
"""


class SearchError(Exception):
    """Root of everything that the search package raises on purpose."""


class SpaceError(SearchError, ValueError):
    """A vector or a value does not fit the search space."""


class ConfigError(SearchError, ValueError):
    """A setting of an algorithm is out of range.

    Attributes:
        field: Name of the setting.
        nearest: The valid value that is most like the one that came, if there is one.
    """

    def __init__(self, field: str, message: str, *, nearest: str | None = None) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field
        self.nearest = nearest


class UnsupportedSpace(SearchError, ValueError):
    """The algorithm cannot work on that search space."""


class OrderError(SearchError, RuntimeError):
    """`ask` and `tell` were called out of order, or with the wrong candidates."""


class DocumentError(SearchError, ValueError):
    """A stored state is broken, or of a version that this code does not know."""


class MissingExtra(SearchError):
    """An optional dependency is not installed."""


def install_command(extra: str) -> str:
    """Return the command that installs an optional part of Brink."""
    return f"pip install -c constraints.txt -e '.[{extra}]'"
