"""What of a camera cannot be, or is not simulated as it is."""

from __future__ import annotations

from gpuspec.simulation.view import depth_mm, view_mm
from gpuspec.station.optics import diffraction_mtf50, magnification
from gpuspec.station.station import Station

_FLAT_MM = 1e-3
"""Height up to which a part counts as flat where its distance is told."""


def of_camera(station: Station) -> list[str]:
    """Say where the camera is out of focus, better than optics allow, or its opening too small.

    Parameters
    ----------
    station : Station
    """
    return [*_of_lens(station), *_of_focus(station), *of_view(station)]


def _of_lens(station: Station) -> list[str]:
    camera = station.camera
    said = []
    if camera.focal_mm and camera.f_number and camera.mtf50_lp_per_mm:
        factor = magnification(camera.focal_mm, camera.focus_mm or camera.height_mm)
        limit = diffraction_mtf50(camera.f_number, factor, station.tunnel.wavelength_nm)
        if camera.mtf50_lp_per_mm > limit:
            said.append(
                f"camera.mtf50_lp_per_mm = {camera.mtf50_lp_per_mm:g} is more than any lens has at "
                f"f/{camera.f_number:g}: diffraction leaves half the contrast at {limit:.3g} lp/mm."
            )
    return said


def _of_focus(station: Station) -> list[str]:
    camera = station.camera
    nearest, farthest, spot = depth_mm(station)
    if spot <= camera.sampling_mm:
        return []
    pixels = spot / camera.sampling_mm
    where = f"{nearest:.6g} mm"
    if farthest - nearest > _FLAT_MM:
        where = f"{nearest:.6g} to {farthest:.6g} mm"
    if camera.focus_mm is not None:
        return [
            f"the part is out of focus: it is {where} from the pupil, which is focused at "
            f"camera.focus_mm = {camera.focus_mm:g}, and a point of it is a spot of up to "
            f"{pixels:.3g} pixels. Blobs are as much wider."
        ]
    return [
        f"the part is deeper than the depth of field: it is {where} from the pupil, and a point "
        f"off the plane in focus is a spot of up to {pixels:.3g} pixels. It is taken as in focus "
        f"everywhere; camera.focus_mm = {camera.height_mm:g} blurs it as it would be."
    ]


def of_view(station: Station) -> list[str]:
    """Say where the opening is smaller than what the camera looks through.

    Parameters
    ----------
    station : Station
    """
    tunnel = station.tunnel
    if not tunnel.opening_length_mm:
        return []
    view = view_mm(station)
    if tunnel.opening_length_mm >= view[0] and tunnel.opening_width_mm >= view[1]:
        return []
    return [
        f"the camera does not see all through its opening of {tunnel.opening_length_mm:g} x "
        f"{tunnel.opening_width_mm:g} mm: its cone of sight, from the whole pupil, is "
        f"{view[0]:.3g} x {view[1]:.3g} mm there; the tunnel is taken as transparent "
        f"to the camera itself."
    ]
