"""Pictures, systems, plans, comparisons, runs, sweeps, the command line and examples."""

import inspect
import json
import runpy
import subprocess
import sys

import cutwater
import numpy as np
import pytest
from conftest import ROOT
from cutwater.errors import CheckError, InputError


def test_three_lines_give_a_picture(scenes):
    sim = cutwater.Simulation(cutwater.Scene(scenes / "dam_break_liquid.toml", scale=0.25), backend="cpu")
    picture = list(sim.frames(2))[-1].show(size=(160, 120))
    assert picture._repr_png_().startswith(b"\x89PNG\r\n")
    assert picture.save("frame.png").read_bytes() == picture.data


def test_pictures_are_those_of_the_command_line(water):
    """Those of `cutwater preview` of a run of the same scene."""
    water["output"] = {"checkpoint_every": 0}
    water["camera"] = {"size": [96, 64]}
    scene = cutwater.Scene(water)
    cutwater.run(scene, "run", backend="cpu", frames=2)
    code = cutwater._core.command_line(["cutwater", "preview", "run"], [])
    assert code == 0
    with open("run/preview/scene.png", "rb") as file:
        animation = file.read()
    assert cutwater.animate(cutwater.Simulation(scene, backend="cpu").frames(2)).data == animation


def test_solids_are_drawn_by_stress(both):
    frame = cutwater.Simulation(both, backend="cpu").frame
    plain, stress = [frame.show(size=(64, 48), colour=colour).data for colour in ("solid", "stress")]
    assert plain != stress
    with pytest.raises(ValueError, match="colour"):
        frame.show(colour="heat")
    with pytest.raises(ValueError, match="no frame"):
        cutwater.animate([])


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_the_system_is_that_of_the_next_sub_step(water, backend):
    sim = cutwater.Simulation(water, backend=backend)
    for _ in range(3):
        sim.step()
    state = sim.state
    system = sim.system()
    assert sim.state == state and system.meta["step"] == 3
    residual = np.linalg.norm(system.rhs - system.matrix @ system.solution) / np.linalg.norm(system.rhs)
    # The solution is rounded to float32 pressures on the GPU with the scene's default precision.
    assert residual < 1e-6 and abs(system.matrix - system.matrix.T).max() == 0
    report = sim.step()
    assert report["unknowns"] == len(system.rhs) and report["dt"] == pytest.approx(system.meta["dt"], rel=1e-6)
    i, j, k = (system.cells[name].astype(int) for name in "ijk")
    pressure = sim.frame.pressure[k, j, i]
    assert np.abs(pressure - system.solution).max() < 1e-5 * np.abs(pressure).max()


def test_the_system_of_both_has_its_blocks(both):
    both["liquid"]["region"][0]["box"]["max"] = [1.0, 0.6, 0.5]
    sim = cutwater.Simulation(both, backend="cpu")
    sim.step()
    system = sim.system()
    assert {"B", "J", "M", "K", "Z1", "Z2", "indefinite", "stress"} <= set(system.blocks)
    b, j = system.blocks["B"], system.blocks["J"]
    assert b.shape[0] == j.shape[0] == len(system.cells["row"]) and b.shape[0] + j.shape[1] == len(system.rhs)
    assert len(system.right_hand_sides["indefinite"]) == len(system.rhs)


def test_plan(both):
    plan = cutwater.plan(both)
    assert plan["cells"] == [12, 12, 6] and plan["nodes"] == 54 and plan["device_bytes"] == sum(b["bytes"] for b in plan["buffers"])
    assert {"name": "solve", "every_step": True} .items() <= next(s for s in plan["stages"] if s["name"] == "solve").items()
    assert cutwater.plan(both, backend="cpu")["buffers"] == []


def test_compare(water):
    result = cutwater.compare(water, frames=1)
    assert result["passed"] and result["steps"] >= 1
    assert {"advect_markers", "solve", "write_back"} <= {row["stage"] for row in result["rows"]}


def test_sweep(water):
    scene = cutwater.Scene(water)
    scene["liquid.density"] = 900
    values = {"liquid.region.0.velocity": [[0, 0, 0], [1.0, 0, 0]], "time.cfl": [2]}
    table = cutwater.sweep(scene, values, out="sweep", frames=1, backend="cpu", jobs=2)
    assert list(table["status"]) == ["finished"] * 2 and (table["frames"] == 1).all()
    assert len({np.load(f"{folder}/checkpoint.npz")["velocity_x"].tobytes() for folder in table["folder"]}) == 2
    manifest = json.load(open(f"{table['folder'][0]}/manifest.json"))
    assert "time.cfl=2" in manifest["options"]["overrides"]
    del scene["probe[1]"]
    cutwater.sweep(scene, {"time.cfl": [2]}, out="fewer", frames=1, backend="cpu")
    with_probe, without = (open(f"{folder}/summary.csv").readline() for folder in ("sweep", "fewer"))
    assert "u_x" in with_probe and "u_x" not in without and "front" in without
    with pytest.raises(CheckError) as caught:
        cutwater.sweep(scene, {"liquid.density": [900, -1]}, out="sweep2", frames=1, backend="cpu")
    assert list(caught.value.table["status"]) == ["finished", "refused"]
    with pytest.raises(InputError, match="density"):
        cutwater.sweep(scene, {"liquid.density": [-1]}, out="sweep3", frames=1, backend="cpu")


def test_run_refuses_and_replaces(water):
    cutwater.run(water, "run", backend="cpu", frames=1)
    with pytest.raises(InputError) as caught:
        cutwater.run(water, "run", backend="cpu", frames=1)
    assert "overwrite=True" in caught.value.cure
    summary = cutwater.run(water, "run", backend="cpu", frames=1, overwrite=True)
    assert summary["frames"] == 1 and summary["worst_residual"] < 1e-8


def test_the_command_line_is_shipped():
    def call(*arguments):
        return subprocess.run([sys.executable, "-m", "cutwater", *arguments], capture_output=True, text=True, check=False)

    assert call("--version").stdout.startswith(f"cutwater {cutwater.__version__}")
    schema = call("schema")
    assert schema.returncode == 0 and "domain" in json.loads(schema.stdout)["properties"]
    refused = call("run", "none.toml")
    assert refused.returncode == 2 and refused.stderr.startswith("error: none.toml")


def test_adapters():
    assert all({"name", "driver", "api", "kind", "f64", "largest_buffer"} == set(adapter) for adapter in cutwater.adapters())


def test_everything_public_is_documented():
    undocumented = []
    for name in cutwater.__all__:
        thing = getattr(cutwater, name)
        if inspect.isclass(thing):
            members = {f"{name}.{key}": member for key, member in vars(thing).items() if not key.startswith("_")}
            functions = {key: member for key, member in members.items() if callable(member) or hasattr(member, "fget") or hasattr(member, "func")}
            undocumented += [key for key, member in {name: thing, **functions}.items() if not getattr(member, "__doc__", None)]
        elif callable(thing) and not thing.__doc__:
            undocumented.append(name)
    assert undocumented == []


EXAMPLES = {
    "dam_break": {"scale": 0.25, "frames": 6},
    "stiffness_sweep": {},
    "controller": {"scale": 0.5, "frames": 4},
    "system": {"scale": 0.25},
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples(name):
    result = runpy.run_path(str(ROOT / f"examples/python/{name}.py"))["main"](**EXAMPLES[name], backend="cpu")
    if name == "dam_break":
        assert result["front"].iloc[-1] > result["front"].iloc[0]
    elif name == "stiffness_sweep":
        # Twice as stiff, half as far, once the beam has begun to turn: at first all fall alike.
        assert (result["displacement"].diff().dropna() < 0).all()
    elif name == "controller":
        assert result[-1][2] > 0
    else:
        # Both solve to better than 1e-8 of the right-hand side; the system of 16 cells along x has a condition number below 1e3.
        assert result[1] < 1e-5


def test_the_notebook(monkeypatch, tmp_path):
    """Runs its cells in order, with small grids and few frames."""
    import matplotlib

    matplotlib.use("Agg")
    cells = json.loads((ROOT / "examples/python/dam_break.ipynb").read_text())["cells"]
    small = [
        ('"../../scenes/dam_break_liquid.toml"\n', ""),
        ('Simulation("../../scenes/dam_break_liquid.toml")', f'Simulation(cutwater.Scene("{ROOT}/scenes/dam_break_liquid.toml", scale=0.25), "cpu")'),
        ('Scene("../../scenes/dam_break_liquid.toml", scale=0.5)', f'Scene("{ROOT}/scenes/dam_break_liquid.toml", scale=0.25)'),
        ("Simulation(scene)", 'Simulation(scene, "cpu")'),
        ("frames(8)", "frames(2)"),
        ("(480, 270)", "(64, 48)"),
        ("(320, 180)", "(64, 48)"),
    ]
    names = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            text = "".join(cell["source"])
            for long, short in small:
                text = text.replace(long, short)
            exec(text, names)  # noqa: S102
    assert names["frames"][-1].number == 2
