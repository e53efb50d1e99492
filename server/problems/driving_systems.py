"""Parameters of all problems in which a driving system of users may take the place of Brink's own."""

from collections.abc import Mapping
from dataclasses import field
from typing import Any

from brink.search.errors import ConfigError
from brink.search.settings import setting
from brink.sim.driving_systems.command import install_read
from brink.sim.driving_systems.option import OWN, DrivingOption, factory_of, wrong_settings
from brink.sim.episode import Json
from brink.sim.errors import InvalidEpisode


def driving_setting() -> Any:
    """Return the field ``driving`` of a problem's parameters, annotated ``str``."""
    return setting(
        OWN,
        help="Driving system: its id, MODULE:CLASS of a plug-in module, or command:FILE; by default Brink's own.",
    )


def driving_settings_setting() -> Any:
    """Return the field ``driving_settings`` of a problem's parameters, annotated ``dict[str, Any]``."""
    return field(default_factory=dict, metadata={"help": "Settings that the driving system gets."})


def check_driving_settings(settings: Mapping[str, Any], driving: str) -> None:
    """Check the settings of a driving system.

    Raises:
        ConfigError: They are not JSON, or there are some for Brink's own, which has none.
    """
    if (why := wrong_settings(settings)) is not None:
        raise ConfigError("driving_settings", why)
    if settings and driving == OWN:
        raise ConfigError("driving_settings", f"expected a driving system other than {OWN}, which has none")


def driving_options(driving: str, settings: Mapping[str, Any]) -> dict[str, Json]:
    """Return the options that an episode has because of its driving system; none for Brink's own."""
    return DrivingOption(system=driving, settings=settings).to_options()


def drives_itself(params: Mapping[str, Any]) -> bool:
    """Return whether Brink's own driving system drives with these parameters of a problem, or nobody drives."""
    return bool(params.get("driving", OWN) == OWN)


def users_part(params: Mapping[str, Any]) -> str:
    """Return what of a user runs in every simulation: a driving system, a program or an FMU; empty if nothing does.

    Args:
        params: Parameters of a problem.
    """
    if not drives_itself(params):
        return str(params["driving"])
    command = params.get("command")
    if isinstance(command, list) and command:
        return str(command[0])
    return str(params.get("fmu", "")).partition("@")[0]


def driving_params(params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters that give another problem the same driving system; none for Brink's own.

    Args:
        params: Parameters of a problem, which may not be driven at all.
    """
    if drives_itself(params):
        return {}
    return {name: params[name] for name in ("driving", "driving_settings") if params.get(name)}


def about_driving(driving: str) -> str:
    """Return what findings say of a driving system that is not Brink's own: a sentence, or nothing."""
    if driving == OWN:
        return ""
    return (
        f" {driving} drove. If it gets objects, Brink's localiser and tracker make them of the boxes, and are "
        "part of what was tested."
    )


class Driven:
    """What problems share in which a driving system of users may take the place of Brink's own."""

    params: Any

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return what is wrong with the name of the driving system. None of its code runs here."""
        try:
            factory_of(self.params.driving, "driving")
        except InvalidEpisode as error:
            return [("driving", str(error).removeprefix("driving: "))]
        return []

    def install(self) -> None:
        """Allow the workers of this machine to run the driving system, if it is a program of the campaign file."""
        install_read(self.params.driving)
