"""Scenes: key paths, dicts, and what is refused with which words."""

import cutwater
import numpy as np
import pytest
from cutwater.errors import CutwaterError, InputError, SceneError


def test_key_paths(scenes):
    scene = cutwater.Scene(scenes / "dam_break.toml", scale=0.32)
    assert scene.cells == (32, 32, 32) and scene.name == "dam_break" and scene.n_frames == 96
    assert scene["solid[0].young"] == scene["solid.0.young"] == 1e6
    scene["solid.0.young"] = 2e6
    assert scene["solid[0].young"] == 2e6
    assert scene.to_dict()["solid"][0]["young"] == 2e6
    assert "solid[0].young = 2e6" not in scene.to_toml() and "young = 2000000.0" in scene.to_toml()
    assert "liquid.density" in scene and "liquid.seed" not in scene
    assert scene.get("liquid.seed", 7) == 7
    with pytest.raises(KeyError, match="defaults"):
        scene["liquid.seed"]
    with pytest.raises(KeyError, match="key path"):
        scene["liquid..seed"]


def test_a_copy_is_independent(water):
    scene = cutwater.Scene(water)
    other = scene.copy()
    other["liquid.density"] = 800
    assert "liquid.density" not in scene and other["liquid.density"] == 800


def test_a_dict_is_the_scene_of_its_toml(water, tmp_path):
    water["liquid"]["region"][0]["box"]["max"] = np.array([0.5, 0.7, 0.5])
    water["domain"]["cells"] = tuple(np.int32(n) for n in (20, 10, 5))
    scene = cutwater.Scene(water, name="tank")
    path = tmp_path / "tank.toml"
    path.write_text(scene.to_toml())
    again = cutwater.Scene(path)
    assert again.to_dict() == scene.to_dict() and again._core.cells == [20, 10, 5]
    with pytest.raises(TypeError, match="not object"):
        cutwater.Scene({"domain": object()})


def test_a_refused_value_changes_nothing(water):
    scene = cutwater.Scene(water)
    before = scene.to_toml()
    with pytest.raises(SceneError) as caught:
        scene.update({"liquid.density": 900, "domain.size": [2, -1, 0.5]})
    error = caught.value
    assert error.key.startswith("domain.size") and error.line is None and error.cure and error.exit_code == 2
    assert str(error).startswith('scene["domain.size"] = [2, -1, 0.5]: ') and "--set" not in str(error)
    assert scene.to_toml() == before


def test_an_error_names_file_line_and_key(tmp_path):
    path = tmp_path / "tank.toml"
    path.write_text("[domain]\nsize = [1, 1, 1]\ncells = [8, 8, 8]\n[liquid]\ndensitty = 3\n")
    with pytest.raises(SceneError) as caught:
        cutwater.Scene(path)
    error = caught.value
    assert (error.file, error.line, error.key) == (str(path), 5, "liquid.densitty")
    assert "density" in error.cure and str(error).startswith(f"{path}:5: liquid.densitty: ")


# Key path, value, and the key that the error names.
BAD = [
    ("domain.size", [2, 1], "domain.size"),
    ("domain.size", [2.0, 1.0, 0.7], "domain"),
    ("domain.cells", [20, 10, 0], "domain.cells"),
    ("domain.cells", "many", "domain.cells"),
    ("domain.gravity", [0, float("nan"), 0], "domain.gravity"),
    ("domain.open", ["up"], "domain.open"),
    ("domain.colour", 1, "domain.colour"),
    ("time.duration", -1, "time.duration"),
    ("time.cfl", 0, "time.cfl"),
    ("time.frames_per_second", float("inf"), "time.frames_per_second"),
    ("liquid.density", 0, "liquid.density"),
    ("liquid.surface", "foam", "liquid.surface"),
    ("liquid.region", [], "liquid"),
    ("liquid.region[0].box.max", [0, 0, 0], "liquid.region[0].box"),
    ("liquid.region[3].velocity", [1, 0, 0], "liquid.region"),
    ("solver.tolerance", 2.0, "solver.tolerance"),
    ("solver.precision", "f16", "solver.precision"),
    ("solid", [{"name": "a"}], "solid[0]"),
    ("obstacle", [{"sphere": {"centre": [0, 0, 0], "radius": -1}}], "obstacle[0].sphere.radius"),
    ("probe", [{"name": "x", "front": {"axis": "w"}}], "probe[0].front.axis"),
    ("output.every", 0, "output.every"),
    ("camera.fov", 200, "camera.fov"),
]


@pytest.mark.parametrize(("key", "value", "named"), BAD, ids=[f"{key}={value}" for key, value, _ in BAD])
def test_bad_values_are_exceptions(water, key, value, named):
    scene = cutwater.Scene(water)
    with pytest.raises(SceneError) as caught:
        scene[key] = value
    error = caught.value
    assert named in error.key or named in str(error), str(error)
    assert error.problem and error.cure and isinstance(error, ValueError)


def test_files_that_are_no_scenes(tmp_path):
    for path in (tmp_path, tmp_path / "none.toml"):
        with pytest.raises(InputError) as caught:
            cutwater.Scene(path)
        assert caught.value.cure and caught.value.exit_code == 2
    (tmp_path / "broken.toml").write_text("[domain\n")
    with pytest.raises(CutwaterError):
        cutwater.Scene(tmp_path / "broken.toml")


def test_cures_are_in_the_words_of_python(scenes):
    with pytest.raises(InputError, match=r"scale=0\.25: .*\n  cure: use scale=0\.5") as caught:
        cutwater.Scene(scenes / "standing_wave.toml", scale=0.25)
    assert "--" not in str(caught.value)


def test_removed_parts_take_along_what_refers_to_them(both):
    both["solid"].append({**both["solid"][0], "name": "wall", "placement": {"translate": [0.85, 0.4, 0.25]}})
    both["probe"] = [{"name": "load", "force": {"solid": "beam"}}, {"name": "u", "velocity": {"point": [0.2, 0.2, 0.2]}}]
    scene = cutwater.Scene(both)
    dry = scene.without("liquid")
    assert "liquid" not in dry and "probe" not in dry and dry.removed == ['probe "load"', 'probe "u"']
    assert "liquid" in scene and scene.removed == []
    # Indices are those before the removal, and afterwards those of what remains.
    dry["solid[1].young"] = 3e5
    one = dry.without("solid[0]")
    assert [solid["name"] for solid in one["solid"]] == ["wall"] and one["solid[0].young"] == 3e5
    one["solid[0].young"] = 4e5
    assert one["solid.wall.young"] == 4e5 and dry["solid[1].young"] == 3e5
    assert cutwater.Scene(one.to_dict()).to_dict() == one.to_dict()
    assert scene.without("solid[0]", "solid[1]").to_dict() == scene.without("solid").to_dict()
    del scene["solid.beam"]
    assert scene.to_dict()["solid"][0]["name"] == "wall" and scene.removed == ['probe "load"']
    with pytest.raises(SceneError, match=r'del scene\["solid\[1\]"\]: there is no') as caught:
        del scene["solid[1]"]
    assert caught.value.key == "solid[1]" and caught.value.line is None and "wall" in caught.value.cure
    with pytest.raises(SceneError, match="neither liquid nor solids"):
        scene.without("solid", "liquid")
    assert len(scene["solid"]) == 1 and "liquid" in scene
