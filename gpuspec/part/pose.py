"""Where the camera and the tunnel are in the part's frame: two rigid motions, exact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.station.sections import Pose
from gpuspec.station.station import Station

Array = NDArray[np.float64]
_NONE = Pose()


@dataclass(frozen=True)
class Frames:
    """The part's frame among the others.

    A camera that is not posed has its frame where the station's is: its pupil at (0, 0, h), looking
    down at the plane z = 0, which is in focus.

    Attributes
    ----------
    view : ndarray, shape (3, 3)
        The camera's axes, in columns, in the part's frame.
    middle : ndarray, shape (3,)
        Where the camera's axis meets its plane in focus, in the part's frame, mm.
    turn : ndarray, shape (3, 3)
        The part's axes, in columns, in the station's frame.
    origin : ndarray, shape (3,)
        The part's origin in the station's frame, mm.
    """

    view: Array
    middle: Array
    turn: Array
    origin: Array

    @classmethod
    def of(cls, station: Station) -> Frames:
        """Work them out from the poses of part and camera.

        Parameters
        ----------
        station : Station

        Examples
        --------
        >>> from gpuspec.part.pose import Frames
        >>> station = gpuspec.example("trim").replace(part__pose={"shift_x_mm": 2.0})
        >>> Frames.of(station).middle.tolist()  # the camera looks at what was 2 mm to the left
        [-2.0, 0.0, 0.0]
        """
        return cls.between(station.part.pose, station.camera.pose, station.camera.height_mm)

    @classmethod
    def between(cls, part: Pose | None, camera: Pose | None, height_mm: float) -> Frames:
        """Work them out from the poses themselves.

        Parameters
        ----------
        part, camera : Pose or None
        height_mm : float
            From the camera's pupil to its plane in focus.
        """
        h = np.array([0.0, 0.0, height_mm])
        part, camera = part or _NONE, camera or _NONE
        turn, origin = np.array(part.axes), np.array(part.shift_mm)
        axes = np.array(camera.axes)
        middle = h + np.array(camera.shift_mm) - axes @ h
        return cls(turn.T @ axes, turn.T @ (middle - origin), turn, origin)

    def rays(self, station: Station, x_mm: Array, y_mm: Array) -> tuple[Array, Array]:
        """Return where rays pass the camera's plane in focus, and their directions I.

        Parameters
        ----------
        station : Station
            Its camera's distance h is used.
        x_mm, y_mm : ndarray
            On the camera's plane in focus, of one shape.

        Returns
        -------
        points, directions : ndarray of float64, shape (3, ...)
            In the part's frame; a direction has the length at which h of it is the distance.
        """
        x, y = np.broadcast_arrays(x_mm, y_mm)
        on_plane = np.stack([x, y, np.zeros(x.shape)])
        points = np.tensordot(self.view, on_plane, 1)
        away = self.view[:, 2].reshape(3, *[1] * x.ndim)
        directions = points / station.camera.height_mm - away
        return points + self.middle.reshape(away.shape), directions

    def in_station(self, points: Array) -> Array:
        """Return points of the part's frame, shape (..., 3), in the station's, mm.

        Parameters
        ----------
        points : ndarray of float64, shape (..., 3)
        """
        there: Array = points @ self.turn.T + self.origin
        return there

    def in_camera(self, points: Array) -> Array:
        """Return points of the part's frame, shape (..., 3), in the camera's, mm.

        Parameters
        ----------
        points : ndarray of float64, shape (..., 3)
        """
        there: Array = (points - self.middle) @ self.view
        return there

    def pupil(self, station: Station) -> Array:
        """Return the middle of the camera's pupil in the part's frame, shape (3,), mm.

        Parameters
        ----------
        station : Station
            Its camera's distance h is used.
        """
        pupil: Array = self.middle + station.camera.height_mm * self.view[:, 2]
        return pupil

    def seen(self, station: Station, points: Array) -> Array:
        """Return x and y on the camera's plane in focus at which points of the part are seen.

        Parameters
        ----------
        station : Station
            Its camera's distance h is used.
        points : ndarray of float64, shape (..., 3)
            In the part's frame, mm.

        Returns
        -------
        ndarray of float64, shape (..., 2)
            Not finite of what is not before the camera.
        """
        of_camera = self.in_camera(points)
        nearer = 1 - of_camera[..., 2:] / station.camera.height_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            found: Array = np.where(nearer > 0, of_camera[..., :2] / nearer, np.nan)
        return found
