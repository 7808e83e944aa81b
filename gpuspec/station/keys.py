"""The reference of the station file: every key with its unit, range, choices and default.

Made from the models themselves, through the JSON schema that `gpuspec schema` prints.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from gpuspec.errors import StationError
from gpuspec.station.station import Station

_UNITS = {
    "_mm": "mm", "_um": "µm", "_mm2": "mm²", "_per_cm2": "1/cm²", "_rad": "rad", "_e": "e⁻",
    "_dn": "DN", "_lp_per_mm": "lp/mm", "_deg": "°", "_nm": "nm", "_hz": "Hz", "_e_per_s": "e⁻/s",
}  # fmt: skip
_LISTS = {"defects", "populations", "edges", "classes", "decision"}
HEAD = """\
# The station file, key by key

Written by `gpuspec reference`; `gpuspec reference tunnel` shows one section. A key that is left out
has its default; none means that nothing is set, as `--set KEY=none` does. The file is TOML:
`[[defects]]` begins an entry of a list. A key is set from the command line with
`--set tunnel.height_mm=120`, in a list with `--set defects[2].depth_um=3`.

"""


@dataclass(frozen=True)
class Key:
    """A key of the station file.

    Attributes
    ----------
    section : str
        Where it stands, e.g. ``tunnel``, ``part.relief`` or ``defects: scratch``.
    name, unit, takes, default, meaning : str
        `unit` is empty for counts, choices and ratios; `takes` says type, range and choices;
        `default` is ``"required"`` where there is none.
    """

    section: str
    name: str
    unit: str
    takes: str
    default: str
    meaning: str

    @property
    def listed(self) -> bool:
        """Whether it stands in the entries of a list: ``defects[1].depth_um``."""
        return self.section.partition(":")[0] in _LISTS

    @property
    def path(self) -> str:
        """The key's place in a station: ``tunnel.height_mm``, ``defects.depth_um``."""
        return f"{self.section.partition(':')[0]}.{self.name}"


def keys(start: str = "") -> tuple[Key, ...]:
    """Return the keys of the station file in their order.

    Parameters
    ----------
    start : str
        A section or key, such as ``"tunnel"`` or ``"camera.sampling_mm"``; "": all.

    Raises
    ------
    StationError
        If there is no such section or key.

    Examples
    --------
    >>> from gpuspec.station.keys import keys
    >>> [key.name for key in keys("sequence")]
    ['images', 'step_mm', 'fusion', 'lag', 'frame_rate_hz']
    >>> keys("camera.pupil_mm")[0].meaning
    'diameter of the lens pupil; 0: pinhole'
    """
    schema = Station.model_json_schema()
    found = tuple(_section("", schema, schema))
    wanted = re.sub(r"\[\d*\]", "", start)  # defects[2].depth_um is defects.depth_um here
    chosen = tuple(key for key in found if not wanted or f"{key.path}.".startswith(f"{wanted}."))
    if not chosen:
        sections = ", ".join(dict.fromkeys(key.section.partition(":")[0] for key in found))
        raise StationError(f"{start} is no section or key of a station file; sections: {sections}.")
    return chosen


def markdown(chosen: tuple[Key, ...], *, head: bool = True) -> str:
    """Return keys as Markdown, a table for each section, under a title and a paragraph.

    Parameters
    ----------
    chosen : tuple of Key
    head : bool
        Whether the title and the paragraph are written.

    Returns
    -------
    str
    """
    text, section = [HEAD] if head else [], ""
    for key in chosen:
        if key.section != section:
            text.append(f"{chr(10) * bool(section)}## {_heading(key.section)}\n\n")
            section = key.section
            text.append("| key | unit | takes | default | meaning |\n")
            text.append("| --- | --- | --- | --- | --- |\n")
        cells = (f"`{key.name}`", key.unit, key.takes, key.default, key.meaning)
        text.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n")
    return "".join(text)


def _heading(section: str) -> str:
    name, _, kinds = section.partition(": ")
    brackets = f"[[{name}]]" if name in _LISTS else f"[{name}]"
    return f"`{brackets}`" + (f", kind {kinds}" if kinds else "")


def _section(path: str, table: dict[str, Any], schema: dict[str, Any]) -> Iterator[Key]:
    """Yield a table's own keys, then those of the tables in it."""
    inner = []
    for name, node in sorted(table["properties"].items(), key=lambda item: item[0] != "kind"):
        below = f"{path}.{name}" if path else name
        tables = [] if _is_distribution(node, schema) else _tables(node, schema)
        if tables:
            inner.append((below, tables))
        else:
            required = name in table.get("required", ())
            yield Key(
                path, name, _unit(name), _takes(node, schema),
                "required" if required else _value(node.get("default")),
                node.get("description", ""),
            )  # fmt: skip
    for below, tables in inner:
        for found in tables:
            kinds = found["properties"].get("kind", {})
            named = " or ".join(kinds.get("enum", [kinds["const"]] if "const" in kinds else []))
            yield from _section(f"{below}: {named}" if named else below, found, schema)


def _resolved(node: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    if "$ref" in node:
        found: dict[str, Any] = schema["$defs"][node["$ref"].rpartition("/")[2]]
        return found
    return node


def _branches(node: dict[str, Any], schema: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what a node may be, none left out."""
    node = _resolved(node, schema)
    several = node.get("anyOf") or node.get("oneOf") or [node]
    return [_resolved(one, schema) for one in several if one.get("type") != "null"]


def _tables(node: dict[str, Any], schema: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the tables that a node may be, or a list of which it is."""
    branches = _branches(node, schema)
    items = [one["items"] for one in branches if isinstance(one.get("items"), dict)]
    branches += [below for item in items for below in _branches(item, schema)]
    return [one for one in branches if one.get("type") == "object" and "properties" in one]


def _is_distribution(node: dict[str, Any], schema: dict[str, Any]) -> bool:
    return any("median" in one.get("properties", {}) for one in _branches(node, schema))


def _unit(name: str) -> str:
    ends = [end for end in _UNITS if name.endswith(end)]
    return _UNITS[max(ends, key=len)] if ends else ""


def _takes(node: dict[str, Any], schema: dict[str, Any]) -> str:
    if _is_distribution(node, schema):
        (table,) = (one for one in _branches(node, schema) if "properties" in one)
        bounds = _range(table["properties"]["low"])
        return f"number {bounds}, or [from, to], or {{median, spread, low, high}}"
    return " or ".join(_one(branch, schema) for branch in _branches(node, schema))


def _one(node: dict[str, Any], schema: dict[str, Any]) -> str:
    if "const" in node or "enum" in node:
        return ", ".join(_value(choice) for choice in node.get("enum", [node.get("const")]))
    kind = node.get("type")
    if kind == "array":
        if "prefixItems" in node:
            return f"a pair of {_one(node['prefixItems'][0], schema)}"
        least = f", at least {node['minItems']}" if "minItems" in node else ""
        return f"list of {_takes(node['items'], schema)}{least}"
    if kind == "object":
        return "table of " + _takes(node["additionalProperties"], schema)
    names = {"integer": "whole number", "boolean": "true or false", "string": "text"}
    bounds = _range(node)
    return names.get(str(kind), "number") + (f" {bounds}" if bounds else "")


def _range(node: dict[str, Any]) -> str:
    low = [_value(node[key]) for key in ("minimum", "exclusiveMinimum") if key in node]
    high = [_value(node[key]) for key in ("maximum", "exclusiveMaximum") if key in node]
    above = "> " if "exclusiveMinimum" in node else "" if high else "≥ "
    below = "< " if "exclusiveMaximum" in node else ""
    return " to ".join([above + value for value in low] + [below + value for value in high])


def _value(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return f"{value:,.10g}" if abs(value) >= 1e-4 or value == 0 else f"{value:.9f}".rstrip("0")
    if isinstance(value, str):
        return f'"{value}"'
    return "none" if value in ([], {}) else str(value)
