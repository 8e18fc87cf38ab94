"""Simulations."""

from __future__ import annotations

import logging
import math
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _core
from ._frame import Frame
from ._scene import Scene, log_warnings, scene_of
from ._system import System, read_system

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

log = logging.getLogger("cutwater")

Progress = Callable[[int, int, float], object]


class State:
    """State of a simulation. The same scene on the same backend and device resumes from it bitwise. It can be pickled."""

    def __init__(self, core: _core.State) -> None:
        self._core = core

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._core.time

    @property
    def step(self) -> int:
        """Sub-steps done."""
        return self._core.step

    @property
    def frame(self) -> int:
        """Frames done."""
        return self._core.frame

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the state, in the format of a run's ``checkpoint.npz``. ``numpy.load`` opens it."""
        self._core.save(Path(path))

    @staticmethod
    def load(path: str | os.PathLike[str]) -> State:
        """Reads a saved state, or the ``checkpoint.npz`` of a run."""
        return State(_core.State.load(Path(path)))

    def __eq__(self, other: object) -> bool:
        """Whether all numbers are bitwise the same."""
        return isinstance(other, State) and self._core == other._core

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self._core.to_bytes(),)

    def __repr__(self) -> str:
        return f"<State at {self.time:.6g} s, after {self.step} sub-steps>"


def _unpickled(data: bytes) -> State:
    return State(_core.State.from_bytes(data))


class Simulation:
    """A simulation of a scene, advanced by sub-steps or by frames.

    Parameters
    ----------
    scene : Scene, path or dict
        The scene. It is copied: later changes of the scene do not change the simulation.
    backend : {"gpu", "cpu"}
        A GPU, or double precision on the CPU.
    adapter : str, optional
        Adapter by index, kind ("discrete", "integrated", "virtual", "software") or part of its name; the best by default.

    Notes
    -----
    The GIL is released during all work. Threads may share a simulation: one waits until the other's call has returned. Ctrl-C raises
    KeyboardInterrupt after the present sub-step; the simulation remains valid, and ``step`` continues it.

    Examples
    --------
    >>> sim = cutwater.Simulation("scenes/dam_break_liquid.toml")
    >>> for frame in sim.frames(10):
    ...     print(frame.time, frame.markers.positions[:, 0].max())
    """

    def __init__(
        self, scene: Scene | str | os.PathLike[str] | Mapping[str, Any], backend: str = "gpu", adapter: str | int | None = None
    ) -> None:
        self._scene = scene_of(scene).copy()
        self._backend = backend
        log_warnings(self._scene)
        self._core = _core.Simulation(self._scene._core, backend, None if adapter is None else str(adapter))
        self._frame: Frame | None = None
        found = self._core.adapter()
        self._adapter = found[0] if found else None
        log.info("%s: %s", self._scene.name, self._adapter or "CPU, float64")

    @property
    def scene(self) -> Scene:
        """A copy of the scene. In-place changes of gravity and motions are not part of it."""
        return self._scene.copy()

    @property
    def backend(self) -> str:
        """"gpu" or "cpu"."""
        return self._backend

    @property
    def adapter(self) -> str | None:
        """Name of the adapter; None on the CPU."""
        return self._adapter

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._core.clock()[0]

    @property
    def step_number(self) -> int:
        """Sub-steps done."""
        return self._core.clock()[1]

    @property
    def frame_number(self) -> int:
        """Frames done."""
        return self._core.clock()[2]

    def step(self) -> dict[str, Any]:
        """Computes one sub-step, of the length that velocities and frame times allow.

        Returns its row of ``steps.csv`` (docs/run.md has the columns and units): ``step``, ``t`` and ``dt`` in s, iterations, true residuals,
        volume in m^3, momentum, energies in J, forces in N, seconds of the stages.
        """
        self._frame = None
        return self._core.step()

    def frames(
        self, n: int | None = None, *, every: int = 1, progress: Progress | None = None, save: str | os.PathLike[str] | None = None
    ) -> Iterator[Frame]:
        """Advances frame by frame and yields each; first the initial state if there was no sub-step yet.

        Parameters
        ----------
        n : int, optional
            Number of the last frame; by default the scene's duration.
        every : int
            Interval of the frames that are yielded. The last one always is.
        progress : callable, optional
            Called after every sub-step with the frames done, their number, and the time in s.
        save : path, optional
            File for the state if Ctrl-C interrupts; see :class:`State`. Its KeyboardInterrupt is raised all the same.
        """
        n = self._scene.n_frames if n is None else n
        if every < 1:
            raise ValueError(f"every is {every}; use 1 or more")
        time, step, done = self._core.clock()
        if step == 0:
            yield self.frame
        try:
            while done < n:
                before = done
                while done == before:
                    self.step()
                    time, _, done = self._core.clock()
                    if progress is not None:
                        progress(done, n, time)
                if done % every == 0 or done == n:
                    yield self.frame
        except KeyboardInterrupt:
            if save is not None:
                self.state.save(save)
                log.warning("interrupted at %.6g s; %s has the state", self.time, save)
            raise

    @property
    def frame(self) -> Frame:
        """The present state as arrays."""
        frame = self._frame
        if frame is None:
            frame = Frame(self._core.frame())
            self._frame = frame
        return frame

    @property
    def probes(self) -> NDArray[np.void]:
        """Values of the scene's probes after every sub-step so far.

        A structured array with the fields ``step``, ``t`` (s) and the columns of ``probes.csv``; ``probe_units`` has their units.
        """
        columns = list(self.probe_units)
        steps, values = self._core.probes()
        kind = np.dtype([("step", np.uint64), ("t", np.float64), *((column, np.float64) for column in columns)])
        table = np.empty(len(steps), kind)
        table["step"] = steps
        for number, column in enumerate(["t", *columns] if len(steps) else []):
            table[column] = values[:, number]
        table.flags.writeable = False
        return table

    @property
    def probe_units(self) -> dict[str, str]:
        """Columns of the probes and their units."""
        return dict(self._scene._core.probes())

    @property
    def state(self) -> State:
        """The present state. Assigning a state of the same scene and backend resumes from it bitwise."""
        return State(self._core.state())

    @state.setter
    def state(self, state: State) -> None:
        self.resume(state)

    def resume(self, state: State, *, same_scene: bool = True) -> None:
        """Resumes from a state. With ``same_scene=False`` of any scene with the same cells, markers and nodes, for branches of a study."""
        self._core.resume(state._core, same_scene)
        self._frame = None

    def change(self, values: Mapping[str, Any]) -> None:
        """Changes keys of the scene from the present time on, such as loads, materials, scripts, sources, tolerances.

        ``values`` are key paths and values. The device is set up anew, which takes as long as a new simulation; gravity, velocities and motions have
        faster methods. Keys that change the grid, the frame rate, the initial liquid or the meshes are refused. Motions must keep the present pose.
        """
        from .errors import SceneError

        fixed = ("domain.size", "domain.cells", "time.frames_per_second", "liquid.region", "liquid.surface", "liquid.seed")
        fixed_of_bodies = ("mesh", "placement", "initial", "box", "sphere", "cylinder", "inside_out", "name")
        for key in values:
            path = key.replace("[", ".").replace("]", "").split(".")
            of_body = len(path) > 2 and path[0] in ("solid", "obstacle") and path[2] in fixed_of_bodies
            whole = len(path) < 3 and path[0] in ("solid", "obstacle", "domain", "liquid", "time") and len(path) == 1
            if of_body or whole or key.startswith(fixed):
                error = SceneError(f"{key}: cannot change during a simulation\n  cure: start a new simulation")
                error.key, error.problem, error.cure, error.exit_code = key, "cannot change during a simulation", "start a new simulation", 2
                raise error
        scene = self._scene.copy()
        scene.update(values)
        self._core.change(scene._core, self._scene._core)
        self._scene, self._frame = scene, None

    def set_gravity(self, gravity: Sequence[float]) -> None:
        """Sets gravity, three numbers in m/s^2. It may change in every sub-step."""
        x, y, z = map(float, gravity)
        self._core.set_gravity([x, y, z])
        self._frame = None

    def set_velocity(
        self,
        x: ArrayLike | None = None,
        y: ArrayLike | None = None,
        z: ArrayLike | None = None,
        *,
        nodes: ArrayLike | None = None,
    ) -> None:
        """Replaces velocities, m/s: of the faces normal to x, y or z, and of the nodes of all solids.

        Shapes as of ``frame.velocity`` and ``frame.node_velocity``. Prescribed components of nodes keep their velocities. The next pressure solve
        makes the velocities of the liquid free of divergence.
        """
        now = self.frame
        faces = None
        if not (x is None and y is None and z is None):
            faces = [self._like(old, new, f"velocities of faces normal to {axis}") for axis, old, new in zip("xyz", now.velocity, (x, y, z))]
        points = None if nodes is None else self._like(now.node_velocity, nodes, "velocities of nodes")
        self._core.set_velocity(faces, points)
        self._frame = None

    @staticmethod
    def _like(old: NDArray[np.float64], new: ArrayLike | None, what: str) -> NDArray[np.float64]:
        array = np.asarray(old if new is None else new, dtype=np.float64)
        if array.shape != old.shape:
            raise ValueError(f"the {what} have the shape {array.shape}; use {old.shape}")
        return np.ascontiguousarray(array)

    def set_motion(self, obstacle: int, keyframes: Sequence[Mapping[str, Any]]) -> None:
        """Replaces the keyframes of a moving obstacle, by its index in the scene.

        Keyframes as in a scene: ``{"t": s, "translate": [m, m, m], "rotate": {"axis": [..], "degrees": ..}}``. At the present time the old and the
        new motion must have the same pose. :meth:`steer` is simpler for a controller.
        """
        self._core.set_motion(obstacle, _keyframes(keyframes))
        self._frame = None

    def set_script(self, solid: int, script: int, keyframes: Sequence[Mapping[str, Any]]) -> None:
        """Replaces the keyframes of a ``[[solid.script]]``, as :meth:`set_motion` does. Its nodes follow one sub-step later."""
        self._core.set_script(solid, script, _keyframes(keyframes))
        self._frame = None

    def steer(self, obstacle: int, velocity: Sequence[float] = (0, 0, 0), spin: Sequence[float] = (0, 0, 0)) -> None:
        """Moves an obstacle with a velocity (m/s) from now on, until it is steered again.

        ``spin`` (rad/s) is the rate of its rotation vector, about the pivot of its motion. The obstacle needs keyframes in the scene, one is enough.
        The acceleration counts as spread over a frame, which limits the sub-steps.
        """
        time = self.time
        scene = self._core.scene()
        pose = scene.pose(obstacle, time)
        if pose is None:
            self._core.set_motion(obstacle, [])  # raises the error that names the obstacle
            raise AssertionError
        frame = 1.0 / scene.frames_per_second
        old = [of for of in scene.motion(obstacle) or [] if of[0] < time]
        rates = [*map(float, velocity), *map(float, spin)]
        start = [*pose[0], *pose[1]]
        keyframes = old[-1:]
        for after in (0.0, frame, 1e6 * frame):
            at = [x + after * rate for x, rate in zip(start, rates)]
            angle = math.sqrt(sum(x * x for x in at[3:]))
            axis = [x / angle for x in at[3:]] if angle > 0 else [0.0, 1.0, 0.0]
            keyframes.append((time + after, at[:3], axis, angle))
        self._core.set_motion(obstacle, keyframes)
        self._frame = None

    def system(self) -> System:
        """The linear system of the next sub-step, as scipy.sparse matrices, with its right-hand side and the simulator's solution.

        The simulation does not advance. Needs scipy.
        """
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "system"
            self._core.export(out)
            return read_system(out)

    def __repr__(self) -> str:
        return f"<Simulation of {self._scene.name!r} on {self._adapter or 'the CPU'}, {self.time:.6g} s>"


def _keyframes(keyframes: Sequence[Mapping[str, Any]]) -> list[Any]:
    tuples = []
    for keyframe in keyframes:
        unknown = set(keyframe) - {"t", "translate", "rotate"}
        if unknown or "t" not in keyframe:
            raise ValueError(f"a keyframe has t, translate and rotate, not {sorted(keyframe)}")
        rotate = keyframe.get("rotate", {"axis": [0, 1, 0], "degrees": 0})
        axis = [float(x) for x in rotate["axis"]]
        translate = [float(x) for x in keyframe.get("translate", [0, 0, 0])]
        tuples.append((float(keyframe["t"]), translate, axis, math.radians(rotate["degrees"])))
    return tuples
