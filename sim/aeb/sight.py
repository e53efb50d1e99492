"""The camera of the emergency brake: rendered, perturbed images, and a detector's boxes in them."""

import cv2

from brink.sim.aeb.braking import Region
from brink.sim.aeb.film import CameraShot, FilmRecorder
from brink.sim.aeb.labels import label_boxes
from brink.sim.aeb.scores import Scores, reported, score_episode
from brink.sim.aeb.street import StreetWorld
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import CONTROL_STEP_S, Box
from brink.sim.perception.boxes import Detections, GroundTruth
from brink.sim.perception.detector import Detector
from brink.sim.perturbations import Pipeline
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import Light, PictureCamera
from brink.sim.urban.camera import driving_boxes, viewpoint_of


class CameraSight:
    """Renders and perturbs each frame and runs a detector on it; keeps all ground truth and detections.

    Args:
        world: The world.
        light: Time of day and weather.
        size_px: Size of the images.
        camera: The driving system's camera, which defines the image of the returned boxes.
        seed: The episode's seed, for appearances.
        detector: The detector.
        threshold: Minimum score of a detection reported to the brake.
        pipeline: Perturbs the images.
        film: Records the images, if given.
    """

    def __init__(
        self,
        world: StreetWorld,
        light: Light,
        size_px: tuple[int, int],
        *,
        camera: Camera,
        seed: int,
        detector: Detector,
        threshold: float,
        pipeline: Pipeline,
        film: FilmRecorder | None = None,
    ) -> None:
        cv2.setNumThreads(1)
        self._world = world
        self._camera = camera
        self._picture = PictureCamera(width_px=size_px[0], height_px=size_px[1])
        self._renderer = Renderer(world.street.scene, light, self._picture, seed)
        self._pipeline = pipeline
        self._detector = detector
        self._threshold = threshold
        self._film = film
        self._truths: list[GroundTruth] = []
        self._found: list[Detections] = []

    def __call__(self, time_s: float) -> tuple[Box, ...]:
        """Return the detections that are reported to the brake, in the driving system's image."""
        ego, actors = self._world.ego, self._world.street.actors
        frame = round(time_s / CONTROL_STEP_S)
        picture = self._renderer.frame(viewpoint_of(ego), [actor.current_body() for actor in actors], time_s)
        truth = label_boxes(picture)
        shown = self._pipeline(picture.image, frame)
        found = self._detector.detect(shown)
        self._truths.append(truth)
        self._found.append(found)
        if self._film is not None:
            self._film.append(frame, CameraShot(shown, truth, found))
        passed = reported(found, self._threshold, *shown.shape[1::-1])
        return driving_boxes(found, passed, self._picture, self._camera)

    def scores(self) -> Scores:
        """Return the detector's scores over all frames so far."""
        region = Region.from_reference(self._picture.width_px, self._picture.height_px, warning=True)
        return score_episode(self._truths, self._found, self._threshold, region)
