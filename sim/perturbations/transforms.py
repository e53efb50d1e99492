"""Which function applies which gene of the catalogue. Importing this loads OpenCV; reading the catalogue does not."""

from collections.abc import Mapping
from types import MappingProxyType

from brink.sim.perturbations.droplets import condensation
from brink.sim.perturbations.dropout import channel_dropout, coarse_dropout, grid_dropout
from brink.sim.perturbations.flare import sun_flare
from brink.sim.perturbations.gene import Transform
from brink.sim.perturbations.lens import broken_lens, dirty
from brink.sim.perturbations.pixels import gaussian_blur, gaussian_noise, shifted_pixels
from brink.sim.perturbations.smoke import smoke
from brink.sim.perturbations.tone import brightness, contrast
from brink.sim.perturbations.weather import rain, snow

TRANSFORMS: Mapping[str, Transform] = MappingProxyType(
    {
        "shifted_pixels": shifted_pixels,
        "gaussian_noise": gaussian_noise,
        "gaussian_blur": gaussian_blur,
        "grid_dropout": grid_dropout,
        "coarse_dropout": coarse_dropout,
        "channel_dropout": channel_dropout,
        "snow": snow,
        "broken_lens": broken_lens,
        "dirty": dirty,
        "condensation": condensation,
        "sun_flare": sun_flare,
        "brightness": brightness,
        "contrast": contrast,
        "rain": rain,
        "smoke": smoke,
    }
)
