"""What is measured on each blob: size, weight, place, extent and shape.

Size and weight are the measures by which the paper (Seulin, Merienne, Gorria) tells defects apart;
the ellipse of same second moments is the usual description of shape. Lengths are on the part's base
plane z = 0, where one pixel is the sampling distance wide.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import numpy.typing as npt

from gpuspec.arrays import GreyLevels, LabelImage, check_label_image
from gpuspec.shown import data_frame, html_table

__all__ = ["Blobs", "measure_blobs"]

Integers = npt.NDArray[np.int64]
Reals = npt.NDArray[np.float64]

PIXEL_VARIANCE = 1 / 12
"""Variance of a uniform distribution one pixel wide, px²."""

ROUNDING = 1e-9
"""Share of the mean variance below which an imbalance of the second moments is rounding."""

_PIXEL_COLUMNS = ("row", "column", "top", "left", "bottom", "right")


@dataclass(frozen=True, eq=False)
class Blobs:
    """A table of blobs: one 1-d array per measure, one element per blob, by increasing label.

    Attributes
    ----------
    label : (n,) int64 array
        Value in the label image.
    area_px, area_mm2 : (n,) arrays
        Size, in pixels and on the part.
    weight_dn, net_weight_dn : (n,) arrays
        Sum of the grey levels, and of the grey levels above the flawless level.
    peak_dn : (n,) array
        Highest grey level.
    row, column : (n,) arrays
        Centroid in index coordinates: (0, 0) is the centre of the first pixel.
    x_mm, y_mm : (n,) arrays
        Centroid in the part frame.
    top, left, bottom, right : (n,) int64 arrays
        Box in pixels, half-open: rows top ≤ r < bottom, columns left ≤ c < right.
    major_mm, minor_mm : (n,) arrays
        Axes of the ellipse of same second moments, four standard deviations long; each pixel is a
        square, not a point, so that a single pixel has axes too.
    orientation_rad : (n,) array
        Direction of the major axis, counter-clockwise from +x with y up, in (-π/2, π/2]; 0 for a
        blob without a major axis.
    elongation : (n,) array
        major_mm / minor_mm, from 1.

    Raises
    ------
    ValueError
        If the columns are not 1-d arrays of one length.
    """

    label: Integers
    area_px: Integers
    area_mm2: Reals
    weight_dn: Reals
    net_weight_dn: Reals
    peak_dn: Reals
    row: Reals
    column: Reals
    x_mm: Reals
    y_mm: Reals
    top: Integers
    left: Integers
    bottom: Integers
    right: Integers
    major_mm: Reals
    minor_mm: Reals
    orientation_rad: Reals
    elongation: Reals

    def __post_init__(self) -> None:
        """Check that the columns make a table."""
        for name, column in self._columns().items():
            if column.shape != (self.label.size,):
                raise ValueError(
                    f"Column {name} is {column.shape}; {self.label.size} blobs were expected."
                )

    def __len__(self) -> int:
        """Return the number of blobs."""
        return self.label.size

    def __repr__(self) -> str:
        return f"Blobs({len(self)}: {', '.join(field.name for field in fields(self))})"

    def _repr_html_(self) -> str:
        """Show itself in a notebook: a line for each of the first blobs."""
        return html_table(self.rows(), len(self))

    def _columns(self) -> dict[str, npt.NDArray[Any]]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def _heads(self) -> list[str]:
        return [f"{n}_px" if n in _PIXEL_COLUMNS else n for n in self._columns()]

    def _check_classes(self, classes: Sequence[str] | None) -> None:
        if classes is not None and len(classes) != len(self):
            raise ValueError(f"There are {len(classes)} classes for {len(self)} blobs.")

    def rows(self) -> list[dict[str, int | float]]:
        """Return one dict per blob, measure name to plain int or float."""
        columns = self._columns()
        values = zip(*(column.tolist() for column in columns.values()), strict=True)
        return [dict(zip(columns, row, strict=True)) for row in values]

    def to_pandas(self, classes: Sequence[str] | None = None) -> Any:
        """Return the table for pandas, with the heads of its CSV.

        Parameters
        ----------
        classes : sequence of str, optional
            Class of each blob, as a last column ``class``.

        Returns
        -------
        pandas.DataFrame
            A row per blob.

        Raises
        ------
        ExtraError
            If pandas is not installed.
        ValueError
            If there is not one class per blob.

        Examples
        --------
        >>> import gpuspec as gs
        >>> result = gs.simulate(gs.example("trim").replace(camera__sampling_mm=0.5), "numpy")
        >>> table = result.blobs.to_pandas(result.classes)
        >>> len(table) == len(result.blobs)
        True
        """
        self._check_classes(classes)
        columns: dict[str, Any] = dict(zip(self._heads(), self._columns().values(), strict=True))
        return data_frame(columns if classes is None else columns | {"class": classes})

    def write_csv(
        self, path_or_file: str | Path | TextIO, classes: Sequence[str] | None = None
    ) -> None:
        """Write the table as CSV, units in the header, nine significant digits.

        Parameters
        ----------
        path_or_file : str, Path or text file
            Where to write; a file given open stays open.
        classes : sequence of str, optional
            Class of each blob, written as a last column ``class``.

        Raises
        ------
        ValueError
            If there is not one class per blob.
        """
        self._check_classes(classes)
        if isinstance(path_or_file, str | Path):
            with Path(path_or_file).open("w", newline="", encoding="utf-8") as file:
                self.write_csv(file, classes)
            return
        header = self._heads()
        rows: list[list[int | str]] = [
            [v if isinstance(v, int) else format(v, ".9g") for v in row.values()]
            for row in self.rows()
        ]
        if classes is not None:
            header.append("class")
            for row, name in zip(rows, classes, strict=True):
                row.append(str(name))
        writer = csv.writer(path_or_file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def measure_blobs(
    labels: LabelImage, aspect: GreyLevels, *, sampling_mm: float, flawless_dn: float
) -> Blobs:
    """Measure every blob of a label image.

    Parameters
    ----------
    labels : (M, N) integer array
        Label image; 0 is no blob. Labels may have gaps and need not be connected.
    aspect : (M, N) array
        Aspect image, DN.
    sampling_mm : float
        Sampling distance on the part, mm per pixel.
    flawless_dn : float
        Grey level of the flawless surface, DN, taken off in the net weight.

    Returns
    -------
    Blobs
        One row per label present, by increasing label.

    Raises
    ------
    ValueError
        If the shapes disagree, `labels` are not integers from 0, a grey level in a blob is not a
        finite number, `sampling_mm` is not positive or `flawless_dn` is not finite.

    Notes
    -----
    With the variances v of the pixel centres about the centroid, plus 1/12 px² for the pixel's own
    square, the axes are 4·√λ, λ = (v_xx + v_yy)/2 ± √[((v_xx − v_yy)/2)² + v_xy²], and the
    orientation is ½·atan2(2·v_xy, v_xx − v_yy).

    Examples
    --------
    >>> from gpuspec.detection.measures import measure_blobs
    >>> labels = np.array([[1, 1, 1, 1], [0, 0, 0, 0], [0, 0, 0, 2]])
    >>> blobs = measure_blobs(labels, 80.0 * (labels > 0), sampling_mm=0.1, flawless_dn=60.0)
    >>> blobs.area_px.tolist(), blobs.net_weight_dn.tolist(), blobs.elongation.round(2).tolist()
    ([4, 1], [80.0, 20.0], [4.0, 1.0])
    >>> blobs.x_mm.round(3).tolist(), blobs.y_mm.round(3).tolist()
    ([0.0, 0.15], [0.1, -0.1])
    """
    check_label_image("labels", labels)
    if aspect.shape != labels.shape or aspect.dtype.kind not in "iuf":
        raise ValueError(
            f"aspect must be an array of grey levels of {labels.shape}, "
            f"not {aspect.dtype} of {aspect.shape}."
        )
    if not (np.isfinite(sampling_mm) and sampling_mm > 0):
        raise ValueError(f"sampling_mm is {sampling_mm}; it must be finite and above 0.")
    if not np.isfinite(flawless_dn):
        raise ValueError(f"flawless_dn is {flawless_dn}; it must be finite.")

    rows, columns = labels.shape
    detected = np.flatnonzero(labels != 0)
    label_of_pixel = labels.ravel()[detected].astype(np.intp)
    level = aspect.ravel()[detected].astype(np.float64)
    if not np.isfinite(level).all():
        raise ValueError("aspect is not a finite number at a pixel of a blob.")

    present = np.bincount(label_of_pixel) > 0
    label = np.flatnonzero(present)
    blob = (np.cumsum(present) - 1)[label_of_pixel]
    n = label.size
    r, c = np.divmod(detected, columns)

    def total(values: npt.NDArray[Any]) -> Reals:
        return np.bincount(blob, values, minlength=n).astype(np.float64, copy=False)

    area = np.bincount(blob, minlength=n)
    row, column = total(r) / area, total(c) / area

    # Centred first: far from the origin, squares of raw coordinates would cancel.
    x, y = c - column[blob], row[blob] - r
    v_xx = total(x * x) / area + PIXEL_VARIANCE
    v_yy = total(y * y) / area + PIXEL_VARIANCE
    v_xy = total(x * y) / area
    mean, spread = (v_xx + v_yy) / 2, np.hypot((v_xx - v_yy) / 2, v_xy)
    major = 4 * sampling_mm * np.sqrt(mean + spread)
    minor = 4 * sampling_mm * np.sqrt(np.maximum(mean - spread, PIXEL_VARIANCE))
    orientation = np.arctan2(_even(2 * v_xy, mean), _even(v_xx - v_yy, mean)) / 2

    # Pixels come row by row, and of repeated indices the last assignment stays.
    top, bottom = np.empty(n, np.int64), np.empty(n, np.int64)
    top[blob[::-1]] = r[::-1]
    bottom[blob] = r + 1
    left, right = np.full(n, columns), np.zeros(n, np.int64)
    np.minimum.at(left, blob, c)
    np.maximum.at(right, blob, c + 1)
    peak = np.full(n, -np.inf)
    np.maximum.at(peak, blob, level)

    return Blobs(
        label=label,
        area_px=area,
        area_mm2=area.astype(np.float64) * sampling_mm**2,
        weight_dn=total(level),
        net_weight_dn=total(level - flawless_dn),
        peak_dn=peak,
        row=row,
        column=column,
        x_mm=(column + 0.5 - columns / 2) * sampling_mm,
        y_mm=(rows / 2 - row - 0.5) * sampling_mm,
        top=top,
        left=left,
        bottom=bottom,
        right=right,
        major_mm=major,
        minor_mm=minor,
        orientation_rad=orientation,
        elongation=major / minor,
    )


def _even(imbalance: Reals, mean: Reals) -> Reals:
    """Zero what is only rounding, lest it choose a round blob's axis or an upright one's sign."""
    return np.where(np.abs(imbalance) <= ROUNDING * mean, 0.0, imbalance)
