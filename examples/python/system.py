"""The system of a sub-step in scipy: its own conjugate gradients against cutwater's solution. Needs scipy."""

from pathlib import Path

import cutwater
import numpy as np
from scipy.sparse import diags_array
from scipy.sparse.linalg import cg

SCENES = Path(__file__).parents[2] / "scenes"


def main(scale: float = 0.5, backend: str = "gpu") -> tuple[int, float]:
    sim = cutwater.Simulation(cutwater.Scene(SCENES / "dam_break_liquid.toml", scale=scale), backend=backend)
    for _ in range(5):
        sim.step()
    system = sim.system()
    count = 0

    def each(_: np.ndarray) -> None:
        nonlocal count
        count += 1

    jacobi = diags_array(1.0 / system.matrix.diagonal())
    x, failed = cg(system.matrix, system.rhs, rtol=1e-10, M=jacobi, callback=each)
    assert failed == 0
    difference = np.linalg.norm(x - system.solution) / np.linalg.norm(x)
    print(f"{len(x)} pressures: {count} iterations of Jacobi CG; scipy and cutwater differ by {difference:.1e}")
    return count, float(difference)


if __name__ == "__main__":
    main()
