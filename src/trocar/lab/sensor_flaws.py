"""Flaws of a structured-light RGBD camera, each with its size."""

from __future__ import annotations

from dataclasses import dataclass, replace

from trocar.checks import require_numbers


@dataclass(frozen=True)
class SensorFlaws:
    """Magnitudes of the flaws; zero switches one off.

    Sizes follow the authors' Zivid One+ S: sphere distances differ by .32 mm RMS (`fiducials/sphere_distances`), the
    real capture of a block leaves .38 mm median, .76 mm RMS to its model (`blocks/capture`), with texture of layers.

    Attributes:
        axial_m: SD of white noise of depth at ``reference_m``, seen face on; grows with depth squared and 1/cos.
        waviness_m: SD of smooth noise of depth, as projected fringes cause it.
        waviness_px: its correlation length.
        reference_m: distance at which ``axial_m`` holds.
        grazing_cos: below this cosine of incidence, pixels go missing ever more often.
        missing: share of pixels missing anywhere.
        shadow: pixels that the projector does not light have no depth and little colour.
        edge_missing: share of pixels beside a jump of depth that go missing.
        edge_mixed: share of them that land between the two surfaces.
        specular_missing: share of pixels lost where bare metal mirrors the projector into the lens.
        color_sd: SD of colour noise in grey levels of 255, the same in all three channels.
    """

    axial_m: float = 0.15e-3
    waviness_m: float = 0.10e-3
    waviness_px: float = 6.0
    reference_m: float = 0.6
    grazing_cos: float = 0.22
    missing: float = 0.005
    shadow: bool = True
    edge_missing: float = 0.35
    edge_mixed: float = 0.25
    specular_missing: float = 0.9
    color_sd: float = 2.5

    def __post_init__(self) -> None:
        require_numbers(self)

    def with_depth(self, scale: float) -> SensorFlaws:
        """Return a sensor whose depth scatters more by this factor."""
        return replace(self, axial_m=scale * self.axial_m, waviness_m=scale * self.waviness_m)

    @staticmethod
    def none() -> SensorFlaws:
        """Return the perfect sensor: exact depth everywhere, noiseless colour, light without shadow."""
        return SensorFlaws(
            axial_m=0.0,
            waviness_m=0.0,
            grazing_cos=0.0,
            missing=0.0,
            shadow=False,
            edge_missing=0.0,
            edge_mixed=0.0,
            specular_missing=0.0,
            color_sd=0.0,
        )
