"""What is wrong with a table, in the words of the person who wrote it.

msgspec says at which path a value was refused and by which single bound; this adds both bounds, the allowed
names, the key that was probably meant, and the value found.
"""

from __future__ import annotations

import difflib
import functools
import json
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec import inspect

if TYPE_CHECKING:
    import numpy as np

LISTED = 5
"""Things that a message lists, however many there are."""

SHOWN = 80
"""Characters of a value that a message shows, however long it is."""

_WORDS = {
    r"\barray": "an array",
    r"\bobject": "a table",
    r"\bstr\b": "a string",
    r"\bint\b": "a whole number",
    r" \| ": " or ",
}
"""msgspec's words for types, and those of people who write scene files."""


def in_words(message: str, table: Any, root: type[msgspec.Struct]) -> str:
    """One line `path: expected …, got …`.

    Args:
        message: Of the msgspec.ValidationError that converting `table` to `root` raised.
        table: What was converted.
        root: The struct that it was converted to.
    """
    text, _, path = message.partition(" - at `$")
    if " - at `key`" in message:
        return "expected keys that are strings"
    path = path.rstrip("`").lstrip(".")
    found, kind = _found(path, table, root)
    got = f"got {shown(found)}"
    field_name = re.search(r"field `([^`]*)`", text)
    if field_name and "unknown" in text:
        path = f"{path}.{field_name[1]}".lstrip(".")
        return f"{path}: no such key; {nearest(field_name[1], _keys(kind))}"
    if field_name:
        keys = shown(sorted(map(str, found or ())))
        return f"{path or 'scene'}: expected a key {field_name[1]!r}, got {keys}"
    tag = path.endswith("kind") and isinstance(kind, inspect.UnionType)
    if tag or "Invalid enum value" in text or isinstance(kind, inspect.LiteralType):
        return f"{path}: expected {_one_of(kind)}, {got}"
    if isinstance(kind, inspect.FloatType | inspect.IntType):
        return f"{path}: expected {_range(kind)}, {got}"
    expected = text.partition(", got ")[0].replace("`", "").removeprefix("Expected ")
    for theirs, ours in _WORDS.items():
        expected = re.sub(theirs, ours, expected)
    return f"{path}: expected {expected}, {got}"


def _found(path: str, table: Any, root: type[msgspec.Struct]) -> tuple[Any, inspect.Type | None]:
    """What stands at `path` of the table, and the type that belongs there."""
    kind: inspect.Type | None = _described(root)
    found = table
    for part in re.findall(r"[^.\[\]]+", path):
        kind = _inner(_member(kind, found), part)
        try:
            found = found[int(part)] if isinstance(found, list | tuple) else found[part]
        except (LookupError, ValueError, TypeError):
            return None, kind
    return found, _member(kind, found)


_described = functools.cache(inspect.type_info)


def _member(kind: inspect.Type | None, found: Any) -> inspect.Type | None:
    """Of a union, the member that is meant: the struct of that `kind`, or the one that is not None."""
    if not isinstance(kind, inspect.UnionType):
        return kind
    structs = [t for t in kind.types if isinstance(t, inspect.StructType)]
    tag = found.get("kind") if isinstance(found, dict) else None
    chosen = next((t for t in structs if t.tag == tag and tag is not None), None)
    others = [t for t in kind.types if not isinstance(t, inspect.NoneType)]
    return chosen or (kind if len(others) > 1 else others[0])


def _inner(kind: inspect.Type | None, part: str) -> inspect.Type | None:
    if isinstance(kind, inspect.StructType):
        return next((f.type for f in kind.fields if f.encode_name == part), None)
    if isinstance(kind, inspect.UnionType) and part == "kind":
        return kind
    if isinstance(kind, inspect.TupleType) and part.isdigit() and int(part) < len(kind.item_types):
        return kind.item_types[int(part)]
    return getattr(kind, "item_type", None)


def _keys(kind: inspect.Type | None) -> list[str]:
    names = [f.encode_name for f in kind.fields] if isinstance(kind, inspect.StructType) else []
    return [name for name in names if name not in ("folder", "source")]


def nearest(name: Any, known: Iterable[str]) -> str:
    """The likeliest of the `known` names for a mistyped one, or all of them."""
    known = list(known)
    close = difflib.get_close_matches(str(name), known, n=2)
    return f"did you mean {' or '.join(close)}?" if close else f"expected one of {', '.join(known)}"


def _one_of(kind: inspect.Type | None) -> str:
    if isinstance(kind, inspect.UnionType):
        values = [t.tag for t in kind.types if isinstance(t, inspect.StructType)]
    else:
        values = getattr(kind, "values", ())
    prefix = "one of " if len(values) > 1 else ""
    return prefix + ", ".join(json.dumps(value) for value in values)


def _range(kind: inspect.FloatType | inspect.IntType) -> str:
    bounds = [
        f"≥ {kind.ge:g}" if kind.ge is not None else "",
        f"≤ {kind.le:g}" if kind.le is not None else "",
    ]
    words = " and ".join(filter(None, bounds))
    if isinstance(kind, inspect.IntType):
        return f"a whole number {words}".strip()
    return words or "a finite number"


def shown(value: Any) -> str:
    """A value that was refused, as Python writes it, no longer than a line has room for."""
    try:
        text = repr(value)
    except ValueError:  # Python writes out no whole number of more than some thousands of digits
        return "a number of thousands of digits"
    return text if len(text) < SHOWN else text[: SHOWN - 3] + "…"


def counted(n: int, one: str, many: str = "") -> str:
    """`n` and what there are so many of."""
    return f"{n:,} {one if n == 1 else many or one + 's'}"


def listed(things: Sequence[object] | np.ndarray) -> str:
    """The first few of `things`, and whether there are more."""
    return ", ".join([str(thing) for thing in things[:LISTED]] + ["…"] * (len(things) > LISTED))
