"""Exceptions of cutwater.

Every exception says what is wrong, where, and what to do; ``cure`` has the last part. ``exit_code`` is that of the command line.
"""

from __future__ import annotations

import os
import re

__all__ = [
    "AdapterError",
    "CheckError",
    "CutwaterError",
    "DeviceError",
    "HostMemoryError",
    "InputError",
    "InternalError",
    "LimitError",
    "OutputError",
    "SceneError",
    "StageError",
]


class CutwaterError(Exception):
    """Base of all exceptions of cutwater."""

    problem: str = ""
    """What is wrong."""
    cure: str = ""
    """What to do; may be empty."""
    exit_code: int = 4
    """Exit code of the command line for the same error."""


class SceneError(CutwaterError, ValueError):
    """A value of a scene is invalid."""

    file: str | None = None
    """The scene file; None for a value set in Python."""
    line: int | None = None
    """Its line in the file, from 1; None for a value set in Python. A scene from a dict has the line of its TOML text, one per top-level key."""
    key: str = ""
    """Dotted key, such as ``liquid.region[1].box.min``."""


class InputError(CutwaterError, ValueError):
    """A file or an argument is unusable."""

    what: str = ""
    """The file or argument."""


class OutputError(CutwaterError, OSError):
    """A file cannot be written."""

    file: str = ""
    """The file or folder."""


class AdapterError(CutwaterError):
    """There is no suitable GPU adapter."""


class LimitError(CutwaterError):
    """The scene exceeds a limit of the adapter."""

    what: str = ""
    """The buffer or kernel."""


class HostMemoryError(CutwaterError, MemoryError):
    """The scene needs more of the machine's memory than is free."""


class StageError(CutwaterError):
    """A stage of a sub-step failed, such as a solve that broke down."""

    stage: str = ""
    """The stage."""
    step: int = 0
    """The sub-step, from 0."""


class DeviceError(CutwaterError):
    """The device reported an error, or was lost."""


class CheckError(CutwaterError):
    """The simulator failed a check against itself."""


class InternalError(CutwaterError):
    """A bug of cutwater. The simulation that raised it cannot continue."""


# Options of the command line in messages, and how they are written here.
_OPTIONS = [
    (r"--backend (cpu|gpu)", r'backend="\1"'),
    (r"--(overwrite|resume)", r"\1=True"),
    (r"--keep-going", "keep_going=True"),
    (r"--set ([\w.\[\]]+)=(\S+)", r'scene["\1"] = \2'),
    (r"--without ([\w.\[\]+-]+)", r'del scene["\1"]'),
    (r"--(adapter|frames|out|scale) (?=[\w.])", r"\1="),
    (r"--(adapter|frames|out|scale)", r"\1"),
]


def _in_python(text: str) -> str:
    for option, written in _OPTIONS:
        text = re.sub(option, written, text)
    return text


def exception(kind: str, message: str, **fields: object) -> CutwaterError:
    """Builds an exception; called by the extension module."""
    what = str(fields.get("what", ""))
    if what.startswith("--set "):
        # A value that Python set. The problem, or what is wrong, may begin with a key below it.
        setting, _, key = what.removeprefix("--set ").partition(": ")
        name, _, value = setting.partition("=")
        problem = str(fields["problem"])
        first, _, rest = problem.partition(": ")
        if not key and rest and " " not in first:
            key, problem = first, rest
        kind = "SceneError"
        fields = {"key": key or name, "problem": problem, "cure": fields["cure"], "exit_code": 2}
        place = "" if key in ("", name) else f"{key}: "
        message = f'scene["{name}"] = {value}: {place}{problem}\n  cure: {fields["cure"]}'
    if what.startswith("--without "):
        kind, fields = "SceneError", {**fields, "key": what.removeprefix("--without ")}
    error = globals()[kind](_in_python(message))
    for field, content in fields.items():
        text = os.fspath(content) if isinstance(content, os.PathLike) else content
        setattr(error, field, _in_python(text) if isinstance(text, str) and field != "file" else text)
    return error
