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
_SATURATED = 1e-3  # share of samples at full scale, above which a table is not told
_BETTER = 0.97  # of another's misfit, below which a table is taken instead
_WORSE = 2.0  # times another's misfit on a few samples, above which a light is given up
_KEPT = 3  # of the starts, that are gone on with on all samples
_F_SCALE = 4.0  # standard deviations, beyond which a sample counts less
_HELD = 1e-6  # periods, between which a pupil that is given is held
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
        step = max(1, -(-self.levels.size // samples))
        return Samples(
            self.levels[::step], self.turn[::step], self.place[::step], self.across, self.down
        )


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
    """

    kind: Kind
    numbers: Mapping[str, Measured]
    falloff: Array
    falloff_spread: Array
    harmonics: NDArray[np.complex128]
    rms_dn: float
    vector: Array
    _across: float
    _down: float
    _pupil: float

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
    pupil: float
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
            least, most = (self.pupil - _HELD, self.pupil + _HELD) if self.held else (0.0, 3.0)
            return [1e-3, 0.01, 0, least, -2], [1e3, 0.99, 0.95, most, 2]
        if self.kind == "sinusoid":
            return [1e-3, 0.2, 0, -2], [1e3, 10, 0.95, 2]
        return [-np.inf] * len(self.names), [np.inf] * len(self.names)

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
            pupil = self.pupil
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
        """Return parameters to begin from, without those of the gain."""
        black, full = sensor.black_level_dn, sensor.full_scale_dn
        level = (samples.levels - black) / (full - black)
        low, high = (max(float(one), 1e-3) for one in np.quantile(level, (0.02, 0.98)))
        wave = np.mean(level * np.exp(2j * np.pi * samples.turn))
        centre = float(np.angle(wave)) / (2 * np.pi)
        saturated = high > 0.97
        exposures = (1.3, 2.5, 5.0, 10.0) if saturated else (high, 1.5 * high)
        if self.kind == "sinusoid":
            return [np.array([e, gamma, min(low / e, 0.9), centre]) for e in exposures
                    for gamma in (0.7, 1.5, 3.0)]  # fmt: skip
        found = []
        for exposure in exposures:
            share = float(np.mean(level > (low + high) / 2))
            for pupil in (self.pupil,) if self.held else (0.02, 0.08, 0.2):
                wide = float(self.boxes(pupil)[0][0])
                duty = float(np.clip(share - wide * (1 - 1 / max(exposure, 1)), 0.05, 0.95))
                start = [exposure, duty, min(low / exposure, 0.9), pupil, centre + duty / 2]
                found.append(np.array(start))
        return found

    def fit(
        self, samples: Samples, start: Array, sensor: Sensor, noise: Callable[[Array], Array],
        calls: int,
    ) -> tuple[Array, Array, float]:  # fmt: skip
        """Return parameters with those of the gain, their covariance, and the cost."""
        basis = _basis(samples.place)
        size = len(self.names)
        levels = samples.levels.astype(np.float64)

        def shown(vector: Array) -> Array:
            gain = (1 + basis @ vector[size:])[:, None]
            return _shown(gain * self.light(vector[:size], samples.turn), sensor)

        spread = noise(shown(start))

        def misfit(vector: Array) -> Array:
            rest: Array = ((shown(vector) - levels) / spread).ravel()
            return rest

        low, high = self.bounds
        low, high = [*low, *[-1.0] * 5], [*high, *[1.0] * 5]
        start = np.clip(start, np.array(low) + 1e-9, np.array(high) - 1e-9)
        found = least_squares(
            misfit, start, bounds=(low, high), x_scale="jac", max_nfev=calls, loss="soft_l1",
            f_scale=_F_SCALE,
        )  # fmt: skip
        rest = misfit(found.x)
        dof = max(rest.size - len(found.x), 1)
        scale = max(float(np.sum(rest**2)) / dof, 1.0)
        free = np.subtract(high, low) > 3 * _HELD
        return found.x, _covariance(found.jac, free) * scale, float(found.cost)


def _covariance(jacobian: Array, free: Any = True) -> Array:
    """Return the covariance of parameters, 0 of those that are not free.

    What the samples hardly tell has a large one: a plain pseudo-inverse gives it none.
    """
    free = np.broadcast_to(free, jacobian.shape[1:])
    own = jacobian[:, free]
    size = np.linalg.norm(own, axis=0)
    size[size == 0] = 1
    told, axes = np.linalg.eigh((own / size).T @ (own / size))
    found = np.zeros((len(free), len(free)))
    found[np.ix_(free, free)] = (axes / np.maximum(told, _FLAT)) @ axes.T / np.outer(size, size)
    return found


def fit_light(
    samples: Samples, sensor: Sensor, noise: Callable[[Array], Array], *, pupil: float = 0.0,
    kind: Kind | None = None, before: LightFit | None = None,
) -> LightFit:  # fmt: skip
    """Return the light that comes nearest to samples.

    Parameters
    ----------
    samples : Samples
    sensor : Sensor
        Its black level, depth and noise are used.
    noise : callable
        Standard deviation of a sample as a function of its mean, DN.
    pupil : float
        Radius of the pupil's image on the light, in periods, for lights that do not tell it, and
        for stripes that saturate the sensor: exposure, width and pupil are then not told apart. 0:
        it is not known.
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
    found: list[tuple[Kind, Array, Array, float]] = []
    held = pupil > 0 and saturated > _SATURATED

    def model_of(light: Kind) -> _Model:
        return _Model(light, samples.across, samples.down, pupil, held)

    if before and before.kind != "table":
        start = np.concatenate([before.vector, before.falloff])
        again = model_of(before.kind).fit(many, start, sensor, noise, 40)
        return _told(before.kind, *again[:2], many, sensor, pupil)
    first: dict[Kind, list[tuple[Array, Array, float]]] = {}
    curved: tuple[Kind, ...] = ("stripes", "sinusoid") if kind is None else (kind,)
    for one in curved:
        if one != "table":
            model = model_of(one)
            tried = [
                model.fit(few, np.concatenate([start, np.zeros(5)]), sensor, noise, 30)
                for start in model.starts(few, sensor)
            ]
            first[one] = sorted(tried, key=lambda one: one[2])[:_KEPT]
    for one, starts in first.items():
        if starts[0][2] <= _WORSE * min(others[0][2] for others in first.values()):
            model = model_of(one)
            for start, _, cost in starts:
                if cost <= _WORSE * starts[0][2]:
                    found.append((one, *model.fit(many, start, sensor, noise, 40)))
    chosen = min(found, key=lambda one: one[3]) if found else None
    if kind == "table" or (kind is None and saturated <= _SATURATED):
        table = _fit_table(many, sensor, noise)
        if chosen is None or table[3] < _BETTER * chosen[3]:
            chosen = table
    assert chosen is not None
    return _told(*chosen[:3], many, sensor, pupil)


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
    kind: Kind, vector: Array, covariance: Array, samples: Samples, sensor: Sensor, pupil: float
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
        vector[:size], samples.across, samples.down, pupil,
    )  # fmt: skip


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
