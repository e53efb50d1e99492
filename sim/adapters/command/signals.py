"""The signals of an episode as arrays over time: columns of a log that a program wrote, and formulas over these."""

import csv
import io
import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Final, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.formula import Formula, FormulaError
from brink.user_file import read_file

FloatArray: TypeAlias = NDArray[np.float64]
MAX_LOG_BYTES: Final = 64 * 1024**2
MAX_COLUMNS: Final = 64
EGO: Final = "ego"
FORMATS: Final = (".csv", ".jsonl", ".json")
_DERIVED: Final = ("columns", "positions")
_FIELDS: Final = ("file", "time", *_DERIVED)
_MAX_HEADER_LINES: Final = 50
_CALENDAR_S: Final = 1e8
"""A later first time is a time of day since 1970: the episode then begins at 0."""
_TRUTH: Final = {"true": "1", "false": "0"}


class SignalError(ValueError):
    """Signals are described wrongly, or a log lacks them; the message says what was expected and what came."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Signals:
    """Which signals a campaign derives from recorded columns.

    Attributes:
        columns: Formula of each signal that is not a column itself, over columns.
        positions: Of the ego and other vehicles: the signals x and y in m and, if it is logged, the heading in rad.
    """

    columns: Mapping[str, Formula]
    positions: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, document: object) -> "Signals":
        """Return what a campaign says about its signals.

        Raises:
            SignalError: It is malformed, or a formula does not parse.
        """
        if not isinstance(document, Mapping) or set(document) - set(_DERIVED):
            raise SignalError(f"expected an object with {', '.join(_DERIVED)}; got {document!r:.80}")
        columns = document.get("columns", {})
        if not isinstance(columns, Mapping) or len(columns) > MAX_COLUMNS:
            raise SignalError(
                f"columns: expected at most {MAX_COLUMNS} formulas by name, got {columns!r:.80}"
            )
        return cls(
            columns={str(key): _formula(key, text) for key, text in columns.items()},
            positions=_positions(document.get("positions", {})),
        )

    @property
    def named(self) -> tuple[str, ...]:
        """All signals that the campaign names."""
        return tuple(
            dict.fromkeys([*self.columns, *(one for names in self.positions.values() for one in names)])
        )

    def formulas(self, names: Iterable[str]) -> dict[str, Formula]:
        """Return the formula of each signal; that of a column is the column."""
        return {name: self.columns.get(name) or Formula(f"`{name}`") for name in names}


def needed_columns(formulas: Mapping[str, Formula]) -> list[str]:
    """Return the columns that formulas are over, each once."""
    return list(dict.fromkeys(name for formula in formulas.values() for name in formula.names))


def evaluated(
    formulas: Mapping[str, Formula], time_s: FloatArray, columns: Mapping[str, FloatArray], log: str
) -> dict[str, FloatArray]:
    """Return signals over time, shape ``(n,)`` each, all of them finite.

    Args:
        formulas: Their formulas.
        time_s: Times, shape ``(n,)``.
        columns: The columns that the formulas need, shape ``(n,)`` each.
        log: What they come from, for messages.

    Raises:
        SignalError: A value is no finite number.
    """
    signals = {}
    for name, formula in formulas.items():
        values = np.broadcast_to(np.asarray(formula.evaluate(columns), np.float64), time_s.shape)
        if not np.all(np.isfinite(values)):
            first = int(np.argmin(np.isfinite(values)))
            raise SignalError(
                f"{log}: expected numbers, but {name} is {values[first]} at {time_s[first]:g} s"
            )
        signals[name] = values
    return signals


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSource(Signals):
    """Where the signals of an episode stand.

    Attributes:
        file: Name of the log in the working folder: CSV with a header, JSON lines, or JSON.
        time: Its column with the time in s.
    """

    file: str
    time: str

    @classmethod
    def of(cls, document: object) -> Self:
        """Return what a campaign says about its signals.

        Raises:
            SignalError: It is malformed, or a formula does not parse.
        """
        if not isinstance(document, Mapping) or set(document) - set(_FIELDS) or "file" not in document:
            raise SignalError(f"expected an object with {', '.join(_FIELDS)}; got {document!r:.80}")
        name, time = document["file"], document.get("time", "time")
        parts = PurePosixPath(name) if isinstance(name, str) else PurePosixPath("/")
        if parts.is_absolute() or ".." in parts.parts or not str(name).isprintable():
            raise SignalError(f"file: expected a name inside the working folder, got {name!r:.80}")
        if parts.suffix.lower() not in FORMATS:
            raise SignalError(f"file: expected a name that ends with {', '.join(FORMATS)}; got {name!r:.80}")
        if not isinstance(time, str) or not time:
            raise SignalError(f"time: expected the name of a column, got {time!r:.80}")
        derived = Signals.of({key: document[key] for key in _DERIVED if key in document})
        return cls(file=str(name), time=time, columns=derived.columns, positions=derived.positions)

    def read(self, folder: Path, names: Iterable[str]) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return the times and some signals of an episode.

        Args:
            folder: Its working folder.
            names: The signals: names of formulas, or of columns of the log.

        Returns:
            Times in s, shape ``(n,)``, n >= 1, increasing; and each signal, shape ``(n,)``, finite.

        Raises:
            SignalError: The log is missing, empty or too large, lacks a column, or has a value that is no number.
        """
        formulas = self.formulas(names)
        raw = self._columns(folder, list(dict.fromkeys([self.time, *needed_columns(formulas)])))
        time_s = raw[self.time]
        if len(time_s) == 0:
            raise SignalError(f"{self.file} has no samples")
        if not np.all(np.isfinite(time_s)) or np.any(np.diff(time_s) <= 0):
            place = int(np.argmin(np.append(True, np.isfinite(np.diff(time_s)) & (np.diff(time_s) > 0))))
            raise SignalError(
                f"{self.file}: expected increasing times, got {time_s[place]} in sample {place + 1}"
            )
        if time_s[0] > _CALENDAR_S:
            time_s = time_s - time_s[0]
        return time_s, evaluated(formulas, time_s, raw, self.file)

    def _columns(self, folder: Path, names: Sequence[str]) -> dict[str, FloatArray]:
        path = folder / self.file
        try:
            if not path.resolve().is_relative_to(folder.resolve()):
                raise SignalError(f"{self.file}: expected a file in the working folder, not a link out of it")
            text = read_file(path, MAX_LOG_BYTES).decode()
        except FileNotFoundError:
            written = sorted(one.name for one in folder.iterdir())[:20]
            raise SignalError(
                f"no log {self.file} was written; the folder has {', '.join(written) or 'no files'}"
            ) from None
        except UnicodeDecodeError:
            raise SignalError(f"{self.file}: expected text in UTF-8, got a binary file") from None
        except OSError as error:
            raise SignalError(f"{self.file} cannot be read: {error.strerror}") from None
        if not text.strip():
            raise SignalError(f"{self.file} is empty")
        if self.file.lower().endswith(".csv"):
            return _from_csv(self.file, text, names)
        try:
            return _from_json(self.file, text, names, lines=self.file.lower().endswith(".jsonl"))
        except (ValueError, RecursionError) as error:
            if isinstance(error, SignalError):
                raise
            raise SignalError(f"{self.file}: not JSON: {error}") from None


def _positions(given: object) -> dict[str, tuple[str, ...]]:
    if isinstance(given, Mapping) and len(given) <= MAX_COLUMNS and (not given or EGO in given):
        named = {str(key): tuple(one) for key, one in given.items() if isinstance(one, list)}
        texts = all(isinstance(name, str) and name for one in named.values() for name in one)
        if len(named) == len(given) and texts and all(len(one) in (2, 3) for one in named.values()):
            return named
    raise SignalError(f"positions: expected signals such as {{ego: [x, y, heading]}}, got {given!r:.80}")


def _formula(name: object, text: object) -> Formula:
    try:
        formula = Formula(text if isinstance(text, str) else str(text))
    except FormulaError as error:
        raise SignalError(f"columns: {name}: {error}") from None
    if formula.is_condition:
        raise SignalError(f"columns: {name}: expected a number, got the condition {formula.text!r}")
    return formula


def _from_csv(file: str, text: str, names: Sequence[str]) -> dict[str, FloatArray]:
    stream = io.StringIO(text)
    for line in itertools.islice(stream, _MAX_HEADER_LINES):
        separator = max(",;\t", key=line.count)
        header = [one.strip() for one in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
        if names[0] in header:
            break
    else:
        raise _lacks(file, names[0], text.partition("\n")[0].split(separator))
    places = []
    for name in names:
        if name not in header:
            raise _lacks(file, name, header)
        places.append(header.index(name))
    reader = csv.reader(stream, delimiter=separator, skipinitialspace=True)
    try:
        rows = [[row[place] for place in places] for row in reader if row and any(row)]
    except (IndexError, csv.Error) as error:
        raise SignalError(f"{file}: expected {len(header)} values in each line: {error}") from None
    columns: list[Sequence[Any]] = list(zip(*rows, strict=True)) or [()] * len(names)
    return {name: _numbers(file, name, column) for name, column in zip(names, columns, strict=True)}


def _from_json(file: str, text: str, names: Sequence[str], *, lines: bool) -> dict[str, FloatArray]:
    content = [json.loads(line) for line in text.splitlines() if line.strip()] if lines else json.loads(text)
    if isinstance(content, list) and all(isinstance(row, Mapping) for row in content):
        known = list(content[0]) if content else []
        missing = [name for name in names if any(name not in row for row in content)]
        columns = {} if missing else {name: [row[name] for row in content] for name in names}
    elif isinstance(content, Mapping) and all(isinstance(column, list) for column in content.values()):
        known, columns = list(content), {name: content[name] for name in names if name in content}
        missing = [name for name in names if name not in content]
    else:
        raise SignalError(f"{file}: expected an object for each sample, or one with a list for each column")
    if missing:
        raise _lacks(file, missing[0], known)
    if len({len(column) for column in columns.values()}) > 1:
        raise SignalError(f"{file}: expected columns of equal length")
    return {name: _numbers(file, name, column) for name, column in columns.items()}


def _lacks(file: str, name: str, known: Sequence[object]) -> SignalError:
    return SignalError(f"{file} has no column {name!r}; it has {', '.join(map(str, known))[:400]}")


def _numbers(file: str, name: str, values: Sequence[Any]) -> FloatArray:
    try:
        return np.array(values, np.float64)
    except (ValueError, TypeError, OverflowError):
        pass
    numbers = []
    for place, value in enumerate(values):
        try:
            numbers.append(
                float(_TRUTH.get(value.strip().lower(), value) if isinstance(value, str) else value)
            )
        except (ValueError, TypeError, OverflowError):
            raise SignalError(
                f"{file}: {name}: expected a number, got {value!r:.40} in sample {place + 1}"
            ) from None
    return np.array(numbers)
