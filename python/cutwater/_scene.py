"""Scenes."""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

from . import _core, _toml

log = logging.getLogger("cutwater")

_STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


def steps_of(key: str) -> list[str | int]:
    """Steps of a key path: ``solid[0].young`` and ``solid.0.young`` are ``["solid", 0, "young"]``."""
    steps: list[str | int] = []
    for part in key.split("."):
        found = _STEP.findall(part)
        if "".join(name or f"[{index}]" for name, index in found) != part or not found:
            raise KeyError(f"{key!r} is no key path: write one such as 'solid[0].young' or 'solid.0.young'")
        for name, index in found:
            steps.append(int(name or index) if (name or index).isdigit() else name)
    return steps


def _path(steps: list[str | int]) -> str:
    text = ""
    for step in steps:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text


class Scene:
    """A scene: what is simulated, in SI units. The keys are those of scene files (docs/scene.md).

    Parameters
    ----------
    source : path or dict
        A scene file (TOML), or a dict of the same structure.
    scale : float
        Multiplies the numbers of cells, rounded, and nothing else.
    name : str
        Name of a scene from a dict, for files and pictures.

    Examples
    --------
    >>> scene = cutwater.Scene("scenes/dam_break.toml", scale=0.32)
    >>> scene["solid[0].young"] = 2e6        # Pa; "solid.0.young" is the same
    >>> scene["domain.gravity"]
    [0.0, -9.81, 0.0]
    >>> del scene["liquid"]                  # and what refers to it

    Raises
    ------
    cutwater.errors.SceneError
        For an invalid value, with ``file``, ``line``, ``key``, ``problem`` and ``cure``. A value that is refused leaves the scene as it was.
    """

    def __init__(self, source: str | os.PathLike[str] | Mapping[str, Any], *, scale: float = 1.0, name: str = "scene") -> None:
        if isinstance(source, Mapping):
            self._file = Path(f"{name}.toml")
            self._text = _toml.document(source)
        else:
            self._file = Path(source)
            _core.Scene(self._file, None, [], float(scale))
            self._text = self._file.read_text(encoding="utf-8")
        self._from_file = not isinstance(source, Mapping)
        self._scale = float(scale)
        # Changes up to the last removal, and later values.
        self._changes: list[str] = []
        self._settings: dict[str, str] = {}
        self._change(self._changes, self._settings)

    def _change(self, changes: list[str], settings: dict[str, str]) -> None:
        overrides = changes + [f"{key}={value}" for key, value in settings.items()]
        core = _core.Scene(self._file, self._text, overrides, self._scale)
        self._tree: dict[str, Any] = json.loads(_core.scene_tree(self._file, self._text, overrides))
        self._core, self._changes, self._settings = core, changes, settings

    def copy(self) -> Scene:
        """An independent copy."""
        new = object.__new__(Scene)
        new.__dict__.update(self.__dict__)
        new._tree = deepcopy(self._tree)
        return new

    __copy__ = copy

    def __getitem__(self, key: str) -> Any:
        """The value of a key path as written in the scene; KeyError for a key that is not written and has its default."""
        at: Any = self._tree
        for step in steps_of(key):
            try:
                named = [entry for entry in at if entry.get("name") == step] if isinstance(at, list) and isinstance(step, str) else []
                at = named[0] if named else at[step]
            except (KeyError, IndexError, TypeError, AttributeError):
                raise KeyError(f"the scene does not write {key!r}; defaults are in docs/scene.md") from None
        return deepcopy(at)

    def __contains__(self, key: str) -> bool:
        try:
            self[key]
        except KeyError:
            return False
        return True

    def get(self, key: str, default: Any = None) -> Any:
        """The value of a key path, or a default."""
        return self[key] if key in self else default

    def __setitem__(self, key: str, value: Any) -> None:
        """Sets a key path. Missing tables are created; a new entry of a list needs the whole list."""
        self.update({key: value})

    def update(self, values: Mapping[str, Any]) -> None:
        """Sets several key paths at once: all of them, or none if the scene with them is refused."""
        settings = dict(self._settings)
        for name, value in values.items():
            steps = steps_of(name)
            path, text = _path(steps), _toml.value(value)
            # Later settings win, and those below this key are gone with it.
            for old in [old for old in settings if old == path or old.startswith((f"{path}.", f"{path}["))]:
                del settings[old]
            settings[path] = text
        self._change(self._changes, settings)

    def __delitem__(self, key: str) -> None:
        """Removes a part and what refers to it, as :meth:`without` does."""
        self._remove(key)

    def without(self, *keys: str) -> Scene:
        """A copy without some parts, such as ``"liquid"``, ``"solid[0]"``, ``"solid.wall"`` or ``"domain.open.+x"``.

        Parts that refer to a removed one are removed too, as by ``--without`` of the command line; :attr:`removed` lists them. All indices are those
        before the removal; indices of the copy count what remains.
        """
        new = self.copy()
        if keys:
            new._remove(*keys)
        return new

    def _remove(self, *keys: str) -> None:
        changes = [*self._changes, *(f"{key}={value}" for key, value in self._settings.items())]
        removals = [f"without {_path(steps_of(key))}" for key in keys]
        # Its indices count what earlier removals left.
        self._change([*changes, f"then {removals[0]}", *removals[1:]], {})

    @property
    def removed(self) -> list[str]:
        """Parts that were removed because they refer to a removed one."""
        return self._core.removed

    def to_dict(self) -> dict[str, Any]:
        """The scene as a dict, with all changes and without the scale."""
        return deepcopy(self._tree)

    def to_toml(self) -> str:
        """The scene as TOML, with all changes and without the scale."""
        return _toml.document(self._tree)

    @property
    def name(self) -> str:
        """Name: that of the file without ``.toml``."""
        return self._core.name

    @property
    def file(self) -> Path | None:
        """The scene file; None for a scene from a dict."""
        return self._file if self._from_file else None

    @property
    def scale(self) -> float:
        """Factor of the numbers of cells."""
        return self._scale

    @property
    def cells(self) -> tuple[int, int, int]:
        """Cells along x, y, z, scaled."""
        nx, ny, nz = self._core.cells
        return nx, ny, nz

    @property
    def dx(self) -> float:
        """Cell size, m."""
        return self._core.dx

    @property
    def n_frames(self) -> int:
        """Frames of the duration, without frame 0."""
        return self._core.n_frames

    def warnings(self) -> list[str]:
        """What the grid or the meshes do not resolve, one sentence each."""
        return self._core.warnings()

    def _repr_lines(self) -> str:
        cells = " x ".join(map(str, self.cells))
        return f"Scene {self.name!r}: {cells} cells of {self.dx:.4g} m, {self.n_frames} frames"

    def __repr__(self) -> str:
        return f"<{self._repr_lines()}>"


def scene_of(source: Scene | str | os.PathLike[str] | Mapping[str, Any]) -> Scene:
    """A scene, or the one of a path or dict."""
    return source if isinstance(source, Scene) else Scene(source)


def log_warnings(scene: Scene) -> None:
    for warning in scene.warnings():
        log.warning("%s: %s", scene.name, warning)
