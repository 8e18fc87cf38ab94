"""A controller moves a gate in each sub-step, so that the water behind it sinks at a constant rate."""

from pathlib import Path

import cutwater

SCENES = Path(__file__).parents[2] / "scenes"


def main(scale: float = 1.0, frames: int = 24, backend: str = "gpu") -> list[tuple[float, float, float]]:
    scene = cutwater.Scene(SCENES / "gate.toml", scale=scale)
    # The gate is at rest until it is steered.
    scene["obstacle[0].keyframes"] = [{"t": 0.0}]
    sim = cutwater.Simulation(scene, backend=backend)
    start, rate, gain, fastest = 0.5, 0.1, 20.0, 0.6  # m, m/s, 1/s, m/s
    lift, rows = 0.0, []
    while sim.frame_number < frames:
        height = sim.probes["reservoir"][-1] if sim.step_number else start
        # Too much water behind the gate: lift it. Too little: lower it, but not into the floor.
        error = height - (start - rate * sim.time)
        speed = max(-fastest, min(fastest, gain * error))
        if lift <= 0.0:
            speed = max(speed, 0.0)
        sim.steer(0, velocity=(0.0, speed, 0.0))
        lift += speed * sim.step()["dt"]
        rows.append((sim.time, height, lift))
    return rows


if __name__ == "__main__":
    for time, height, lift in main():
        print(f"{time:.3f} s: water {height:.3f} m, gate lifted by {lift:.3f} m")
