"""An FMU as the longitudinal controller of a driving system: FMI 2 or 3, co-simulation.

    command: [python3, -m, brink.sim.driving_systems.fmu, acc.fmu, acc-variables.yaml]

The program speaks brink-driving/1 (docs/reference/driving-protocol.md), so an FMU runs under the rule of all
programs: workers run it only where somebody installed it, and a crash ends this process alone. Steering is Brink's
own. The second file says which variable of the FMU is what:

    inputs: {gap_m: gap, relative_speed_mps: dv, ego_speed_mps: v, set_speed_mps: v_set}
    output: {accel_mps2: a}          # or {brake_mps2: b}: braking alone, Brink's own drives otherwise
    parameters: {headway: 1.2}       # start values
    free_gap_m: 200                  # what gap_m is with nobody ahead

`gap_m` is the distance from the ego's front to the rear of the nearest object in its way.
"""

import json
import os
import socket
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from brink.sim.fmi import FmuError, FmuFailed, Instance, read_model
from brink.sim.programs.working_folder import working_folder

INPUTS: Final = ("gap_m", "relative_speed_mps", "ego_speed_mps", "set_speed_mps")
OUTPUTS: Final = ("accel_mps2", "brake_mps2")
FREE_GAP_M: Final = 200.0
MARGIN_M: Final = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Variables:
    """Which variable of an FMU is what.

    Attributes:
        inputs: Names of variables by `INPUTS`.
        output: One of `OUTPUTS`, and the name of its variable.
        parameters: Start values by the names of variables.
        free_gap_m: The gap with nobody ahead.
    """

    inputs: Mapping[str, str]
    output: tuple[str, str]
    parameters: Mapping[str, object]
    free_gap_m: float = FREE_GAP_M

    @classmethod
    def of(cls, path: Path) -> "Variables":
        """Read the file.

        Raises:
            FmuError: It says something else.
        """
        import yaml  # only for those who use it

        document = yaml.safe_load(path.read_text(encoding="utf-8"))
        names = ("inputs", "output", "parameters", "free_gap_m")
        if not isinstance(document, dict) or set(document) - set(names):
            raise FmuError(f"{path}: expected {', '.join(names)}; got {document!r:.120}")
        inputs, output = document.get("inputs", {}), document.get("output", {})
        if not isinstance(inputs, dict) or not inputs or set(inputs) - set(INPUTS):
            raise FmuError(f"{path}: inputs: expected some of {', '.join(INPUTS)}; got {inputs!r:.120}")
        if not isinstance(output, dict) or len(output) != 1 or set(output) - set(OUTPUTS):
            raise FmuError(f"{path}: output: expected one of {', '.join(OUTPUTS)}; got {output!r:.120}")
        return cls(
            inputs=inputs,
            output=next(iter(output.items())),
            parameters=document.get("parameters", {}),
            free_gap_m=float(document.get("free_gap_m", FREE_GAP_M)),
        )


class Fmu:
    """A co-simulation FMU with mapped variables.

    Args:
        path: The FMU.
        variables: Its variables.
        folder: An empty folder to unpack it into.

    Raises:
        FmuError: It has no co-simulation, is for another platform, or lacks a variable.
    """

    def __init__(self, path: Path, variables: Variables, folder: Path) -> None:
        model = read_model(path)
        _, output = variables.output
        for name in (*variables.inputs.values(), output):
            if not model.variable(name).is_real:
                raise FmuError(f"{path.name}: expected a real number; {name} is {model.variable(name).kind}")
        self._start_values = {
            name: model.settable(name).number(value) for name, value in variables.parameters.items()
        }
        self._inputs = variables.inputs
        self._instance = Instance(model, folder)
        self._reader = self._instance.reader([output])
        self._time_s = 0.0

    def start(self) -> None:
        """Begin a drive at time 0."""
        self._instance.start(self._start_values)
        self._time_s = 0.0

    def step(self, inputs: Mapping[str, float], step_s: float) -> float:
        """Return the output after a step of the FMU.

        Raises:
            FmuFailed: It reported an error, or asked to end.
        """
        self._instance.set({name: inputs[kind] for kind, name in self._inputs.items()})
        if (ended_s := self._instance.step(self._time_s, step_s)) is not None:
            raise FmuFailed(f"the FMU asked to end at {ended_s:g} s")
        self._time_s += step_s
        return float(self._reader.read()[0])


def leader(step: Mapping[str, Any], start: Mapping[str, Any], free_gap_m: float) -> tuple[float, float]:
    """Return the gap to the nearest object in the ego's way, and its speed relative to the ego's."""
    car, speed_mps = start["car"], step["ego"]["speed_mps"]
    gaps = [
        (one["x_m"] - 0.5 * (one["length_m"] + car["length_m"]), one["vx_mps"] - speed_mps)
        for one in step["objects"]
        if one["x_m"] > 0 and abs(one["y_m"]) < 0.5 * (one["width_m"] + car["width_m"]) + MARGIN_M
    ]
    return min(gaps, default=(free_gap_m, 0.0))


def main() -> None:
    """Answer Brink's messages."""
    path = Path(sys.argv[1])
    try:
        variables = Variables.of(Path(sys.argv[2]))
        with working_folder() as (folder, _):
            drive(Fmu(path, variables, folder / "unpacked"), path.stem, variables)
    except (FmuError, FmuFailed) as error:
        sys.exit(str(error))


def drive(fmu: Fmu, name: str, variables: Variables) -> None:
    """Answer Brink's messages with an FMU until Brink closes the socket."""
    channel = socket.socket(fileno=int(os.environ["BRINK_DRIVING_FD"])).makefile("rwb", buffering=1 << 16)

    def say(kind: str, content: object) -> None:
        channel.write(json.dumps({kind: content}).encode() + b"\n")
        channel.flush()

    say("hello", {"protocol": "brink-driving/1", "name": name, "version": "1", "needs": "objects"})
    start: Mapping[str, Any] = {}
    ahead = (variables.free_gap_m, 0.0)
    for line in channel:
        message = json.loads(line)
        if "start" in message:
            start, ahead = message["start"], (variables.free_gap_m, 0.0)
            fmu.start()
            say("ready", {})
        elif "step" in message:
            step = message["step"]
            if step["objects"] is not None:
                ahead = leader(step, start, variables.free_gap_m)
            inputs = dict(
                zip(
                    INPUTS, (*ahead, step["ego"]["speed_mps"], start["route"]["speed_limit_mps"]), strict=True
                )
            )
            value = fmu.step(inputs, start["control_s"])
            kind, _ = variables.output
            if kind == "accel_mps2":
                say("decision", {"accel_mps2": value})
            else:
                say("decision", {"accel_mps2": -value, "emergency": True} if value > 0 else {})


if __name__ == "__main__":
    main()
