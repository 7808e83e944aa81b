"""What light would show the grey levels that were taken: stripes, a screen's sinusoid, or a table.

The station's own laws of light and sensor are turned round: their parameters are those with which
they come nearest to the samples, by least squares with each sample's noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from gpuspec.errors import FrameError
from gpuspec.frames.fringes import Measured
from gpuspec.light.constants import HARMONICS
from gpuspec.light.float64 import two_boxes
from gpuspec.light.float64_noise import Excess, unclipped_mean
from gpuspec.light.float64_stripes import lit_fraction
from gpuspec.station.sections import Sensor

Array = NDArray[np.float64]
Kind = Literal["stripes", "sinusoid", "table"]
TABLE = 32
"""Values of a table over a period."""
_ORDERS = 8  # harmonics of a table
_SAMPLES = 24_000  # that are fitted
_FIRST = 3_000  # on which starts are compared
_FOLDED = 256  # places on the light, on whose mean levels many starts are tried
_GOLDEN = (5**0.5 - 1) / 2
_EXPLAINED = 1.25  # times the samples' noise, above which what is left is no noise
_AT = 1e-3  # of a limit, relatively, within which a number is at it
_TRIED = 12  # starts on these, the best of a grid
_SATURATED = 1e-3  # share of samples at full scale, above which a table is not told
_BETTER = 0.97  # of a simpler light's misfit, below which another is taken instead
_WORSE = 2.0  # times another's misfit, above which a start is given up
_SAME = 1e-4  # relatively, to which two misfits are those of one light
_KEPT = 3  # of the starts, that are gone on with on more samples
_F_SCALE = 4.0  # standard deviations, beyond which a sample counts less
_FLAT = 1e-12  # of a normalised square, below which a direction is as good as not told
_TURNS = 6  # of Newton's method for a table and its gain


@dataclass(frozen=True, eq=False)
class Samples:
    """Grey levels of an even part's pixels, and where in the light each was taken.

    Attributes
    ----------
    levels : ndarray, shape (n, K)
        DN.
    turn : ndarray of float64, shape (n, K)
        Place on the light, in periods.
    place : ndarray of float64, shape (n, 2)
        In the image: x to the right and y up from its middle, over half its longer side.
    across, down : float
        Of the pixel's square on the light, in periods.
    """

    levels: NDArray[Any]
    turn: Array
    place: Array
    across: float
    down: float

    def some(self, samples: int) -> Samples:
        """Return about so many of them, spread evenly.

        Parameters
        ----------
        samples : int
        """
        pixels, images = self.levels.shape
        wanted = max(1, samples // images)
        if wanted >= pixels:
            return self
        # By the golden section: equal steps would meet the same few columns in every row.
        chosen = np.unique((np.arange(wanted) * _GOLDEN % 1 * pixels).astype(np.intp))
        return Samples(
            self.levels[chosen], self.turn[chosen], self.place[chosen], self.across, self.down
        )

    def folded(self) -> Samples:
        """Return the mean level at each of some places on the light, as of one image."""
        bins = np.floor(self.turn % 1 * _FOLDED).astype(np.intp).ravel() % _FOLDED
        number = np.bincount(bins, minlength=_FOLDED)
        met = number > 0
        levels = np.bincount(bins, self.levels.ravel(), _FOLDED)[met] / number[met]
        turn = (np.flatnonzero(met) + 0.5) / _FOLDED
        place = np.zeros((len(turn), 2))
        return Samples(levels[:, None], turn[:, None], place, self.across, self.down)


@dataclass(frozen=True, eq=False)
class LightFit:
    """A light that shows what was taken.

    Attributes
    ----------
    kind : {"stripes", "sinusoid", "table"}
    numbers : mapping of str to Measured
        Exposure, duty, leak, gamma, pupil's radius on the light ...; lengths in periods.
    falloff : ndarray of float64, shape (5,)
        Relative gain over the image: 1 + the product with x, y, x^2, xy and y^2, see
        :attr:`Samples.place`.
    falloff_spread : ndarray of float64, shape (5,)
        Its standard uncertainties.
    harmonics : ndarray of complex128, shape (h + 1,)
        Of a table, of full scale, as the pixels see it; empty of others.
    vector : ndarray
        The numbers in the order of the model.
    rms_dn : float
        Of the samples about it.
    noise_dn : float
        Of what is left of the samples about that of their neighbours on the light: the `rms_dn`
        of a light that explains them.
    at_limit : mapping of str to float
        Numbers that end at the least or the most that is looked for.
    """

    kind: Kind
    numbers: Mapping[str, Measured]
    falloff: Array
    falloff_spread: Array
    harmonics: NDArray[np.complex128]
    rms_dn: float
    noise_dn: float
    at_limit: Mapping[str, float]
    vector: Array
    _across: float
    _down: float
    _pupil: float | None

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why its numbers are not to be believed, a sentence each."""
        said = []
        if self.rms_dn > _EXPLAINED * self.noise_dn:
            said.append(
                f"the fitted light ({self.kind}) does not explain these frames: grey levels are "
                f"{self.rms_dn:.2f} DN rms off it, and their noise is {self.noise_dn:.2f} DN. Its "
                f"numbers are off by more than their uncertainties; look at the picture, and give "
                f"what is known of the light and the pupil."
            )
        for name, value in self.at_limit.items():
            said.append(
                f"{name} ends at {value:g}, the limit of what is looked for: the light is hardly "
                f"such a one ({self.kind}), and the uncertainty of its numbers does not hold."
            )
        return tuple(said)

    def gain(self, place: Array) -> Array:
        """Return the relative gain at places of the image.

        Parameters
        ----------
        place : ndarray, shape (n, 2)
        """
        return 1 + _basis(place) @ self.falloff

    def signal(self, turn: Array, gain: Array) -> Array:
        """Return the signal over saturation, not clipped.

        Parameters
        ----------
        turn : ndarray
            Place on the light, in periods.
        gain : ndarray
            Relative gain there, of a shape that goes with it.
        """
        model = _Model(self.kind, self._across, self._down, self._pupil)
        return gain * model.light(self.vector, turn)

    def levels(self, turn: Array, gain: Array, sensor: Sensor) -> Array:
        """Return the mean grey level, DN.

        Parameters
        ----------
        turn, gain : ndarray
        sensor : Sensor
        """
        return _shown(self.signal(turn, gain), sensor)


def _basis(place: Array) -> Array:
    x, y = place.T
    return np.stack([x, y, x * x, x * y, y * y], axis=1)


def _shown(signal: Array, sensor: Sensor) -> Array:
    signal = np.maximum(signal, 0)
    shown: Array = unclipped_mean(signal, sensor) + Excess.of(sensor).at(signal)[0]
    return shown


@dataclass(frozen=True)
class _Tunnel:
    """What of a tunnel its light goes by, lengths in periods."""

    profile: str
    profile_gamma: float
    luminous_mm: float
    period_mm: float = 1.0

    @property
    def is_striped(self) -> bool:
        return self.profile == "stripes"


@dataclass(frozen=True)
class _Lit:
    tunnel: _Tunnel


@dataclass(frozen=True)
class _Model:
    """The luminance that a pixel sees as a function of a vector of parameters."""

    kind: Kind
    across: float
    down: float
    pupil: float | None
    held: bool = False
    """Whether the pupil is that which is given, for stripes too."""

    @property
    def names(self) -> tuple[str, ...]:
        if self.kind == "stripes":
            return "exposure", "duty", "leak", "pupil", "phase"
        if self.kind == "sinusoid":
            return "exposure", "gamma", "leak", "phase"
        waves = [f"{part}{h}" for h in range(1, _ORDERS + 1) for part in ("cos", "sin")]
        return "mean", *waves

    @property
    def bounds(self) -> tuple[list[float], list[float]]:
        if self.kind == "stripes":
            return [1e-3, 0.01, 0, 0, -2], [1e3, 0.99, 0.95, 3, 2]
        if self.kind == "sinusoid":
            return [1e-3, 0.2, 0, -2], [1e3, 10, 0.95, 2]
        return [-np.inf] * len(self.names), [np.inf] * len(self.names)

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which of the parameters are looked for."""
        return np.array([not (self.held and name == "pupil") for name in self.names])

    def at_limit(self, vector: Array) -> dict[str, float]:
        """Return the parameters at a limit that is none by nature, as no leak and a pinhole are."""
        return {
            name: limit
            for limits in self.bounds
            for name, value, limit in zip(self.names, vector, limits, strict=True)
            if limit and np.isfinite(limit) and abs(value - limit) <= _AT * abs(limit)
        }

    def boxes(self, pupil: float) -> tuple[Array, Array]:
        at = np.ones(1)
        return two_boxes(self.across * at, self.down * at, pupil * at, 0 * at)

    def light(self, vector: Array, turn: Array) -> Array:
        """Return exposure times what is seen of the light, leak and all."""
        if self.kind == "table":
            waves = np.full(turn.shape, vector[0])
            for order in range(1, _ORDERS + 1):
                angle = 2 * np.pi * order * turn
                waves += vector[2 * order - 1] * np.cos(angle) + vector[2 * order] * np.sin(angle)
            return waves
        if self.kind == "stripes":
            exposure, duty, leak, pupil, phase = vector[:5]
            tunnel = _Tunnel("stripes", 1.0, duty)
        else:
            exposure, gamma, leak, phase = vector[:4]
            pupil = self.pupil or 0.0
            tunnel = _Tunnel("sinusoid", float(gamma), 0.5)
        station: Any = _Lit(tunnel)  # a Station takes too long to make, ten thousand times
        wide, narrow = self.boxes(float(pupil))
        fine = np.arange(513) / 512 if self.kind == "sinusoid" else None
        if fine is None:
            at = turn - phase
            lit = lit_fraction(at, wide + 0 * at, narrow + 0 * at, 0.0, station)
        else:  # smooth: a table of it is as good
            curve = lit_fraction(fine, wide + 0 * fine, narrow + 0 * fine, 0.0, station)
            lit = np.interp((turn - phase) % 1, fine, curve)
        seen: Array = exposure * (leak + (1 - leak) * lit)
        return seen

    def starts(self, samples: Samples, sensor: Sensor) -> list[Array]:
        """Return parameters to begin from, without those of the gain: the best of a grid.

        Parameters
        ----------
        samples : Samples
            Few: what each of the grid leaves of them is worked out.
        sensor : Sensor
        """
        black, full = sensor.black_level_dn, sensor.full_scale_dn
        level = (samples.levels - black) / (full - black)
        low, high = (max(float(one), 1e-3) for one in np.quantile(level, (0.02, 0.98)))
        wave = np.mean(level * np.exp(2j * np.pi * samples.turn))
        centre = float(np.angle(wave)) / (2 * np.pi)
        exposures = np.geomspace(1.05, 30, 10) if high > 0.97 else high * np.geomspace(1, 4, 5)
        if self.kind == "sinusoid":
            grid = [
                np.array([e, gamma, min(low / e, 0.9), centre])
                for e in exposures for gamma in np.geomspace(0.4, 8, 8)
            ]  # fmt: skip
        else:
            grid = [
                np.array([e, duty, min(low / e, 0.9), pupil, centre - duty / 2])
                for e in exposures for pupil in self.pupils for duty in np.linspace(0.05, 0.95, 19)
            ]  # fmt: skip
        left = [np.abs(_shown(self.light(one, samples.turn), sensor) - samples.levels).mean()
                for one in grid]  # fmt: skip
        return [grid[n] for n in np.argsort(left)[:_TRIED]]

    @property
    def pupils(self) -> tuple[float, ...]:
        """Radii of the pupil's image to begin from, of stripes."""
        given = () if self.pupil is None else (self.pupil,)
        return given if self.held else (*given, 0.02, 0.08, 0.2, 0.4)

    def fit(
        self, samples: Samples, start: Array, sensor: Sensor, noise: Callable[[Array], Array],
        calls: int,
    ) -> tuple[Array, Array, float]:  # fmt: skip
        """Return parameters with those of the gain, their covariance, and the cost."""
        basis = _basis(samples.place)
        size = len(self.names)
        levels = samples.levels.astype(np.float64)
        free = np.append(self.free, np.full(5, bool(basis.any())))

        def whole(vector: Array) -> Array:
            found = start.copy()
            found[free] = vector
            return found

        def shown(vector: Array) -> Array:
            gain = (1 + basis @ vector[size:])[:, None]
            return _shown(gain * self.light(vector[:size], samples.turn), sensor)

        spread = noise(shown(start))

        def misfit(vector: Array) -> Array:
            rest: Array = ((shown(whole(vector)) - levels) / spread).ravel()
            return rest

        least, most = self.bounds
        low, high = np.array([*least, *[-1.0] * 5]), np.array([*most, *[1.0] * 5])
        start = np.where(free, np.clip(start, low + 1e-9, high - 1e-9), start)
        found = least_squares(
            misfit, start[free], bounds=(low[free], high[free]), x_scale="jac", max_nfev=calls,
            loss="soft_l1", f_scale=_F_SCALE,
        )  # fmt: skip
        rest = misfit(found.x)
        dof = max(rest.size - len(found.x), 1)
        scale = max(float(np.sum(rest**2)) / dof, 1.0)
        return whole(found.x), _covariance(found.jac, free) * scale, float(found.cost)


def _covariance(jacobian: Array, free: NDArray[np.bool_] | None = None) -> Array:
    """Return the covariance of parameters, 0 of those that are not free.

    What the samples hardly tell has a large one: a plain pseudo-inverse gives it none.
    """
    if free is None:
        free = np.full(jacobian.shape[1], True)
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = 1
    told, axes = np.linalg.eigh((jacobian / size).T @ (jacobian / size))
    found = np.zeros((len(free), len(free)))
    found[np.ix_(free, free)] = (axes / np.maximum(told, _FLAT)) @ axes.T / np.outer(size, size)
    return found


def fit_light(
    samples: Samples, sensor: Sensor, noise: Callable[[Array], Array], *,
    pupil: float | None = None, kind: Kind | None = None, before: LightFit | None = None,
) -> LightFit:  # fmt: skip
    """Return the light that comes nearest to samples.

    Parameters
    ----------
    samples : Samples
    sensor : Sensor
        Its black level, depth and noise are used.
    noise : callable
        Standard deviation of a sample as a function of its mean, DN.
    pupil : float, optional
        Radius of the pupil's image on the light, in periods, for lights that do not tell it, and
        for stripes that saturate the sensor: exposure, width and pupil are then not told apart.
        None: it is not known; 0: a pinhole.
    kind : str, optional
        Which light; None: that which comes nearest.
    before : LightFit, optional
        Of the same samples with another noise, to begin from.

    Returns
    -------
    LightFit

    Raises
    ------
    FrameError
        If a table is asked for of saturated samples.
    """
    few, many = samples.some(_FIRST), samples.some(_SAMPLES)
    saturated = float(np.mean(samples.levels >= sensor.full_scale_dn))
    if kind == "table" and saturated > _SATURATED:
        raise FrameError(
            f"{saturated:.1%} of the grey levels are saturated, so the light's profile beyond them "
            f"is not told; take frames at a shorter exposure, or fit stripes or a sinusoid."
        )
    held = pupil is not None and saturated > _SATURATED

    def model_of(light: Kind) -> _Model:
        return _Model(light, samples.across, samples.down, pupil, held)

    if before and before.kind != "table":
        start = np.concatenate([before.vector, before.falloff])
        again = model_of(before.kind).fit(many, start, sensor, noise, 40)
        return _told(before.kind, *again[:2], many, sensor, pupil)
    found: list[tuple[Kind, Array, Array, float]] = []
    laws: tuple[Kind, ...] = ("stripes", "sinusoid") if kind is None else (kind,)
    for law in laws:
        if law != "table":
            found.append((law, *_best(model_of(law), few, many, sensor, noise)))
    if kind == "table" or (kind is None and saturated <= _SATURATED):
        found.append(_fit_table(many, sensor, noise))
    least = min(one[3] for one in found)
    chosen = next(one for one in found if _BETTER * one[3] <= least)
    return _told(*chosen[:3], many, sensor, pupil)


def _best(
    model: _Model, few: Samples, many: Samples, sensor: Sensor, noise: Callable[[Array], Array]
) -> tuple[Array, Array, float]:
    """Return what comes nearest from many starts: on the folded levels, on a few, on all."""
    folded = many.folded()
    tried = [np.append(start, np.zeros(5)) for start in model.starts(folded, sensor)]
    last: tuple[Array, Array, float] | None = None
    for samples, calls, kept in ((folded, 100, _KEPT), (few, 40, _KEPT), (many, 40, 1)):
        fits = [model.fit(samples, start, sensor, noise, calls) for start in tried]
        fits.sort(key=lambda one: one[2])
        last = fits[0]
        near = [one for one in fits if one[2] <= _WORSE * last[2]]
        tried = [one[0] for one in _unlike(near)[:kept]]
    assert last is not None
    return last


def _unlike(fits: list[tuple[Array, Array, float]]) -> list[tuple[Array, Array, float]]:
    """Leave out what came to the same cost as one before."""
    kept: list[tuple[Array, Array, float]] = []
    for one in fits:
        if not kept or one[2] > kept[-1][2] * (1 + _SAME):
            kept.append(one)
    return kept


def _fit_table(
    samples: Samples, sensor: Sensor, noise: Callable[[Array], Array]
) -> tuple[Kind, Array, Array, float]:
    """Return the harmonics and the gain over the image, by the method of Gauss and Newton."""
    full = sensor.full_scale_dn - sensor.black_level_dn
    level = (samples.levels.astype(np.float64) - sensor.black_level_dn) / full
    waves = [np.ones_like(samples.turn)]
    for order in range(1, _ORDERS + 1):
        waves += [part(2 * np.pi * order * samples.turn) for part in (np.cos, np.sin)]
    basis = _basis(samples.place)[:, :, None]
    gain, vector = np.zeros(5), np.zeros(len(waves))
    vector[0] = float(level.mean())
    kept = samples.levels < sensor.full_scale_dn
    spread = full / noise(np.asarray(samples.levels, np.float64))
    for _ in range(_TURNS):
        field = (1 + np.tensordot(basis[:, :, 0], gain, 1))[:, None]
        seen = np.tensordot(vector, np.array(waves), 1)
        columns = [field * wave for wave in waves] + [basis[:, n] * seen for n in range(5)]
        together = np.stack([(column * spread)[kept] for column in columns], axis=1)
        step, *_ = np.linalg.lstsq(together, ((level - field * seen) * spread)[kept], rcond=None)
        vector, gain = vector + step[: len(waves)], gain + step[len(waves) :]
    field = (1 + np.tensordot(basis[:, :, 0], gain, 1))[:, None]
    seen = np.tensordot(vector, np.array(waves), 1)
    rest = ((field * seen - level) * spread)[kept]
    scale = max(float(np.mean(rest**2)), 1.0)
    cost = float(np.sum(_F_SCALE**2 * (np.sqrt(1 + (rest / _F_SCALE) ** 2) - 1)))
    return "table", np.concatenate([vector, gain]), _covariance(together) * scale, cost


def _told(
    kind: Kind, vector: Array, covariance: Array, samples: Samples, sensor: Sensor,
    pupil: float | None,
) -> LightFit:  # fmt: skip
    model = _Model(kind, samples.across, samples.down, pupil)
    size = len(model.names)
    spread = np.sqrt(np.diag(covariance))
    numbers = {
        name: Measured(float(value), float(one))
        for name, value, one in zip(model.names, vector, spread, strict=False)
    }
    waves: NDArray[np.complex128] = np.zeros(0, np.complex128)
    if kind == "table":
        waves = np.array([vector[0], *(vector[1:size:2] + 1j * vector[2:size:2])])
    gain = (1 + _basis(samples.place) @ vector[size:])[:, None]
    shown = _shown(gain * model.light(vector[:size], samples.turn), sensor)
    rest = samples.levels - shown
    return LightFit(
        kind, numbers, vector[size:], spread[size:], waves, float(np.sqrt(np.mean(rest**2))),
        _noise(rest, samples.turn), model.at_limit(vector[:size]), vector[:size], samples.across,
        samples.down, pupil,
    )  # fmt: skip


def _noise(rest: Array, turn: Array) -> float:
    """Return the noise of what is left: of neighbours on the light the same light is left.

    J. von Neumann, Ann. Math. Stat. 12 (1941): half the mean square of successive differences.
    """
    sorted_rest = rest.ravel()[np.argsort(turn.ravel() % 1)]
    return float(np.sqrt(np.mean(np.diff(sorted_rest) ** 2) / 2))


def seen_through(waves: NDArray[np.complex128], wide: float, narrow: float) -> Array:
    """Return by how much a footprint's two boxes weaken each harmonic.

    Parameters
    ----------
    waves : ndarray, shape (h + 1,)
        Of which there are so many.
    wide, narrow : float
        In periods.

    Examples
    --------
    >>> from gpuspec.captured.light_fit import seen_through
    >>> seen_through(np.ones(2, complex), 0.5, 0.0).round(3).tolist()
    [1.0, 0.637]
    """
    orders = np.arange(len(waves))
    found: Array = np.sinc(orders * wide) * np.sinc(orders * narrow)
    return found


def table_of(waves: NDArray[np.complex128]) -> tuple[float, tuple[float, ...]]:
    """Return the exposure and the profile over a period of a light with some harmonics.

    Parameters
    ----------
    waves : ndarray of complex128, shape (h + 1,)
        Of full scale: cos in the real part, sin in the imaginary one.

    Returns
    -------
    exposure : float
    profile : tuple of float
        `TABLE` values from 0 to 1.

    Examples
    --------
    >>> from gpuspec.captured.light_fit import table_of
    >>> exposure, profile = table_of(np.array([0.4, 0.2]))
    >>> round(exposure, 3), round(profile[16], 3)
    (0.6, 0.333)
    """
    assert len(waves) <= HARMONICS + 1
    turn = np.arange(TABLE) / TABLE
    orders = np.arange(len(waves))
    level = (waves * np.exp(-2j * np.pi * np.outer(turn, orders))).real.sum(axis=1)
    top = float(level.max())
    return top, tuple(round(float(one), 6) for one in (level / top).clip(0, 1))
