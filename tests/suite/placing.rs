//! Places of bodies, units of their files, and the warnings before a run.

use std::fs;

use cutwater::Error;
use cutwater::geometry::{self, Surface, TetMesh};
use cutwater::scene::Scene;
use cutwater::sim::{self, Plan};
use glam::{DMat3, DVec3};
use tempfile::TempDir;

use crate::cli::{complains, folder, says};
use crate::geometry::obj_text;

/// A cone along z on the plane z = 0, 160 high and as wide at its base, of 24 sides.
fn cone() -> Surface {
    let mut surface = Surface { vertices: vec![DVec3::ZERO, DVec3::new(0.0, 0.0, 160.0)], triangles: Vec::new() };
    for i in 0..24 {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / 24.0).sin_cos();
        surface.vertices.push(80.0 * DVec3::new(cos, sin, 0.0));
        let (rim, next) = (2 + i, 2 + (i + 1) % 24);
        surface.triangles.extend([[0, next, rim], [1, rim, next]]);
    }
    surface
}

const HEAD: &str = "[domain]\nsize = [0.4, 0.4, 0.4]\ncells = [40, 40, 40]\n[time]\nduration = 0.1\n";
const POOL: &str = "[[liquid.region]]\nbox = { min = [0, 0, 0], max = [0.4, 0.1, 0.4] }\n";

/// A folder with the cone as a file in mm, `cone.obj`, and in m, `metres.obj`, and a scene.
fn with_cone(scene: &str) -> TempDir {
    let folder = folder(scene);
    fs::write(folder.path().join("cone.obj"), obj_text(&cone())).unwrap();
    let metres = cone().map(|x| 1e-3 * x);
    fs::write(folder.path().join("metres.obj"), obj_text(&metres)).unwrap();
    folder
}

fn load(folder: &TempDir) -> Result<Scene, Error> {
    Scene::load(&folder.path().join("dam.toml"), &[], 1.0)
}

fn solid(mesh: &str, placement: &str) -> String {
    format!(
        "[[solid]]\nname = \"cone\"\nmesh = {{ {mesh} }}\nplacement = {{ {placement} }}\ndensity = 300\nyoung = 1e5\npoisson = 0.3\n"
    )
}

/// The solid of a scene.
fn placed_solid(mesh: &str, placement: &str) -> TetMesh {
    let folder = with_cone(&(HEAD.to_owned() + &solid(mesh, placement)));
    let scene = load(&folder).unwrap();
    geometry::solid_meshes(&scene).unwrap().remove(0)
}

/// The middle of the file's box comes to lie where `at` says, whatever the cell size, turn and unit: judged by the volume and the
/// centroid of the cone, which lies a quarter of its height above its base.
#[test]
fn a_filled_surface_lands_where_its_file_says() {
    let at = DVec3::new(0.2, 0.21, 0.19);
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 2.0) / 3.0, 0.7);
    let rotate = format!("rotate = {{ axis = [1, 2, 2], degrees = {} }}", 0.7_f64.to_degrees());
    let whole = format!("at = [{}, {}, {}]", at.x, at.y, at.z);
    for cell_size in [0.012, 0.02, 0.03, 0.04] {
        let mm = format!("surface = {{ file = \"cone.obj\", units = \"mm\", cell_size = {cell_size} }}");
        let m = format!("surface = {{ file = \"metres.obj\", cell_size = {cell_size} }}");
        let scaled = format!("surface = {{ file = \"cone.obj\", cell_size = {} }}", 1e3 * cell_size);
        // The middle of the box, (0, 0, 80) mm, moved there by hand: as docs/scene.md says, too.
        let by_hand = format!("scale = 0.001, {rotate}, translate = [{}, {}, {}]", at.x, at.y, at.z - 80.0);
        for (mesh, placement, turn) in [
            (&mm, whole.clone(), DMat3::IDENTITY),
            (&mm, format!("{whole}, {rotate}"), turn),
            (&m, format!("{whole}, {rotate}"), turn),
            (&scaled, format!("{whole}, {rotate}, scale = 0.001"), turn),
            (&scaled, by_hand, turn),
        ] {
            let mesh = placed_solid(mesh, &placement);
            // Chords take up to a tenth of the volume with 4 cells across, from all sides.
            let sum: DVec3 = mesh
                .elements
                .iter()
                .map(|&element| {
                    let corners = element.map(|node| mesh.nodes[node as usize]);
                    mesh.determinant(element) / 6.0 * 0.25 * corners.iter().sum::<DVec3>()
                })
                .sum();
            let centroid = sum / mesh.volume();
            let right = at + turn * DVec3::new(0.0, 0.0, -0.04);
            let off = centroid.distance(right);
            assert!(off < 0.15 * cell_size, "{cell_size}, {placement}: {centroid}, off by {off} m");
        }
    }
}

/// Meshes of tetrahedra, in every unit: exact.
#[test]
fn a_file_of_tetrahedra_lands_where_its_file_says() {
    let folder = with_cone(HEAD);
    let args = "mesh cone.obj --scale 0.001 --cell-size 0.03 --out cone.vtu";
    let told = says(&folder, args);
    assert!(told.contains("to [0.0"), "{told}");
    let metres = geometry::read_tets(&folder.path().join("cone.vtu")).unwrap().mesh;
    let [low, high] = metres.bounds();
    assert!(high.max_element() < 0.17 && low.min_element() > -0.09, "{low} {high}");
    // Of tetrahedra, too.
    says(&folder, "mesh cone.vtu --scale 1000 --out mm.vtu");
    let mm = geometry::read_tets(&folder.path().join("mm.vtu")).unwrap().mesh;
    for (a, b) in mm.nodes.iter().zip(&metres.nodes) {
        assert_eq!(*a, 1000.0 * *b);
    }
    let middle = 0.5 * (low + high);
    for (unit, name) in [(1.0, "m"), (0.01, "cm"), (0.001, "mm"), (0.0254, "in")] {
        let text = solid(&format!("file = \"cone.vtu\", units = \"{name}\""), "at = [0.2, 0.2, 0.2]");
        fs::write(folder.path().join("dam.toml"), HEAD.to_owned() + &text).unwrap();
        let placed = geometry::solid_meshes(&load(&folder).unwrap()).unwrap().remove(0);
        for (x, rest) in placed.nodes.iter().zip(&metres.nodes) {
            let right = DVec3::splat(0.2) + unit * (*rest - middle);
            assert!(x.distance(right) < 1e-15, "{name}: {x}, {right}");
        }
    }
    for scale in ["0", "-1", "nan", "inf"] {
        let told = complains(&folder, &format!("mesh cone.vtu --scale={scale}"), 2);
        assert!(told.contains("--scale") && told.contains("above zero"), "{told}");
    }
}

/// Obstacles and regions of liquid from the same file fill the same cells; the right ones by the cone's formula.
#[test]
fn regions_and_obstacles_land_where_their_files_say() {
    let rotate = "rotate = { axis = [1, 0, 0], degrees = -90 }";
    let placement = format!("placement = {{ at = [0.2, 0.2, 0.2], {rotate} }}");
    let mesh = "mesh = { file = \"cone.obj\", units = \"mm\" }";
    let text = format!("{HEAD}[[liquid.region]]\n{mesh}\n{placement}\n[[obstacle]]\n{mesh}\n{placement}\n");
    let folder = with_cone(&text);
    let scene = load(&folder).unwrap();
    let grid = scene.grid();
    let in_liquid = geometry::liquid_distance(&scene, &grid).unwrap();
    let in_obstacle = geometry::cut_cells(&scene, &grid).unwrap().solid_distance;
    let mut n = 0;
    for cell in 0..grid.n_cells() {
        let x = grid.cell_centre(grid.cell_at(cell));
        let (height, radius) = (x.y - 0.12, DVec3::new(x.x - 0.2, 0.0, x.z - 0.2).length());
        // Half its angle has a tangent of a half; the sides of a polygon lie up to 0.9 % of the radius within the circle.
        let along = (radius + 0.5 * (height - 0.16)) / 1.25_f64.sqrt();
        let right = along.max(-height);
        if right.abs() > 0.001 {
            assert_eq!(in_liquid[cell] < 0.0, right < 0.0, "liquid at {x}: {}", in_liquid[cell]);
            assert_eq!(in_obstacle[cell] < 0.0, right < 0.0, "obstacle at {x}");
            n += usize::from(right < 0.0);
        }
    }
    assert!(n > 900, "{n} cells");
}

/// The other shapes of regions are placed as those of obstacles.
#[test]
fn placed_regions_are_what_obstacles_are() {
    let placement = "placement = { at = [0.2, 0.25, 0.2], scale = 0.5, rotate = { axis = [1, 1, 0], degrees = 40 } }";
    for shape in [
        "box = { min = [0, 0, 0], max = [0.3, 0.2, 0.25] }",
        "sphere = { centre = [0.1, 0.1, 0.1], radius = 0.15 }",
        "cylinder = { base = [0, 0, 0], axis = [0, 2, 1], radius = 0.1, height = 0.3 }",
    ] {
        let text = format!("{HEAD}[[liquid.region]]\n{shape}\n{placement}\n[[obstacle]]\n{shape}\n{placement}\n");
        let scene = load(&folder(&text)).unwrap();
        let grid = scene.grid();
        let in_liquid = geometry::liquid_distance(&scene, &grid).unwrap();
        let in_obstacle = geometry::cut_cells(&scene, &grid).unwrap().solid_distance;
        let near = in_liquid.iter().zip(&in_obstacle);
        for (a, b) in near.filter(|(_, b)| b.abs() < 2.9 * grid.dx) {
            // The air inside the liquid of a region alone is exact.
            assert!((a - b).abs() < 1e-12, "{shape}: {a}, {b}");
        }
        assert!(in_liquid.iter().any(|&phi| phi < 0.0));
    }
}

/// A plan refuses the places that a run refuses, with the same words.
#[test]
fn plans_refuse_places_as_runs_do() {
    let cone = |mesh: &str, placement: &str| POOL.to_owned() + &solid(mesh, placement);
    let obstacle = |mesh: &str, placement: &str| {
        format!("{POOL}[[obstacle]]\nmesh = {{ {mesh} }}\nplacement = {{ {placement} }}\n")
    };
    let region = |mesh: &str, placement: &str| {
        format!("{POOL}[[liquid.region]]\nmesh = {{ {mesh} }}\nplacement = {{ {placement} }}\n")
    };
    let fill = |file: &str| format!("surface = {{ {file}, cell_size = 0.03 }}");
    let (mm, wrong, m) = ("file = \"cone.obj\", units = \"mm\"", "file = \"cone.obj\"", "file = \"metres.obj\"");
    let block = "[[obstacle]]\nsphere = { centre = [0.35, 0.35, 0.35], radius = 0.02 }\n[[obstacle]]\nbox = { min = [0.1, 0, 0.1], max = [0.3, 0.3, 0.3] }\n";
    let cases: [(String, &[&str]); 10] = [
        (cone(&fill(mm), "at = [0.38, 0.2, 0.2]"), &["solid[0]", "starts outside the domain", "placement.at"]),
        (solid(&fill(mm), "at = [0.38, 0.2, 0.2]"), &["solid[0]", "starts outside the domain"]),
        (
            cone(&fill(wrong), "at = [0.2, 0.2, 0.2]"),
            &["solid[0]", "160 m long, the domain 0.4 m", "is it in mm or cm?", "units = \"mm\""],
        ),
        (obstacle(m, "at = [0.2, 0.2, 0.6]"), &["obstacle[0]", "lies outside the domain", "placement.at"]),
        (obstacle(wrong, "at = [0.2, 0.2, -100]"), &["obstacle[0]", "lies outside the domain", "is it in mm or cm?"]),
        (region(m, "at = [0.2, 0.2, 0.6]"), &["liquid.region[1]", "lies outside the domain", "placement.at"]),
        (
            region(wrong, "translate = [100, 0, 0]"),
            &["liquid.region[1]", "lies outside the domain", "is it in mm or cm?"],
        ),
        (cone(&fill(mm), "at = [0.2, 0.2, 0.2]") + block, &["solid[0]", "deep in obstacle[1], with its node at [0."]),
        (solid(&fill(mm), "at = [0.2, 0.2, 0.2]") + block, &["solid[0]", "deep in obstacle[1]", "[[solid.pin]]"]),
        (
            format!("{POOL}[[obstacle]]\nbox = {{ min = [0, 0, 0], max = [0.4, 0.2, 0.4] }}\n"),
            &["liquid.region", "no cell of the 40 x 40 x 40 has liquid"],
        ),
    ];
    for (text, parts) in cases {
        let folder = with_cone(&(HEAD.to_owned() + &text));
        let planned = complains(&folder, "plan dam.toml --backend cpu", 2);
        let run = complains(&folder, "run dam.toml --backend cpu --frames 0", 2);
        let error = |told: &str| told[told.find("error: ").unwrap()..].to_owned();
        assert_eq!(error(&planned), error(&run));
        for part in parts {
            assert!(planned.contains(part), "{planned}\nhas no {part}, of\n{text}");
        }
    }
}

fn warnings(text: &str) -> Vec<String> {
    let folder = with_cone(text);
    let scene = load(&folder).unwrap();
    Plan::new(&scene, None).unwrap();
    sim::warnings(&scene).unwrap()
}

/// The only warning of a scene, with these parts; none without parts.
fn warns(text: &str, parts: &[&str]) {
    let told = warnings(text);
    assert_eq!(told.len(), usize::from(!parts.is_empty()), "{told:?}, of\n{text}");
    for part in parts {
        assert!(told[0].contains(part), "{told:?}\nhas no {part}");
    }
}

#[test]
fn large_meshes_are_asked_after_their_unit() {
    let ground = |mesh: &str, placement: &str| {
        format!("{HEAD}{POOL}[[obstacle]]\nmesh = {{ {mesh} }}\nplacement = {{ {placement} }}\n")
    };
    // Its base lies at z = -1 m, so it fills the whole domain.
    let filled = with_cone(&ground("file = \"cone.obj\"", "translate = [0.2, 0.2, -1]"));
    let told = complains(&filled, "plan dam.toml --backend cpu", 2);
    for part in ["obstacle[0] is 160 m long, the domain 0.4 m: is it in mm or cm?", "no cell of"] {
        assert!(told.contains(part), "{told}\nhas no {part}");
    }
    warns(&ground("file = \"cone.obj\", units = \"mm\"", "at = [0.2, 0.2, 0.2]"), &[]);
}

fn ball(name: &str, at: [f64; 3], rest: &str) -> String {
    format!(
        "[[solid]]\nname = \"{name}\"\nmesh = {{ sphere = {{ radius = 0.06, cell_size = 0.05 }} }}\n\
         placement = {{ at = {at:?} }}\ndensity = 300\nyoung = 1e5\npoisson = 0.3\n{rest}"
    )
}

#[test]
fn solids_that_overlap_or_may_meet_are_told_before_a_run() {
    let one = ball("one", [0.2, 0.25, 0.2], "");
    let apart = ball("two", [0.1, 0.25, 0.1], "");
    // They touch.
    warns(&(format!("{HEAD}{POOL}") + &one + &apart), &[]);
    let head = format!("{HEAD}{POOL}[solver]\nsolid_contact = false\n");
    warns(&(head.clone() + &one), &[]);
    let same = ball("two", [0.2, 0.25, 0.2], "");
    warns(
        &(head.clone() + &one + &same),
        &["solids \"one\" and \"two\" overlap by 0.056", "at [0.2, 0.25, 0.2]", "Place them apart"],
    );
    // One brick: all its nodes lie on the surface of the other.
    let brick = |name: &str| {
        format!(
            "[[solid]]\nname = \"{name}\"\nmesh = {{ box = {{ size = [0.1, 0.1, 0.1], cells = [1, 1, 1] }} }}\n\
             placement = {{ at = [0.2, 0.25, 0.2] }}\ndensity = 300\nyoung = 1e5\npoisson = 0.3\n"
        )
    };
    warns(&(head.clone() + &brick("a") + &brick("b")), &["\"a\" and \"b\" overlap by"]);
    // Sides that touch are no overlap, but the bodies may meet.
    let beside = brick("b").replace("[0.2, 0.25, 0.2]", "[0.3, 0.25, 0.2]");
    warns(&(head.clone() + &brick("a") + &beside), &["\"a\" and \"b\" may meet"]);
    let third = ball("three", [0.3, 0.25, 0.33], "");
    warns(&(head.clone() + &one + &apart), &["\"one\" and \"two\" may meet: they pass through"]);
    warns(&(head.clone() + &one + &apart + &third), &["\"one\" and \"two\" may meet, 2 more pairs too"]);
    // What is held cannot get away.
    let pin = "[[solid.pin]]\nregion = { half_space = { point = [0, 0.25, 0], normal = [0, -1, 0] } }\n";
    let held = |at: [f64; 3], name: &str| ball(name, at, pin);
    let wide = head.replace("size = [0.4, 0.4, 0.4]", "size = [0.8, 0.4, 0.4]").replace("cells = [40,", "cells = [80,");
    warns(&(wide.clone() + &held([0.1, 0.25, 0.2], "one") + &held([0.7, 0.25, 0.2], "two")), &[]);
    warns(&(wide + &held([0.1, 0.25, 0.2], "one") + &held([0.25, 0.25, 0.2], "two")), &["may meet"]);
}

#[test]
fn bodies_too_soft_for_the_depth_are_told_before_a_run() {
    // 2 x 1000 x 9.81 x 0.1 = 1962 Pa, with the depth of the pool in whole cells.
    let head = format!("{HEAD}{POOL}");
    let soft = |young: &str| head.clone() + &ball("jelly", [0.2, 0.25, 0.2], "").replace("1e5", young);
    warns(&soft("1.9e3"), &["solid \"jelly\" has young = 1900.0 Pa", "under 0.1 m of liquid, 1962 Pa", "invert"]);
    warns(&soft("2.1e3"), &[]);
    warns(&soft("1.9e3").replace("[time]", "gravity = [0, 0, 0]\n[time]"), &[]);
    warns(&soft("1.9e3").replace(POOL, ""), &[]);
}

/// Of the cantilever of docs/scene.md linear tetrahedra leave less than about a half of the deflection where they warn.
#[test]
fn elements_that_lock_are_told_before_a_run() {
    let bar = |cells: [usize; 3], poisson: f64| {
        format!(
            "{HEAD}[[solid]]\nname = \"bar\"\nmesh = {{ box = {{ size = [0.2, 0.04, 0.04], cells = {cells:?} }} }}\n\
             placement = {{ at = [0.2, 0.2, 0.2] }}\ndensity = 300\nyoung = 1e5\npoisson = {poisson}\n"
        )
    };
    for (layers, poisson, told) in [
        (2, 0.3, false),
        (2, 0.4, false),
        (2, 0.45, true),
        (3, 0.45, true),
        (4, 0.45, false),
        (4, 0.49, true),
        (8, 0.49, false),
    ] {
        let parts: &[&str] = match told {
            true => &["solid \"bar\" has poisson", "linear elements across its thin side"],
            false => &[],
        };
        warns(&bar([5 * layers, layers, layers], poisson), parts);
    }
    // The thinner of two thin sides counts; a cube bends in no direction.
    warns(&bar([20, 2, 8], 0.45), &["about 2 linear elements"]);
    warns(&bar([2, 2, 2], 0.49).replace("[0.2, 0.04, 0.04]", "[0.1, 0.1, 0.1]"), &[]);
    // A shell is slender all around, and a compact file is not.
    let shell = "shell = { radius = 0.1, thickness = 0.02, cell_size = 0.02 }";
    let hollow = |poisson: &str| HEAD.to_owned() + &solid(shell, "at = [0.2, 0.2, 0.2]").replace("0.3\n", poisson);
    warns(&hollow("0.45\n"), &["solid \"cone\" has poisson = 0.45 and about one linear element"]);
    warns(&hollow("0.35\n"), &[]);
    let compact = solid("surface = { file = \"metres.obj\", cell_size = 0.05 }", "at = [0.2, 0.2, 0.2]");
    warns(&(HEAD.to_owned() + &compact.replace("0.3\n", "0.49\n")), &[]);
}

/// The surface of the tetrahedra of a cone has small triangles at its tip, and other bodies beside it.
#[test]
fn a_filled_cone_is_not_thin() {
    for cell_size in [0.012, 0.02] {
        let mesh = format!("surface = {{ file = \"metres.obj\", cell_size = {cell_size} }}");
        let cone = solid(&mesh, "at = [0.2, 0.2, 0.2]");
        warns(&(format!("{HEAD}{POOL}") + &cone), &[]);
        // A ball that overlaps it leaves a thin gap between their surfaces.
        let ball = ball("ball", [0.2, 0.2, 0.17], "");
        warns(&(format!("{HEAD}{POOL}") + &cone + &ball), &["\"cone\" and \"ball\" overlap"]);
    }
}

/// Folders, scenes, meshes and results in place of one another are told by what they are.
#[test]
fn what_is_given_in_the_wrong_place_is_told_by_what_it_is() {
    let folder = with_cone(&format!("{HEAD}{POOL}"));
    says(&folder, "run dam.toml --backend cpu --scale 0.25 --frames 0");
    let root = folder.path();
    fs::create_dir(root.join("none")).unwrap();
    for (arguments, parts) in [
        ("run .", &["is a folder, not a scene file", "give the scene file in it: ./dam.toml"] as &[&str]),
        ("plan none", &["is a folder", "this folder has none"]),
        ("plan out/dam", &["is the folder of a run, not a scene", "cutwater preview"]),
        ("sweep out/dam --set liquid.seed=1,2", &["is the folder of a run, not a scene"]),
        ("plan cone.obj", &["is a mesh, not a scene", "cutwater mesh"]),
        ("plan out/dam/manifest.json", &["is a result, not a scene"]),
        ("plan dam", &["dam: No such file", "did you mean dam.toml?"]),
        ("mesh dam.toml", &["is a scene, not a mesh", "cutwater plan"]),
        ("mesh none", &["is a folder, not a mesh"]),
        (
            "preview dam.toml",
            &["is a scene, not the folder of a run", "cutwater run dam.toml; then cutwater preview out/dam"],
        ),
        ("plot dam.toml", &["is a scene, not the folder of a run", "then cutwater plot out/dam"]),
        ("report dam.toml", &["is a scene, not the folder of a run", "then cutwater report out/dam"]),
        ("preview out/dam/manifest.json", &["is a file, not the folder of a run", "give its folder: out/dam"]),
        ("preview out", &["contains runs, but is not one itself", "such as out/dam"]),
        ("plot out", &["contains runs, but is not one itself", "such as out/dam"]),
    ] {
        let told = complains(&folder, arguments, 2);
        for part in parts {
            assert!(told.contains(part), "{arguments}: {told}\nhas no {part}");
        }
    }
}

/// An obstacle that is outside the domain at all keyframes may cross it between two of them; one that passes beside it is refused.
#[test]
fn obstacles_may_cross_the_domain_between_keyframes() {
    let keyframes =
        |end: &str| format!("keyframes = [{{ t = 0.0 }}, {{ t = 0.02 }}, {{ t = 0.1, translate = {end} }}]\n");
    let bodies = [
        "sphere = { centre = [-0.4, 0.3, 0.2], radius = 0.05 }",
        "box = { min = [-0.45, 0.25, 0.15], max = [-0.35, 0.35, 0.25] }",
        "mesh = { file = \"metres.obj\" }\nplacement = { at = [-0.4, 0.3, 0.2] }",
    ];
    for body in bodies {
        let scene = |end: &str| {
            let text = format!("{HEAD}{POOL}[[obstacle]]\n{body}\n{}", keyframes(end));
            let folder = with_cone(&text);
            load(&folder).and_then(|scene| geometry::obstacle_cut(&scene, &scene.grid()))
        };
        let mut cut = scene("[1.2, 0, 0]").unwrap();
        assert!(cut.wall_velocities().is_empty(), "{body}: starts outside");
        cut.move_to(0.06, 0.0);
        assert!(!cut.wall_velocities().is_empty(), "{body}: crosses");
        let beside = scene("[0, 1.2, 0]").unwrap_err().to_string();
        assert!(beside.contains("obstacle[0]") && beside.contains("lies outside the domain"), "{beside}");
    }
}

/// All parts of a scene share the parsed contents of a mesh file: once one of them has read it, the others need no file.
#[test]
fn a_mesh_file_is_parsed_once_per_scene() {
    let cone = "file = \"metres.obj\"";
    let text = format!(
        "{HEAD}{POOL}[[liquid.region]]\nmesh = {{ {cone} }}\nplacement = {{ at = [0.1, 0.2, 0.1] }}\n\
         [[obstacle]]\nmesh = {{ {cone} }}\nplacement = {{ at = [0.3, 0.2, 0.1] }}\n{}",
        solid(&format!("surface = {{ {cone}, cell_size = 0.03 }}"), "at = [0.2, 0.2, 0.3]")
    );
    let folder = with_cone(&text);
    let scene = load(&folder).unwrap();
    let grid = scene.grid();
    let cut = geometry::cut_cells(&scene, &grid).unwrap();
    fs::remove_file(folder.path().join("metres.obj")).unwrap();
    assert!(geometry::large_meshes(&scene).unwrap().is_empty());
    assert!(geometry::liquid_height(&scene, &grid).unwrap() > 0.1);
    assert_eq!(geometry::solid_meshes(&scene).unwrap().len(), 1);
    let again = geometry::cut_cells(&scene.clone(), &grid).unwrap();
    assert_eq!(cut.solid_distance, again.solid_distance);
    assert!(load(&folder).is_err(), "the file is gone");
}
