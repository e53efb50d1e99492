"""Errors of the search package.

SearchError
├── SpaceError          a vector or a value does not fit the search space
│   ├── OddError        a limit of the operational design domain does not fit the search space
│   └── DistributionError  an operational distribution does not fit the search space
├── ConfigError         a setting of an algorithm is invalid
├── UnsupportedSpace    the algorithm does not support the search space
├── OrderError          ask and tell were called out of order, or with the wrong candidates
├── DocumentError       a stored document is corrupt, or not the expected one
│   └── OtherVersion    another version of the algorithm stored it
├── TooManyPairs        an archive holds more pairs than are looked at
├── BoundaryTooLarge    too many boundary solutions would have to be compared with each other
├── OutOfTime           a computation with a time limit took too long
└── MissingExtra        an optional dependency is not installed
"""


class SearchError(Exception):
    """Base class of all errors that the search package raises deliberately."""


class SpaceError(SearchError, ValueError):
    """A vector or a value does not fit the search space."""


class OddError(SpaceError):
    """A limit of the operational design domain does not fit the search space.

    Attributes:
        name: The parameter as it was named; None if several limits are to blame.
    """

    def __init__(self, name: str | None, message: str) -> None:
        super().__init__(message)
        self.name = name


class DistributionError(SpaceError):
    """An operational distribution does not fit the search space.

    Attributes:
        name: The entry of the distribution; None if several are to blame.
    """

    def __init__(self, name: str | None, message: str) -> None:
        super().__init__(message)
        self.name = name


class ConfigError(SearchError, ValueError):
    """A setting of an algorithm is invalid.

    Attributes:
        field: Name of the setting.
        nearest: The valid value closest to the given one, if there is one.
    """

    def __init__(self, field: str, message: str, *, nearest: str | None = None) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field
        self.nearest = nearest


class UnsupportedSpace(SearchError, ValueError):
    """The algorithm does not support the search space."""


class OrderError(SearchError, RuntimeError):
    """`ask` and `tell` were called out of order, or with the wrong candidates."""


class DocumentError(SearchError, ValueError):
    """A stored document is corrupt, or not the expected one."""


class OtherVersion(DocumentError):
    """Another version of the algorithm stored the document, and would continue from it differently."""


class TooManyPairs(SearchError):
    """An archive holds more pairs than can be analysed.

    Attributes:
        setting: Name of the setting to change, ``eps`` or ``d_th``.
    """

    def __init__(self, message: str, *, setting: str) -> None:
        self.setting = setting
        super().__init__(message)


class BoundaryTooLarge(SearchError):
    """Too many boundary solutions would have to be compared with each other to find the distinct ones."""


class OutOfTime(SearchError):
    """A computation with a time limit took too long."""


class MissingExtra(SearchError):
    """An optional dependency is not installed."""
