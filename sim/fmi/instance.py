"""Steps an FMU: loads its library into this process, sets values before it begins, and reads values after each step.

An FMU is native code. It may end or hang the process that calls it, and keep state between its instances.
"""

import ctypes
import zipfile
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from brink.sim.fmi.model import BOOLEAN, ENUMERATION, FmuError, Model, Variable

_LINES: Final = 8
_DISCARD: Final = 2
_FUNCTIONS: Final = {
    2: {"Real": "Real", "Integer": "Integer", BOOLEAN: BOOLEAN, ENUMERATION: "Integer"},
    3: {ENUMERATION: "Int64"},
}
"""Which functions read and write a type, where their names do not end with that of the type; by version of FMI."""
_TYPES: Final[Mapping[int, Mapping[str, Any]]] = {
    2: {"Real": ctypes.c_double, "Integer": ctypes.c_int, BOOLEAN: ctypes.c_int},
    3: {
        **{"Float64": ctypes.c_double, "Float32": ctypes.c_float, BOOLEAN: ctypes.c_bool},
        **{f"Int{bits}": getattr(ctypes, f"c_int{bits}") for bits in (8, 16, 32, 64)},
        **{f"UInt{bits}": getattr(ctypes, f"c_uint{bits}") for bits in (8, 16, 32, 64)},
    },
}


class FmuFailed(Exception):
    """An FMU reported an error; the message has what it logged last."""


class Instance:
    """An FMU in this process, for one simulation after another.

    Args:
        model: The FMU.
        folder: An empty folder to unpack it into, which must stay while it is used.

    Raises:
        FmuError: It cannot be unpacked or loaded.
    """

    def __init__(self, model: Model, folder: Path) -> None:
        import fmpy
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        self.model = model
        self._log: deque[str] = deque(maxlen=_LINES)
        self._is_new = True
        self._is_over = True
        try:
            fmpy.extract(str(model.path), str(folder))
            self._slave = (FMU2Slave if model.version == 2 else FMU3Slave)(
                guid=model.token,
                unzipDirectory=str(folder),
                modelIdentifier=model.identifier,
                instanceName="brink",
            )
        except (OSError, zipfile.BadZipFile) as error:
            raise FmuError(f"{model.path.name} cannot be unpacked: {error}") from None
        except AttributeError as error:
            raise FmuError(f"{model.path.name}: its library lacks a function of FMI: {error}") from None
        except Exception as error:  # noqa: BLE001  (FMPy raises plain exceptions)
            raise FmuError(f"{model.path.name} cannot be loaded: {error}") from None
        self._log_callback = self._callback()

    def start(self, values: Mapping[str, float], stop_s: float | None = None) -> None:
        """Begin a simulation at time 0.

        Args:
            values: Numbers by the names of variables that can be set; others keep their start values.
            stop_s: When it will end; None if that is open.

        Raises:
            FmuFailed: The FMU reported an error.
        """
        self.end()
        self._log.clear()
        variables = {name: self.model.settable(name) for name in values}
        inputs = {name for name, one in variables.items() if one.causality == "input"}
        try:
            if self._is_new:
                self._instantiate()
            else:
                self._slave.reset()
            self._is_new = self._is_over = False
            if self.model.version == 2:
                self._slave.setupExperiment(startTime=0.0, stopTime=stop_s)
            self.set({name: values[name] for name in values if name not in inputs})
            if self.model.version == 2:
                self._slave.enterInitializationMode()
            else:
                self._slave.enterInitializationMode(startTime=0.0, stopTime=stop_s)
            self.set({name: values[name] for name in inputs})
            self._slave.exitInitializationMode()
        except Exception as error:  # noqa: BLE001  (FMPy raises plain exceptions)
            raise self._failed(error, "before the first step") from None

    def set(self, values: Mapping[str, float]) -> None:
        """Set variables by name.

        Raises:
            FmuFailed: The FMU reported an error.
        """
        for function, names in self._by_function(list(values)).items():
            references = [self.model.variables[name].reference for name in names]
            try:
                getattr(self._slave, f"set{function}")(references, [values[name] for name in names])
            except Exception as error:  # noqa: BLE001  (FMPy raises plain exceptions)
                raise self._failed(error, f"setting {', '.join(names)}") from None

    def step(self, time_s: float, step_s: float) -> float | None:
        """Step from a time; return when the FMU asks to end, in s, or None if it goes on.

        Raises:
            FmuFailed: The FMU reported an error.
        """
        try:
            done = self._slave.doStep(currentCommunicationPoint=time_s, communicationStepSize=step_s)
            if self.model.version == 2 or not done[1]:
                return None
            reached_s = done[3]
        except Exception as error:  # noqa: BLE001  (FMPy raises plain exceptions)
            ended_s = self._ended_s(error)
            if ended_s is None:
                raise self._failed(error, f"in the step from {time_s:g} s") from None
            reached_s = ended_s
        return float(reached_s) if time_s <= reached_s <= time_s + step_s else time_s + step_s

    def _ended_s(self, error: Exception) -> float | None:
        """Return when an FMU of FMI 2 asked to end, which it says by a step that it discards; None if it did not."""
        from fmpy.fmi2 import fmi2LastSuccessfulTime, fmi2Terminated

        if self.model.version == 2 and getattr(error, "status", None) == _DISCARD:
            try:
                if self._slave.getBooleanStatus(fmi2Terminated):
                    return float(self._slave.getRealStatus(fmi2LastSuccessfulTime))
            except Exception:  # noqa: BLE001  (it need not answer)
                return None
        return None

    def reader(self, names: Sequence[str]) -> "Reader":
        """Return what reads some variables, in this order."""
        return Reader(self, names)

    def end(self) -> None:
        """End the simulation, if one has begun."""
        if self._is_over:
            return
        self._is_over = True
        try:
            self._slave.terminate()
            if not self.model.is_single:
                self._free()
        except Exception as error:  # noqa: BLE001  (FMPy raises plain exceptions)
            raise self._failed(error, "at the end") from None

    def _instantiate(self) -> None:
        if self.model.version == 2:
            self._slave.instantiate(callbacks=self._log_callback)
        else:
            self._slave.instantiate(logMessage=self._log_callback)

    def _free(self) -> None:
        # Without its library, which `freeInstance` of FMPy would unload.
        if self.model.version == 2:
            self._slave.fmi2FreeInstance(self._slave.component)
        else:
            self._slave.fmi3FreeInstance(self._slave.component)
        self._is_new = True

    def _callback(self) -> Any:
        from fmpy import calloc, free
        from fmpy.fmi2 import (
            fmi2CallbackAllocateMemoryTYPE,
            fmi2CallbackFreeMemoryTYPE,
            fmi2CallbackFunctions,
            fmi2CallbackLoggerTYPE,
        )
        from fmpy.logging import addLoggerProxy

        def keep(*arguments: Any) -> None:
            self._log.append((arguments[-1] or b"").decode(errors="replace").strip())

        if self.model.version == 3:
            return keep
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(keep)
        callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
        addLoggerProxy(ctypes.byref(callbacks))
        return callbacks

    def _failed(self, error: Exception, when: str) -> FmuFailed:
        """Return the error to raise; the instance is not used again."""
        self._is_over = True
        if isinstance(error, FmuFailed):
            return error
        lines = [f"{self.model.path.name}: {str(error).rstrip('.')} {when}", *self._log]
        return FmuFailed("\n".join(lines))

    def _by_function(self, names: Sequence[str]) -> dict[str, list[str]]:
        groups: dict[str, list[str]] = {}
        for name in names:
            groups.setdefault(self._function(self.model.variables[name]), []).append(name)
        return groups

    def _function(self, variable: Variable) -> str:
        return _FUNCTIONS[self.model.version].get(variable.kind, variable.kind)


class Reader:
    """Reads some variables of an FMU at once.

    Args:
        instance: The FMU.
        names: The variables.
    """

    def __init__(self, instance: Instance, names: Sequence[str]) -> None:
        self._instance = instance
        self._values = np.zeros(len(names))
        self._groups = []
        version = instance.model.version
        places = {name: place for place, name in enumerate(names)}
        for function, group in instance._by_function(names).items():
            references = (ctypes.c_uint * len(group))(
                *(instance.model.variables[one].reference for one in group)
            )
            buffer = (_TYPES[version][function] * len(group))()
            arguments = [references, len(group), buffer, *([len(group)] if version == 3 else [])]
            self._groups.append(
                (
                    getattr(instance._slave, f"fmi{version}Get{function}"),
                    arguments,
                    np.frombuffer(buffer, buffer._type_),
                    np.array([places[one] for one in group]),
                )
            )

    def read(self) -> NDArray[np.float64]:
        """Return the values now, shape ``(n,)``; the next call overwrites them.

        Raises:
            FmuFailed: The FMU reported an error.
        """
        try:
            for get, arguments, values, places in self._groups:
                get(self._instance._slave.component, *arguments)
                self._values[places] = values
        except Exception as error:  # noqa: BLE001  (FMPy raises plain exceptions)
            raise self._instance._failed(error, "reading its variables") from None
        return self._values
