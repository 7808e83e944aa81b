"""What a station costs: images, tunnel, light, exposure time, and time per part."""

from __future__ import annotations

from gpuspec.station.station import Station

COSTS = ("images", "tunnel_mm", "light_e", "exposure_s", "cycle_s")
"""Names of the costs; lower is better."""


def costs(station: Station) -> dict[str, float | int | None]:
    """Return what a station costs.

    An image takes as long as it is exposed, and no less than the camera's frame rate allows; a part
    takes all its images.

    Parameters
    ----------
    station : Station

    Returns
    -------
    dict
        By `COSTS`: images; length of the tunnel, mm; electrons per image of a fully luminous
        footprint; exposure time, s, None without ``sensor.light_e_per_s``; cycle time per part, s,
        None without ``sequence.frame_rate_hz`` and without the former.

    Examples
    --------
    >>> from gpuspec.station.costs import costs
    >>> station = gpuspec.example("trim").replace(sensor__light_e_per_s=1e6)
    >>> costs(station)
    {'images': 40, 'tunnel_mm': 1000.0, 'light_e': 40000.0, 'exposure_s': 0.04, 'cycle_s': 1.6}
    >>> costs(station.replace(sequence__frame_rate_hz=10.0))["cycle_s"]
    4.0
    """
    sensor, sequence = station.sensor, station.sequence
    exposure = sensor.exposure_s
    rate = sequence.frame_rate_hz
    spans = [span for span in (exposure, 1 / rate if rate else None) if span is not None]
    return {
        "images": sequence.images,
        "tunnel_mm": station.tunnel.length_mm,
        "light_e": sensor.light_e,
        "exposure_s": exposure,
        "cycle_s": sequence.images * max(spans) if spans else None,
    }
