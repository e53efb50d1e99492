"""Which function applies which gene of the catalogue. Importing this loads OpenCV; reading the catalogue does not."""

from collections.abc import Mapping
from types import MappingProxyType

from sim.perturbations.droplets import condensation
from sim.perturbations.dropout import channel_dropout, coarse_dropout, grid_dropout
from sim.perturbations.flare import sun_flare
from sim.perturbations.gene import Transform
from sim.perturbations.lens import broken_lens, dirty
from sim.perturbations.pixels import gaussian_blur, gaussian_noise, shifted_pixels
from sim.perturbations.smoke import smoke
from sim.perturbations.tone import brightness, contrast
from sim.perturbations.weather import rain, snow

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
