"""Where the screen is in the pictures of a session: shift, scale and radial term from the spots of fibres and reference, the mirror direction
and the focal length from a target with spots in known directions.

A touched camera or a warming bench shifts the picture by a fraction of a pixel; 0.05 degree are seven percent on the flank of a narrow lobe.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from brdfpipe import specular_directions
from brdfpipe.geometry import Array
from brdfpipe.rig import screen as screens
from brdfpipe.rig.description import Rig, Screen

DIRECTION_U = 0.1
"""Standard uncertainty [degree], along either axis, of the direction of the disc's centre without a target."""

SCALE_U = 0.01
"""Relative standard uncertainty of angles on the disc without a target: at its rim of 10 degree as large as that of its centre."""

FIBRES_ENOUGH = 12
"""Spots that are enough to fit scale and radial term besides the shift."""

_DISTORTION_U = 0.2  # standard uncertainty of a shift [pixel] fitted to few spots, with the described lens
_POSITION_U = 0.5  # standard uncertainty of the picture's position [pixel] without any spot
_FEWEST_TARGET_SPOTS = 3
SEARCH = 4
"""Largest distance of a spot from its expected position [pixel]."""

_SPOT_SNR = 25.0  # smallest ratio of a usable spot's light to its uncertainty
_SENSOR_U = 0.02  # standard deviation [pixel] that the sensor's uneven response adds to a centroid
_ROUNDS = 3
_RIM = 4.0  # distance from the rim of the disc within which its light is not even [pixel]
_LEAST_FALLOFF = 0.05  # lower limit of the lens's relative light


@dataclass(frozen=True)
class Registration:
    """Where the screen is in the pictures, and how well that is known."""

    screen: Screen
    shift_u: float  # standard uncertainty of a cell's position in the picture, along either axis [pixel]
    direction_u: float  # standard uncertainty of the direction of the disc's centre, along either axis [degree]
    spots: int  # spots used
    scale_u: float = SCALE_U  # relative standard uncertainty common to all angles on the disc: of the focal length
    blur: float = 0.0  # standard deviation of the core of the camera's point spread, from the spots [pixel]

    def shift(self, rig: Rig) -> tuple[float, float]:
        """Of the screen's origin against the description (column, row) [pixel]."""
        return self.screen.centre[0] - rig.screen.centre[0], self.screen.centre[1] - rig.screen.centre[1]


@dataclass(frozen=True)
class Centroids:
    """Centroids of spots (spot,)."""

    column: Array
    row: Array
    u: Array  # standard uncertainty along either axis [pixel]; infinite for an unclear spot
    variance: Array  # mean square distance of the light from the centroid along either axis [pixel²]


def centroids(picture: Array, variance: Array, column: ArrayLike, row: ArrayLike, radius: float) -> Centroids:
    """Centroids of spots of a radius near expected positions (spot,) [pixel] in a finite picture (y, x) of given variance.

    The window follows the spot in three steps. The background is the median of a ring about it. A spot whose window leaves the picture,
    or that moves too far, is unclear.
    """
    start = x, y = np.ravel(np.asarray(column, dtype=float)), np.ravel(np.asarray(row, dtype=float))
    clear, u, spread = np.ones(x.shape, dtype=bool), np.full(x.shape, np.inf), np.zeros(x.shape)
    half_width = int(np.ceil(radius)) + SEARCH
    steps = np.arange(-half_width, half_width + 1)
    height, width = picture.shape
    for _ in range(_ROUNDS):
        left, top = np.rint(np.where(clear, x, 0.0)).astype(int), np.rint(np.where(clear, y, 0.0)).astype(int)
        clear &= (left >= half_width) & (top >= half_width) & (left < width - half_width) & (top < height - half_width)
        columns = np.where(clear, left, half_width)[:, None, None] + steps
        rows = np.where(clear, top, half_width)[:, None, None] + steps[:, None]
        dx, dy = columns - x[:, None, None], rows - y[:, None, None]
        distance = np.hypot(dx, dy)
        inside = distance <= radius + 2
        ring = np.where(~inside & (distance <= radius + SEARCH), picture[rows, columns], np.nan)
        clear &= np.isfinite(ring).any(axis=(1, 2))
        ring[~clear] = 0.0
        light = np.where(inside, picture[rows, columns] - _medians(ring)[:, None, None], 0.0)
        noise = np.where(inside, variance[rows, columns], 0.0)
        total = light.sum(axis=(1, 2))
        clear &= total > _SPOT_SNR * np.sqrt(noise.sum(axis=(1, 2)))
        total = np.where(clear, total, 1.0)
        step = (light * dx).sum(axis=(1, 2)) / total, (light * dy).sum(axis=(1, 2)) / total
        spread = ((light * distance**2).sum(axis=(1, 2)) / total - step[0] ** 2 - step[1] ** 2) / 2
        x, y = x + step[0], y + step[1]
        u = np.sqrt((noise * distance**2 / 2).sum(axis=(1, 2))) / total
        clear &= np.hypot(x - start[0], y - start[1]) <= SEARCH
    return Centroids(np.where(clear, x, start[0]), np.where(clear, y, start[1]), np.where(clear, u, np.inf), spread)


def _medians(values: Array) -> Array:
    """Medians (any,) of the finite ones of values (any, y, x): as NumPy's, without masked arrays, which are slow for few values."""
    rising = np.sort(values.reshape(len(values), -1), axis=1)
    count, index = np.isfinite(rising).sum(axis=1), np.arange(len(values))
    return np.asarray((rising[index, (count - 1) // 2] + rising[index, count // 2]) / 2)


def register(rig: Rig, picture: Array, variance: Array, screen: Screen | None = None) -> Registration:
    """Fit the screen's position to the spots of the fibres and of the reference in a finite picture (y, x) of given variance.

    With a ``screen`` its scale and radial term are taken and only the shift is fitted. Otherwise it starts from the described screen, and scale
    and radial term are fitted too if there are enough spots.
    """
    screen_given = screen is not None
    screen = screen or rig.screen
    x = np.array([*(fibre.x for fibre in rig.fibres), screen.reference_centre[0]])
    y = np.array([*(fibre.y for fibre in rig.fibres), screen.reference_centre[1]])
    radius = np.append(np.full(len(rig.fibres), screen.fibre_radius), screen.reference_radius) * screen.scale
    column, row = screens.to_pixel(screen, x, y)
    fibres = centroids(picture, variance, column[:-1], row[:-1], radius[0])
    reference = centroids(picture, variance, column[-1:], row[-1:], radius[-1])
    column, row, u, spread = (
        np.append(getattr(fibres, name), getattr(reference, name)) for name in ("column", "row", "u", "variance")
    )
    used = np.isfinite(u)
    if not used.any():
        return Registration(screen, _POSITION_U, DIRECTION_U, 0)
    u = np.hypot(u[used], _SENSOR_U)
    fit_lens = not screen_given and used.sum() >= FIBRES_ENOUGH

    def shifted_screen(parameters: Array) -> Screen:
        dx, dy, stretch, bend = np.pad(parameters, (0, 4 - parameters.size))
        centre = (screen.centre[0] + dx, screen.centre[1] + dy)
        # The last two in units of about a pixel at the rim: a per mille of scale, 1e-7 of the radial term.
        return replace(
            screen, centre=centre, scale=screen.scale * (1 + 1e-3 * stretch), radial=screen.radial + 1e-7 * bend
        )

    def residuals(parameters: Array) -> Array:
        expected = screens.to_pixel(shifted_screen(parameters), x[used], y[used])
        return np.concatenate([(expected[0] - column[used]) / u, (expected[1] - row[used]) / u])

    parameters, parameters_u = _robust_fit(residuals, 4 if fit_lens else 2)
    # A disc of radius R has the variance R²/4 along either axis, a pixel 1/12.
    blur = float(np.sqrt(max(np.median(spread[used] - radius[used] ** 2 / 4) - 1 / 12, 0.0)))
    shift_u = _shift_u(parameters_u)
    if not (screen_given or fit_lens):
        shift_u = float(np.hypot(shift_u, _DISTORTION_U))
    return Registration(shifted_screen(parameters), shift_u, DIRECTION_U, int(used.sum()), blur=blur)


def fit_falloff(registration: Registration, picture: Array, entrance: float) -> Array:
    """Relative light that lens and camera pass from each direction, (y, x), smooth and 1 in the disc's centre.

    From a finite picture (y, x) of the etalon lit through an entrance [degree]: a polynomial of second degree in position, of the light over
    the etalon's cosine, whose other changes over twenty degrees are negligible. Beyond the disc it has the value of the rim.
    """
    screen = registration.screen
    row, column = np.indices(picture.shape)
    position = screens.to_position(screen, column, row)
    x, y = ((at - centre) / screen.disc_radius for at, centre in zip(position, screen.disc_centre, strict=True))
    radius = np.hypot(x, y)
    inside = radius < 1 - _RIM / (screen.scale * screen.disc_radius)
    cosine = specular_directions.cos_view_etalon(entrance, *screens.disc_direction(screen, position.x, position.y))
    shrink = 1 / np.maximum(radius, 1.0)
    terms = np.stack([np.ones_like(x), x * shrink, y * shrink, *(shrink**2 * term for term in (x * x, x * y, y * y))])
    lit = inside & (cosine > 0)
    coefficients = np.linalg.lstsq(terms[:, lit].T, picture[lit] / cosine[lit], rcond=None)[0]
    if coefficients[0] <= 0:  # a picture without light
        return np.ones_like(x)
    return np.maximum(np.tensordot(coefficients / coefficients[0], terms, 1), _LEAST_FALLOFF)


def fit_disc(
    registration: Registration,
    picture: Array,
    variance: Array,
    theta_s: ArrayLike,
    phi_s: ArrayLike,
    radius: float,
    falloff: Array | None = None,
) -> Registration:
    """Fit the position of the disc's centre, and the focal length, to the spots of an angular target.

    Parameters
    ----------
    registration : of the pictures of the target
    picture, variance : (y, x), finite
    theta_s, phi_s : directions of the target's spots [degree]
    radius : of a spot [degree]
    falloff : (y, x) of :func:`fit_falloff`, if known; it shifts centroids inwards as a shorter focal length does, by 0.02 % of it if the rim
        of 10 degree has 0.7 of the light and spots have a radius of 0.3 degree
    """
    screen = registration.screen
    theta, phi = np.asarray(theta_s, dtype=float), np.asarray(phi_s, dtype=float)
    pixels = float(np.radians(radius)) * screen.focal_length * screen.scale
    spots = centroids(picture, variance, *screens.to_pixel(screen, *screens.disc_position(screen, theta, phi)), pixels)
    used = np.isfinite(spots.u)
    if used.sum() < _FEWEST_TARGET_SPOTS:
        return registration
    u = np.hypot(spots.u[used], _SENSOR_U)
    bias = np.zeros((2, int(used.sum())))
    if falloff is not None:
        # Light that changes by a share g per pixel moves the centroid of a disc by g R²/4.
        at = np.rint(spots.row[used]).astype(int), np.rint(spots.column[used]).astype(int)
        bias = pixels**2 / 4 * np.array([gradient[at] for gradient in np.gradient(np.log(falloff))])

    def shifted_screen(parameters: Array) -> Screen:
        disc_centre = (screen.disc_centre[0] + parameters[0], screen.disc_centre[1] + parameters[1])
        return replace(screen, disc_centre=disc_centre, focal_length=screen.focal_length * (1 + 1e-2 * parameters[2]))

    def residuals(parameters: Array) -> Array:
        trial = shifted_screen(parameters)
        column, row = screens.to_pixel(trial, *screens.disc_position(trial, theta[used], phi[used]))
        column, row = column + bias[1], row + bias[0]
        return np.concatenate([(column - spots.column[used]) / u, (row - spots.row[used]) / u])

    parameters, parameters_u = _robust_fit(residuals, 3)
    # The scatter of many spots shows their uncertainty better than the assumed one of the sensor.
    final_residuals = residuals(parameters)
    scatter = np.sqrt((final_residuals**2).sum() / max(final_residuals.size - parameters.size, 1))
    millimetres, scale_u = _shift_u(parameters_u), 1e-2 * float(parameters_u[2] * min(scatter, 1.0))
    shift = registration.shift_u / screen.scale
    direction_u = float(np.degrees(np.arctan(np.hypot(millimetres, shift) / screen.focal_length)))
    return replace(registration, screen=shifted_screen(parameters), direction_u=direction_u, scale_u=scale_u)


def _robust_fit(residuals: Callable[[Array], Array], count: int) -> tuple[Array, Array]:
    """Robust least squares of some parameters from 0, and their standard uncertainties."""
    fit = optimize.least_squares(residuals, np.zeros(count), loss="soft_l1", f_scale=3.0)
    jacobian = np.asarray(fit.jac, dtype=float)
    variance = np.diag(np.linalg.pinv(jacobian.T @ jacobian))
    scatter = max(1.0, float(np.median(np.abs(fit.fun))) / 0.6745) if fit.fun.size > 2 * count else 1.0
    return np.asarray(fit.x), scatter * np.sqrt(np.maximum(variance, 0.0))


def _shift_u(u: Array) -> float:
    """Standard uncertainty of a shift along either axis, the first two parameters."""
    return float(np.sqrt((u[:2] ** 2).mean()))
