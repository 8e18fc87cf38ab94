"""cutwater: two-way coupling between inviscid free-surface liquids and elastic solids on the GPU.

The first picture::

    import cutwater
    sim = cutwater.Simulation("scenes/dam_break_liquid.toml")
    list(sim.frames(12))[-1].show()

:class:`Scene` reads and changes scenes, :class:`Simulation` advances them, :class:`Frame` has the arrays. :func:`run` and :func:`sweep` write
folders, :func:`plan` and :func:`compare` return dicts. Exceptions are in :mod:`cutwater.errors`. Messages go to the logger "cutwater". All units
are SI.
"""

from . import errors
from ._core import __version__
from ._frame import Frame, Markers, Picture, Solid, Surface, animate
from ._scene import Scene
from ._simulation import Simulation, State
from ._system import System
from ._tools import adapters, compare, plan, run, sweep

__all__ = [
    "Frame",
    "Markers",
    "Picture",
    "Scene",
    "Simulation",
    "Solid",
    "State",
    "Surface",
    "System",
    "__version__",
    "adapters",
    "animate",
    "compare",
    "errors",
    "plan",
    "run",
    "sweep",
]
