"""What the API answers of an episode: its trace in columns, rounded, ready to be drawn.

What is not there at a sample, and what has no bound, is null. Positions are rounded to 1 mm, angles to 0.0001 rad,
boxes to a tenth of a pixel.
"""

from typing import Annotated, TypeAlias

from pydantic import Field

from brink.server.api.schemas import View

Column: TypeAlias = list[float | None]
Point: TypeAlias = tuple[float, float]


class EgoView(View):
    """The ego at each sample."""

    x_m: Column
    y_m: Column
    yaw_rad: Column
    speed_mps: Column
    accel_mps2: Column
    length_m: float
    width_m: float


class ActorView(View):
    """Another road user at each sample; null where it is not there."""

    name: str
    kind: Annotated[str, Field(description="vehicle or pedestrian.")]
    length_m: float
    width_m: float
    x_m: Column
    y_m: Column
    yaw_rad: Column
    speed_mps: Column


class SurfaceView(View):
    """A flat polygon or line of the scene; they are drawn in the given order."""

    kind: str
    closed: Annotated[bool, Field(description="Whether it is an area; otherwise a line of `width_m`.")]
    width_m: float
    points: Annotated[list[Point], Field(description="In metres.")]


class RowsView(View):
    """Rows that belong to samples, any number a sample, in columns."""

    first: Annotated[
        list[int], Field(description="Where each sample's rows begin, and after the last where they end.")
    ]
    columns: Annotated[dict[str, Column], Field(description="By name; label is 0 vehicle, 1 person.")]


class PictureCamera(View):
    """The camera whose pixels the boxes `seen` and `given` are in. It looks along the ego's yaw."""

    width_px: int
    height_px: int
    focal_px: float
    centre_x_px: float
    horizon_px: float
    height_m: Annotated[float, Field(description="Above the ground.")]
    forward_m: Annotated[float, Field(description="Ahead of the ego's centre.")]


class FilmView(View):
    """What a camera in the loop saw. Its boxes are in pixels of its own pictures."""

    size_px: tuple[int, int]
    samples: Annotated[list[int], Field(description="Of which sample each picture is, ascending.")]
    judged: Annotated[
        RowsView, Field(description="What is there; ignored is 1 where nobody is judged by it.")
    ]
    found: Annotated[RowsView, Field(description="All that was detected with a score of at least 0.1.")]
    threshold: Annotated[float, Field(description="Least score of a detection that counted.")]
    regions: Annotated[dict[str, list[Point]], Field(description="Areas of the picture that decide.")]


class EventView(View):
    """Something worth a word at a time."""

    time_s: float
    kind: str
    text: str


class StoryView(View):
    """What the episode is about."""

    requirement: str
    violated: bool
    decisive: Annotated[int, Field(description="Sample of the first violation, or of the least robustness.")]


class EpisodeWords(View):
    """The episode in words."""

    scenario: str
    perturbations: Annotated[str, Field(description="Of the camera's pictures; empty without any.")]
    report: Annotated[
        str, Field(description="What the given boxes are: injected, detected, or seen as they are.")
    ]


class EpisodeView(View):
    """An episode, sampled."""

    time_s: list[float]
    ego: EgoView
    route: Annotated[list[Point], Field(description="Centre line of the ego's lane.")]
    actors: list[ActorView]
    scene: list[SurfaceView]
    seen: Annotated[RowsView, Field(description="What was in the picture: the component's input.")]
    given: Annotated[RowsView, Field(description="What the driving system was told is there.")]
    perceived: Annotated[RowsView, Field(description="What the driving system holds to be there.")]
    plan_mode: list[str]
    target_speed_mps: Column
    lights: Annotated[list[str], Field(description="State of the ego's traffic light; empty without one.")]
    robustness: Annotated[dict[str, Column], Field(description="Over time, by requirement.")]
    units: Annotated[dict[str, str], Field(description="By requirement; empty where unknown.")]
    events: list[EventView]
    story: StoryView | None
    words: EpisodeWords
    camera: PictureCamera
    film: FilmView | None
