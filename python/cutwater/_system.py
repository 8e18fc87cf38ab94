"""Exported systems."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from scipy.sparse import csr_matrix


@dataclass(frozen=True)
class System:
    """The linear system of a sub-step: ``matrix @ solution = rhs``, symmetric. docs/export.md has the equations."""

    matrix: csr_matrix
    """The matrix of the solve. Rows are pressures of cells, then velocities of nodes."""
    rhs: NDArray[np.float64]
    """Its right-hand side."""
    solution: NDArray[np.float64]
    """The simulator's solution, Pa and m/s."""
    blocks: dict[str, csr_matrix]
    """Blocks by name: with liquid and solids B, J, M, K, Z1, Z2, indefinite and stress; with solids alone M, K and S."""
    right_hand_sides: dict[str, NDArray[np.float64]]
    """Right-hand sides of "indefinite" and "stress"."""
    cells: dict[str, NDArray[np.float64]]
    """Columns of cells.csv: row, i, j, k, and the centre x, y, z in m. Empty without liquid."""
    nodes: dict[str, NDArray[Any]]
    """Columns of nodes.csv. Empty without solids."""
    meta: dict[str, Any]
    """Numbers: dt (s), dx (m), density, status, residual, tolerance."""


def read_system(folder: Path) -> System:
    """Reads the folder of ``cutwater export``."""
    import numpy as np
    from scipy.io import mmread

    def table(name: str) -> dict[str, NDArray[Any]]:
        path = folder / name
        if not path.exists():
            return {}
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        columns = {}
        for column in rows[0] if rows else []:
            texts = [row[column] for row in rows]
            columns[column] = np.array(texts if column == "solid" else [float(text) for text in texts])
        return columns

    vectors, blocks = {}, {}
    for path in sorted(folder.glob("*.mtx")):
        read = mmread(path)
        if isinstance(read, np.ndarray):
            vectors[path.stem.removesuffix("_rhs")] = np.ravel(read)
        else:
            blocks[path.stem] = read.tocsr()
    if "B" not in blocks and "S" not in blocks:
        blocks["B"] = blocks["spd"]
    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
    solution, rhs = vectors.pop("solution"), vectors.pop("spd")
    return System(blocks.pop("spd"), rhs, solution, blocks, vectors, table("cells.csv"), table("nodes.csv"), meta)
