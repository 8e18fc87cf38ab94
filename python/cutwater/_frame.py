"""Frames: states of a simulation as numpy arrays."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _core

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray


class Picture:
    """A PNG picture; notebooks show it. Several frames are an animated PNG, which browsers play."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        """The bytes of the PNG file."""

    def save(self, path: str | Path) -> Path:
        """Writes the file."""
        Path(path).write_bytes(self.data)
        return Path(path)

    def _repr_png_(self) -> bytes:
        return self.data

    def __repr__(self) -> str:
        return f"<Picture, {len(self.data)} bytes of PNG; save(path) writes it>"


class Markers:
    """Markers of the liquid, N of them. Empty with a fixed surface."""

    def __init__(self, core: _core.Frame) -> None:
        self._core = core

    def __len__(self) -> int:
        return len(self.positions)

    @cached_property
    def positions(self) -> NDArray[np.float64]:
        """Positions, m, shape (N, 3)."""
        return self._core.array("markers")

    @cached_property
    def velocities(self) -> NDArray[np.float64]:
        """Velocities, m/s, shape (N, 3): of spray its own, else trilinear from the faces."""
        return self._core.marker_velocities()

    @cached_property
    def spray(self) -> NDArray[np.bool_]:
        """Whether each marker flies, shape (N,); empty unless liquid.surface is "level"."""
        return self._core.array("spray")


class Surface:
    """Closed triangle mesh of the liquid's surface, V vertices and T triangles, float32."""

    def __init__(self, arrays: list[Any]) -> None:
        self.vertices: NDArray[np.float32] = arrays[0]
        """Positions, m, shape (V, 3)."""
        self.normals: NDArray[np.float32] = arrays[1]
        """Unit normals out of the liquid, shape (V, 3)."""
        self.velocities: NDArray[np.float32] = arrays[2]
        """Velocities, m/s, shape (V, 3)."""
        self.triangles: NDArray[np.uint32] = arrays[3]
        """Corners, counter-clockwise seen from outside, shape (T, 3)."""


class Solid:
    """An elastic solid of N nodes and E tetrahedra. Node numbers are its own, from 0."""

    def __init__(self, frame: Frame, name: str, nodes: slice, elements: slice, triangles: slice) -> None:
        self.name = name
        """Name in the scene."""
        self._frame, self._nodes, self._elements, self._triangles = frame, nodes, elements, triangles

    @property
    def rest(self) -> NDArray[np.float64]:
        """Positions at rest, m, shape (N, 3)."""
        return self._frame._meshes[0][self._nodes]

    @property
    def displacement(self) -> NDArray[np.float64]:
        """Displacements from rest, m, shape (N, 3)."""
        return self._frame.displacement[self._nodes]

    @cached_property
    def nodes(self) -> NDArray[np.float64]:
        """Positions, m, shape (N, 3)."""
        positions = self.rest + self.displacement
        positions.flags.writeable = False
        return positions

    @property
    def velocities(self) -> NDArray[np.float64]:
        """Velocities of the nodes, m/s, shape (N, 3)."""
        return self._frame.node_velocity[self._nodes]

    @cached_property
    def elements(self) -> NDArray[np.uint32]:
        """Nodes of the tetrahedra, shape (E, 4)."""
        return self._own(self._frame._meshes[1][self._elements])

    @cached_property
    def triangles(self) -> NDArray[np.uint32]:
        """Nodes of the surface triangles, counter-clockwise seen from outside, shape (T, 3)."""
        return self._own(self._frame._meshes[2][self._triangles])

    def _own(self, nodes: NDArray[np.uint32]) -> NDArray[np.uint32]:
        nodes = nodes - np.uint32(self._nodes.start)
        nodes.flags.writeable = False
        return nodes

    @property
    def von_mises(self) -> NDArray[np.float64]:
        """Von Mises stress of the tetrahedra, Pa, shape (E,)."""
        return self._frame._stresses[0][self._elements]

    @property
    def det_f(self) -> NDArray[np.float64]:
        """Volume of the tetrahedra over that at rest, shape (E,)."""
        return self._frame._stresses[1][self._elements]


class Frame:
    """State of a simulation at one time.

    Arrays are read-only and never change; copy them to change them. They keep the frame's memory for as long as they live. Fields of cells have the
    index order ``[k, j, i]``, with i along x, so ``field.T[i, j, k]`` is the value of a cell.
    """

    def __init__(self, core: _core.Frame) -> None:
        self._core = core
        self.markers = Markers(core)
        """The markers."""

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._core.time

    @property
    def step(self) -> int:
        """Sub-steps done."""
        return self._core.step

    @property
    def number(self) -> int:
        """Frames done."""
        return self._core.number

    @cached_property
    def velocity(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Velocities of the faces normal to x, y and z, m/s, shapes (nz, ny, nx + 1), (nz, ny + 1, nx), (nz + 1, ny, nx)."""
        x, y, z = (self._core.array(f"velocity_{axis}") for axis in "xyz")
        return x, y, z

    @cached_property
    def velocities(self) -> NDArray[np.float64]:
        """Velocities of the cells, the means of opposite faces, m/s, shape (nz, ny, nx, 3)."""
        return self._core.cell_velocities()

    @cached_property
    def pressure(self) -> NDArray[np.float64]:
        """Pressure of the last projection at cell centres, Pa, shape (nz, ny, nx); 0 in inactive cells."""
        return self._core.array("pressure")

    @cached_property
    def distance(self) -> NDArray[np.float64]:
        """Distance of cell centres to the liquid's surface, m, negative inside, shape (nz, ny, nx)."""
        return self._core.array("liquid_distance")

    @cached_property
    def solid_distance(self) -> NDArray[np.float64]:
        """Distance of cell centres to obstacles and immersed solids, m, negative inside, shape (nz, ny, nx); at most three cells."""
        return self._core.array("solid_distance")

    @cached_property
    def active(self) -> NDArray[np.bool_]:
        """Whether each cell was an unknown of the last pressure solve, shape (nz, ny, nx)."""
        return self._core.array("active")

    @cached_property
    def component(self) -> NDArray[np.uint32]:
        """Connected component of the liquid of each cell, from 1, 0 for none, shape (nz, ny, nx); empty unless liquid.surface is "level"."""
        return self._core.array("component")

    @cached_property
    def displacement(self) -> NDArray[np.float64]:
        """Displacements of the nodes of all solids from rest, m, shape (N, 3)."""
        return self._core.array("displacement")

    @cached_property
    def node_velocity(self) -> NDArray[np.float64]:
        """Velocities of the nodes of all solids, m/s, shape (N, 3)."""
        return self._core.array("node_velocity")

    @cached_property
    def _meshes(self) -> list[Any]:
        return self._core.meshes()

    @cached_property
    def _stresses(self) -> tuple[Any, Any]:
        return self._core.stresses()

    @cached_property
    def solids(self) -> Mapping[str, Solid]:
        """The solids by name."""
        bodies = self._core.bodies()
        return MappingProxyType({name: Solid(self, name, *(slice(*part) for part in parts)) for name, *parts in bodies})

    @cached_property
    def surface(self) -> Surface:
        """The liquid's surface."""
        return Surface(self._core.surface())

    def show(self, *, size: tuple[int, int] | None = None, colour: str = "solid") -> Picture:
        """Draws the frame as ``cutwater preview`` does.

        ``size`` is width and height in pixels, by default the scene's. ``colour`` of solids: "solid", "stress" or "det_f".
        """
        return animate([self], size=size, colour=colour)

    def __repr__(self) -> str:
        return f"<Frame {self.number} at {self.time:.6g} s, after {self.step} sub-steps>"


def animate(frames: Iterable[Frame], *, size: tuple[int, int] | None = None, colour: str = "solid") -> Picture:
    """Draws frames of one simulation as an animated PNG, at the scene's frame rate.

    ``frames`` may be ``sim.frames()`` itself. Each frame keeps its state in memory until the end. Options as of :meth:`Frame.show`.
    """
    return Picture(_core.draw([frame._core for frame in frames], size, colour))
