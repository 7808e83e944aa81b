"""What a GLSL compiler says of a user's pattern, in the lines of the user's own file."""

from __future__ import annotations

import re

from gpuspec.light.patterns import SIGNATURES, Pattern

_LINE = re.compile(
    r"^(?P<head>ERROR: |WARNING: )?(?:(?P<file>[^:\n]+):(?P<line>\d+):)?\s*(?P<said>.*)$"
)
_NAGA = {
    r'UnknownVariable\("(.*)"\)': r"\1 is not declared",
    r'SemanticError\("(.*)"\)': r"\1",
    r'NotImplemented\("(.*)"\)': r"not known to wgpu's GLSL: \1",
    r"PreprocessorError\((.*)\)": r"preprocessor: \1",
    r"InvalidToken\((.*), \[(.*)\]\)": "",
}
_TOKENS = {
    r"Token\((\w+)\)": r"\1",
    r'Identifier\("(\w*)"\)': r"\1",
    r"TypeName\(.*": "a type",
    r"(?:Float|Int|Double)Constant\(\w+ \{ value: ([-\d.e]+).*?\}\)": r"\1",
}
_SIGNS = {
    "Semicolon": "';'", "Comma": "','", "LeftBrace": "'{'", "RightBrace": "'}'",
    "LeftParen": "'('", "RightParen": "')'", "LeftBracket": "'['", "RightBracket": "']'",
    "Eof": "the end of the file", "Identifier": "a name", "Assign": "'='", "Return": "'return'",
    "Dot": "'.'", "Void": "'void'",
}  # fmt: skip
# wgpu numbers what it speaks of; names stand beside some of the numbers.
_HANDLES = {
    r" Some\(\[\d+\]\)": "", r"\[\d+\] (?=')": "", r"\[\d+\]": "a value", r"\bNone\b": "nothing",
}  # fmt: skip
_FUNCTION = re.compile(r"Function \[\d+\] '(\w+)' is invalid")
_VARIABLE = re.compile(r"Local variable \[\d+\] '(\w+)' is invalid")


def own_lines(log: str, pattern: Pattern) -> str:
    """Return what a compiler says of the user's file, errors first, each with file and line.

    The program's own shaders stand around the pattern: what a compiler warns of in them, and what
    an error makes of them, is left out. Only where nothing is said of the user's file are the
    errors beyond it told, with what the file must define.

    Parameters
    ----------
    log : str
        A message a line, those with a place as ``file:line: message``.
    pattern : Pattern
    """
    errors: list[str] = []
    warnings: list[str] = []
    beyond: list[str] = []
    for line in log.splitlines():
        found = _LINE.match(line)
        if not found or not found["said"]:
            continue
        said = _in_words(found["said"])
        warned = found["head"] == "WARNING: " or said.startswith("warning")
        if found["file"] == pattern.file:
            (warnings if warned else errors).append(_placed(pattern, int(found["line"]), said))
        elif not warned and (found["file"] or "error" in said.lower()):
            beyond.append(said)
    invalid = _FUNCTION.search(log)
    if not errors and invalid:
        errors = [_unplaced(log, invalid[1], pattern)]
    if not errors:
        wanted = SIGNATURES[pattern.kind]
        errors = [f"{pattern.file}: {said}" for said in beyond or [log.strip()]]
        warnings = [f"It is met where the program takes up {pattern.file}, which must define "
                    f"{wanted}.", *warnings]  # fmt: skip
    return "\n".join(dict.fromkeys([*errors, *warnings]))


def _placed(pattern: Pattern, line: int, said: str) -> str:
    """Say where a message is; the line after the last one closes the user's text."""
    last = pattern.lines
    if line <= last:
        return f"{pattern.file}:{line}: {said}"
    return (
        f"{pattern.file}:{last}: the text ends too early, is a brace or a semicolon missing? {said}"
    )


def _in_words(said: str) -> str:
    """Return a message of wgpu's compiler in words; others as they are."""
    for kind, text in _NAGA.items():
        found = re.fullmatch(kind, said)
        if not found:
            continue
        said = f"error: {found.expand(text)}"
        if kind.startswith("InvalidToken"):
            said = f"error: unexpected {_token(found[1])}, expecting " + " or ".join(
                map(_token, found[2].split(", "))
            )
        return said
    return said


def _token(name: str) -> str:
    """Return what stands in the text for a token of wgpu's compiler."""
    for kind, text in _TOKENS.items():
        found = re.match(kind, name)
        if found:
            name = found.expand(text)
    return _SIGNS.get(name, name)


def _unplaced(log: str, function: str, pattern: Pattern) -> str:
    """Return what wgpu says of a whole function, with the line where it, or a variable, begins."""
    reason = ": ".join(re.findall(r"^ *= (.*)", log, re.MULTILINE) or [log.strip()])
    line, text = 1, pattern.text.splitlines()
    variable = _VARIABLE.search(log)
    for name in (f"{function}\\s*\\(", *([f"{variable[1]}\\b"] if variable else [])):
        line += next((n for n, t in enumerate(text[line - 1 :]) if re.search(rf"\b{name}", t)), 0)
    for number, words in _HANDLES.items():
        reason = re.sub(number, words, reason)
    return f"{pattern.file}:{line}: error in {function}: {reason}"
