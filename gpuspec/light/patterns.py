"""A light's pattern as a user writes it: one small GLSL function, run for every ray and shift."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from gpuspec.errors import PatternError
from gpuspec.light.sources import folder

SIGNATURES = {
    "pattern": "float pattern(float light, float across, float shift, float footprint)",
    "picture": "float picture(vec2 place, float light, float across, float footprint, int k)",
}
_BYTES_MAX = 1_000_000
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_NOT_GLSL = {
    r"/\*": "a comment begins here, /*, and is never closed; close it with */.",
    r"[^\t\n\f\r -~]": "{!r} is no character of GLSL outside comments.",
}


@dataclass(frozen=True)
class Pattern:
    """A pattern's text.

    Attributes
    ----------
    text : str
        GLSL that defines ``pattern`` (the light's radiance, 0 to 1, averaged over a footprint) or
        ``picture`` (the relative irradiance of a pixel in image k: the whole image one's own).
    file : str
        Named in the compiler's messages.
    kind : str
        Which of the two it defines.

    Examples
    --------
    >>> pattern = gpuspec.Pattern.read("sinusoidal")
    >>> pattern.kind, pattern.lines
    ('pattern', 8)
    """

    text: str
    file: str
    kind: str

    @property
    def defines(self) -> tuple[str, ...]:
        """Words that tell the shaders about it."""
        return ("PATTERN", "PICTURE") if self.kind == "picture" else ("PATTERN",)

    @property
    def lines(self) -> int:
        """Number of the last line with text."""
        return len(self.text.rstrip().splitlines())

    @classmethod
    def read(cls, path: str | Path) -> Pattern:
        """Read a pattern from a file, or a shipped one by name.

        Raises
        ------
        PatternError
            If it is not there, not text, or defines neither function or both.

        Examples
        --------
        >>> gpuspec.Pattern.read("binary").file
        'binary.glsl'
        >>> gpuspec.Pattern.read("fringe")
        Traceback (most recent call last):
            ...
        gpuspec.errors.PatternError: fringe: no such pattern; give a .glsl file or one of
            binary, checkerboard, sinusoidal, warped.
        """
        path = Path(path)
        if not path.exists() and str(path) in shipped():
            path = folder("shaders") / "patterns" / f"{path}.glsl"
        try:
            data = path.read_bytes()
            text = data.decode("utf-8-sig")
        except FileNotFoundError:
            raise PatternError(
                f"{path}: no such pattern; give a .glsl file or one of {', '.join(shipped())}."
            ) from None
        except (OSError, UnicodeDecodeError) as error:
            raise PatternError(f"{path}: cannot be read as UTF-8 text ({error}).") from None
        if len(data) > _BYTES_MAX:
            raise PatternError(f"{path}: more than {_BYTES_MAX:,} bytes is no pattern.")
        return cls.parse(text, path.name)

    @classmethod
    def parse(cls, text: str, file: str) -> Pattern:
        """Take a pattern from text.

        Parameters
        ----------
        text : str
            GLSL.
        file : str
            Its name in messages.

        Raises
        ------
        PatternError
            If it defines neither function or both, reads files and versions of its own, or leaves a
            comment or a condition open.

        Examples
        --------
        >>> head = "float pattern(float light, float across, float shift, float footprint)"
        >>> gpuspec.Pattern.parse(head + " { return 0.5; }", "even.glsl").kind
        'pattern'
        >>> gpuspec.Pattern.parse("float half() { return 0.5; }", "half.glsl")
        Traceback (most recent call last):
            ...
        gpuspec.errors.PatternError: half.glsl: must define one of
          float pattern(float light, float across, float shift, float footprint) { ... }
          float picture(vec2 place, float light, float across, float footprint, int k) { ... }
        """
        bare = _COMMENT.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), text)
        for word, why in _NOT_GLSL.items():
            for found in re.finditer(word, bare):
                line = bare.count("\n", 0, found.start()) + 1
                raise PatternError(f"{file}:{line}: {why.format(found[0])}")
        for word in ("#version", "#include", "#line", "#extension"):
            if word in bare:
                raise PatternError(f"{file}: {word} is not for a pattern; it is set around it.")
        opened = [found[1] for found in re.finditer(r"^\s*#\s*(if|endif)", bare, re.MULTILINE)]
        if opened.count("if") > opened.count("endif"):
            raise PatternError(f"{file}: an #if has no #endif.")
        kinds = [
            kind for kind in SIGNATURES if re.search(rf"\bfloat\s+{kind}\s*\([^)]*\)\s*\{{", bare)
        ]
        if len(kinds) > 1:
            raise PatternError(
                f"{file}: defines both `pattern`, a light, and `picture`, a whole image; only one "
                f"can be shown: keep one, or give the other another name."
            )
        if kinds:
            return cls(text, file, kinds[0])
        wanted = "\n  ".join(signature + " { ... }" for signature in SIGNATURES.values())
        raise PatternError(f"{file}: must define one of\n  {wanted}")


def shipped() -> tuple[str, ...]:
    """Return the names of the patterns that come with gpuspec."""
    return tuple(sorted(path.stem for path in (folder("shaders") / "patterns").glob("*.glsl")))
