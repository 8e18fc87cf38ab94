"""Simulations: arrays against the files of a run, states, changes between sub-steps, threads, interruptions, memory."""

import base64
import gc
import logging
import pickle
import resource
import signal
import subprocess
import sys
import threading
import zlib
from xml.etree import ElementTree

import cutwater
import numpy as np
import pytest
from cutwater.errors import AdapterError, InputError, InternalError, SceneError

BACKENDS = ["cpu", "gpu"]


def vtk(path):
    """Arrays of a VTK file of the run by name: inline base64 with a byte count first, or with zlib one block after its four counts."""
    root = ElementTree.parse(path).getroot()
    count = np.dtype(root.get("header_type", "UInt32").lower())
    arrays = {}
    for array in root.iter("DataArray"):
        text = array.text.strip()
        kind = np.dtype(array.get("type").lower())
        if root.get("compressor"):
            head = (4 * count.itemsize + 2) // 3 * 4
            assert np.frombuffer(base64.b64decode(text[:head]), count)[0] == 1
            values = np.frombuffer(zlib.decompress(base64.b64decode(text[head:])), kind)
        else:
            values = np.frombuffer(base64.b64decode(text), kind, offset=count.itemsize)
        width = int(array.get("NumberOfComponents", 1))
        arrays[array.get("Name") or "Points"] = values.reshape(-1, width) if width > 1 else values
    return arrays


def same(array, other):
    """Whether both have the same numbers, bit for bit."""
    array, other = np.asarray(array), np.asarray(other)
    return array.shape == other.shape and array.dtype == other.dtype and array.tobytes() == other.tobytes()


@pytest.mark.parametrize("backend", BACKENDS)
def test_arrays_are_those_of_the_files(both, backend):
    both["output"] = {"fields": True, "surface": True, "checkpoint_every": 1}
    scene = cutwater.Scene(both)
    cutwater.run(scene, "run", backend=backend, frames=2)
    *_, frame = cutwater.Simulation(scene, backend=backend).frames(2)
    assert (frame.number, frame.time) == (2, 2 / 24)

    markers = vtk("run/frames/scene_000002.vtp")
    assert same(frame.markers.positions.astype(np.float32), markers["Points"])
    assert same(frame.markers.velocities.astype(np.float32), markers["velocity"])
    fields = vtk("run/frames/scene_000002.vti")
    assert same(frame.pressure.astype(np.float32).ravel(), fields["pressure"])
    assert same(frame.distance.astype(np.float32).ravel(), fields["liquid_distance"])
    assert same(frame.solid_distance.astype(np.float32).ravel(), fields["solid_distance"])
    assert same(frame.velocities.astype(np.float32).reshape(-1, 3), fields["velocity"])
    solids, beam = vtk("run/frames/scene_000002.vtu"), frame.solids["beam"]
    assert same(beam.nodes.astype(np.float32), solids["Points"])
    assert same(beam.displacement.astype(np.float32), solids["displacement"])
    assert same(beam.velocities.astype(np.float32), solids["velocity"])
    assert same(beam.von_mises.astype(np.float32), solids["von_mises"])
    assert same(beam.det_f.astype(np.float32), solids["det_f"])
    assert same(beam.elements.ravel().astype(solids["connectivity"].dtype), solids["connectivity"])
    surface = vtk("run/frames/scene_surface_000002.vtp")
    assert same(frame.surface.vertices, surface["Points"])
    assert same(frame.surface.normals, surface["Normals"])
    assert same(frame.surface.velocities, surface["velocity"])

    # The checkpoint has float32 where that is exact.
    state = np.load("run/checkpoint.npz")
    for name, array in {
        "markers": frame.markers.positions,
        "pressure": frame.pressure,
        "liquid_distance": frame.distance,
        "velocity_x": frame.velocity[0],
        "velocity_y": frame.velocity[1],
        "velocity_z": frame.velocity[2],
        "displacement": frame.displacement,
        "node_velocity": frame.node_velocity,
        "active": frame.active,
    }.items():
        assert same(array, state[name].astype(array.dtype)), name


def test_arrays_are_read_only_and_keep_their_memory(both):
    sim = cutwater.Simulation(both, backend="cpu")
    frame = sim.frame
    arrays = [frame.markers.positions, frame.pressure, frame.velocity[0], frame.displacement, frame.surface.vertices]
    for array in [*arrays, frame.solids["beam"].nodes]:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    for array in arrays:
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.flags.writeable = True
    # A view of the frame's memory, not a copy: two arrays share it.
    assert np.shares_memory(frame._core.array("pressure"), frame.pressure)
    copies = [array.copy() for array in arrays]
    del frame
    for _ in range(3):
        sim.step()
        sim.frame.pressure  # noqa: B018
    del sim
    gc.collect()
    assert all(same(array, copy) for array, copy in zip(arrays, copies))


def test_reports_and_probes(water):
    sim = cutwater.Simulation(water, backend="cpu")
    reports = [sim.step() for _ in range(3)]
    assert [report["step"] for report in reports] == [0, 1, 2]
    assert reports[-1]["t"] == sim.time and reports[-1]["status"] == "converged"
    assert reports[-1]["residual_p"] < 1e-8 and isinstance(reports[-1]["seconds_solve"], float)
    assert sim.probes.dtype.names == ("step", "t", "front", "u_x", "u_y", "u_z")
    assert sim.probe_units == {"front": "m", "u_x": "m/s", "u_y": "m/s", "u_z": "m/s"}
    assert list(sim.probes["step"]) == [0, 1, 2] and sim.probes["t"][-1] == sim.time
    # The front is the largest x of the surface, which lies about half a cell beyond the markers.
    front = sim.frame.markers.positions[:, 0].max()
    assert abs(sim.probes["front"][-1] - front) < sim.scene.dx


def test_a_level_has_components(water):
    water["liquid"]["surface"] = "level"
    sim = cutwater.Simulation(water, backend="cpu")
    sim.step()
    frame = sim.frame
    assert frame.component.shape == frame.pressure.shape == (5, 10, 20) and frame.component.max() == 1
    assert (frame.component[frame.active] == 1).all()
    assert len(frame.markers.spray) == len(frame.markers) == len(frame.markers.velocities) and not frame.markers.spray.any()
    # The column of 0.5 m x 0.7 m x 0.5 m, its surface between the cells: half of a layer of cells at most.
    volume = sim.scene.dx**3 * (frame.distance < 0).sum()
    assert abs(volume - 0.175) < 0.05 * (0.5 + 0.7) * 0.5


def test_progress_and_every(water):
    calls = []
    frames = list(cutwater.Simulation(water, backend="cpu").frames(5, every=2, progress=lambda *now: calls.append(now)))
    assert [frame.number for frame in frames] == [0, 2, 4, 5]
    assert calls[-1] == (5, 5, 5 / 24)
    with pytest.raises(ZeroDivisionError):
        list(cutwater.Simulation(water, backend="cpu").frames(2, progress=lambda *now: 1 / 0))


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_state_resumes_bitwise(both, backend):
    sim = cutwater.Simulation(both, backend=backend)
    for _ in range(4):
        sim.step()
    state = sim.state
    assert (state.step, state.time) == (4, sim.time)
    for _ in range(4):
        sim.step()
    end = sim.state
    again = pickle.loads(pickle.dumps(state))
    again.save("state.npz")
    sim.state = cutwater.State.load("state.npz")
    assert sim.state == state
    for _ in range(4):
        sim.step()
    assert sim.state == end and not sim.state == state


def test_a_checkpoint_of_a_run_is_a_state(water):
    scene = cutwater.Scene(water)
    cutwater.run(scene, "run", backend="cpu", frames=2)
    sim = cutwater.Simulation(scene, backend="cpu")
    sim.state = cutwater.State.load("run/checkpoint.npz")
    assert sim.frame_number == 2
    longer = cutwater.Simulation(water | {"time": {"duration": 1.0}}, backend="cpu")
    longer.state = sim.state
    other = cutwater.Simulation(water | {"liquid": water["liquid"] | {"density": 900.0}}, backend="cpu")
    with pytest.raises(InputError, match="another scene: liquid.density"):
        other.state = sim.state
    other.resume(sim.state, same_scene=False)
    assert other.frame_number == 2
    with pytest.raises(InputError, match="no such file"):
        cutwater.State.load("nowhere.npz")


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_change_of_nothing_changes_nothing(both, backend):
    plain, changed = [cutwater.Simulation(both, backend=backend) for _ in range(2)]
    for number in range(4):
        plain.step()
        if number == 2:
            changed.set_gravity([0, -9.81, 0])
            changed.set_velocity(*changed.frame.velocity, nodes=changed.frame.node_velocity)
            changed.change({})
        changed.step()
    assert changed.state == plain.state


def test_changes(both):
    sim = cutwater.Simulation(both, backend="cpu")
    sim.step()
    before = sim.frame.node_velocity.copy()
    sim.change({"solid[0].load[0].force": [500.0, 0, 0]})
    assert same(sim.frame.node_velocity, before)
    sim.step()
    pushed = sim.frame.node_velocity[:, 0].max()
    assert pushed > 10 * abs(before[:, 0]).max()
    sim.set_gravity([9.81, 0, 0])
    assert sim.step()["step"] == 2
    for key in ("domain.cells", "liquid.region[0].velocity", "solid[0].mesh", "time.frames_per_second", "solid"):
        with pytest.raises(SceneError, match="cannot change"):
            sim.change({key: 1})
    with pytest.raises(InputError, match="gravity"):
        sim.set_gravity([0, float("nan"), 0])


def test_changes_keep_what_was_steered(gate):
    sim = cutwater.Simulation(gate, backend="cpu")
    sim.step()
    sim.steer(0, velocity=(0, 0.5, 0))
    sim.set_gravity([0, -5, 0])
    sim.step()
    pose = sim._core.scene().pose(0, sim.time)
    sim.change({"solver.tolerance": 1e-6})
    assert sim._core.scene().pose(0, sim.time) == pose and pose[0][1] > 0
    assert sim._core.scene().gravity == [0, -5, 0]
    with pytest.raises(InputError, match="away from the old one"):
        sim.change({"obstacle[0].keyframes": [{"t": 0}, {"t": 1, "translate": [0, 0.1, 0]}]})
    assert sim._core.scene().pose(0, sim.time) == pose
    sim.change({"obstacle[0].keyframes": [{"t": sim.time, "translate": pose[0]}]})
    sim.step()
    assert sim._core.scene().pose(0, sim.time)[0] == pytest.approx(pose[0], rel=1e-12)


def test_velocities(both):
    sim = cutwater.Simulation(both, backend="cpu")
    sim.step()
    x, y, z = sim.frame.velocity
    sim.set_velocity(x=x + 0.5, nodes=np.ones_like(sim.frame.node_velocity))
    assert same(sim.frame.velocity[0], x + 0.5) and same(sim.frame.velocity[1], y)
    # The pinned nodes stay at rest.
    beam = sim.frame.solids["beam"]
    pinned = beam.rest[:, 1] > 0.64
    assert (beam.velocities[pinned] == 0).all() and (beam.velocities[~pinned] == 1).all()
    with pytest.raises(ValueError, match="shape"):
        sim.set_velocity(y=np.zeros((1, 2, 3)))
    with pytest.raises(InputError, match="number 0"):
        sim.set_velocity(x=np.full_like(x, np.nan))


@pytest.mark.parametrize(("backend", "rounding"), [("cpu", 1e-9), ("gpu", 1e-5)])
def test_a_steered_gate_moves_as_one_with_keyframes(gate, backend, rounding):
    """Both paths are the same to 1e-16 m; after six sub-steps markers differ by some roundings of positions of about 1 m."""
    gate["time"]["fixed_step"] = 1 / 96
    gate["liquid"]["surface"] = "markers"
    steered = cutwater.Simulation(gate, backend=backend)
    gate["obstacle"][0]["keyframes"] = [{"t": 0}, {"t": 0.5, "translate": [0, 0.2, 0]}]
    scripted = cutwater.Simulation(gate, backend=backend)
    for _ in range(6):
        steered.steer(0, velocity=(0, 0.4, 0))
        steered.step()
        scripted.step()
    assert steered.time == scripted.time == pytest.approx(6 / 96, rel=1e-12)
    translate, turned = steered._core.scene().pose(0, steered.time)
    assert translate == pytest.approx([0, 0.4 * steered.time, 0], rel=1e-12) and turned == [0, 0, 0]
    assert np.abs(steered.frame.markers.positions - scripted.frame.markers.positions).max() < rounding
    assert np.abs(steered.frame.solid_distance - scripted.frame.solid_distance).max() < rounding
    # It has left the floor: the cells below it are open.
    at_rest = cutwater.Simulation(gate, backend="cpu").frame.solid_distance
    assert (steered.frame.solid_distance - at_rest).max() > 0.2 * translate[1]
    with pytest.raises(InputError, match="no such obstacle"):
        steered.steer(1)
    with pytest.raises(InputError, match="away from the old one"):
        steered.set_motion(0, [{"t": 0, "translate": [0, 0.3, 0]}])
    steered.set_motion(0, [{"t": steered.time, "translate": translate}])
    steered.step()
    assert steered._core.scene().pose(0, steered.time)[0] == pytest.approx(translate, rel=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_script_that_is_set_is_that_of_the_scene(both, backend):
    both["time"]["fixed_step"] = 1 / 96
    del both["solid"][0]["load"]
    pin = both["solid"][0].pop("pin")[0]
    keyframes = [{"t": 0}, {"t": 0.1, "translate": [0.02, 0, 0], "rotate": {"axis": [0, 1, 0], "degrees": 10}}]
    both["solid"][0]["script"] = [pin | {"keyframes": keyframes}]
    scripted = cutwater.Simulation(both, backend=backend)
    both["solid"][0]["script"] = [pin | {"keyframes": keyframes[:1]}]
    steered = cutwater.Simulation(both, backend=backend)
    steered.set_script(0, 0, keyframes)
    for _ in range(4):
        scripted.step()
        steered.step()
    assert same(steered.frame.displacement, scripted.frame.displacement) and steered.frame.displacement.any()
    with pytest.raises(InputError, match="no such script"):
        steered.set_script(0, 1, keyframes)


def test_two_simulations_side_by_side(water, both):
    """Two threads, a simulation each, compute what one computes."""
    scenes = [water, both]
    alone = [cutwater.Simulation(scene, backend="cpu") for scene in scenes]
    beside = [cutwater.Simulation(scene, backend="cpu") for scene in scenes]
    for sim in alone:
        for _ in range(6):
            sim.step()
    threads = [threading.Thread(target=lambda sim=sim: [sim.step() for _ in range(6)]) for sim in beside]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [sim.state for sim in beside] == [sim.state for sim in alone]


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_thread_steps_while_another_draws(water, backend):
    water["liquid"]["surface"] = "markers"
    sim = cutwater.Simulation(water, backend=backend)
    first = sim.frame
    failures = []

    def work():
        try:
            for _ in range(10):
                sim.step()
        except BaseException as error:  # noqa: BLE001
            failures.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    pictures = [first.show(size=(64, 48)).data for _ in range(2)]
    frames = [sim.frame for _ in range(3)]
    thread.join()
    assert not failures and sim.step_number == 10
    assert pictures[0] == pictures[1] and pictures[0].startswith(b"\x89PNG")
    # Each is a state between two sub-steps.
    assert all(len(frame.markers) == len(first.markers) for frame in frames)


def test_the_gil_is_released(water):
    """Another thread counts while a sub-step is computed."""
    water["domain"]["cells"] = [80, 40, 20]
    sim = cutwater.Simulation(water, backend="cpu")
    count, going = 0, True

    def counter():
        nonlocal count
        while going:
            count += 1

    thread = threading.Thread(target=counter)
    thread.start()
    before = count
    sim._core.step()
    counted = count - before
    going = False
    thread.join()
    # With the GIL held it would count during switches alone: nothing within the one call.
    assert counted > 1000


INTERRUPTED = """
import os, signal, sys, threading
import cutwater
sys.path.insert(0, sys.argv[1])
from conftest import WATER
from cutwater import Simulation
water = WATER | {"time": {"duration": 20.0}}
interrupt = lambda *now: now[0] == 2 and os.kill(os.getpid(), signal.SIGINT)
sim = Simulation(water, backend="cpu")
try:
    for frame in sim.frames(progress=interrupt, save="state.npz"):
        pass
except KeyboardInterrupt:
    assert cutwater.State.load("state.npz") == sim.state
    sim.step()
    print("frames")
try:
    cutwater.run(water, "run", backend="cpu", progress=interrupt)
except KeyboardInterrupt:
    summary = cutwater.run(water, "run", backend="cpu", resume=True, frames=3)
    print("run", summary["resumed_at"])
"""


def test_ctrl_c_saves_and_raises(request):
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, str(request.path.parent)], capture_output=True, text=True, timeout=60, check=False,
        # A shell in the background ignores the signal, and so would its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert done.stdout.split() == ["frames", "run", "2"], done.stderr


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_thousand_steps_need_no_more_memory(water, backend):
    water["domain"]["cells"] = [20, 10, 5]
    del water["probe"]
    sim = cutwater.Simulation(water, backend=backend)

    def steps(n):
        for _ in range(n):
            sim.step()
            sim.frame.pressure  # noqa: B018
        gc.collect()
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    size = sim.state._core.to_bytes()
    before = steps(100)
    growth = 1024 * (steps(1000) - before)
    # A state that stayed in each step would be at least 1,000 times its packed size.
    assert growth < 0.1 * 1000 * len(size), f"{growth / 1000:.0f} bytes a step"


def test_wrong_devices(water):
    with pytest.raises(AdapterError) as caught:
        cutwater.Simulation(water, adapter="none of these")
    assert caught.value.cure and caught.value.exit_code == 3
    with pytest.raises(ValueError, match="backend"):
        cutwater.Simulation(water, backend="tpu")


WITHOUT_DRIVER = """
import sys
import cutwater
sys.path.insert(0, sys.argv[1])
from conftest import WATER
try:
    cutwater.Simulation(WATER)
except cutwater.errors.AdapterError as error:
    print(error.cure)
"""


def test_no_driver_is_an_exception(request):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_DRIVER, str(request.path.parent)],
        env={"VK_DRIVER_FILES": "/nowhere.json", "PATH": "/usr/bin"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert 'backend="cpu"' in done.stdout, done.stdout + done.stderr


def test_a_panic_is_an_exception(capfd):
    with pytest.raises(InternalError, match="requested by a test"):
        cutwater._core.panic()


def test_warnings_are_logged(water, caplog):
    water["obstacle"] = [{"box": {"min": [1, 0, 0], "max": [1.02, 0.5, 0.5]}}]
    with caplog.at_level(logging.WARNING, "cutwater"):
        cutwater.Simulation(water, backend="cpu")
    assert any("thin" in record.message or "leak" in record.message for record in caplog.records)


def test_signals_of_python_are_untouched(water):
    before = signal.getsignal(signal.SIGINT)
    cutwater.run(water, "run", backend="cpu", frames=1)
    assert signal.getsignal(signal.SIGINT) is before
