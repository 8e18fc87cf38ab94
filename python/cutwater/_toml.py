"""Values of Python as TOML."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def value(of: object) -> str:
    """A TOML value in one line: texts, numbers, booleans, lists, mappings, numpy's scalars and arrays."""
    if hasattr(of, "tolist"):
        of = of.tolist()
    if isinstance(of, bool):
        return "true" if of else "false"
    if isinstance(of, int):
        return str(of)
    if isinstance(of, float):
        if math.isfinite(of):
            return repr(of)
        return "nan" if math.isnan(of) else "inf" if of > 0 else "-inf"
    if isinstance(of, os.PathLike):
        of = os.fspath(of)
    if isinstance(of, str):
        # TOML has no DEL in texts, and JSON's escapes otherwise.
        return json.dumps(of, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(of, Mapping):
        return "{ " + ", ".join(f"{key(name)} = {value(entry)}" for name, entry in of.items()) + " }"
    if isinstance(of, (list, tuple)):
        return "[" + ", ".join(map(value, of)) + "]"
    raise TypeError(f"a scene has texts, numbers, booleans, lists and dicts, not {type(of).__name__}")


def key(name: object) -> str:
    if not isinstance(name, str):
        raise TypeError(f"the keys of a scene are texts, not {type(name).__name__}")
    return name if _BARE.fullmatch(name) else json.dumps(name, ensure_ascii=False)


def document(tree: Mapping[str, object]) -> str:
    """A TOML document with a line per top-level key."""
    return "".join(f"{key(name)} = {value(entry)}\n" for name, entry in tree.items())
