"""Lenses: the directions in which the pixels of a picture look."""

import dataclasses
import math
from typing import Literal

import numpy as np

from carpark_mj.config.checks import CheckedConfig, require_count, require_finite

Projection = Literal["pinhole", "fisheye"]


@dataclasses.dataclass(frozen=True)
class Lens(CheckedConfig):
    """A lens whose picture is round about its axis.

    A ray at an angle to the axis falls at a radius of g (1 + k1 g² + k2 g⁴ + ...); g is
    the angle of an equidistant fisheye (Kannala and Brandt 2006), the tangent of a
    pinhole camera (Brown 1971).

    Attributes:
        projection: which of the two.
        fov: angle that the width of the picture spans [rad].
        distortion: k1, k2...; none by default.
    """

    projection: Projection = "pinhole"
    fov: float = math.radians(90.0)
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite(self, "fov")
        most = 180.0 if self.projection == "pinhole" else 360.0
        degrees = math.degrees(self.fov)
        if not 0.0 < degrees <= most or degrees == 180.0 == most:
            raise ValueError(
                f"fov of a {self.projection} camera must be more than 0 and "
                f"{'less than' if most == 180.0 else 'at most'} {most:g} degrees, not "
                f"{degrees:g}: its unit is rad"
            )
        if not all(map(math.isfinite, self.distortion)):
            raise ValueError(f"distortion must be finite, not {self.distortion}")

    def radius(self, angle: np.ndarray) -> np.ndarray:
        """Radii in the picture of rays at angles to the axis [rad], no unit."""
        g = np.tan(angle) if self.projection == "pinhole" else np.asarray(angle)
        terms = (k * g ** (2 * n) for n, k in enumerate(self.distortion, start=1))
        return g * (1.0 + sum(terms, np.zeros_like(g)))

    def directions(self, width: int, height: int) -> np.ndarray:
        """Unit vectors (height, width, 3) of the pixels' middles, rows from the top.

        In the frame of the camera: x along the axis, y left, z up.

        Raises:
            ValueError: no pixels, or the lens has no ray for some of them.
        """
        require_count("width", width, 1)
        require_count("height", height, 1)
        scale = float(self.radius(np.array(self.fov / 2))) / (width / 2)
        left = width / 2 - 0.5 - np.arange(width)
        up = height / 2 - 0.5 - np.arange(height)
        left, up = (scale * x for x in np.meshgrid(left, up))
        radius = np.hypot(left, up)
        angle = self._angle(radius, width, height)
        aside = np.sin(angle) / np.where(radius > 0.0, radius, 1.0)
        return np.stack([np.cos(angle), aside * left, aside * up], axis=-1)

    def _angle(self, radius: np.ndarray, width: int, height: int) -> np.ndarray:
        """Angles [rad] to the axis of rays that fall at radii; inverts `radius`."""
        most = math.pi / 2 - 1e-6 if self.projection == "pinhole" else math.pi
        angles = np.linspace(0.0, most, 4096)
        radii = self.radius(angles)
        rising = np.append(np.diff(radii) > 0.0, True)
        known = len(radii) if rising.all() else int(np.argmin(rising)) + 1
        if radius.max() > radii[known - 1]:
            degrees = 2.0 * math.degrees(angles[known - 1])
            raise ValueError(
                f"fov {math.degrees(self.fov):g} degrees over {width} pixels and "
                f"{height} of height reaches beyond {degrees:.0f} degrees in the "
                "corners, where the lens shows nothing: choose a smaller one"
            )
        low, high = np.zeros_like(radius), np.full_like(radius, angles[known - 1])
        for _ in range(60):
            middle = (low + high) / 2
            below = self.radius(middle) < radius
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return (low + high) / 2
