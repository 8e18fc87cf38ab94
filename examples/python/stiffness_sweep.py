"""How far a beam that sticks out of a wall sags within 1/6 s, for several Young's moduli, two runs at a time. Needs pandas."""

from pathlib import Path

import cutwater
import numpy as np
import pandas as pd

SCENES = Path(__file__).parents[2] / "scenes"


def main(out: Path = Path("out/python"), frames: int = 4, backend: str = "gpu") -> pd.DataFrame:
    scene = cutwater.Scene(SCENES / "cantilever.toml")
    young = [scene["solid[0].young"] * factor for factor in (1, 2, 4)]
    runs = cutwater.sweep(scene, {"solid[0].young": young}, out=out / "stiffness", frames=frames, jobs=2, backend=backend)
    table = pd.DataFrame(runs)[["solid[0].young", "status", "sub_steps", "seconds", "folder"]]

    # The largest displacement at the end, from the checkpoints.
    def sag(folder: str) -> float:
        with np.load(Path(folder) / "checkpoint.npz") as state:
            return float(np.linalg.norm(state["displacement"], axis=1).max())

    table["displacement"] = table["folder"].map(sag)
    return table


if __name__ == "__main__":
    print(main())
