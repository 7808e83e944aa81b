"""Turns pydantic's errors into sentences that name file, key, value and what is allowed."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError

_ALLOWED = {
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "finite_number": "must be a finite number",
    "literal_error": "must be {expected}",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be a text in quotes",
    "string_unicode": "must be text that can be written as UTF-8",
    "string_too_short": "must not be empty",
    "string_too_long": "must have at most {max_length} characters",
    "too_short": "must have at least {min_length} entries",
    "too_long": "must have at most {max_length} entries",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "union_tag_not_found": "must say its kind, such as kind = 'dent'",
    "int_parsing_size": "is too large for a whole number",
}


def explain(error: ValidationError, model: type[BaseModel], file: str) -> list[str]:
    """Return one sentence per wrong value.

    Parameters
    ----------
    error : pydantic.ValidationError
        What pydantic found.
    model : type of BaseModel
        The model that was validated, to look known keys up.
    file : str
        Named at the head of each sentence.
    """
    sentences: dict[str, str] = {}
    items = error.errors(include_url=False)
    for item in items:
        if item["type"] == "too_short" and any(
            other["loc"][: len(item["loc"])] == item["loc"] for other in items if other is not item
        ):
            continue  # pydantic does not count entries that are wrong themselves
        if (
            item["type"] == "literal_error"
            and isinstance(item["input"], (list, tuple))
            and any(
                other["loc"][: len(item["loc"]) - 1] == item["loc"][:-1]
                and len(other["loc"]) > len(item["loc"])
                for other in items
            )
        ):
            continue  # a list was meant, and its entries are wrong
        last = item["loc"][-1:] if item["type"] == "extra_forbidden" else ()
        inner = item["loc"][: len(item["loc"]) - len(last)]
        location = tuple(part for part in inner if not _is_branch(part)) + last
        key = _dotted(location)
        head = f"{file}: {key}" if key else file
        allowed = ""
        if item["type"] == "value_error":
            told = str(item["ctx"]["error"])
            stated = f" = {_short(item['input'])} " if told.startswith("must") else ": "
            text = f"{head}{stated}{told}."
        elif item["type"] == "extra_forbidden":
            text = f"{head} is not a known key{_suggestion(item['loc'], model)}."
        elif item["type"] == "missing":
            text = f"{head} is missing."
        elif item["type"] == "union_tag_invalid":
            kind, kinds = _short(item["input"]["kind"]), item["ctx"]["expected_tags"]
            text = f"{head}.kind = {kind} must be one of {kinds}."
        else:
            template = _ALLOWED.get(item["type"])
            context = dict(item.get("ctx", {}))
            allowed = template.format(**context) if template else item["msg"]
            if head in sentences:
                allowed = _number(model, location) or allowed
            text = f"{head} = {_short(item['input'])} {allowed}."
        # A union such as "auto" | number reports every branch; the last says what else is allowed.
        if head in sentences and item["type"] not in ("extra_forbidden", "missing"):
            text = f"{sentences[head].rstrip('.')}, or {allowed}." if allowed else text
        sentences[text if key == "" else head] = text
    return list(sentences.values())


def choices(model: type[BaseModel], place: Sequence[int | str]) -> set[Any]:
    """Return the values of which a key takes one; empty: others, or there is no such key.

    Parameters
    ----------
    model : type of BaseModel
        In which the key is looked up.
    place : sequence of str and int
        Its path, entries of lists by their index.
    """
    return {choice for annotation in _annotations(model, place) for choice in _literals(annotation)}


def _annotations(model: type[BaseModel], place: Sequence[int | str]) -> list[Any]:
    """Return what a key may be annotated with; lists are looked through."""
    found: list[Any] = [model]
    for step in place:
        if isinstance(step, str):
            fields = [m.model_fields for annotation in found for m in _models(annotation)]
            found = [known[step].annotation for known in fields if step in known]
    return found


def _number(model: type[BaseModel], place: Sequence[int | str]) -> str:
    """Return "a whole number from 1 to 16" of a key that takes such a one or a word; "": another.

    Whatever is wrong with a value, both ends are told: it may have been meant for either.
    """
    for annotation in _annotations(model, place):
        for branch in get_args(annotation) if _literals(annotation) else ():
            kind, *about = get_args(branch) if get_origin(branch) is Annotated else (None,)
            bounds = [bound for field in about for bound in getattr(field, "metadata", ())]
            ends = [getattr(b, end) for end in ("ge", "le") for b in bounds if hasattr(b, end)]
            if kind in (int, float) and len(ends) == 2:
                what = "a whole number" if kind is int else "a number"
                return f"{what} from {ends[0]} to {ends[1]}"
    return ""


def _literals(annotation: Any) -> list[Any]:
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    return [choice for argument in get_args(annotation) for choice in _literals(argument)]


def _is_branch(part: int | str) -> bool:
    """Whether a step of the location is pydantic's name for a branch of a union, not a key."""
    kinds = {"dent", "bump", "scratch", "measured"}
    kinds |= {"float", "int", "str", "bool", "constrained-float", "constrained-int"}
    return isinstance(part, str) and (part in kinds or "[" in part or "(" in part)


def _dotted(location: tuple[int | str, ...]) -> str:
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f"[{part + 1}]"
        else:
            bare = re.fullmatch(r"[A-Za-z0-9_-]{1,60}", part)
            text += ("." if text else "") + (part if bare else _short(part))
    return text


def _short(value: Any) -> str:
    try:
        if isinstance(value, bool):
            text = str(value).lower()
        elif isinstance(value, str):
            writable = value.encode("utf-8", "backslashreplace").decode("utf-8")
            text = json.dumps(writable, ensure_ascii=False)
        elif isinstance(value, (list, tuple)):
            text = f"[{', '.join(map(_short, value[:20]))}{', ...' if len(value) > 20 else ''}]"
        else:
            text = "{...}" if isinstance(value, dict) else str(value)
    except (ValueError, RecursionError):  # Python writes no integer of more than 4,300 digits
        text = "(too long to show)"
    return text if len(text) <= 60 else text[:57] + "..."


def _suggestion(location: tuple[int | str, ...], model: type[BaseModel]) -> str:
    known = _keys_beside(location, model)
    wrong = str(location[-1])
    close = difflib.get_close_matches(wrong, known, n=1, cutoff=0.5)
    close += [key for key in known if key.split("_")[0] == wrong.split("_")[0]]
    return f" (did you mean {close[0]}?)" if close else f"; known here are {', '.join(known)}"


def _keys_beside(location: tuple[int | str, ...], model: type[BaseModel]) -> list[str]:
    """Keys of the (sub)model in which the unknown key stands."""
    current: list[type[BaseModel]] = [model]
    for part in location[:-1]:
        if isinstance(part, int):
            continue
        fields = [m.model_fields[part].annotation for m in current if part in m.model_fields]
        if fields:
            current = [m for f in fields for m in _models(f)]
        else:  # the tag of a union: keep the models of that kind
            current = [
                m
                for m in current
                if "kind" not in m.model_fields
                or part in get_args(m.model_fields["kind"].annotation)
            ]
    return sorted({name for m in current for name in m.model_fields})


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for argument in get_args(annotation) for m in _models(argument)]
