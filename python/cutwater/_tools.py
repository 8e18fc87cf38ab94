"""Runs into folders, sweeps, plans and comparisons."""

from __future__ import annotations

import csv
import json
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from . import _core, _toml
from ._scene import Scene, _path, log_warnings, scene_of, steps_of
from ._simulation import Progress
from .errors import CheckError, CutwaterError, InputError

log = logging.getLogger("cutwater")

Source = Scene | str | os.PathLike[str] | Mapping[str, Any]


def adapters() -> list[dict[str, Any]]:
    """The GPU adapters: name, driver, API, kind, whether they have f64, and their largest buffer in bytes."""
    return json.loads(_core.adapters())


def plan(scene: Source, *, backend: str = "gpu", adapter: str | int | None = None) -> dict[str, Any]:
    """What a simulation of a scene consists of; nothing is simulated.

    Returns cells, dx (m), numbers of markers, nodes and elements, the first sub-step (s), effects with reasons, stages with kernels, solves, device
    buffers in bytes. Raises the errors that the simulation would raise for too small an adapter.
    """
    scene = scene_of(scene)
    log_warnings(scene)
    return json.loads(_core.plan(scene._core, backend, _text(adapter)))


def compare(scene: Source, *, frames: int = 1, adapter: str | int | None = None) -> dict[str, Any]:
    """Compares every stage of the GPU path with its float64 twin (docs/compare.md).

    Returns ``adapter``, ``steps``, ``passed`` and ``rows``: a list of dicts with stage, quantity, unit, count, largest and rms difference, ratio of
    the worst difference to the bound that rounding explains, and whether it is breached. ``pandas.DataFrame(result["rows"])`` is a table.
    """
    result = json.loads(_core.compare_stages(scene_of(scene)._core, frames, _text(adapter)))
    result["passed"] = not any(row["breached"] for row in result["rows"])
    return result


def run(
    scene: Source,
    out: str | os.PathLike[str],
    *,
    backend: str = "gpu",
    adapter: str | int | None = None,
    frames: int | None = None,
    overwrite: bool = False,
    resume: bool = False,
    keep_going: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Runs a scene into a folder, as ``cutwater run`` does: frames for ParaView and Blender, tables, checkpoints.

    ``progress`` is called after every sub-step with the frames done, their number, and the time in s. Ctrl-C, or an exception of ``progress``, saves
    a checkpoint and is raised; ``resume=True`` continues from it. Returns frames, steps, seconds, worst residual and counts of notices.
    """
    scene = scene_of(scene)
    log_warnings(scene)

    def listen(frame: int, n: int, time: float, notices: list[str]) -> None:
        for notice in notices:
            log.warning("%s: %s", scene.name, notice)
        if progress is not None:
            progress(frame, n, time)

    keywords = {
        "backend": backend,
        "adapter": _text(adapter),
        "out": Path(out),
        "frames": frames,
        "overwrite": overwrite,
        "resume": resume,
        "keep_going": keep_going,
    }
    return json.loads(_core.run(scene._core, keywords, listen))


def sweep(
    scene: Source,
    values: Mapping[str, Sequence[Any]],
    *,
    out: str | os.PathLike[str],
    jobs: int = 1,
    frames: int | None = None,
    backend: str = "gpu",
    adapter: str | int | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Runs a scene with every combination of values of some keys, each in a process and a folder of its own (docs/sweep.md).

    ``values`` are key paths and their values. Runs that are finished already are not repeated. Returns the columns of ``summary.csv`` as arrays, with
    ``folder``, a row per run in order: ``pandas.DataFrame(result)`` is a table. Ctrl-C ends the runs with checkpoints.

    Raises
    ------
    cutwater.errors.CheckError
        If a run did not finish; ``table`` of the exception has the columns.
    """
    scene, out = scene_of(scene), Path(out)
    file, settings = scene.file, dict(scene._settings)
    if file is None or scene._changes:
        out.mkdir(parents=True, exist_ok=True)
        file, settings = out / f"{scene.name}.toml", {}
        file.write_text(_toml.document(_with_absolute_files(scene.to_dict(), scene._file.parent)), encoding="utf-8")
    command = [*_program(), "sweep", str(file), "--out", str(out), "--jobs", str(jobs), "--scale", repr(scene.scale), "--backend", backend]
    axes = {_path(steps_of(key)): [_toml.value(value) for value in several] for key, several in values.items()}
    for key, value in settings.items():
        axes.setdefault(key, [value])
    for key, texts in axes.items():
        command += ["--set", f"{key}={','.join(texts)}"]
    if frames is not None:
        command += ["--frames", str(frames)]
    if adapter is not None and backend == "gpu":
        command += ["--adapter", str(adapter)]
    if overwrite:
        command.append("--overwrite")
    code, text = _supervised(command)
    summary = out / "summary.csv"
    if code == 130:
        raise KeyboardInterrupt
    if code != 0 and not (code == 1 and summary.exists()):
        message = text.rpartition("error: ")[2].strip() or f"cutwater sweep ended with exit code {code}"
        error: CutwaterError = InputError(message) if code == 2 else CutwaterError(message)
        error.problem, error.exit_code = message, code
        raise error
    table = _columns(summary)
    table["folder"] = np.array([str(out / str(name)) for name in table["folder"]])
    if code == 1:
        failed = CheckError(text.rpartition("error: ")[2].strip())
        failed.problem, failed.exit_code = str(failed), 1
        failed.table = table  # type: ignore[attr-defined]
        raise failed
    return table


def _with_absolute_files(part: Any, folder: Path) -> Any:
    """Part of a scene with the paths of its mesh files absolute; they are relative to a folder."""
    if isinstance(part, list):
        return [_with_absolute_files(entry, folder) for entry in part]
    if not isinstance(part, dict):
        return part
    absolute = {key: _with_absolute_files(entry, folder) for key, entry in part.items()}
    if isinstance(part.get("file"), str):
        absolute["file"] = str((folder / part["file"]).resolve())
    return absolute


def _supervised(command: list[str]) -> tuple[int, str]:
    """Exit code and standard error of a command; Ctrl-C is forwarded once and waited for."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True)
    lines = []
    try:
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line)
            log.info("%s", line.rstrip())
        code = process.wait()
    except KeyboardInterrupt:
        process.send_signal(signal.SIGINT)
        process.communicate()
        raise
    return code, "".join(lines)


def _columns(path: Path) -> dict[str, Any]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    columns: dict[str, Any] = {}
    for name in rows[0] if rows else []:
        texts = [row[name] for row in rows]
        try:
            numbers = np.array([float(text) if text else np.nan for text in texts])
            columns[name] = np.array(texts) if all(text == "" for text in texts) else numbers
        except ValueError:
            columns[name] = np.array(texts)
    return columns


def _program() -> list[str]:
    return [sys.executable, "-m", "cutwater"]


def _text(adapter: str | int | None) -> str | None:
    return None if adapter is None else str(adapter)
