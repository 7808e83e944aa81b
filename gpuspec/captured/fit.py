"""The way through from an even part's frames to the station that would take them: its twin."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image, Mask
from gpuspec.captured.light_fit import Kind, LightFit, Samples, fit_light
from gpuspec.captured.sequence import Given, Sequenced, added, fitting, stated_rate
from gpuspec.captured.smallest import Smallest, smallest
from gpuspec.captured.twin import Dark, Scale, known, twin_of, unknown
from gpuspec.errors import FrameError
from gpuspec.frames.accumulator import Accumulator
from gpuspec.frames.fringes import Fringes, Measured, fringes, periods_of, steps
from gpuspec.frames.outline import outlined
from gpuspec.frames.period import whole_periods
from gpuspec.frames.photon_transfer import Noise, Transfer, photon_transfer
from gpuspec.frames.readers import Colour
from gpuspec.frames.region import lit_region
from gpuspec.frames.texture import Texture, band_gain, texture
from gpuspec.light.backend import Backend, DeviceInfo
from gpuspec.light.float64_noise import grey_moments
from gpuspec.report.captured import FrameRow
from gpuspec.report.twin import Number
from gpuspec.shown import object_of
from gpuspec.simulation.simulate import simulate
from gpuspec.station.sections import Sensor
from gpuspec.station.station import Station

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOOKED_AT = 600_000  # grey levels of the sequence
_WEIGHED = 150_000  # of them, for a noise that gives weights alone
_ROUNDS = 3  # of light and noise: each tells the other's weight
_TOLD = 0.02  # relative uncertainty of a gain, below which no other way to it is tried
_LESS = 4.0  # standard deviations below 0, from which a dark's variance is none
_CHECKED_PX = 700  # side of the twin's image that is held against the real one


@dataclass(frozen=True, eq=False)
class Fit:
    """A station fitted to frames, and how far it can be trusted.

    Attributes
    ----------
    station : Station
        The twin: what takes such frames of an even part, without its defects.
    numbers : tuple of Number
        What was found, each with its standard uncertainty.
    unknown : tuple of str
        What these frames cannot tell.
    real, twin : Texture
        Flawless level, ripple and noise of the frames' aspect image and of the twin's.
    light : LightFit
    fringes : Fringes
    transfer : Transfer
    aspect : ndarray of float32, shape (M, N)
        Of the frames, DN.
    region : ndarray of bool, shape (M, N)
    residual : ndarray of float32, shape (M, N)
        Aspect image less the fitted one, DN; 0 outside the region.
    fold : tuple of ndarray, each of shape (n,)
        Place on the light in periods, mean grey level there, that of the fit, DN, and the standard
        deviation of the samples.
    smallest : Smallest or None
        Which defects this station would find.
    frames : tuple of FrameRow
    info : DeviceInfo
        What simulated the twin.
    warnings : tuple of str
    """

    station: Station
    numbers: tuple[Number, ...]
    unknown: tuple[str, ...]
    real: Texture
    twin: Texture
    light: LightFit
    fringes: Fringes
    transfer: Transfer
    aspect: Image
    region: Mask
    residual: Image
    fold: tuple[NDArray[np.float64], ...]
    smallest: Smallest | None
    frames: tuple[FrameRow, ...]
    info: DeviceInfo
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        said = {
            "light": f"{self.light.kind}, period {self.fringes.period_px} px",
            "level": f"{self.real.level_dn:.1f} DN, twin {self.twin.level_dn:.1f}",
            "noise": f"{self.real.noise_dn:.2f} DN, twin {self.twin.noise_dn:.2f}",
        }
        return object_of("Fit", self.about, said)

    def __getitem__(self, name: str) -> Measured:
        """Return one of the numbers by its name, e.g. ``"exposure"``."""
        return next(one.measured for one in self.numbers if one.name == name)

    @property
    def kind(self) -> str:
        """Which light it is: stripes, sinusoid or table."""
        return self.light.kind

    @property
    def about(self) -> str:
        """What was fitted, in a line."""
        used = [frame.name for frame in self.frames if frame.used]
        rows, columns = self.aspect.shape
        return f"{len(used)} frames, {used[0]} to {used[-1]}  ·  {columns} × {rows} px"

    def picture(self) -> Figure:
        """Draw the fit and what is left of it."""
        from gpuspec.pictures.twin import twin_picture

        return twin_picture(self)

    def save(self, path: str | Path, *, force: bool = False) -> None:
        """Write the twin's station file, and beside it the numbers (.json) and the picture (.png).

        Parameters
        ----------
        path : str or Path
            Of the station file, e.g. ``"twin.toml"``.
        force : bool
            Whether files are replaced that are not known to be of an earlier fit.

        Raises
        ------
        OutputError
            If a file is in the way, or cannot be written.
        """
        from gpuspec.report.twin import outputs, write_files

        read = tuple(frame.path for frame in self.frames if frame.path)
        with outputs(path, (*self.station.inputs, *read), force=force).writing() as partial:
            write_files(self, partial, Path(path).stem)


def fit(
    frames: Given,
    station: Station | str | Path | None = None,
    *,
    region: str | Path | Mask | None = None,
    dark: Given | None = None,
    colour: Colour | None = None,
    gaps: bool = False,
    defects: bool = True,
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> Fit:
    """Fit a station to the frames of an even part: its twin.

    Parameters
    ----------
    frames : str, Path, sequence of these, ndarray, or iterable of ndarray
        As of :func:`gpuspec.inspect`; whole periods of the light in equal steps.
    station : Station, str or Path, optional
        What is known: the scale (``camera.sampling_mm``, or the stripes' widths), the heights of
        camera and tunnel, the lens, a ``tunnel.profile`` if the light is known to be that,
        ``sensor.black_level_dn``, segmentation and classes. None: gpuspec's defaults.
    region : str, Path or ndarray of bool, optional
        Where the part is, see :func:`gpuspec.frames.outline.outlined`; None: the largest region
        over which the light passes.
    dark : as `frames`, optional
        Frames without light: they tell the black level and, two or more, the read noise.
    colour, gaps
        As of :func:`gpuspec.inspect`.
    defects : bool
        Whether the twin is asked which defects it finds.
    backend, device
        As of :func:`gpuspec.simulate`.
    progress : callable, optional
        Told in a few words what is being done.

    Returns
    -------
    Fit

    Raises
    ------
    FrameError
        If the frames are no whole periods, or as :func:`gpuspec.inspect`.
    StationError
        If the station cannot be read, or says another size or depth.

    Examples
    --------
    >>> light = {"profile": "sinusoid", "luminous_mm": 2.0, "dark_mm": 2.0}
    >>> real = gpuspec.Station(
    ...     part={"length_mm": 20.0, "width_mm": 10.0}, tunnel=light,
    ...     camera={"sampling_mm": 0.1, "pupil_mm": 3.0},
    ...     sensor={"exposure": 0.8, "noise": True}, sequence={"images": 12})
    >>> taken = gpuspec.simulate(real, "numpy").light_map
    >>> frames = [np.rint(taken.image(k)).astype(np.uint8) for k in range(12)]
    >>> found = gpuspec.fit(frames, real, region="0,0,200,100", defects=False, backend="numpy")
    >>> found.light.kind, bool(abs(found["exposure"].value - 0.8) < 0.005)
    ('sinusoid', True)
    """
    tell = progress or (lambda _: None)
    given = Station() if station is None else Station.of(station)
    if not isinstance(frames, (str, Path, np.ndarray, Sequence)):
        frames = list(frames)
    tell("looking at the frames")
    sequence = Sequenced.of(frames, colour=colour, gaps=gaps)
    one_mean = _fused_to_mean(given)
    sums, seen = added(sequence, one_mean, tell, ends=True)
    names = [frame.name for frame in seen.frames]
    chosen = whole_periods(seen.samples, names, rate=stated_rate(given))
    if not chosen.whole:
        raise FrameError(
            f"{len(seen.frames)} frames from {seen.frames[0].name} on are no whole period of the "
            f"light, as far as they tell; a fit needs frames until the first comes again."
        )
    every = seen.frames
    if chosen.why:
        sequence = sequence.only(range(chosen.first, chosen.last))
        sums, seen = added(sequence, one_mean, tell, ends=True)
    seen.check()
    depth = fitting(one_mean, seen).sensor.bit_depth
    assert seen.ends is not None
    high, low = seen.ends
    inside = lit_region(high - low) if region is None else outlined(region, seen.shape)
    count = len(seen.frames)
    periods = periods_of(np.stack(seen.samples))
    tell("finding the light's phase")
    waves = fringes((frame for _, frame in sequence), count, periods, inside)
    even = waves.even(inside)
    step, uneven, _ = steps((frame for _, frame in sequence), waves, even)
    samples = _samples(sequence, waves, even, periods, count)
    tell("reading dark frames" if dark is not None else "fitting light and noise")
    blacks = _dark(dark, seen.shape, even, colour)
    sensor = _sensor(given, depth, blacks)
    scale = Scale.of(given, waves, seen.shape)
    light, transfer, sensor = _light_and_noise(samples, sensor, scale, given, tell)
    aspect = sums.fused()
    residual, fold = _left(aspect, waves, even, inside, light, sensor, samples)
    tell("simulating the twin")
    real = texture(aspect, waves.phase, even, count / periods)
    station_of = twin_of(given, scale, light, transfer, sensor, count, periods, inside, blacks)
    plain, _ = _texture_of(station_of, scale, count / periods, backend, device)
    usual = float(np.median(light.gain(samples.place)))
    prnu = _uneven(real, plain, light, usual, sensor, int(np.count_nonzero(even)))
    station_of = station_of.replace(sensor={"prnu": round(prnu.value, 6)})
    twin, info = _texture_of(station_of, scale, count / periods, backend, device)
    found = None
    if defects:
        tell("asking the twin which defects it finds")
        found = smallest(station_of, backend, device)
    return Fit(
        station_of,
        known(scale, waves, step, uneven, light, transfer, prnu, blacks, station_of),
        unknown(given, scale, waves, light, transfer, real, twin, dark=dark is not None),
        real, twin, light, waves, transfer, aspect, inside, residual, fold, found,
        tuple(_rows(every, seen.frames, chosen.first, chosen.why)), info,
        (*(f"{every[k].name} is left out: {why}." for k, why in sorted(chosen.why.items())),
         *light.doubts),
    )  # fmt: skip


def _rows(
    every: tuple[FrameRow, ...], used: tuple[FrameRow, ...], first: int, why: dict[int, str]
) -> Iterable[FrameRow]:
    from dataclasses import replace

    for k, frame in enumerate(every):
        inside = 0 <= k - first < len(used)
        yield replace(frame, used=inside, why=why.get(k, ""))


def _fused_to_mean(given: Station) -> Station:
    """Return the station with a mean of its images; what it does not say stays unsaid."""
    if given.sequence.fusion == "mean":
        return given
    said = given.model_dump(mode="json", exclude_unset=True)
    said["sequence"] = {**said["sequence"], "fusion": "mean"}
    return Station.from_dict(said, given.file)


def _samples(sequence: Sequenced, waves: Fringes, even: Mask, periods: int, images: int) -> Samples:
    """Return the levels of some pixels in every image, and where on the light each is."""
    pixels = np.flatnonzero(even)
    pixels = pixels[:: max(1, pixels.size * images // _LOOKED_AT)]
    levels = np.stack([frame.ravel()[pixels] for _, frame in sequence], axis=1)
    row, column = np.divmod(pixels, even.shape[1])
    half = max(even.shape) / 2
    place = np.stack(
        [(column + 0.5 - even.shape[1] / 2) / half, (even.shape[0] / 2 - row - 0.5) / half], axis=1
    )
    turn = waves.phase.ravel()[pixels][:, None] - periods / images * np.arange(images)
    angle = np.radians(waves.direction_deg)
    across, down = (abs(float(part(angle))) / waves.period_px.value for part in (np.cos, np.sin))
    return Samples(levels, turn, place, across, down)


def _dark(
    given: Given | None, shape: tuple[int, int], even: Mask, colour: Colour | None
) -> Dark | None:
    """Return what dark frames tell: the black level and, of two or more, their noise."""
    if given is None:
        return None
    sums, spread = Accumulator(), Accumulator("std")
    for source, frame in Sequenced.of(given, colour=colour, gaps=True):
        name = str(source.path) if source else "the dark frame"
        if frame.shape != shape:
            raise FrameError(
                f"{name} has another size than the frames; take dark frames with the same camera."
            )
        sums.add(frame, name)
        spread.add(frame, name)
    levels = sums.fused()[even].astype(np.float64)
    black = Measured(float(levels.mean()), float(levels.std() / np.sqrt(levels.size)))
    if sums.count < 2:
        return Dark(black, None)
    square = float(np.mean(spread.fused()[even].astype(np.float64) ** 2))
    return Dark(black, float(np.sqrt(square * sums.count / (sums.count - 1))))


def _sensor(given: Station, depth: int, dark: Dark | None) -> Sensor:
    """Return the sensor to begin with: its black level is known, given, or taken as 0."""
    black = dark.black.value if dark else given.sensor.black_level_dn
    return Sensor.model_construct(
        **{**Sensor().model_dump(), "bit_depth": depth, "black_level_dn": black,
           "saturation_e": given.sensor.saturation_e,
           "read_noise_e": given.sensor.read_noise_e}
    )  # fmt: skip


def _light_and_noise(
    samples: Samples, sensor: Sensor, scale: Scale, given: Station, tell: Callable[[str], None]
) -> tuple[LightFit, Transfer, Sensor]:
    """Fit light and noise in turns."""
    kind: Kind | None = None
    if "profile" in given.tunnel.model_fields_set:
        profile = given.tunnel.profile
        kind = "table" if not isinstance(profile, str) else profile
    first = np.sqrt(np.maximum(sensor.full_scale_dn / 100, 1.0))
    noise: Callable[[NDArray[np.float64]], NDArray[np.float64]] = lambda y: np.full_like(y, first)  # noqa: E731
    light: LightFit | None = None
    for turn in range(_ROUNDS):
        tell(f"fitting light and noise, {turn + 1} of {_ROUNDS}")
        light = fit_light(
            samples, sensor, noise, pupil=scale.pupil_periods, kind=kind, before=light
        )
        kind = light.kind
        some = samples if turn == _ROUNDS - 1 else samples.some(_WEIGHED)
        gain = light.gain(some.place)[:, None]
        expected = light.levels(some.turn, gain, sensor)
        small = 1e-3
        slope = (
            light.levels(some.turn + small, gain, sensor)
            - light.levels(some.turn - small, gain, sensor)
        ) / (2 * small)
        black, full = sensor.black_level_dn, float(sensor.full_scale_dn)
        levels = some.levels.astype(np.float64)
        signal = light.signal(some.turn, gain) * (full - black)
        transfer = _transfer(levels, expected, signal, slope, sensor, kind)
        gain_dn = max(transfer.gain_dn_per_e.value, (full - black) / 1e7)
        sensor = sensor.model_copy(
            update={
                "saturation_e": (full - black) / gain_dn,
                "read_noise_e": float(np.sqrt(max(transfer.dark_dn2.value, 0.0))) / gain_dn,
            }
        )

        def noise(y: NDArray[np.float64]) -> NDArray[np.float64]:
            from gpuspec.light.float64_noise import unclipped_variance

            signal = np.maximum(y - black, 0) / (full - black)  # noqa: B023
            return np.sqrt(unclipped_variance(signal, sensor))  # noqa: B023

    assert light is not None
    return light, transfer, sensor


def _transfer(
    levels: NDArray[np.float64], expected: NDArray[np.float64], signal: NDArray[np.float64],
    slope: NDArray[np.float64], sensor: Sensor, kind: Kind,
) -> Transfer:  # fmt: skip
    """Return the photon transfer, the pixels' own taken off; or not, where that tells the gain.

    Stripes may leave a pixel few levels between dark and saturated.
    """
    refused: FrameError | None = None
    found = []
    for own in (True, False):
        try:
            one = photon_transfer(
                levels, expected, signal, slope, float(sensor.full_scale_dn), _noise_of(sensor),
                own=own,
            )  # fmt: skip
        except FrameError as error:
            refused = refused or error
        else:
            dark = one.dark_dn2
            if own or dark.value > -_LESS * dark.uncertainty:  # else the light left more than noise
                found.append(one)
        if kind != "stripes" or (found and _told(found[0]) < _TOLD):
            break
    if not found:
        assert refused is not None
        raise refused
    return min(found, key=_told)


def _noise_of(sensor: Sensor) -> Noise:
    def variance(signal: NDArray[np.float64], dark: float, gain: float) -> NDArray[np.float64]:
        full = sensor.full_scale_dn - sensor.black_level_dn
        sensed = sensor.model_copy(
            update={"saturation_e": full / gain, "read_noise_e": float(np.sqrt(dark)) / gain}
        )
        return grey_moments(signal / gain, sensed)[1]

    return variance


def _told(transfer: Transfer) -> float:
    gain = transfer.gain_dn_per_e
    return gain.uncertainty / gain.value


def _left(
    aspect: Image, waves: Fringes, even: Mask, inside: Mask, light: LightFit, sensor: Sensor,
    samples: Samples,
) -> tuple[Image, tuple[NDArray[np.float64], ...]]:  # fmt: skip
    """Return what is left of the aspect image without the fit, and the samples over the light."""
    rows, columns = aspect.shape
    half = max(aspect.shape) / 2
    x = (np.arange(columns) + 0.5 - columns / 2) / half
    y = (rows / 2 - np.arange(rows) - 0.5) / half
    grid = np.stack(np.meshgrid(x[::8], y[::8]), axis=-1).reshape(-1, 2)
    gains = light.gain(grid)
    some = np.linspace(gains.min(), gains.max(), 40)
    period = (np.arange(360) / 360)[None, :]
    means = light.levels(period, some[:, None], sensor).mean(axis=1)
    residual = np.zeros_like(aspect)
    for row in range(rows):
        place = np.column_stack([x, np.full(columns, y[row])])
        residual[row] = aspect[row] - np.interp(light.gain(place), some, means)
    residual[~inside] = 0
    gain = light.gain(samples.place)[:, None]
    expected = light.levels(samples.turn, gain, sensor)
    rest = samples.levels - expected
    bins = 120
    at = np.floor((samples.turn % 1) * bins).astype(np.intp).ravel()
    number = np.maximum(np.bincount(at, minlength=bins), 1)
    left = np.bincount(at, rest.ravel(), bins) / number
    spread = np.sqrt(np.bincount(at, rest.ravel() ** 2, bins) / number - left**2)
    middle = (np.arange(bins) + 0.5) / bins
    flawless = light.levels(middle, np.ones(bins), sensor)
    return residual, (middle, flawless + left, flawless, spread)


def _texture_of(
    station: Station, scale: Scale, images_per_period: float, backend: str | Backend,
    device: str | None,
) -> tuple[Texture, DeviceInfo]:  # fmt: skip
    """Simulate the twin of a piece of the part and measure its aspect image."""
    side = _CHECKED_PX * station.camera.sampling_mm
    piece = station.replace(
        part={
            "length_mm": min(station.part.length_mm, side),
            "width_mm": min(station.part.width_mm, side),
        }
    )
    found = simulate(piece, backend, device)
    columns = np.arange(found.aspect.shape[1]) / scale.period_px
    phase = columns + np.zeros((found.aspect.shape[0], 1))
    return texture(found.aspect, phase, found.lost == 0, images_per_period), found.info


def _uneven(
    real: Texture, plain: Texture, light: LightFit, gain: float, sensor: Sensor, pixels: int
) -> Measured:
    """Return the gain non-uniformity that makes the twin's noise the real one's."""
    turn, ends = (np.arange(720) / 720), gain * np.array([0.99, 1.01])[:, None]
    low, high = light.levels(turn, ends, sensor).mean(axis=1)
    rise = max(float(high - low) / 0.02, 1e-9) * band_gain()
    more = real.noise_dn**2 - plain.noise_dn**2
    # Of a robust deviation over correlated pixels: 0.37 of a normal one's, 28 px to a number.
    share = np.sqrt(1 / (2 * 0.37 * max(pixels / 28, 1)))
    spread = 2 * share * real.noise_dn**2 * np.sqrt(2)
    value = float(np.sqrt(max(more, 0.0))) / rise
    root = spread / (2 * rise**2 * value) if more > spread else np.sqrt(spread) / rise
    return Measured(value, float(root))
