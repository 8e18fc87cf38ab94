"""A dam break: its front and its energy over time, in a pandas table and a matplotlib chart. Needs pandas and matplotlib."""

from pathlib import Path

import cutwater
import pandas as pd

SCENES = Path(__file__).parents[2] / "scenes"


def main(out: Path = Path("out/python"), scale: float = 1.0, frames: int = 24, backend: str = "gpu") -> pd.DataFrame:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    scene = cutwater.Scene(SCENES / "dam_break_liquid.toml", scale=scale)
    sim = cutwater.Simulation(scene, backend=backend)
    steps = []
    while sim.frame_number < frames:
        steps.append(sim.step())

    # A row per sub-step: the columns of steps.csv beside those of probes.csv.
    table = pd.DataFrame(steps).merge(pd.DataFrame(sim.probes), on=["step", "t"])
    out.mkdir(parents=True, exist_ok=True)
    table.to_csv(out / "dam_break.csv", index=False)

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    left.plot(table["t"], table["front"])
    left.set(xlabel="time, s", ylabel="front, m")
    right.plot(table["t"], table["kinetic_energy"], label="kinetic")
    right.plot(table["t"], table["potential_energy"], label="potential")
    right.set(xlabel="time, s", ylabel="energy, J")
    right.legend()
    figure.savefig(out / "dam_break.svg")

    sim.frame.show(size=(480, 270)).save(out / "dam_break.png")
    return table


if __name__ == "__main__":
    print(main().describe())
