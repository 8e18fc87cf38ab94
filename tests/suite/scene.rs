//! Scene files: what good ones become, overrides, scale, and what is refused, where and with which words.

use std::path::{Path, PathBuf};

use cutwater::Error;
use cutwater::scene::{
    ElasticModel, LoadKind, Placement, Precision, Preconditioner, Probe, ProbeKind, ProbedNodes, Scene, Shape,
    SolidMesh, Solver, Surface, ThetaFloor, Up,
};
use glam::DVec3;

/// A scene that uses most keys; the cases below break it.
const GOOD: &str = r#"# Everything at once.
[domain]
size = [2, 1.0, 0.5]
cells = [32, 16, 8]
gravity = [0.0, 0.0, -9.81]
[time]
duration = 1.5
frames_per_second = 20
cfl = 2
fixed_step = 0.0125
[liquid]
density = 800.0
surface = "markers"
marker_radius = 1.0
seed = 7
volume_control = false
[[liquid.region]]
box = { min = [0, 0, 0], max = [0.5, 0.5, 0.5] }
velocity = [1, 0, 0]
[[liquid.region]]
sphere = { centre = [0.25, 0.25, 0.25], radius = 0.1 }
subtract = true
[[liquid.region]]
half_space = { point = [0, 0.1, 0], normal = [0, 2, 0] }
[[obstacle]]
cylinder = { base = [1, 0, 0.25], axis = [0, 3, 0], radius = 0.1, height = 0.5 }
placement = { translate = [0.1, 0, 0], rotate = { axis = [0, 0, 1], degrees = 90 }, scale = 0.5 }
[[obstacle]]
mesh = { file = "body.stl" }
inside_out = true
[[probe]]
name = "h1"
height = { x = 0.5, y = 0.25 }
[[probe]]
name = "v1"
velocity = { point = [0.5, 0.1, 0.25] }
[[probe]]
name = "reach"
front = { axis = "x" }
[solver]
tolerance = 1e-6
max_iterations = 50
precision = "f32"
preconditioner = "jacobi"
theta_floor = 0.001
area_clamp = 1e-5
[output]
particles = false
fields = true
every = 2
[camera]
eye = [1, 1, 3]
target = [1, 0.5, 0.25]
up = [0, 2, 0]
fov = 50
size = [640, 480]
"#;

/// `text` as a scene beside the files `body.stl` and `body.msh`, loaded.
fn load(text: &str, overrides: &[&str], scale: f64) -> Result<Scene, Error> {
    let folder = tempfile::tempdir().unwrap();
    for file in ["body.stl", "body.msh"] {
        std::fs::write(folder.path().join(file), "").unwrap();
    }
    let path = folder.path().join("good.toml");
    std::fs::write(&path, text).unwrap();
    let overrides: Vec<_> = overrides.iter().map(|&text| text.to_owned()).collect();
    Scene::load(&path, &overrides, scale)
}

fn scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let files = std::fs::read_dir(folder).unwrap();
    let mut files: Vec<_> = files.map(|file| file.unwrap().path()).collect();
    files.retain(|file| file.extension().is_some_and(|kind| kind == "toml"));
    files.sort();
    files
}

#[test]
fn a_scene_says_what_its_file_says() {
    let scene = load(GOOD, &[], 1.0).unwrap();
    assert_eq!(scene.name, "good");
    assert_eq!(scene.domain.size, DVec3::new(2.0, 1.0, 0.5));
    assert_eq!(scene.domain.cells, [32, 16, 8]);
    assert_eq!(scene.domain.gravity, DVec3::new(0.0, 0.0, -9.81));
    assert_eq!(scene.grid().dx, 0.0625);
    assert_eq!(scene.time.duration, 1.5);
    assert_eq!(scene.time.cfl, 2.0);
    assert_eq!(scene.time.fixed_step, Some(0.0125));
    assert_eq!(scene.n_frames(), 30);

    let liquid = scene.liquid.unwrap();
    assert_eq!((liquid.density, liquid.marker_radius, liquid.seed), (800.0, 1.0, 7));
    assert_eq!((liquid.surface, liquid.volume_control), (Surface::Markers, false));
    let subtract: Vec<_> = liquid.regions.iter().map(|region| region.subtract).collect();
    assert_eq!(subtract, [false, true, false]);
    assert_eq!(liquid.regions[0].velocity, DVec3::X);
    assert_eq!(liquid.regions[1].velocity, DVec3::ZERO);
    assert!(matches!(liquid.regions[0].shape, Shape::Box { max, .. } if max == DVec3::splat(0.5)));
    assert!(matches!(liquid.regions[1].shape, Shape::Sphere { radius: 0.1, .. }));
    assert!(matches!(liquid.regions[2].shape, Shape::HalfSpace { normal, .. } if normal == DVec3::Y));

    let Placement { translate, rotate, scale, .. } = scene.obstacles[0].placement;
    assert_eq!((translate, scale), (DVec3::new(0.1, 0.0, 0.0), 0.5));
    assert!((rotate * DVec3::X - DVec3::Y).length() < 1e-15);
    assert!(!scene.obstacles[0].inside_out && scene.obstacles[1].inside_out);
    assert!(
        matches!(scene.obstacles[0].shape, Shape::Cylinder { axis, .. } if axis == DVec3::Y),
        "axes become unit vectors"
    );
    let middle = scene.obstacles[0].shape.centre().unwrap();
    assert_eq!(middle, DVec3::new(1.0, 0.25, 0.25));
    let Shape::Mesh { file, .. } = &scene.obstacles[1].shape else { panic!("the second obstacle is a mesh") };
    assert_eq!(file.parent(), scene.file.parent());
    assert_eq!(scene.obstacles[1].shape.centre(), None);

    let columns: Vec<_> = scene.probes.iter().flat_map(|probe| probe.columns()).collect();
    assert_eq!(columns, ["h1", "v1_x", "v1_y", "v1_z", "reach"]);
    assert!(matches!(
        scene.probes[0].kind,
        ProbeKind::Height { foot, up: Up { axis: 2, falling: false } } if foot == DVec3::new(0.5, 0.25, 0.0)
    ));
    assert!(matches!(scene.probes[2].kind, ProbeKind::Front { axis: 0, lower: false }));
    let solver = Solver {
        tolerance: 1e-6,
        max_iterations: 50,
        precision: Precision::F32,
        preconditioner: Preconditioner::Jacobi,
        theta_floor: ThetaFloor::from(1e-3),
        area_clamp: 1e-5,
        ..Solver::default()
    };
    assert_eq!(scene.solver, solver);
    assert!(!scene.output.particles && scene.output.fields);
    assert_eq!(scene.output.every, 2);
    let camera = scene.camera;
    assert_eq!((camera.up, camera.fov, camera.size), (DVec3::Y, 50.0, [640, 480]));
}

#[test]
fn what_a_scene_leaves_out_has_the_documented_default() {
    let text = "[domain]\nsize = [1, 1, 1]\ncells = [8, 8, 8]\n[time]\nduration = 1\n\
                [[liquid.region]]\nwave = { level = 0.5, amplitude = 0.1, wave_number = [3, 0] }\n";
    let scene = load(text, &[], 1.0).unwrap();
    assert_eq!(scene.domain.gravity, DVec3::new(0.0, -9.81, 0.0));
    assert_eq!(scene.time.frames_per_second, 24.0);
    assert_eq!(scene.time.cfl, 3.0);
    assert_eq!(scene.time.fixed_step, None);
    let liquid = scene.liquid.unwrap();
    assert_eq!((liquid.density, liquid.marker_radius, liquid.seed), (1000.0, 0.87, 0));
    assert!(liquid.volume_control && liquid.surface == Surface::Level);
    assert!(matches!(liquid.regions[0].shape, Shape::Wave { phase: 0.0, .. }));
    assert!(scene.obstacles.is_empty() && scene.probes.is_empty());
    let solver = Solver { theta_floor: ThetaFloor { whole: 1e-4, closing: 0.15 }, ..Solver::default() };
    assert_eq!(scene.solver, solver);
    assert!(scene.output.particles && !scene.output.fields && scene.output.every == 1);

    let markers = load(text, &["liquid.surface=markers"], 1.0).unwrap();
    // Markers make a surface that is bumpy by a tenth of a cell.
    assert_eq!(markers.solver.theta_floor, 0.15.into());
    let fixed = load(text, &["liquid.surface=fixed"], 1.0).unwrap();
    assert!(!fixed.liquid.unwrap().volume_control, "a fixed surface has no volume control");
}

#[test]
fn keys_that_act_on_markers_alone_imply_them() {
    let text = "[domain]\nsize = [1, 1, 1]\ncells = [8, 8, 8]\n[time]\nduration = 1\n\
                [[liquid.region]]\nsphere = { centre = [0.5, 0.5, 0.5], radius = 0.3 }\n";
    let surface = |overrides: &[&str]| load(text, overrides, 1.0).unwrap().liquid.unwrap().surface;
    for (key, expected) in [
        ("liquid.separation=walls", Surface::Level),
        ("liquid.separation=from_air", Surface::Level),
        ("liquid.marker_radius=0.9", Surface::Markers),
        ("surface.smoothing=5", Surface::Markers),
    ] {
        assert_eq!(surface(&[key]), expected, "{key}");
    }
    assert_eq!(surface(&["liquid.marker_radius=0.9", "liquid.surface=level"]), Surface::Level);
}

#[test]
fn single_precision_has_a_tolerance_that_it_reaches() {
    let text = "[domain]\nsize = [1, 1, 1]\ncells = [8, 8, 8]\n[time]\nduration = 1\n\
                [[liquid.region]]\nsphere = { centre = [0.5, 0.5, 0.5], radius = 0.3 }\n[solver]\nprecision = \"f32\"\n";
    let tolerance = |overrides: &[&str]| load(text, overrides, 1.0).unwrap().solver.tolerance;
    assert_eq!(tolerance(&[]), 1e-5);
    assert_eq!(tolerance(&["solver.tolerance=1e-4"]), 1e-4);
    assert_eq!(tolerance(&["solver.precision=\"mixed\""]), 1e-8);
}

/// Replace the first text by the second in a good scene; the error is at the line, at the key, and has the parts.
type Case = (&'static str, &'static str, usize, &'static str, &'static [&'static str]);

#[rustfmt::skip] // one case a line
const REFUSED: &[Case] = &[
    // TOML itself.
    ("cfl = 2", "cfl = ", 9, "TOML", &["syntax"]),
    ("cfl = 2", "cfl = 2\ncfl = 3", 10, "TOML", &["duplicate key"]),
    ("[solver]", "[solver", 40, "TOML", &["cure"]),
    ("seed = 7", "seed = 99999999999999999999", 15, "liquid.seed", &["lies beyond +-2^63"]),
    // Words of other programs.
    ("frames_per_second = 20", "fps = 20", 8, "time.fps", &["unknown key", "did you mean `frames_per_second`?"]),
    ("fixed_step = 0.0125", "dt = 0.0125", 10, "time.dt", &["did you mean `fixed_step`?"]),
    ("duration = 1.5", "end_time = 1.5", 7, "time.end_time", &["did you mean `duration`?"]),
    ("cells = [32, 16, 8]", "resolution = [32, 16, 8]", 4, "domain.resolution", &["did you mean `cells`?"]),
    ("density = 800.0", "viscosity = 1e-6", 12, "liquid.viscosity", &["liquids here are inviscid", "remove `viscosity`"]),
    ("density = 800.0", "Viscosity = 1e-6", 12, "liquid.Viscosity", &["liquids here are inviscid"]),
    ("density = 800.0", "nu = 1e-6", 12, "liquid.nu", &["liquids here are inviscid"]),
    ("density = 800.0", "surface_tension = 0.07", 12, "liquid.surface_tension", &["no surface tension"]),
    ("density = 800.0", "rho = 800.0", 12, "liquid.rho", &["did you mean `density`?"]),
    ("inside_out = true", "position = [1, 0, 0]", 30, "obstacle[1].position", &["write placement = { at = [x, y, z] }", "the keys here are"]),
    ("inside_out = true", "units = \"mm\"", 30, "obstacle[1].units", &["beside the file of the mesh: { file = .., units = \"mm\" }"]),
    ("inside_out = true", "friction = -0.1", 30, "obstacle[1].friction", &["use 0 to 100"]),
    ("file = \"body.stl\"", "path = \"body.stl\"", 29, "obstacle[1].mesh.path", &["did you mean `file`?"]),
    ("file = \"body.stl\"", "file = \"body.stl\", unit = \"mm\"", 29, "obstacle[1].mesh.unit", &["did you mean `units`?"]),
    ("file = \"body.stl\"", "file = \"body.stl\", units = \"km\"", 29, "obstacle[1].mesh.units", &["the text \"km\"", "one of \"m\", \"cm\", \"mm\", \"in\""]),
    ("translate = [0.1, 0, 0]", "position = [0.1, 0, 0]", 27, "obstacle[0].placement.position", &["did you mean `at`?"]),
    ("translate = [0.1, 0, 0]", "at = [0.1, 0, 0], translate = [0.1, 0, 0]", 27, "obstacle[0].placement.at", &["conflicts with `translate`", "keep one"]),
    ("half_space = { point = [0, 0.1, 0], normal = [0, 2, 0] }", "half_space = { point = [0, 0.1, 0], normal = [0, 2, 0] }\nplacement = { at = [0, 0, 0] }", 25, "liquid.region[2].placement", &["a half_space has none", "remove it"]),
    ("centre = [0.25, 0.25, 0.25]", "position = [0.25, 0.25, 0.25]", 21, "liquid.region[1].sphere.position", &["did you mean `centre`?"]),
    ("[domain]\nsize", "gravity = [0, 0, 0]\n[domain]\nsize", 2, "gravity", &["unknown key", "write the key in the section [domain]"]),
    ("[domain]\nsize", "units = \"mm\"\n[domain]\nsize", 2, "units", &["lengths in m", "beside its file"]),
    ("[camera]", "[fluid]\n[camera]", 51, "fluid", &["did you mean `liquid`?"]),
    // Types.
    ("density = 800.0", "density = \"800\"", 12, "liquid.density", &["the text \"800\"", "without quotes"]),
    ("density = 800.0", "density = true", 12, "liquid.density", &["is true", "kg/m^3"]),
    ("density = 800.0", "density = 1979-05-27", 12, "liquid.density", &["a date"]),
    ("size = [2, 1.0, 0.5]", "size = 2", 3, "domain.size", &["the number 2", "list of 3"]),
    ("size = [2, 1.0, 0.5]", "size = [2, 1]", 3, "domain.size", &["a list of 2", "list of 3"]),
    ("size = [2, 1.0, 0.5]", "size = [2, \"1\", 0.5]", 3, "domain.size[1]", &["the text \"1\""]),
    ("cells = [32, 16, 8]", "cells = [32.0, 16, 8]", 4, "domain.cells[0]", &["is the number 32.0", "whole number"]),
    ("volume_control = false", "volume_control = \"no\"", 16, "liquid.volume_control", &["true or false"]),
    ("name = \"h1\"", "name = 1", 32, "probe[0].name", &["the number 1", "quotes"]),
    ("precision = \"f32\"", "precision = \"f16\"", 43, "solver.precision", &["f16", "\"mixed\""]),
    ("[[obstacle]]\ncyl", "[obstacle]\ncyl", 28, "TOML", &["duplicate key", "double brackets"]),
    ("[[probe]]\nname = \"h1\"\nheight = { x = 0.5, y = 0.25 }\n[[probe]]\nname = \"v1\"\nvelocity = { point = [0.5, 0.1, 0.25] }\n[[probe]]", "[probe]", 31, "probe", &["not a list", "[[probe]]"]),
    ("[solver]", "[[solver]]", 40, "solver", &["is a list", "[solver]"]),
    // Numbers that mean nothing.
    ("density = 800.0", "density = nan", 12, "liquid.density", &["NaN", "finite"]),
    ("velocity = [1, 0, 0]", "velocity = [1, -inf, 0]", 19, "liquid.region[0].velocity[1]", &["-inf", "finite"]),
    ("density = 800.0", "density = 1e999", 12, "liquid.density", &["finite"]),
    ("density = 800.0", "density = 0", 12, "liquid.density", &["above zero"]),
    ("size = [2, 1.0, 0.5]", "size = [2, -1.0, 0.5]", 3, "domain.size", &["[2, -1, 0.5]", "1e-6 to 1e6 m"]),
    ("cells = [32, 16, 8]", "cells = [32, 0, 8]", 4, "domain.cells[1]", &["is 0", "from 1"]),
    ("seed = 7", "seed = -7", 15, "liquid.seed", &["is -7", "from 0"]),
    ("marker_radius = 1.0", "marker_radius = 0.1", 14, "liquid.marker_radius", &["0.5 to 1.2"]),
    ("marker_radius = 1.0", "marker_radius = 1.3", 14, "liquid.marker_radius", &["is 1.3", "0.5 to 1.2"]),
    ("density = 800.0", "density = 1e40", 12, "liquid.density", &["is 1e40", "1e-6 to 1e6"]),
    ("velocity = [1, 0, 0]", "velocity = [1e30, 0, 0]", 19, "liquid.region[0].velocity", &["is [1e30, 0.0, 0.0]", "-1e6 to 1e6"]),
    ("gravity = [0.0, 0.0, -9.81]", "gravity = [0.0, 0.0, -1e20]", 5, "domain.gravity", &["-1e20", "-1e6 to 1e6"]),
    ("frames_per_second = 20", "frames_per_second = 1e300", 8, "time.frames_per_second", &["is 1e300", "1e-3 to 1e6"]),
    ("tolerance = 1e-6", "tolerance = 1", 41, "solver.tolerance", &["1e-8 is usual"]),
    ("preconditioner = \"jacobi\"", "preconditioner = \"block_jacobi\"", 44, "solver.preconditioner", &["does not have both"]),
    ("theta_floor = 0.001", "theta_floor = 0.6", 45, "solver.theta_floor", &["1e-4 is usual with a level", "0.15 with markers"]),
    ("area_clamp = 1e-5", "area_clamp = 0", 46, "solver.area_clamp", &["is 0", "1e-6 to less", "1e-3 is usual"]),
    ("max_iterations = 50", "max_iterations = 0", 42, "solver.max_iterations", &["from 1"]),
    ("every = 2", "every = 0", 50, "output.every", &["from 1"]),
    ("cfl = 2", "cfl = 100", 9, "time.cfl", &["at most 32"]),
    // Grid and time.
    ("cells = [32, 16, 8]", "cells = [32, 16, 9]", 4, "domain.cells", &["not cubic", "use cells = [32, 16, 8]"]),
    ("cells = [32, 16, 8]", "cells = [30, 16, 8]", 4, "domain.cells", &["not cubic", "use cells = [32, 16, 8]"]),
    ("size = [2, 1.0, 0.5]", "size = [2, 1.1415926, 0.5]", 4, "domain.cells", &["not cubic", "use size = [2, 1, 0.5]"]),
    ("size = [2, 1.0, 0.5]\ncells = [32, 16, 8]", "size = [1e6, 1e-6, 1e-6]\ncells = [65536, 65536, 65536]", 4, "domain.cells", &["not cubic", "use size = "]),
    ("cells = [32, 16, 8]", "cells = [8192, 4096, 2048]", 4, "domain.cells", &["1073741824", "fewer cells"]),
    ("duration = 1.5", "duration = 1e9", 7, "time.duration", &["999999"]),
    ("fixed_step = 0.0125", "fixed_step = 0.013", 10, "time.fixed_step", &["does not divide", "use 0.0125, 4 in a frame"]),
    ("fixed_step = 0.0125", "fixed_step = 0.1", 10, "time.fixed_step", &["use 0.05, 1 in a frame"]),
    // Keys.
    ("density = 800.0", "densty = 800.0", 12, "liquid.densty", &["unknown key", "did you mean `density`"]),
    ("[solver]", "[solvr]", 40, "solvr", &["did you mean `solver`"]),
    ("centre", "center", 21, "liquid.region[1].sphere.center", &["did you mean `centre`"]),
    ("seed = 7", "zebra = 7", 15, "liquid.zebra", &["unknown key", "the keys here are density"]),
    ("degrees = 90", "degree = 90", 27, "obstacle[0].placement.rotate.degree", &["did you mean `degrees`"]),
    ("gravity = [0.0, 0.0, -9.81]", "open = [\"up\"]", 5, "domain.open[0]", &["\"-x\"", "\"+z\""]),
    ("precision = \"f32\"", "face_areas = \"nodal\"", 43, "solver.face_areas", &["needs liquid and elastic solids", "remove it"]),
    ("precision = \"f32\"", "pressure_on_patches = \"cell\"", 43, "solver.pressure_on_patches", &["needs liquid and elastic solids", "remove it"]),
    ("[solver]", "[[source]]\n[solver]", 40, "source[0]", &["box, sphere, cylinder"]),
    ("inside_out = true", "keyframes = []", 30, "obstacle[1].keyframes", &["has no entry", "keyframes = [{ t = 0 }"]),
    ("front = { axis = \"x\" }", "node = { solid = \"ball\" }", 39, "probe[2].node", &["no [[solid]]", "measure the liquid"]),
    ("front = { axis = \"x\" }", "force = { solid = \"ball\" }", 39, "probe[2].force", &["no [[solid]]", "measure the liquid"]),
    ("front = { axis = \"x\" }", "solid = { name = \"ball\" }", 39, "probe[2].solid", &["no [[solid]]", "measure the liquid"]),
    ("fields = true", "solids = true", 49, "output.solids", &["no [[solid]]", "solids = false"]),
    ("precision = \"f32\"", "formulation = \"auto\"", 43, "solver.formulation", &["needs liquid and elastic solids", "remove it"]),
    ("every = 2", "checkpoint_every = -2", 50, "output.checkpoint_every", &["whole number from 0"]),
    ("[solver]", "[surface]\nradius = 9\n[solver]", 41, "surface.radius", &["is 9", "0.6 to 3 cells"]),
    ("[solver]", "[surface]\nsmoothing = -1\n[solver]", 41, "surface.smoothing", &["is -1", "from 0 to 1000"]),
    ("[solver]", "[surface]\nsmothing = 1\n[solver]", 41, "surface.smothing", &["did you mean `smoothing`"]),
    // What is missing: at the header of its table.
    ("cells = [32, 16, 8]\n", "", 2, "domain.cells", &["is missing", "cells = [32, 32, 32]"]),
    ("duration = 1.5\n", "", 6, "time.duration", &["is missing"]),
    (", radius = 0.1 }", " }", 21, "liquid.region[1].sphere.radius", &["is missing", "radius = 0.1"]),
    (", degrees = 90", "", 27, "obstacle[0].placement.rotate.degrees", &["is missing"]),
    ("box = { min = [0, 0, 0], max = [0.5, 0.5, 0.5] }\n", "", 17, "liquid.region[0]", &["has no shape", "half_space"]),
    ("front = { axis = \"x\" }\n", "", 37, "probe[2]", &["has no measurement"]),
    ("subtract = true", "box = { min = [0, 0, 0], max = [1, 1, 1] }", 20, "liquid.region[1]", &["`box` and `sphere`", "keep one shape"]),
    // Liquid.
    ("velocity = [1, 0, 0]", "subtract = true", 17, "liquid.region[0]", &["subtracts from nothing"]),
    ("max = [0.5, 0.5, 0.5]", "max = [0.5, 0.0, 0.5]", 18, "liquid.region[0].box", &["no volume", "along y"]),
    ("radius = 0.1 }\nsub", "radius = -0.1 }\nsub", 21, "liquid.region[1].sphere.radius", &["above zero"]),
    ("centre = [0.25, 0.25, 0.25]", "centre = [2.08, 1.08, 0.25]", 21, "liquid.region[1].sphere", &["outside the domain", "[2, 1, 0.5]"]),
    ("min = [0, 0, 0], max = [0.5, 0.5, 0.5]", "min = [2, 0, 0], max = [2.5, 0.5, 0.5]", 18, "liquid.region[0].box", &["outside the domain"]),
    ("point = [0, 0.1, 0]", "point = [0, -0.1, 0]", 24, "liquid.region[2].half_space", &["outside the domain"]),
    ("half_space = { point = [0, 0.1, 0], normal = [0, 2, 0] }", "wave = { level = -0.2, amplitude = 0.1, wave_number = [3, 0] }", 24, "liquid.region[2].wave", &["outside the domain"]),
    ("normal = [0, 2, 0]", "normal = [0, 0, 0]", 24, "liquid.region[2].half_space.normal", &["no direction", "[0, 1, 0]"]),
    ("half_space = { point = [0, 0.1, 0], normal = [0, 2, 0] }", "solitary = { height = 0.05, crest = [0, 0], direction = [1, 0] }", 24, "liquid.region[2].solitary.depth", &["is missing", "depth = 0.3"]),
    ("half_space = { point = [0, 0.1, 0], normal = [0, 2, 0] }", "solitary = { depth = 0.2, height = 0.15, crest = [0, 0], direction = [1, 0] }", 24, "liquid.region[2].solitary.height", &["is 0.15, 0.75 of the depth", "at most 0.6"]),
    ("half_space = { point = [0, 0.1, 0], normal = [0, 2, 0] }", "solitary = { depth = 0.2, height = 0.05, crest = [0, 0], direction = [0, 0] }", 24, "liquid.region[2].solitary.direction", &["no direction", "[1, 0]"]),
    ("half_space = { point = [0, 0.1, 0], normal = [0, 2, 0] }", "solitary = { depth = 0.2, height = 0.05, crest = [0, 0], direction = [1, 0] }", 24, "liquid.region[2].solitary", &["gravity is [0, 0, -9.81]", "along -y"]),
    ("surface = \"markers\"\nmarker_radius = 1.0\nseed = 7\nvolume_control = false", "surface = \"fixed\"\nvolume_control = true", 14, "liquid.volume_control", &["no volume control"]),
    ("surface = \"markers\"\nmarker_radius = 1.0\nseed = 7\nvolume_control = false", "surface = \"fixed\"\nseparation = \"walls\"", 14, "liquid.separation", &["needs a surface that moves", "\"none\""]),
    ("volume_control = false", "separation = \"air\"", 16, "liquid.separation", &["\"from_air\""]),
    // Obstacles.
    ("axis = [0, 3, 0]", "axis = [0, 0, 0]", 26, "obstacle[0].cylinder.axis", &["no direction"]),
    ("axis = [0, 0, 1]", "axis = [0, 0, 0]", 27, "obstacle[0].placement.rotate.axis", &["no direction"]),
    ("scale = 0.5", "scale = 0", 27, "obstacle[0].placement.scale", &["above zero"]),
    ("translate = [0.1, 0, 0]", "translate = [0, 1, 0]", 26, "obstacle[0].cylinder", &["outside the domain"]),
    ("scale = 0.5", "scale = 50", 26, "obstacle[0].cylinder", &["fills the whole domain"]),
    ("mesh = { file = \"body.stl\" }", "sphere = { centre = [1, 0.5, 0.25], radius = 2 }", 29, "obstacle[1].sphere", &["contains the whole domain"]),
    ("mesh = { file = \"body.stl\" }", "mesh = \"body.stl\"", 29, "obstacle[1].mesh", &["is the text", "write { file = \"body.stl\" }"]),
    ("body.stl", "nobody.stl", 29, "obstacle[1].mesh.file", &["there is no file", "nobody.stl"]),
    ("body.stl", "body.fbx", 29, "obstacle[1].mesh.file", &["not a supported mesh format", ".obj"]),
    ("body.stl", "", 29, "obstacle[1].mesh.file", &["is empty"]),
    // Probes.
    ("name = \"v1\"", "name = \"h1\"", 35, "probe[1].name", &["has the name \"h1\" too", "another name"]),
    ("name = \"reach\"", "name = \"v1_y\"", 38, "probe[2].name", &["column \"v1_y\"", "probe \"v1\""]),
    ("name = \"h1\"", "name = \"t\"", 32, "probe[0].name", &["the time"]),
    ("name = \"h1\"", "name = \"step\"", 32, "probe[0].name", &["the number of the sub-step"]),
    ("name = \"h1\"", "name = \"h,1\"", 32, "probe[0].name", &["letters"]),
    ("x = 0.5, y = 0.25", "x = 0.5, y = 1.25", 33, "probe[0].height.y", &["outside the domain", "0 to 1 m"]),
    ("x = 0.5, y = 0.25", "x = 0.5, z = 0.25", 33, "probe[0].height", &["has no `y`", "add y = 0.5"]),
    ("x = 0.5, y = 0.25", "x = 0.5, y = 0.25, z = 0.1", 33, "probe[0].height.z", &["along gravity", "remove it"]),
    ("point = [0.5, 0.1, 0.25]", "point = [0.5, 1.1, 0.25]", 36, "probe[1].velocity.point", &["outside the domain"]),
    ("axis = \"x\"", "axis = \"w\"", 39, "probe[2].front.axis", &["\"w\"", "\"x\", \"y\", \"z\", \"-x\""]),
    ("front = { axis = \"x\" }", "flux = { min = [0.5, 0, 0], max = [0.5, 1] }", 39, "probe[2].flux.max", &["3 numbers"]),
    ("front = { axis = \"x\" }", "flux = { min = [0.5, 0, 0], max = [0.5, 1, 2] }", 39, "probe[2].flux.max", &["outside the domain"]),
    ("front = { axis = \"x\" }", "flux = { min = [0.5, 0, 0], max = [0.6, 1, 0.5] }", 39, "probe[2].flux", &["no rectangle", "one equal coordinate"]),
    ("front = { axis = \"x\" }", "flux = { min = [0.5, 0.5, 0], max = [0.5, 0.2, 0.5] }", 39, "probe[2].flux", &["no rectangle", "smaller ones in min"]),
    ("front = { axis = \"x\" }", "flux = { min = [0.5, 0, 0], max = [0.5, 0, 0.5] }", 39, "probe[2].flux", &["no rectangle"]),
    ("front = { axis = \"x\" }", "reaction = { solid = \"ball\" }", 39, "probe[2].reaction", &["no [[solid]]", "measure the liquid"]),
    // Camera.
    ("eye = [1, 1, 3]", "eye = [1, 0.5, 0.25]", 52, "camera.eye", &["target"]),
    ("eye = [1, 1, 3]", "eye = [1, 5, 0.25]", 52, "camera.eye", &["along the camera's up"]),
    ("eye = [1, 1, 3]", "eye = [1, 1, 3]\nkeyframes = [{ t = 0, eye = [1, 1, 3] }]", 52, "camera.eye", &["conflicts with keyframes", "remove one"]),
    ("eye = [1, 1, 3]", "keyframes = []", 52, "camera.keyframes", &["no entry", "eye = [3, 2, 4]"]),
    ("eye = [1, 1, 3]", "keyframes = [{ t = 0 }]", 52, "camera.keyframes[0].eye", &["is missing", "eye = [3, 2, 4], in m"]),
    ("eye = [1, 1, 3]", "keyframes = [{ t = 1, eye = [1, 1, 3] }, { t = 1, eye = [2, 1, 3] }]", 52, "camera.keyframes[1].t", &["1 s is not later", "ascending order of time"]),
    ("eye = [1, 1, 3]", "keyframes = [{ t = 0, eye = [1, 1, 3], fov = 170 }]", 52, "camera.keyframes[0].fov", &["is 170", "150"]),
    ("eye = [1, 1, 3]", "keyframes = [{ t = 0, eye = [1, 0.5, 3.25] }, { t = 1, eye = [1, 0.5, -2.75] }]", 52, "camera.keyframes[0]", &["target itself at 0.5 s", "move it"]),
    ("fov = 50", "fov = 180", 55, "camera.fov", &["150"]),
    ("fov = 50", "cut = { axis = \"z\", at = 0.5 }", 55, "camera.cut.at", &["is 0.5, outside the domain", "between 0 and 0.5"]),
    ("fov = 50", "cut = { axis = \"z\" }", 55, "camera.cut.at", &["is missing", "at = 0.5, in m"]),
    ("tolerance = 1e-6", "sigma = 0.5", 41, "solver.sigma", &["is no key", "halves the masses", "remove `sigma`"]),
    ("size = [640, 480]", "size = [640, 4]", 56, "camera.size[1]", &["from 16"]),
];

#[test]
fn malformed_scenes_are_refused_with_line_key_and_cure() {
    refuse(GOOD, REFUSED);
}

/// Breaks a scene case by case.
fn refuse(base: &str, cases: &[Case]) {
    let mut failures = Vec::new();
    for &(good, bad, line, key, parts) in cases {
        assert!(base.contains(good), "the base scene has no `{good}`");
        match load(&base.replacen(good, bad, 1), &[], 1.0) {
            Err(error @ Error::Scene { .. }) => {
                assert_eq!(error.exit_code(), 2);
                let message = error.to_string();
                let start = format!("good.toml:{line}: {key}: ");
                let absent = parts.iter().find(|part| !message.contains(**part));
                if let Some(part) = absent.or((!message.contains(&start)).then_some(&&*start)) {
                    failures.push(format!("`{bad}`: no `{part}` in: {message}"));
                }
            }
            other => failures.push(format!("`{bad}` gave {other:?}")),
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn a_scene_without_liquid_and_solids_is_refused() {
    let base = "[domain]\nsize = [1, 1, 1]\ncells = [8, 8, 8]\n[time]\nduration = 1\n";
    for (rest, line, key) in [
        ("", 5, "liquid"),
        ("[liquid]\ndensity = 1\n", 6, "liquid.region"),
        ("[liquid]\nregion = []\n", 7, "liquid.region"),
    ] {
        let error = load(&format!("{base}{rest}"), &[], 1.0).unwrap_err().to_string();
        assert!(error.contains(&format!("good.toml:{line}: {key}: ")), "{error}");
        assert!(error.contains("[[liquid.region]]"), "{error}");
    }
    let error = load(base, &[], 1.0).unwrap_err().to_string();
    assert!(error.contains("or [[solid]]"), "{error}");
}

/// A scene of solids that uses every key of theirs; the cases below break it.
const SOLIDS: &str = r#"# Beams and balls.
[domain]
size = [2, 1, 1]
cells = [32, 16, 16]
[time]
duration = 1
[[solid]]
name = "beam"
mesh = { box = { size = [1, 0.1, 0.2], cells = [10, 1, 2] } }
placement = { translate = [1, 0.5, 0.5], rotate = { axis = [0, 0, 2], degrees = 90 }, scale = 0.5 }
initial = { scale = [1, 0.5, -1], velocity = [0, 1, 0], spin = [0, 0, 3] }
density = 1200.0
young = 1e6
poisson = 0.49
model = "linear"
damping = { mass = 0.5, stiffness = 1e-3 }
[[solid.pin]]
region = { box = { min = [0, 0, 0], max = [2, 0.3, 1] } }
[[solid.pin]]
region = { half_space = { point = [0, 0.2, 0], normal = [0, 1, 0] } }
components = "zx"
[[solid.script]]
region = { sphere = { centre = [1, 0.75, 0.5], radius = 0.1 } }
components = "y"
keyframes = [
  { t = 0 },
  { t = 0.5, translate = [0, 0.1, 0], rotate = { axis = [0, 3, 0], degrees = 180 } },
]
[[solid.load]]
region = { cylinder = { base = [1, 0.7, 0.5], axis = [0, 1, 0], radius = 1, height = 0.1 } }
force = [0, -10, 0]
[[solid.load]]
region = { box = { min = [0, 0.7, 0], max = [2, 1, 1] } }
traction = [100, 0, 0]
[[solid]]
name = "ball"
mesh = { sphere = { radius = 0.1, cell_size = 0.05 } }
placement = { translate = [1.8, 0.5, 0.5] }
density = 1000
young = 1e5
poisson = 0.3
[[solid]]
name = "shell"
mesh = { shell = { radius = 0.1, thickness = 0.02, cell_size = 0.03 } }
placement = { translate = [0.2, 0.5, 0.5] }
initial = { scale = 0.5 }
density = 1000
young = 1e5
poisson = -0.3
[[solid]]
name = "dinosaur"
mesh = { file = "body.msh" }
density = 1000
young = 1e5
poisson = 0
[[solid]]
name = "stone"
mesh = { surface = { file = "body.stl", cell_size = 0.1 } }
density = 1000
young = 1e5
poisson = 0.25
[[probe]]
name = "tip"
node = { solid = "beam", rest_point = [1, 0.75, 0.5] }
[[probe]]
name = "whole"
solid = { name = "ball" }
[output]
solids = false
"#;

#[test]
fn solids_are_what_their_scene_says() {
    let scene = load(SOLIDS, &[], 1.0).unwrap();
    assert!(scene.liquid.is_none());
    let [beam, ball, shell, dinosaur, stone] = &scene.solids[..] else { panic!("{} solids", scene.solids.len()) };
    assert_eq!(beam.name, "beam");
    assert!(matches!(
        beam.mesh,
        SolidMesh::Box { size, cells: [10, 1, 2] } if size == DVec3::new(1.0, 0.1, 0.2)
    ));
    assert!((beam.placement.rotate * DVec3::X - DVec3::Y).length() < 1e-15);
    assert_eq!(beam.placement.scale, 0.5);
    assert_eq!(beam.initial.scale, DVec3::new(1.0, 0.5, -1.0));
    assert_eq!((beam.initial.velocity, beam.initial.spin), (DVec3::Y, DVec3::new(0.0, 0.0, 3.0)));
    assert_eq!((beam.density, beam.young, beam.poisson), (1200.0, 1e6, 0.49));
    assert_eq!(beam.model, ElasticModel::Linear);
    assert_eq!((beam.mass_damping, beam.stiffness_damping), (0.5, 1e-3));

    let [held, roller, script] = &beam.pins[..] else { panic!("{} pins", beam.pins.len()) };
    assert_eq!((held.components, held.keyframes.len()), ([true; 3], 0));
    assert_eq!(roller.components, [true, false, true]);
    assert!(matches!(roller.region, Shape::HalfSpace { .. }));
    assert_eq!(script.components, [false, true, false]);
    assert!(matches!(script.region, Shape::Sphere { radius: 0.1, .. }));
    let [first, second] = script.keyframes[..] else { panic!("{} keyframes", script.keyframes.len()) };
    assert_eq!((first.time, first.translate, first.angle), (0.0, DVec3::ZERO, 0.0));
    assert_eq!((second.time, second.translate), (0.5, DVec3::new(0.0, 0.1, 0.0)));
    assert_eq!(second.axis, DVec3::Y, "axes become unit vectors");
    assert!((second.angle - std::f64::consts::PI).abs() < 1e-15);
    assert_eq!(beam.loads[0].kind, LoadKind::Force(DVec3::new(0.0, -10.0, 0.0)));
    assert_eq!(beam.loads[1].kind, LoadKind::Traction(DVec3::new(100.0, 0.0, 0.0)));

    assert!(matches!(ball.mesh, SolidMesh::Sphere { radius: 0.1, cell_size: 0.05 }));
    assert_eq!(
        (ball.model, ball.mass_damping, ball.pins.len(), ball.loads.len()),
        (ElasticModel::Corotational, 0.0, 0, 0)
    );
    assert_eq!(ball.initial.scale, DVec3::ONE);
    assert!(matches!(shell.mesh, SolidMesh::Shell { thickness: 0.02, .. }));
    assert_eq!((shell.initial.scale, shell.poisson), (DVec3::splat(0.5), -0.3));
    let SolidMesh::File { file, .. } = &dinosaur.mesh else { panic!("the dinosaur is a file") };
    assert_eq!(file.parent(), scene.file.parent());
    assert!(matches!(&stone.mesh, SolidMesh::Surface { file, cell_size: 0.1, .. } if file.ends_with("body.stl")));

    let columns: Vec<_> = scene.probes.iter().flat_map(Probe::columns).collect();
    assert_eq!(columns, ["tip_x", "tip_y", "tip_z", "whole_x", "whole_y", "whole_z", "whole_volume"]);
    assert!(matches!(
        scene.probes[0].kind,
        ProbeKind::Node { solid: 0, nodes: ProbedNodes::Nearest(point), velocity: false } if point == DVec3::new(1.0, 0.75, 0.5)
    ));
    assert!(matches!(scene.probes[1].kind, ProbeKind::Solid { solid: 1 }));
    assert!(!scene.output.solids && !scene.output.particles && !scene.output.fields);
    let scene = load(SOLIDS, &["output={}", "solid[1].young=2e5"], 1.0).unwrap();
    assert!(scene.output.solids);
    assert_eq!(scene.solids[1].young, 2e5);
}

#[rustfmt::skip] // one case a line
const REFUSED_SOLIDS: &[Case] = &[
    // Keys and types.
    ("[[solid]]\nname = \"beam\"", "[solid]\nname = \"beam\"", 35, "TOML", &["duplicate key", "double brackets"]),
    ("young = 1e6", "yuong = 1e6", 13, "solid[0].yuong", &["unknown key", "did you mean `young`"]),
    ("spin = [0, 0, 3]", "spni = [0, 0, 3]", 11, "solid[0].initial.spni", &["did you mean `spin`"]),
    ("stiffness = 1e-3", "stifness = 1e-3", 16, "solid[0].damping.stifness", &["did you mean `stiffness`"]),
    ("components = \"zx\"", "component = \"zx\"", 21, "solid[0].pin[1].component", &["did you mean `components`"]),
    ("{ t = 0 }", "{ time = 0 }", 26, "solid[0].script[0].keyframes[0].time", &["unknown key", "t, translate, rotate"]),
    ("spin = [0, 0, 3]", "velocity_gradient = [0, 0, 3]", 11, "solid[0].initial.velocity_gradient", &["is a list", "one table"]),
    ("spin = [0, 0, 3]", "velocity_gradient = { x = [0, 1] }", 11, "solid[0].initial.velocity_gradient.x", &["a list of 2", "1/s"]),
    ("spin = [0, 0, 3]", "velocity_gradient = { w = [0, 1, 0] }", 11, "solid[0].initial.velocity_gradient.w", &["x, y, z"]),
    ("spin = [0, 0, 3]", "spin = 3", 11, "solid[0].initial.spin", &["the number 3", "rad/s"]),
    ("scale = [1, 0.5, -1]", "scale = [1, 0.5]", 11, "solid[0].initial.scale", &["a list of 2", "list of 3"]),
    ("velocity = [0, 1, 0]", "velocity = [0, nan, 0]", 11, "solid[0].initial.velocity[1]", &["NaN", "finite"]),
    ("model = \"linear\"", "model = \"neohookean\"", 15, "solid[0].model", &["neohookean", "\"corotational\""]),
    // Words of other programs.
    ("young = 1e6", "E = 1e6", 13, "solid[0].E", &["unknown key", "did you mean `young`?"]),
    ("young = 1e6", "youngs_modulus = 1e6", 13, "solid[0].youngs_modulus", &["did you mean `young`?"]),
    ("poisson = 0.49", "nu = 0.49", 14, "solid[0].nu", &["did you mean `poisson`?"]),
    ("density = 1200.0", "mass = 1200.0", 12, "solid[0].mass", &["write density, in kg/m^3"]),
    ("young = 1e6", "velocity = [0, 0, 0]", 13, "solid[0].velocity", &["write initial = { velocity"]),
    ("young = 1e6", "position = [0, 0, 0]", 13, "solid[0].position", &["write placement = { at = [x, y, z] }"]),
    ("sphere = { radius = 0.1, cell_size = 0.05 }", "sphere = { radius = 0.1, cell_size = 0.05 }, units = \"mm\"", 37, "solid[1].mesh.units", &["needs a mesh file", "lengths in a scene are in m"]),
    ("cell_size = 0.1 }", "cell_size = 0.1 }, units = \"mm\"", 58, "solid[4].mesh.units", &["beside its file: surface = { file"]),
    // What is missing.
    ("name = \"beam\"\n", "", 7, "solid[0].name", &["is missing"]),
    ("density = 1200.0\n", "", 7, "solid[0].density", &["is missing", "kg/m^3"]),
    ("young = 1e6\n", "", 7, "solid[0].young", &["is missing", "Pa"]),
    ("poisson = 0.49\n", "", 7, "solid[0].poisson", &["is missing", "poisson = 0.3"]),
    ("mesh = { sphere = { radius = 0.1, cell_size = 0.05 } }\n", "", 35, "solid[1].mesh", &["is missing", "box"]),
    (", cell_size = 0.05", "", 37, "solid[1].mesh.sphere.cell_size", &["is missing", "cell_size = 0.03"]),
    ("region = { sphere = { centre = [1, 0.75, 0.5], radius = 0.1 } }\n", "", 22, "solid[0].script[0].region", &["is missing"]),
    ("force = [0, -10, 0]\n", "", 29, "solid[0].load[0]", &["has no kind of load", "force, traction"]),
    // Names.
    ("name = \"ball\"\nmesh", "name = \"beam\"\nmesh", 36, "solid[1].name", &["has the name \"beam\" too", "another name"]),
    ("name = \"beam\"", "name = \"a beam\"", 8, "solid[0].name", &["letters"]),
    // Meshes.
    ("sphere = { radius = 0.1, cell_size = 0.05 }", "sphere = { radius = 0.1, cell_size = 0.05 }, file = \"body.msh\"", 37, "solid[1].mesh", &["`sphere` and `file`", "keep one mesh"]),
    ("size = [1, 0.1, 0.2]", "size = [1, -0.1, 0.2]", 9, "solid[0].mesh.box.size", &["[1, -0.1, 0.2]", "above zero"]),
    ("cells = [10, 1, 2]", "cells = [10, 0, 2]", 9, "solid[0].mesh.box.cells[1]", &["is 0", "from 1"]),
    ("cells = [10, 1, 2]", "cells = [1000, 1000, 1000]", 9, "solid[0].mesh.box.cells", &["1000000000 bricks", "fewer cells"]),
    ("thickness = 0.02", "thickness = 0.1", 44, "solid[2].mesh.shell.thickness", &["no hollow", "below the radius"]),
    ("cell_size = 0.05", "cell_size = 0.2", 37, "solid[1].mesh.sphere.cell_size", &["is 0.2", "to 0.1 m"]),
    ("cell_size = 0.05", "cell_size = 1e-6", 37, "solid[1].mesh.sphere.cell_size", &["1.240e-3 to 0.1 m"]),
    ("body.msh", "nobody.msh", 52, "solid[3].mesh.file", &["there is no file", "nobody.msh"]),
    ("body.msh", "body.stl", 52, "solid[3].mesh.file", &["not a supported mesh format", "fill a closed surface"]),
    ("file = \"body.stl\", cell", "file = \"body.msh\", cell", 58, "solid[4].mesh.surface.file", &["not a supported mesh format", ".obj"]),
    // Placement and start.
    ("placement = { translate = [1.8, 0.5, 0.5] }", "placement = { translate = [1.95, 0.5, 0.5] }", 38, "solid[1].placement", &["sticks out of the domain", "along x", "from 0 to 2 m"]),
    ("placement = { translate = [1.8, 0.5, 0.5] }\n", "", 37, "solid[1].mesh", &["sticks out of the domain", "placement.at"]),
    ("initial = { scale = 0.5 }", "initial = { scale = -9 }", 45, "solid[2].placement", &["sticks out of the domain"]),
    ("degrees = 90 }, scale = 0.5", "degrees = 90 }, scale = 2.5", 10, "solid[0].placement", &["along y"]),
    ("scale = 0.5 }\ninitial = { scale = [1", "scale = -0.5 }\ninitial = { scale = [1", 10, "solid[0].placement.scale", &["above zero"]),
    // Material.
    ("density = 1200.0", "density = 0", 12, "solid[0].density", &["above zero"]),
    ("young = 1e6", "young = -1e6", 13, "solid[0].young", &["above zero"]),
    ("density = 1200.0", "density = 1e300", 12, "solid[0].density", &["is 1e300", "1e-6 to 1e6"]),
    ("young = 1e6", "young = 1e300", 13, "solid[0].young", &["is 1e300", "1e-3 to 1e13 Pa"]),
    ("force = [0, -10, 0]", "force = [0, -1e300, 0]", 31, "solid[0].load[0].force", &["1e300", "-1e13 to 1e13"]),
    ("initial = { scale = 0.5 }", "initial = { spin = [0, 1e200, 0] }", 46, "solid[2].initial.spin", &["1e200", "-1e6 to 1e6"]),
    ("poisson = 0.49", "poisson = 0.5", 14, "solid[0].poisson", &["is 0.5", "less than 0.5", "0.49 is nearly incompressible"]),
    ("poisson = 0.49", "poisson = -1", 14, "solid[0].poisson", &["more than -1"]),
    ("mass = 0.5", "mass = -0.5", 16, "solid[0].damping.mass", &["is -0.5", "zero or above"]),
    // Pins, scripts and loads.
    ("components = \"zx\"", "components = \"xw\"", 21, "solid[0].pin[1].components", &["is \"xw\"", "x, y, z"]),
    ("components = \"zx\"", "components = \"xx\"", 21, "solid[0].pin[1].components", &["each once"]),
    ("components = \"zx\"", "components = \"\"", 21, "solid[0].pin[1].components", &["is empty"]),
    ("half_space = { point", "wave = { point", 20, "solid[0].pin[1].region.wave", &["unknown key", "half_space"]),
    ("sphere = { centre = [1, 0.75, 0.5], radius = 0.1 }", "half_space = { point = [0, 0.2, 0], normal = [0, 1, 0] }", 23, "solid[0].script[0].region.half_space", &["unknown key", "box, sphere, cylinder"]),
    ("max = [2, 0.3, 1]", "max = [2, 0, 1]", 18, "solid[0].pin[0].region.box", &["no volume"]),
    ("{ t = 0.5,", "{ t = 0,", 27, "solid[0].script[0].keyframes[1].t", &["is not later than the keyframe before, 0 s", "ascending order"]),
    ("{ t = 0 }", "{ t = -1 }", 26, "solid[0].script[0].keyframes[0].t", &["is -1", "0 s or later"]),
    ("axis = [0, 3, 0]", "axis = [0, 0, 0]", 27, "solid[0].script[0].keyframes[1].rotate.axis", &["no direction"]),
    ("force = [0, -10, 0]", "force = -10", 31, "solid[0].load[0].force", &["the number -10", "in N"]),
    ("force = [0, -10, 0]", "force = [0, -10, 0]\ntraction = [0, 0, 0]", 29, "solid[0].load[0]", &["`force` and `traction`"]),
    // Probes and outputs.
    ("node = { solid = \"beam\"", "node = { solid = \"boom\"", 64, "probe[0].node.solid", &["\"boom\"", "\"beam\", \"ball\""]),
    (", rest_point = [1, 0.75, 0.5]", "", 64, "probe[0].node", &["no choice of nodes", "rest_point, region"]),
    (", rest_point = [1, 0.75, 0.5]", ", rest_point = [1, 1, 1], region = {}", 64, "probe[0].node", &["`rest_point` and `region`", "keep one"]),
    (", rest_point = [1, 0.75, 0.5]", ", region = {}", 64, "probe[0].node.region", &["no shape", "half_space"]),
    ("solid = { name = \"ball\" }", "reaction = { solid = \"bell\" }", 67, "probe[1].reaction.solid", &["\"bell\"", "\"ball\""]),
    ("solid = { name = \"ball\" }", "solid = {}", 67, "probe[1].solid.name", &["is missing", "\"beam\""]),
    ("solid = { name = \"ball\" }", "front = { axis = \"x\" }", 67, "probe[1].front", &["no", "measure a solid"]),
    ("solid = { name = \"ball\" }", "force = { solid = \"ball\" }", 67, "probe[1].force", &["force of liquid", "add a [liquid] section"]),
    ("name = \"whole\"", "name = \"tip\"", 66, "probe[1].name", &["has the name \"tip\" too"]),
    ("solids = false", "particles = true", 69, "output.particles", &["no liquid", "particles = false"]),
    ("solids = false", "fields = true", 69, "output.fields", &["no liquid"]),
    ("[output]\nsolids = false", "[solver]\npreconditioner = \"jacobi\"", 69, "solver.preconditioner", &["no liquid", "its own preconditioner"]),
];

#[test]
fn malformed_solids_are_refused_with_line_key_and_cure() {
    refuse(SOLIDS, REFUSED_SOLIDS);
}

#[test]
fn a_file_that_cannot_be_read_is_an_input_error() {
    let folder = tempfile::tempdir().unwrap();
    let missing = Scene::load(&folder.path().join("no.toml"), &[], 1.0).unwrap_err();
    assert!(matches!(&missing, Error::Input { what, .. } if what.contains("no.toml")));
    let binary = folder.path().join("binary.toml");
    std::fs::write(&binary, [0xff, 0xfe, 0x00]).unwrap();
    let binary = Scene::load(&binary, &[], 1.0).unwrap_err();
    assert!(binary.to_string().contains("UTF-8"), "{binary}");
}

#[test]
fn overrides_set_any_key() {
    let scene = load(
        GOOD,
        &[
            "liquid.density=900",
            "liquid.region[0].velocity=[2, 0.5, 0]",
            "liquid.region[0].box.max[1] = 0.75",
            "obstacle[0].placement.scale=0.25",
            "obstacle[1].mesh.file=./body.stl",
            "solver.precision=f64",
            "solver.preconditioner=\"multigrid\"",
            "time={ duration = 2 }",
            "liquid.density=950",
        ],
        1.0,
    )
    .unwrap();
    let liquid = scene.liquid.unwrap();
    assert_eq!(liquid.density, 950.0, "the last one counts");
    assert_eq!(liquid.regions[0].velocity, DVec3::new(2.0, 0.5, 0.0));
    assert!(matches!(liquid.regions[0].shape, Shape::Box { max, .. } if max.y == 0.75));
    assert_eq!(scene.obstacles[0].placement.scale, 0.25);
    assert_eq!(scene.solver.precision, Precision::F64);
    assert_eq!(scene.solver.preconditioner, Preconditioner::Multigrid);
    assert_eq!((scene.time.duration, scene.time.cfl), (2.0, 3.0));
    assert_eq!(scene.overrides.len(), 9);

    // Tables on the way are made.
    let text = "[domain]\nsize = [1, 1, 1]\ncells = [8, 8, 8]\n[time]\nduration = 1\n\
                [[liquid.region]]\nbox = { min = [0, 0, 0], max = [1, 0.5, 1] }\n";
    let scene = load(text, &["camera.fov=20", "output.fields=true"], 1.0).unwrap();
    assert!(scene.output.fields && scene.camera.fov == 20.0);
}

#[test]
fn bad_overrides_name_themselves() {
    #[rustfmt::skip] // one case a line
    let cases: &[(&str, &[&str])] = &[
        ("liquid.density", &["no `=`", "--set KEY=VALUE"]),
        ("=3", &["not a key"]),
        ("liquid..density=3", &["not a key"]),
        ("liquid.region[x].velocity=3", &["not a key"]),
        ("liquid.density=-1", &["liquid.density: is -1", "above zero"]),
        ("liquid.density=heavy", &["the text \"heavy\""]),
        ("liquid.density=", &["not a TOML value"]),
        ("domain.size=[1, 2", &["not a TOML value"]),
        ("liquid.density=1 2", &["not a TOML value"]),
        ("liquid.densty=1", &["liquid.densty: unknown key", "did you mean `density`"]),
        ("solid[0].young=1", &["no list `solid`"]),
        ("solid.young=1", &["solid: is one table, not a list", "[[solid]]"]),
        ("liquid.region.velocity=[0, 0, 0]", &["a list of 3", "liquid.region[0].velocity"]),
        ("liquid.region[3].velocity=[0, 0, 0]", &["no `liquid.region[3]`", "0 to 2"]),
        ("liquid.density[0]=3", &["`liquid.density` is the number 800", "remove the [0]"]),
        ("liquid.density.x=3", &["has no key `x`", "set `liquid.density`"]),
        ("domain.size=[2, 1, 0.4]", &["domain.size", "not cubic", "[30, 15, 6]"]),
        ("obstacle[0].placement.rotate={ axis = [1, 0, 0] }", &["obstacle[0].placement.rotate.degrees: is missing"]),
        ("time.duration=99999999999999999999", &["lies beyond +-2^63"]),
        ("solver.tolerance=1", &["solver.tolerance: is 1", "use 1e-14 to below 1"]),
        ("liquid.region[0].box.min=[2, 0, 0]", &["liquid.region[0].box.min: the box has no volume: along x it extends from 2 to 0.5"]),
        ("liquid.region[0].box.max=[0.5, 0, 0.5]", &["liquid.region[0].box.max: the box has no volume: along y"]),
    ];
    for &(setting, parts) in cases {
        let error = load(GOOD, &[setting], 1.0).map(|_| ()).expect_err(setting);
        assert!(matches!(&error, Error::Input { what, .. } if *what == format!("--set {setting}")), "{error}");
        for part in parts {
            let message = error.to_string();
            assert!(message.contains(part), "`{setting}`: no `{part}` in: {message}");
        }
    }
}

#[test]
fn scale_multiplies_the_cells_and_keeps_them_cubic() {
    let cells = |scale| load(GOOD, &[], scale).map(|scene| scene.domain.cells);
    assert_eq!(cells(2.0).unwrap(), [64, 32, 16]);
    assert_eq!(cells(0.5).unwrap(), [16, 8, 4]);
    assert_eq!(cells(0.125).unwrap(), [4, 2, 1]);
    assert_eq!(cells(0.13).unwrap(), [4, 2, 1], "rounded");
    let scene = load(GOOD, &[], 2.0).unwrap();
    assert_eq!((scene.scale, scene.grid().dx), (2.0, 0.03125));

    for (scale, cure) in [(0.3, "--scale 0.25"), (1.1, "--scale 1.125"), (0.01, "--scale 0.125")] {
        let error = cells(scale).unwrap_err();
        let message = error.to_string();
        assert!(matches!(&error, Error::Input { what, .. } if *what == format!("--scale {scale}")), "{message}");
        assert!(message.ends_with(cure), "{message}");
        let works: f64 = cure.trim_start_matches("--scale ").parse().unwrap();
        cells(works).unwrap();
    }
    // The proposal is right even where it is no short decimal.
    let thirds = GOOD.replace("[32, 16, 8]", "[12, 6, 3]");
    let message = load(&thirds, &[], 0.5).unwrap_err().to_string();
    let works = message.rsplit_once("--scale ").unwrap().1.parse().unwrap();
    assert_eq!(load(&thirds, &[], works).unwrap().domain.cells, [8, 4, 2]);

    for scale in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e6] {
        assert!(matches!(cells(scale), Err(Error::Input { .. })), "{scale}");
    }
}

#[test]
fn the_hash_changes_with_the_mesh_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("good.toml");
    std::fs::write(&path, GOOD).unwrap();
    let hash = |mesh: &str| {
        std::fs::write(folder.path().join("body.stl"), mesh).unwrap();
        Scene::load(&path, &[], 1.0).unwrap().hash
    };
    let once = hash("solid a");
    assert_ne!(once, hash("solid b"));
    assert_eq!(once, hash("solid a"));
}

#[test]
fn the_hash_changes_with_everything_the_scene_is_made_from() {
    let hash = |text: &str, overrides: &[&str], scale| load(text, overrides, scale).unwrap().hash;
    let base = hash(GOOD, &[], 1.0);
    assert_eq!(base.len(), 64);
    assert_eq!(base, hash(GOOD, &[], 1.0));
    let others = [
        hash(&GOOD.replace("seed = 7", "seed = 8"), &[], 1.0),
        hash(GOOD, &["liquid.seed=8"], 1.0),
        hash(GOOD, &["liquid.seed=8", "liquid.density=9"], 1.0),
        hash(GOOD, &["liquid.density=9", "liquid.seed=8"], 1.0),
        hash(GOOD, &[], 0.5),
        base,
    ];
    for (i, a) in others.iter().enumerate() {
        assert!(!others[..i].contains(a), "hash {i} is not new");
    }
}

#[test]
fn the_default_camera_sees_the_whole_domain_upright() {
    for (size, cells) in [("[2, 1, 1]", "[16, 8, 8]"), ("[2, 1.25, 0.125]", "[16, 10, 1]"), ("[1, 4, 1]", "[4, 16, 4]")]
    {
        for (gravity, up) in [
            ([0.0, -9.81, 0.0], DVec3::Y),
            ([1.0, 0.5, -9.0], DVec3::Z),
            ([2.0, 0.0, 0.0], -DVec3::X),
            ([0.0, 3.0, 0.0], -DVec3::Y),
            ([0.0; 3], DVec3::Y),
        ] {
            let text = format!(
                "[domain]\nsize = {size}\ncells = {cells}\ngravity = {gravity:?}\n[time]\nduration = 1\n\
                 [[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [0.5, 0.5, 0.5] }}\n"
            );
            for overrides in [vec![], vec!["camera.fov=70", "camera.size=[200, 400]"]] {
                let scene = load(&text, &overrides, 1.0).unwrap();
                let camera = scene.camera;
                assert_eq!(camera.up, up);
                let ahead = (camera.target - camera.eye).normalize();
                assert!(ahead.dot(up) < -0.2 && ahead.dot(up) > -0.7, "from slightly above");
                let right = ahead.cross(up).normalize();
                let top = right.cross(ahead);
                let half = (0.5 * camera.fov.to_radians()).tan();
                let aspect = camera.size[0] as f64 / camera.size[1] as f64;
                let mut fill = 0.0_f64;
                for corner in 0..8 {
                    let bit = |axis: usize| (corner >> axis & 1) as f64;
                    let x = scene.domain.size * DVec3::new(bit(0), bit(1), bit(2)) - camera.eye;
                    assert!(x.dot(ahead) > 0.0);
                    let across = x.dot(right).abs() / (x.dot(ahead) * half * aspect);
                    let along = x.dot(top).abs() / (x.dot(ahead) * half);
                    fill = fill.max(across).max(along);
                }
                assert!(fill < 1.0 && fill > 0.8, "{size} {gravity:?}: fills {fill}");
            }
        }
    }
}

#[test]
fn every_scene_in_the_folder_loads_at_every_usual_size() {
    let files = scenes();
    let names: Vec<_> = files.iter().map(|file| file.file_stem().unwrap().to_str().unwrap()).collect();
    for name in [
        "bouncing_ball",
        "buoyancy_heavy",
        "buoyancy_light",
        "buoyancy_neutral",
        "cantilever",
        "compressibility",
        "conditioning_40",
        "conditioning_60",
        "conditioning_80",
        "cylinder_tank",
        "dam_break",
        "dam_break_liquid",
        "dam_break_on_blocks",
        "dinosaur_step",
        "draining_tank",
        "drop_into_pool",
        "fountain",
        "fluid_in_sphere",
        "gate",
        "gripper",
        "hanging_beam",
        "hydrostatic_block",
        "light_dino",
        "material_stack",
        "platform",
        "sloped_panel",
        "sloshing_tank",
        "soft_wheel",
        "solitary_run_up",
        "sphere_half_full",
        "spinning_block",
        "squashed_cube",
        "stability",
        "standing_wave",
        "uneven_sphere",
        "water_wheel",
        "wave_maker",
    ] {
        assert!(names.contains(&name), "no {name}");
    }
    for file in &files {
        let text = std::fs::read_to_string(file).unwrap();
        assert!(text.starts_with("# "), "{}: begins with a comment", file.display());
        for word in ["# Expect: ", "# Numbers: "] {
            assert!(text.contains(word), "{}: no `{word}`", file.display());
        }
        for scale in [0.5, 1.0, 2.0] {
            let scene = Scene::load(file, &[], scale).unwrap();
            assert!(scene.domain.cells.iter().any(|&n| n as f64 >= 20.0 * scale));
            let n_cells: usize = scene.domain.cells.iter().product();
            assert!(n_cells as f64 <= (100.0 * scale).powi(3), "{n_cells} cells");
        }
    }
}

/// Through its keyframes, at rest before and after them; with two on a straight line at one speed, with three without a kink.
#[test]
fn a_camera_goes_smoothly_through_its_keyframes() {
    let text = "[domain]
size = [1, 1, 1]
cells = [8, 8, 8]
[time]
duration = 4
[[liquid.region]]
box = { min = [0, 0, 0], max = [1, 0.5, 1] }
[camera]
target = [0.5, 0.5, 0.5]
fov = 40
keyframes = [{ t = 1, eye = [3, 1, 3] }, { t = 2, eye = [0, 1, 4], fov = 20 }, { t = 3.5, eye = [-3, 2, 3], target = [0.5, 1, 0.5] }]
";
    let path = Path::new("moving.toml");
    let camera = Scene::parse(path, text, &[], 1.0).unwrap().camera;
    assert_eq!(camera.eye, DVec3::new(3.0, 1.0, 3.0));
    let eye = |time: f64| camera.pose(time).eye;
    for (time, at) in [
        (0.0, DVec3::new(3.0, 1.0, 3.0)),
        (1.0, DVec3::new(3.0, 1.0, 3.0)),
        (2.0, DVec3::new(0.0, 1.0, 4.0)),
        (3.5, DVec3::new(-3.0, 2.0, 3.0)),
        (9.0, DVec3::new(-3.0, 2.0, 3.0)),
    ] {
        assert!(eye(time).distance(at) < 1e-12, "at {time} s: {}", eye(time));
    }
    let speed = |time: f64| (eye(time + 1e-6) - eye(time - 1e-6)) / 2e-6;
    let (before, after) = (speed(2.0 - 1e-5), speed(2.0 + 1e-5));
    assert!(before.distance(after) < 1e-3, "a kink from {before} to {after}");
    // From the first to the last, in 2.5 s.
    assert!(before.distance(DVec3::new(-6.0, 1.0, 0.0) / 2.5) < 1e-3, "{before}");
    assert_eq!(camera.pose(2.0).fov, 20.0);
    assert_eq!(camera.pose(2.0).target, DVec3::splat(0.5));
    assert!((20.0..=40.0).contains(&camera.pose(2.7).fov));
    let two = text.replace(", { t = 3.5, eye = [-3, 2, 3], target = [0.5, 1, 0.5] }", "");
    let camera = Scene::parse(path, &two, &[], 1.0).unwrap().camera;
    assert!(camera.pose(1.25).eye.distance(DVec3::new(2.25, 1.0, 3.25)) < 1e-12);
}

/// A plane problem with a value of every kind that is stretched.
const SLAB: &str = r#"[domain]
size = [2, 1, 1]
cells = [32, 16, 2]
slab = "z"
[time]
duration = 1
[[liquid.region]]
box = { min = [0, 0, 0], max = [1, 0.5, 1] }
[[liquid.region]]
cylinder = { base = [1.5, 0.5, 0.0], axis = [0, 0, 1], radius = 0.2, height = 1 }
subtract = true
[[source]]
box = { min = [0, 0.8, 0], max = [0.2, 1, 1] }
flow_rate = 0.4
direction = [1, 0, 0]
[[obstacle]]
box = { min = [1.8, 0, 0], max = [2, 0.2, 1] }
placement = { translate = [0, 0.1, 0], rotate = { axis = [0, 0, 1], degrees = 10 } }
[[solid]]
name = "wall"
mesh = { box = { size = [0.2, 0.5, 1], cells = [2, 4, 2] } }
placement = { at = [1.3, 0.25, 0.5] }
density = 1000
young = 1e6
poisson = 0.3
[[solid.pin]]
region = { box = { min = [0, -0.001, 0], max = [2, 0.001, 1] } }
[[solid.load]]
region = { box = { min = [0, 0.499, 0], max = [2, 0.501, 1] } }
force = [8, 0, 0]
[[probe]]
name = "p"
pressure = { point = [0.5, 0.1, 0.5] }
[[probe]]
name = "f"
force = { solid = "wall" }
"#;

#[test]
fn a_slab_keeps_its_cells_and_what_is_per_thickness() {
    for (scale, cells, thickness) in [(1.0, [32, 16, 2], 0.125), (0.5, [16, 8, 2], 0.25)] {
        let scene = load(SLAB, &[], scale).unwrap();
        assert_eq!(scene.domain.cells, cells);
        assert_eq!(scene.domain.size, DVec3::new(2.0, 1.0, thickness));
        let Some(liquid) = &scene.liquid else { panic!() };
        let Shape::Box { max, .. } = liquid.regions[0].shape else { panic!() };
        assert_eq!(max, DVec3::new(1.0, 0.5, thickness));
        let Shape::Cylinder { height, .. } = liquid.regions[1].shape else { panic!() };
        assert_eq!(height, thickness);
        // 0.4 m^3/s per metre through 0.2 m of height are 2 m/s.
        assert!((scene.sources[0].velocity - DVec3::new(2.0, 0.0, 0.0)).length() < 1e-12);
        assert!((scene.sources[0].flow_rate.unwrap() - 0.4 * thickness).abs() < 1e-12);
        let LoadKind::Force(force) = scene.solids[0].loads[0].kind else { panic!() };
        assert_eq!(force, DVec3::new(8.0 * thickness, 0.0, 0.0));
        let ProbeKind::Pressure { point } = scene.probes[0].kind else { panic!() };
        assert_eq!(point.z, 0.5 * thickness);
        // The mesh fills the slab; its nodes are on rollers, those of the foot are clamped.
        let meshes = cutwater::geometry::solid_meshes(&scene).unwrap();
        let (low, high) =
            meshes[0].nodes.iter().fold((1.0_f64, 0.0_f64), |(low, high), x| (low.min(x.z), high.max(x.z)));
        assert_eq!([low, high], [0.0, thickness]);
        let solids = cutwater::elastic::Solids::new(&scene, &meshes).unwrap();
        for (node, prescribed) in solids.rest.iter().zip(&solids.prescribed) {
            let foot = node.y == 0.0;
            assert_eq!(*prescribed, [foot, foot, true], "{node}");
        }
    }
    // The thickness of the file needs no cubes, and a slab of one cell has half of the load.
    let thin = load(SLAB, &["domain.cells=[32, 16, 1]"], 1.0).unwrap();
    assert_eq!(thin.domain.size.z, 0.0625);
}

#[test]
fn what_varies_across_a_slab_is_refused() {
    for (set, expected) in [
        ("domain.cells=[32, 16, 3]", "domain.slab: is 3 cells thick"),
        ("domain.gravity=[0, -9, 1]", "domain.gravity: gravity varies along z"),
        ("domain.open=[\"+z\"]", "domain.open: opens a wall of the slab"),
        ("liquid.region[0].velocity=[0, 0, 1]", "liquid.region[0]: its velocity varies along z"),
        ("liquid.region[1].cylinder.axis=[0, 1, 1]", "liquid.region[1]: the cylinder varies along z"),
        ("obstacle[0].placement.rotate.axis=[1, 0, 0]", "obstacle[0]: its placement turns it out of the plane"),
        (
            "obstacle[0].keyframes=[{ t = 0 }, { t = 1, translate = [0, 0, 1] }]",
            "obstacle[0]: its keyframes move it out of the plane",
        ),
        ("solid[0].mesh={ sphere = { radius = 0.2, cell_size = 0.1 } }", "solid[0]: a ball varies along z"),
        ("solid[0].initial.velocity=[0, 0, 1]", "solid[0]: initial.velocity moves it out of the plane"),
        ("solid[0].initial.spin=[1, 0, 0]", "solid[0]: initial.spin moves it out of the plane"),
        ("solid[0].mesh.box.size=[0.2, 0.5, 0.9]", "solid[0]: leaves a gap to the walls of the slab"),
        (
            "solid[0].pin[0].region={ sphere = { centre = [1.3, 0, 0.5], radius = 0.3 } }",
            "solid[0]: a sphere varies along z",
        ),
        ("probe[0]={ name = \"p\", front = { axis = \"z\" } }", "probe[0]: its front varies along z"),
    ] {
        let message = load(SLAB, &[set], 1.0).unwrap_err().to_string();
        assert!(message.contains(expected) && message.contains("cure: "), "{set}: {message}");
    }
}
