"""Which files are meant by a folder, a pattern or a list, in natural order, none missing."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

from gpuspec.errors import FrameError

READ = frozenset({".png", ".tif", ".tiff"})
"""Ends of the names of files that are read."""
PICTURES = READ | {
    ".jpg", ".jpeg", ".bmp", ".gif", ".webp", ".jp2", ".pgm", ".ppm", ".raw", ".dng", ".heic",
}  # fmt: skip
"""Ends of names that tell a picture, read or not."""
_NUMBER = re.compile(r"(\d+)")


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return a key by which names are put in the order in which people count: 2 before 10.

    Parameters
    ----------
    name : str

    Examples
    --------
    >>> from gpuspec.frames.series import natural
    >>> sorted(["img_10.png", "img_2.png"], key=natural)
    ['img_2.png', 'img_10.png']
    """
    pieces = _NUMBER.split(name)
    return tuple((0, int(one), one) if n % 2 else (1, 0, one) for n, one in enumerate(pieces))


def found(sources: Sequence[str | Path], *, gaps: bool = False) -> tuple[Path, ...]:
    """Return the files that are meant, in natural order.

    Parameters
    ----------
    sources : sequence of str or Path
        Folders, patterns such as ``"shots/img_*.png"``, and files.
    gaps : bool
        Whether numbers may be missing in the series.

    Raises
    ------
    FrameError
        If there is none, one stands twice, a folder holds other pictures, or a number is missing.

    Examples
    --------
    >>> from pathlib import Path
    >>> from gpuspec.frames.series import found
    >>> for number in (10, 9, 11):
    ...     Path(f"img_{number}.png").touch()
    >>> [path.name for path in found(["img_*.png"])]
    ['img_9.png', 'img_10.png', 'img_11.png']
    >>> for number in (7, 8, 12):
    ...     Path(f"img_{number}.png").touch()
    >>> Path("img_10.png").unlink()
    >>> found(["img_*.png"])
    Traceback (most recent call last):
        ...
    gpuspec.errors.FrameError: img_10.png is missing between img_9.png and img_11.png: a
        sequence with a hole has another mean; take it again, or allow it (--gaps) if it was left
        out on purpose.
    """
    paths: list[Path] = []
    for source in sources:
        if not isinstance(source, (str, Path)) or not str(source).strip():
            raise FrameError(f"frames are named by a folder, a pattern or a file, not {source!r}.")
        paths += _of(Path(source))
    if not paths:
        raise FrameError("no frames are named; give a folder, a pattern or files.")
    seen: dict[Path, Path] = {}
    for path in paths:
        if path.resolve() in seen:
            raise FrameError(f"{path} stands twice among the frames; name each file once.")
        seen[path.resolve()] = path
    paths.sort(key=lambda path: (natural(str(path.parent)), natural(path.name)))
    if not gaps:
        _check_whole(paths)
    return tuple(paths)


def _of(source: Path) -> list[Path]:
    """Return the files of one name."""
    try:
        if source.is_dir():
            return _of_folder(source)
        if source.exists():
            return [source]
        if any(sign in source.name for sign in "*?["):
            return _of_pattern(source)
    except (OSError, ValueError) as error:  # impossible names
        raise FrameError(f"{str(source)[:200]!r} cannot be looked up: {error}.") from None
    raise FrameError(f"{source} is not there; name a folder, a pattern or files of frames.")


def _of_folder(folder: Path) -> list[Path]:
    files = [
        path for path in folder.iterdir()
        if path.suffix.lower() in PICTURES and not path.name.startswith(".") and path.is_file()
    ]  # fmt: skip
    if not files:
        raise FrameError(f"{folder} holds no PNG or TIFF; name the folder of the frames.")
    kinds = Counter(_NUMBER.sub("#", path.name) for path in files)
    if len(kinds) > 1:
        shown = "; ".join(_shown(files, kind, count) for kind, count in kinds.most_common(3))
        more = "; ..." if len(kinds) > 3 else ""
        read = [kind for kind, _ in kinds.most_common() if Path(kind).suffix.lower() in READ]
        example = f", e.g. '{folder / read[0].replace('#', '*')}'" if read else ", PNG or TIFF"
        raise FrameError(
            f"{folder} holds pictures of several names ({shown}{more}); name those that are "
            f"meant{example}."
        )
    return files


def _shown(files: Iterable[Path], kind: str, count: int) -> str:
    first = min((p.name for p in files if _NUMBER.sub("#", p.name) == kind), key=natural)
    return first if count == 1 else f"{first} and {count - 1} more"


def _of_pattern(pattern: Path) -> list[Path]:
    files = [path for path in pattern.parent.glob(pattern.name) if path.is_file()]
    if not files:
        raise FrameError(f"no file is named like {pattern}; check the pattern and its folder.")
    return files


def _check_whole(paths: Sequence[Path]) -> None:
    """See that the numbers in the names of a series go on without a hole."""
    names = [path.name for path in paths]
    if len(names) < 3 or len({_NUMBER.sub("#", name) for name in names}) > 1:
        return
    columns = list(zip(*(map(int, _NUMBER.findall(name)) for name in names), strict=True))
    steps = [[after - before for before, after in pairwise(column)] for column in columns]
    varying = [(number, step) for number, step in enumerate(steps) if any(step)]
    if any(len(set(step)) == 1 for _, step in varying):
        return
    for number, step in varying:
        usual, times = Counter(step).most_common(1)[0]
        if usual <= 0 or 2 * times < len(step):
            continue  # a time, not a count
        at = next(n for n, one in enumerate(step) if one != usual)
        count = step[at] // usual - 1
        missing = _renumbered(names[at], number, columns[number][at] + usual)
        more = f" and {count - 1} more" if count > 1 else ""
        raise FrameError(
            f"{missing}{more} {'are' if more else 'is'} missing between {names[at]} and "
            f"{names[at + 1]}: a sequence with a hole has another mean; take it again, or allow it "
            f"(--gaps) if it was left out on purpose."
        )


def _renumbered(name: str, number: int, value: int) -> str:
    """Return a name with another value in place of one of its numbers, as many digits long."""
    pieces = _NUMBER.split(name)
    pieces[2 * number + 1] = str(value).zfill(len(pieces[2 * number + 1]))
    return "".join(pieces)
