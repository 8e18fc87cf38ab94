"""
The module `cutwater._core`.
"""

from _typeshed import Incomplete, SupportsGetItem, SupportsLenAndGetItem
from os import PathLike
from typing import Any, Final, SupportsFloat, SupportsIndex, final

__all__ = ["__version__", "Frame", "Scene", "Simulation", "State", "adapters", "command_line", "compare_stages", "draw", "panic", "plan", "run", "scene_tree"]

__version__: Final[str]
"""
Version of cutwater.
"""

@final
class Frame:
    """
    State of a simulation at one time. Its arrays never change.
    """
    def array(self, /, name: str) -> Any:
        """
        An array of the state by its name in checkpoint.npz.
        """
    def bodies(self, /) -> list[tuple[str, list[int], list[int], list[int]]]:
        """
        Names of the solids with the ranges of their nodes, elements and surface triangles.
        """
    def cell_velocities(self, /) -> Any:
        """
        Velocities of the cells, m/s.
        """
    @property
    def has_liquid(self, /) -> bool: ...
    def marker_velocities(self, /) -> Any:
        """
        Velocities of the markers, m/s.
        """
    def meshes(self, /) -> list[Any]:
        """
        Rest positions of the nodes (m), corners of the elements and of the surface triangles.
        """
    @property
    def number(self, /) -> int: ...
    @property
    def step(self, /) -> int: ...
    def stresses(self, /) -> tuple[Any, Any]:
        """
        Von Mises stress (Pa) and det F of all elements.
        """
    def surface(self, /) -> list[Any]:
        """
        Vertices (m), normals, velocities (m/s) and triangles of the liquid's surface, float32.
        """
    @property
    def time(self, /) -> float: ...

@final
class Scene:
    """
    A checked scene.
    """
    def __new__(cls, /, path: str | PathLike[str], text: str | None, overrides: SupportsGetItem[int, str], scale: SupportsFloat | SupportsIndex) -> Scene:
        """
        Checks a text, or without one the file.
        """
    @property
    def cells(self, /) -> list[int]: ...
    @property
    def dx(self, /) -> float: ...
    @property
    def frames_per_second(self, /) -> float: ...
    @property
    def gravity(self, /) -> list[float]: ...
    def motion(self, /, obstacle: SupportsIndex) -> list[tuple[float, list[float], list[float], float]] | None:
        """
        Keyframes of an obstacle; none for one at rest.
        """
    @property
    def n_frames(self, /) -> int: ...
    @property
    def name(self, /) -> str: ...
    def pose(self, /, obstacle: SupportsIndex, time: SupportsFloat | SupportsIndex) -> tuple[list[float], list[float]] | None:
        """
        Translation (m) and rotation vector (rad) of a moving obstacle at a time (s).
        """
    def probes(self, /) -> list[tuple[str, str]]:
        """
        Columns of the probes and their units.
        """
    @property
    def removed(self, /) -> list[str]:
        """
        Parts that were removed because they refer to one that an override removed.
        """
    @property
    def size(self, /) -> list[float]: ...
    def warnings(self, /) -> list[str]: ...

@final
class Simulation:
    """
    A simulation.
    """
    def __new__(cls, /, scene: Scene, backend: str, adapter: str | None) -> Simulation: ...
    def adapter(self, /) -> tuple[str, str] | None:
        """
        Name and driver of the adapter; `None` on the CPU.
        """
    def change(self, /, scene: Scene, before: Scene) -> None:
        """
        Continues with another scene, a change of the scene `before`, from the present state.
        """
    def clock(self, /) -> tuple[float, int, int]:
        """
        Time (s), sub-steps and frames done.
        """
    def export(self, /, out: str | PathLike[str]) -> None:
        """
        Writes the system of the next sub-step into a folder.
        """
    def frame(self, /) -> Frame:
        """
        Reads back the present state.
        """
    def probes(self, /) -> tuple[Any, Any]:
        """
        Sub-steps, and a row per sub-step with the time (s) and the values of all columns.
        """
    def resume(self, /, state: State, same_scene: bool) -> None:
        """
        Resumes from a state; with `same_scene` of the same scene and backend only.
        """
    def scene(self, /) -> Scene:
        """
        The scene with its changes.
        """
    def set_gravity(self, /, gravity: SupportsLenAndGetItem[SupportsFloat | SupportsIndex]) -> None: ...
    def set_motion(self, /, obstacle: SupportsIndex, keyframes: SupportsGetItem[int, tuple[SupportsFloat | SupportsIndex, SupportsLenAndGetItem[SupportsFloat | SupportsIndex], SupportsLenAndGetItem[SupportsFloat | SupportsIndex], SupportsFloat | SupportsIndex]]) -> None: ...
    def set_script(self, /, solid: SupportsIndex, script: SupportsIndex, keyframes: SupportsGetItem[int, tuple[SupportsFloat | SupportsIndex, SupportsLenAndGetItem[SupportsFloat | SupportsIndex], SupportsLenAndGetItem[SupportsFloat | SupportsIndex], SupportsFloat | SupportsIndex]]) -> None: ...
    def set_velocity(self, /, faces: SupportsLenAndGetItem[Incomplete] | None, nodes: Incomplete | None) -> None:
        """
        Replaces velocities of the faces, and of the nodes, m/s.
        """
    def state(self, /) -> State: ...
    def step(self, /) -> dict:
        """
        Computes a sub-step; returns its row of steps.csv and the seconds of its stages.
        """

@final
class State:
    """
    State of a simulation, from which the same scene resumes bitwise.
    """
    def __eq__(self, other: object, /) -> bool: ...
    @property
    def frame(self, /) -> int: ...
    @staticmethod
    def from_bytes(bytes: bytes) -> State: ...
    @staticmethod
    def load(path: str | PathLike[str]) -> State:
        """
        Reads an .npz file, of a state or of a run.
        """
    def save(self, /, path: str | PathLike[str]) -> None:
        """
        Writes an .npz file.
        """
    @property
    def step(self, /) -> int: ...
    @property
    def time(self, /) -> float: ...
    def to_bytes(self, /) -> bytes: ...

def adapters() -> str:
    """
    All adapters as JSON.
    """

def command_line(arguments: SupportsGetItem[int, str], program: SupportsGetItem[int, str]) -> int:
    """
    The command line; returns the exit code. `program`: the command that starts it in another process.
    """

def compare_stages(scene: Scene, frames: SupportsIndex, adapter: str | None) -> str:
    """
    The rows of a comparison of all stages as JSON.
    """

def draw(frames: SupportsGetItem[int, Frame], size: SupportsLenAndGetItem[SupportsIndex] | None, colour: str) -> bytes:
    """
    Draws frames of one scene through the files of a run in a temporary folder; returns a PNG, of several frames an animated one.
    """

def panic() -> None:
    """
    Panics where the library would, for the tests.
    """

def plan(scene: Scene, backend: str, adapter: str | None) -> str:
    """
    The plan of a scene as JSON.
    """

def run(scene: Scene, keywords: Incomplete, progress: Any) -> str:
    """
    Runs a scene into a folder. `progress` receives frame, frames, time (s) and new notices after each sub-step. An exception of it, or a signal,
    stops the run after a checkpoint.
    """

def scene_tree(path: str | PathLike[str], text: str, overrides: SupportsGetItem[int, str]) -> str:
    """
    The keys that a text and overrides give, as JSON.
    """
