//! Meshes of the liquid's surface, read back by trimesh and fieldcompare, which share no code with what makes and writes them.

use std::path::Path;

use cutwater::elastic::Solids;
use cutwater::geometry;
use cutwater::output::frames::{FrameKinds, FrameWriter};
use cutwater::scene::Scene;
use cutwater::state::State;
use glam::DVec3;
use serde_json::Value;

use crate::output::{flat, python, read};

/// A tank of 1 x 0.5 x 0.5 m, 2 cells to 1/16 m more with `cells`, and liquid in it.
/// With markers, unless the liquid names its surface.
fn scene(cells: &str, liquid: &str) -> Scene {
    let text = format!(
        "[domain]\nsize = [1, 0.5, 0.5]\ncells = {cells}\n[time]\nduration = 1\n[output]\nparticles = false\nsurface = true\n{liquid}"
    );
    let names_a_surface = text.contains("surface = '");
    let markers = ["liquid.surface=markers".to_owned()];
    let overrides = if names_a_surface { &[][..] } else { &markers };
    Scene::parse(Path::new("wet.toml"), &text, overrides, 1.0).unwrap()
}

fn state(scene: &Scene) -> State {
    let grid = scene.grid();
    let cut = geometry::cut_cells(scene, &grid).unwrap();
    geometry::initial_state(scene, &grid, &cut).unwrap()
}

/// Writes the state as one frame.
fn write(run: &Path, scene: &Scene, state: &State) {
    let grid = scene.grid();
    let cut = geometry::cut_cells(scene, &grid).unwrap();
    let kinds = FrameKinds::of(scene);
    let mut writer = FrameWriter::create(run, &scene.name, grid, kinds).unwrap();
    writer.write(state, &cut, &Solids::default()).unwrap();
}

/// What trimesh finds in the PLY file of frame 0, and fieldcompare in the VTP file: the same.
fn read_both(python: &Path, run: &Path) -> Value {
    let frames = run.join("frames");
    let ply = read(python, &frames.join("wet_000000.ply"));
    let vtp = read(python, &frames.join("wet_surface_000000.vtp"));
    let none = Value::Array(Vec::new());
    for (of_ply, of_vtp) in [
        (&ply["coordinates"], &vtp["coordinates"]),
        (&ply["normals"], &vtp["points"]["Normals"]["values"]),
        (&ply["velocity"], &vtp["points"]["velocity"]["values"]),
        // The reader leaves out a kind of cell that there is none of.
        (&ply["triangles"], vtp["connectivity"].get("POLYGON").unwrap_or(&none)),
    ] {
        assert!(flat(of_ply) == flat(of_vtp), "PLY and VTP differ");
    }
    ply
}

/// Closed, turned outwards, within the tank, of the volume and area of what was filled.
///
/// A flat free surface is within 0.1 cells of where it was filled to (0.05 by the level, as much near walls, where a part of the
/// spline is missing), that of a ball of 6 cells within 0.25 (cells half in the ball have no markers towards the outside); edges between
/// free sides are rounded with about a cell, which costs a fifth of a squared cell along each.
#[test]
fn a_surface_is_closed_and_holds_the_volume() {
    let Some(python) = python() else { return };
    let dx: f64 = 1.0 / 32.0;
    let pi = std::f64::consts::PI;
    let cases = [
        // 1 x 0.5 m of free surface.
        ("box = { min = [0, 0, 0], max = [1, 0.25, 0.5] }", 0.125, 0.5 * 0.1 * dx),
        // Two free sides of 0.25 x 0.5 m, an edge of 0.5 m.
        ("box = { min = [0, 0, 0], max = [0.25, 0.25, 0.5] }", 0.03125, 0.25 * 0.1 * dx + 0.1 * dx * dx),
        (
            "sphere = { centre = [0.5, 0.25, 0.25], radius = 0.1875 }",
            4.0 / 3.0 * pi * 0.1875_f64.powi(3),
            4.0 * pi * 0.1875_f64.powi(2) * 0.25 * dx,
        ),
    ];
    for (shape, volume, bound) in cases {
        let run = tempfile::tempdir().unwrap();
        let scene = scene("[32, 16, 16]", &format!("[[liquid.region]]\n{shape}"));
        let mut state = state(&scene);
        for axis in 0..3 {
            state.velocity[axis].fill([0.5, -1.0, 2.0][axis]);
        }
        write(run.path(), &scene, &state);
        let mesh = read_both(&python, run.path());
        assert_eq!(mesh["watertight"], true, "{shape}: an edge has not two triangles");
        assert_eq!(mesh["winding"], true, "{shape}: triangles are not turned alike");
        let found = mesh["volume"].as_f64().unwrap();
        assert!((found - volume).abs() < bound, "{shape}: {found}, not {volume} +- {bound}");
        let points = flat(&mesh["coordinates"]);
        let inside =
            points.chunks_exact(3).all(|x| x.iter().zip([1.0, 0.5, 0.5]).all(|(x, size)| (0.0..=size).contains(x)));
        assert!(inside, "{shape}: beyond the walls");
        let normals = flat(&mesh["normals"]);
        for (x, normal) in points.chunks_exact(3).zip(normals.chunks_exact(3)) {
            let length: f32 = normal.iter().map(|part| part * part).sum();
            assert!((length - 1.0).abs() < 1e-5, "{shape}: the normal at {x:?} is {normal:?}");
        }
        for velocity in flat(&mesh["velocity"]).chunks_exact(3) {
            assert_eq!(velocity, [0.5, -1.0, 2.0], "{shape}");
        }
    }
}

/// Of a ball with a fixed surface, the distance is exact to the straight edges of marching cubes: dx^2/(8 r) at most, a half of
/// that on average; normals point from its centre.
#[test]
fn a_fixed_surface_is_where_its_distance_says() {
    let Some(python) = python() else { return };
    let run = tempfile::tempdir().unwrap();
    let radius = 0.1875;
    let scene = scene(
        "[32, 16, 16]",
        "[liquid]\nsurface = 'fixed'\n[[liquid.region]]\nsphere = { centre = [0.5, 0.25, 0.25], radius = 0.1875 }",
    );
    write(run.path(), &scene, &state(&scene));
    let mesh = read_both(&python, run.path());
    assert_eq!(mesh["watertight"], true);
    assert_eq!(mesh["winding"], true);
    let points = flat(&mesh["coordinates"]);
    let normals = flat(&mesh["normals"]);
    let dx = 1.0 / 32.0;
    assert!(points.len() > 1000);
    for (x, normal) in points.chunks_exact(3).zip(normals.chunks_exact(3)) {
        let vector = |x: &[f32]| DVec3::new(x[0].into(), x[1].into(), x[2].into());
        let out = vector(x) - DVec3::new(0.5, 0.25, 0.25);
        let off = out.length() - radius;
        assert!(off.abs() < dx * dx / (8.0 * radius), "{x:?} is {off} m off");
        let cosine = vector(normal).dot(out.normalize());
        assert!(cosine > 0.99, "the normal at {x:?} is {normal:?}");
    }
}

/// Liquid and an obstacle whose sides pass through centres of cells, where distances are 0.
#[test]
fn surfaces_through_centres_are_closed() {
    let Some(python) = python() else { return };
    for surface in ["level", "fixed"] {
        let run = tempfile::tempdir().unwrap();
        let liquid = format!(
            "[liquid]\nsurface = '{surface}'\n[[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [1, 0.265625, 0.5] }}\n\
             [[obstacle]]\nbox = {{ min = [0.484375, 0, 0.109375], max = [0.609375, 0.359375, 0.359375] }}"
        );
        let scene = scene("[32, 16, 16]", &liquid);
        let state = state(&scene);
        // A level is shifted until it has the volume of its region; with it the distance to the obstacle is 0.
        assert!(surface == "level" || state.liquid_distance.contains(&0.0));
        write(run.path(), &scene, &state);
        let mesh = read_both(&python, run.path());
        assert_eq!(mesh["watertight"], true, "{surface}");
        assert_eq!(mesh["winding"], true, "{surface}");
        assert_eq!(mesh["coincident"], 0, "{surface}");
    }
}

#[test]
fn no_liquid_is_an_empty_surface() {
    let Some(python) = python() else { return };
    let run = tempfile::tempdir().unwrap();
    let scene = scene("[16, 8, 8]", "[[liquid.region]]\nbox = { min = [0, 0, 0], max = [1, 0.25, 0.5] }");
    let mut state = state(&scene);
    state.markers.clear();
    write(run.path(), &scene, &state);
    let mesh = read_both(&python, run.path());
    assert_eq!(flat(&mesh["coordinates"]), [0.0_f32; 0]);
    let series = read(&python, &run.path().join("frames/wet_surface.pvd"));
    assert_eq!(series["times"].as_array().unwrap().len(), 1);
}

/// The same markers make the same files, byte for byte, whatever the number of threads, also where the mesh is put together from
/// several parts; a thousand drops make many parts that are not joined.
#[test]
fn surfaces_do_not_depend_on_threads() {
    let scene = scene("[128, 64, 64]", "[[liquid.region]]\nbox = { min = [0, 0, 0], max = [1, 0.04, 0.5] }");
    let mut state = state(&scene);
    let drop = |n: u32, axis: u32| (f64::from(n * (axis + 2)) * 0.618_034).fract();
    let drops = (0..1000).map(|n| [drop(n, 0), 0.1 + 0.3 * drop(n, 1), 0.5 * drop(n, 2)]);
    state.markers.extend(drops);
    let bytes = |threads: usize| {
        let run = tempfile::tempdir().unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| write(run.path(), &scene, &state));
        ["wet_000000.ply", "wet_surface_000000.vtp"]
            .map(|file| std::fs::read(run.path().join("frames").join(file)).unwrap())
    };
    let once = bytes(1);
    assert!(once[0].len() > 1_000_000);
    for threads in [3, 5, 8] {
        assert!(bytes(threads) == once, "{threads} threads make another mesh than one");
    }
}

/// Where walls press a surface flat it has neither triangles without area nor vertices at one place, so that readers that merge vertices,
/// as trimesh does by default, find it closed. Least height: a thousandth of a cell, less rounding.
#[test]
fn surfaces_have_no_degenerate_triangles() {
    let Some(python) = python() else { return };
    let pool = "[[liquid.region]]\nbox = { min = [0, 0, 0], max = [1, 0.25, 0.5] }";
    let slope = "[[liquid.region]]\nhalf_space = { point = [0.5, 0.25, 0.25], normal = [0.2, 1, 0.1] }";
    let full = "[[liquid.region]]\nbox = { min = [0, 0, 0], max = [1, 0.5, 0.5] }";
    let corner = "[[liquid.region]]\nsphere = { centre = [0, 0, 0], radius = 0.2 }";
    let thin = "[[liquid.region]]\nbox = { min = [0, 0, 0], max = [1, 0.06, 0.5] }";
    let uniform = |n: u32, axis: u32| (f64::from(n * (axis + 2)) * 0.618_034).fract();
    for (liquid, drops) in
        [(pool, 0), (slope, 0), (full, 0), (corner, 0), (thin, 0), (pool, 500), (thin, 3000), (corner, 100)]
    {
        for smoothing in [0, 20] {
            let case = format!("{liquid}, {drops} drops, smoothing {smoothing}");
            let run = tempfile::tempdir().unwrap();
            let keys = format!("[surface]\nsmoothing = {smoothing}\n{liquid}");
            let scene = scene("[32, 16, 16]", &keys);
            let mut state = state(&scene);
            let drops = (0..drops).map(|n| [uniform(n, 0), 0.5 * uniform(n, 1), 0.5 * uniform(n, 2)]);
            state.markers.extend(drops);
            write(run.path(), &scene, &state);
            let mesh = read_both(&python, run.path());
            let least = mesh["least_height"].as_f64().unwrap();
            assert_eq!(mesh["coincident"], 0, "{case}");
            assert!(least > 0.9e-4 / 32.0, "{case}: a triangle is {least:e} m high");
            assert_eq!(mesh["watertight"], true, "{case}");
            assert_eq!(mesh["loads_watertight"], true, "{case}");
            assert_eq!(mesh["winding"], true, "{case}");
        }
    }
}

/// A thousand rounds of smoothing keep the volume, and a pool at rest flat to its walls; without mirrors it has a ridge of 0.4 cells there.
#[test]
fn smoothing_keeps_the_volume_and_the_level_at_walls() {
    let Some(python) = python() else { return };
    let dx = 1.0 / 32.0;
    let (mut volumes, mut highest_off) = (Vec::new(), Vec::new());
    for smoothing in [0, 20, 1000] {
        let run = tempfile::tempdir().unwrap();
        let keys = format!(
            "[surface]\nsmoothing = {smoothing}\n[[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [1, 0.25, 0.5] }}"
        );
        let scene = scene("[32, 16, 16]", &keys);
        write(run.path(), &scene, &state(&scene));
        let mesh = read_both(&python, run.path());
        volumes.push(mesh["volume"].as_f64().unwrap());
        let heights = flat(&mesh["coordinates"]);
        let highest = heights.chunks_exact(3).map(|x| x[1]).fold(0.0, f32::max);
        highest_off.push((f64::from(highest) - 0.25) / dx);
    }
    // Smoothing raises no crest, and a thousand rounds leave what the level is off by: 0.05 cells, as much near walls.
    let falls = highest_off.is_sorted_by(|rough, smooth| smooth <= rough);
    assert!(falls && highest_off[2] < 0.1, "{highest_off:?} cells");
    for volume in &volumes {
        let off = volume / volumes[0] - 1.0;
        assert!(off.abs() < 1e-5, "{volumes:?}");
    }
}

/// More smoothing makes a smaller area and keeps the volume; a larger radius makes a larger volume.
#[test]
fn radius_and_smoothing_do_what_they_say() {
    let Some(python) = python() else { return };
    let measure = |keys: &str| {
        let run = tempfile::tempdir().unwrap();
        let liquid = "[[liquid.region]]\nbox = { min = [0.1, 0.1, 0.1], max = [0.6, 0.4, 0.4] }";
        let scene = scene("[32, 16, 16]", &format!("[surface]\n{keys}\n{liquid}"));
        write(run.path(), &scene, &state(&scene));
        let mesh = read_both(&python, run.path());
        ["volume", "area"].map(|value| mesh[value].as_f64().unwrap())
    };
    let [volume, area] = measure("smoothing = 0");
    let [smooth_volume, smooth_area] = measure("smoothing = 20");
    assert!(smooth_area < 0.995 * area, "{smooth_area} of {area} m^2");
    assert!((smooth_volume / volume - 1.0).abs() < 1e-4, "{smooth_volume} of {volume} m^3");
    let [fat, _] = measure("radius = 1.45");
    let offset = (fat - smooth_volume) / smooth_area;
    // 0.7 of the half cell more.
    assert!((offset * 32.0 - 0.35).abs() < 0.1, "the surface moved by {} cells", 32.0 * offset);
}
