"""``dataset.bsdf.plot``: a BSDF as polar and Cartesian cuts, as a lobe, as a map of directions, and as a picture of the material."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError, VocabularyError
from brdfpipe.geometry import Array, check_angles
from brdfpipe.report.plots import bsdf_sections, measurement_coverage
from brdfpipe.report.plots.bsdf_sections import Plane

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from brdfpipe.figures.canvas import BSDFFigure

KINDS = ("polar", "cartesian", "lobe", "map", "preview")
"""Methods of :class:`BSDFPlots`."""

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Of curves: those of Okabe and Ito, which people with any colour vision tell apart."""

_DECADES = 6
"""Decades below the peak that a logarithmic axis shows."""


class PlotError(BrdfpipeError):
    """A figure cannot be drawn."""


class BSDFPlots:
    """Figures of a BSDF. Each method returns a :class:`matplotlib.figure.Figure`, which a notebook shows and ``savefig`` writes.

    Angles are in degree, wavelengths in nm. By default a figure shows the wavelength of the dataset next to 550 nm. A surface with a lay is
    shown along and across it. Light that a smooth surface sends into a single direction has no BSDF and is not drawn; the title names it.
    """

    def __init__(self, bsdf: xr.Dataset) -> None:
        if find_spec("matplotlib") is None:
            raise PlotError("figures need matplotlib, which is not installed: pip install 'brdfpipe[plot]'")
        representation(bsdf)  # refuses a dataset that is not a BSDF
        self._bsdf = bsdf

    def __repr__(self) -> str:
        return f"<figures of a BSDF: {', '.join(f'.{kind}()' for kind in KINDS)}>"

    def __call__(self, kind: str = "polar", **options: Any) -> BSDFFigure:
        """The figure of a kind, by name."""
        if kind not in KINDS:
            raise PlotError(f"no figure of the kind {kind!r}; accepted: {', '.join(KINDS)}")
        figure: BSDFFigure = getattr(self, kind)(**options)
        return figure

    def polar(self, theta_i: ArrayLike = (0.0, 30.0, 60.0), *, wavelength: float | None = None) -> BSDFFigure:
        """The BSDF in the plane of incidence as a goniometer draws it: the angle is that of view, the radius is logarithmic.

        Parameters
        ----------
        theta_i : angles of incidence, 0 to below 90 degree; light comes from the left
        wavelength : nm, in the range of the dataset
        """
        figure, axes, shown = self._in_planes("polar", wavelength)
        for ax, plane in zip(axes, shown.planes, strict=True):
            ax.set_theta_zero_location("N")
            ax.set_theta_direction(-1)
            curves = [curve for angle in _incidences(theta_i) for curve in shown.cuts(plane, angle)]
            low, high = _decades([curve.values for curve in curves])
            for number, curve in enumerate(curves):
                turned = np.where(curve.through, 180 - curve.theta, curve.theta)
                radius = np.log10(np.where(curve.values > 0, curve.values, np.nan))
                _draw(ax, np.radians(turned), np.maximum(radius, low), curve, number // (1 + shown.transmits))
            ax.set_ylim(low, high)
            ax.set_yticks(np.arange(low, high + 1), [f"$10^{{{exponent}}}$" for exponent in range(low, high + 1)])
            ax.set_rlabel_position(90)
            if not shown.transmits:
                ax.set_thetamin(-90)
                ax.set_thetamax(90)
            _finish(ax, plane.title(f"{shown.quantity} in the plane of incidence [sr⁻¹]"), curves)
        return figure.titled(shown.words(_incidences(theta_i)))

    def cartesian(
        self, theta_i: ArrayLike = (0.0, 30.0, 60.0), *, wavelength: float | None = None, log: bool = True
    ) -> BSDFFigure:
        """The BSDF in the plane of incidence against the angle of view, negative on the side of the source.

        Parameters
        ----------
        theta_i : angles of incidence, 0 to below 90 degree
        wavelength : nm, in the range of the dataset
        log : whether the axis of the BSDF is logarithmic
        """
        figure, axes, shown = self._in_planes("rectilinear", wavelength)
        for ax, plane in zip(axes, shown.planes, strict=True):
            curves = [curve for angle in _incidences(theta_i) for curve in shown.cuts(plane, angle)]
            for number, curve in enumerate(curves):
                _draw(
                    ax,
                    curve.theta,
                    np.where(curve.values > 0, curve.values, np.nan),
                    curve,
                    number // (1 + shown.transmits),
                )
            if log:
                low, high = _decades([curve.values for curve in curves])
                ax.set_yscale("log")
                ax.set_ylim(10.0**low, 10.0**high)
            ax.set_xlim(-90, 90)
            ax.set_xticks(np.arange(-90, 91, 30))
            ax.set_xlabel("angle of view [degree], positive away from the source")
            ax.set_ylabel(f"{shown.quantity} [sr⁻¹]")
            ax.grid(alpha=0.3)
            _finish(ax, plane.title("plane of incidence"), curves)
        return figure.titled(shown.words(_incidences(theta_i)))

    def lobe(self, theta_i: float = 45.0, *, wavelength: float | None = None) -> BSDFFigure:
        """The light of one incidence in three dimensions: the distance from the origin is the BSDF on a logarithmic scale."""
        figure, axes, shown = self._in_planes("3d", wavelength)
        incidence = _one_incidence(theta_i)
        for ax, plane in zip(axes, shown.planes, strict=True):
            polar, turn = np.meshgrid(_denser_near(incidence, 90.0), np.r_[0:181:3], indexing="ij")
            turn = np.concatenate([-turn[:, :0:-1], turn], axis=1)
            polar = np.broadcast_to(polar[:, :1], turn.shape)
            values = shown.at(plane, incidence, polar, turn)
            low, high = _decades([values])
            level = np.clip(np.log10(np.where(values > 0, values, 10.0**low)), low, high)
            radius = (level - low) / (high - low)
            x, y = (radius * np.sin(np.radians(polar)) * trig(np.radians(turn)) for trig in (np.cos, np.sin))
            z = radius * np.cos(np.radians(polar))
            from matplotlib import colormaps

            colours = colormaps["viridis"](radius)
            ax.plot_surface(x, y, z, facecolors=colours, rstride=1, cstride=1, shade=False, linewidth=0)
            at = math.radians(incidence)
            ax.plot([-math.sin(at), 0], [0, 0], [math.cos(at), 0], color="black")
            ax.text(-math.sin(at), 0, math.cos(at), "source")
            ax.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(0, 1), xticks=[], yticks=[], zticks=[])
            ax.set_box_aspect((2, 2, 1), zoom=1.35)
            ax.set_axis_off()
            figure.add_scale(ax, 10.0**low, 10.0**high, f"{shown.quantity} [sr⁻¹]")
            ax.set_title(plane.title("lobe, logarithmic radius"), fontsize=10)
        return figure.titled(shown.words([incidence]))

    def map(
        self, theta_i: float = 45.0, *, wavelength: float | None = None, about_mirror: float | None = None
    ) -> BSDFFigure:
        """The BRDF over all directions of view in false colours, seen along the normal; equal areas get equal shares of a diffuser's light.

        Parameters
        ----------
        theta_i : angle of incidence, 0 to below 90 degree; light comes from the left
        wavelength : nm, in the range of the dataset
        about_mirror : half width about the mirror direction [degree] of the part that is shown, for a narrow lobe; by default the hemisphere
        """
        figure, axes, shown = self._in_planes("rectilinear", wavelength)
        incidence = _one_incidence(theta_i)
        peak = math.sin(math.radians(incidence))
        reach = (
            1.0
            if about_mirror is None
            else math.sin(math.radians(float(check_angles("about_mirror", about_mirror, 1e-3, 90).item())))
        )
        # An odd number of steps from the peak to each edge: a narrow lobe must not fall between two pixels.
        across = peak + np.linspace(-reach, reach, 301) if about_mirror else _through(peak, 301)
        up = np.linspace(-reach, reach, 301)
        x, y = np.meshgrid(across, up)
        inside = np.hypot(x, y) < 1
        polar = np.degrees(np.arcsin(np.where(inside, np.hypot(x, y), 0)))
        turn = np.degrees(np.arctan2(y, x))
        fields = [np.where(inside, shown.at(plane, incidence, polar, turn), np.nan) for plane in shown.planes]
        low, high = _range(fields)
        for ax, plane, values in zip(axes, shown.planes, fields, strict=True):
            from matplotlib.colors import LogNorm

            norm = LogNorm(low, high)
            drawn = ax.pcolormesh(across, up, np.maximum(values, low), norm=norm, rasterized=True, shading="nearest")
            figure.colorbar(drawn, ax=ax, label=f"{shown.quantity} [sr⁻¹]", shrink=0.8)
            around = np.radians(np.arange(361))
            for angle in (30, 60, 90):
                r = math.sin(math.radians(angle))
                ax.plot(r * np.cos(around), r * np.sin(around), color="grey", linewidth=0.6)
                if about_mirror is None:
                    ax.annotate(f"{angle}°", (0, r), color="grey", fontsize=8, ha="center", va="bottom")
            ax.plot(peak, 0, "o", markerfacecolor="none", color="tab:red", label="mirror direction")
            ax.set(aspect="equal", xlim=(across[0], across[-1]), ylim=(up[0], up[-1]), xticks=[], yticks=[])
            if about_mirror is None:
                ax.set(xlim=(-1.08, 1.08), ylim=(-1.08, 1.12))
                ax.axis("off")
            ax.legend(loc="upper center", bbox_to_anchor=(0.5, 0), frameon=False, fontsize=8)
            part = "" if about_mirror is None else f", ±{about_mirror:g}° about the mirror direction"
            ax.set_title(plane.title(f"directions of view{part}"), fontsize=10)
        return figure.titled(shown.words([incidence]))

    def preview(self, *, illuminant: str = "D65", light: str = "studio", side: int = 256) -> BSDFFigure:
        """A sphere, a panel and a moulded part of the material in a known light; see :func:`brdfpipe.appearance.preview.preview`."""
        from brdfpipe.appearance.preview import preview
        from brdfpipe.figures.canvas import BSDFFigure

        picture = preview(self._bsdf, illuminant=illuminant, light=light, side=side, others=())
        rows, columns = picture["picture"].shape[:2]
        figure = BSDFFigure(figsize=(columns / 80, rows / 80 + 0.3), layout="constrained")
        ax = figure.subplots()
        ax.imshow(picture["picture"].values)
        ax.axis("off")
        return figure.titled(f"{_name(self._bsdf)}{light} light, {picture.attrs['illuminant']}")

    def _in_planes(self, projection: str, wavelength: float | None) -> tuple[BSDFFigure, list[Any], _Shown]:
        """A figure with axes for each plane of incidence that is shown."""
        from brdfpipe.figures.canvas import BSDFFigure

        shown = _Shown.of(self._bsdf, wavelength)
        count = len(shown.planes)
        figure = BSDFFigure(figsize=(6.4 if count == 1 else 10.5, 4.8), layout="constrained")
        axes = figure.subplots(1, count, squeeze=False, subplot_kw={"projection": projection})
        return figure, list(axes[0]), shown


class _Curve(NamedTuple):
    """A cut of one incidence, on one side of the surface."""

    incidence: float
    theta: Array
    values: Array
    through: bool
    measured: NDArray[np.bool_]


class _Shown(NamedTuple):
    """What the figures of a BSDF show of it."""

    bsdf: xr.Dataset
    wavelength: Array | None
    planes: list[Plane]
    transmits: bool

    @classmethod
    def of(cls, bsdf: xr.Dataset, wavelength: float | None) -> _Shown:
        at = bsdf_sections.reference(bsdf)
        if at is not None and wavelength is not None:
            own = bsdf["wavelength"].values
            if not own[0] <= wavelength <= own[-1]:
                raise VocabularyError(f"wavelength is {wavelength:g} nm; the data cover {own[0]:g} to {own[-1]:g} nm")
            at = np.array([float(wavelength)])
        return cls(bsdf, at, bsdf_sections.planes(bsdf), representation(bsdf).transmits)

    @property
    def quantity(self) -> str:
        return "BSDF" if self.transmits else "BRDF"

    def at(self, plane: Plane, incidence: float, polar: ArrayLike, turn: ArrayLike) -> Array:
        """Values [sr-1] at polar angles, and azimuths from the one away from the source [degree]."""
        angles = bsdf_sections.directions(plane, incidence, polar, turn)
        return representation(self.bsdf).evaluate(*angles, self.wavelength)[..., 0].astype(float)

    def cuts(self, plane: Plane, incidence: float) -> list[_Curve]:
        """The curve of reflected light, and that of transmitted light of a body that transmits."""
        curves = []
        for through in (False, True) if self.transmits else (False,):
            theta = bsdf_sections.cut_angles(self.bsdf, incidence, through=through)
            polar, turn = bsdf_sections.in_plane(theta, through=through)
            flags = measurement_coverage.quality(self.bsdf, plane, incidence, polar, turn)
            measured = np.ones(theta.shape, bool) if flags is None else measurement_coverage.known(flags)
            curves.append(_Curve(incidence, theta, self.at(plane, incidence, polar, turn), through, measured))
        return curves

    def words(self, incidences: Sequence[float]) -> str:
        """Title of a figure: material, wavelength, and light that has no BSDF."""
        at = "all wavelengths alike" if self.wavelength is None else f"{self.wavelength[0]:g} nm"
        if len(incidences) == 1:
            at = f"{incidences[0]:g}° incidence, {at}"
        single = bsdf_sections.specular(self.bsdf, np.asarray(incidences, dtype=float))
        mirrored = (
            f"; not drawn: light {'/'.join(['mirrored', 'transmitted'][: 1 + self.transmits])} into one direction"
        )
        return f"{_name(self.bsdf)}{at}{mirrored if any(share.max() > 1e-6 for share in single) else ''}"


def _name(bsdf: xr.Dataset) -> str:
    name = bsdf.attrs.get("material", "")
    return f"{name}: " if name and name != "material" else ""


def _incidences(theta_i: ArrayLike) -> list[float]:
    angles = np.atleast_1d(check_angles("theta_i", theta_i, 0, 90))
    if not angles.size or angles.max() >= 90:
        raise VocabularyError("theta_i of a figure: angles from 0 to below 90 degree are accepted")
    return [float(angle) for angle in angles]


def _one_incidence(theta_i: ArrayLike) -> float:
    angles = _incidences(theta_i)
    if len(angles) > 1:
        raise VocabularyError(f"lobe and map show one angle of incidence; found {len(angles)}")
    return angles[0]


def _range(values: Sequence[Array]) -> tuple[float, float]:
    """The smallest and the largest value to show [sr-1], at most six decades apart."""
    positive = np.concatenate([value[np.isfinite(value) & (value > bsdf_sections.DARKEST)].ravel() for value in values])
    if not positive.size:
        return 0.1, 1.0
    # At the horizon a BRDF may fall to zero: a few values must not take most of the scale.
    high = float(positive.max())
    low = max(float(np.percentile(positive, 2)), high * 10.0**-_DECADES)
    return (low, high) if low < 0.99 * high else (0.9 * high, 1.1 * high)


def _decades(values: Sequence[Array]) -> tuple[int, int]:
    """Exponents of ten at both ends of an axis."""
    low, high = _range(values)
    top = math.ceil(math.log10(high) - 1e-9)
    return min(math.floor(math.log10(low) + 1e-9), top - 1), top


def _draw(ax: Axes, x: Array, y: Array, curve: _Curve, number: int) -> None:
    """A curve: transmitted light thinner, and what was not measured dashed."""
    colour = COLOURS[number % len(COLOURS)]
    side = ", transmitted" if curve.through else ""
    width = 1.0 if curve.through else 1.6
    solid, rest = np.where(curve.measured, y, np.nan), np.where(curve.measured, np.nan, y)
    ax.plot(x, solid, color=colour, linewidth=width, label=f"{curve.incidence:g}°{side}")
    if not curve.measured.all():
        ax.plot(x, rest, color=colour, linewidth=width, linestyle="--", label="_not measured")


def _finish(ax: Axes, title: str, curves: Sequence[_Curve]) -> None:
    """Title and legend of cuts."""
    dashed = "" if all(curve.measured.all() for curve in curves) else "; dashed: not measured"
    ax.set_title(f"{title}{dashed}", fontsize=10)
    legend = ax.legend(title="incidence", fontsize=8)
    if ax.name == "polar":  # beside the half disc
        legend.set_loc("lower left")
        legend.set_bbox_to_anchor((-0.12, 0.75))


def _denser_near(peak: float, end: float) -> Array:
    """Polar angles from 0 to the horizon [degree], denser near a peak."""
    offsets = np.geomspace(0.02, 20, 40)
    angles = np.unique(np.r_[np.linspace(0, end - 0.5, 46), peak, peak - offsets, peak + offsets].round(6))
    return angles[(angles >= 0) & (angles < end)]


def _through(peak: float, count: int) -> Array:
    """Direction cosines from -1 to 1, one of them exactly at the peak."""
    step = 2 / (count - 1)
    step = peak / max(1, round(peak / step)) if peak > step / 2 else step
    half = math.ceil(1 / step)
    return np.asarray(step * np.arange(-half, half + 1), dtype=float)
