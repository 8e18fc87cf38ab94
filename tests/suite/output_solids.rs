//! Outputs of elastic solids: frames read back by an independent reader, tables, manifest, pictures.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use cutwater::Error;
use cutwater::elastic::Solids;
use cutwater::geometry::{self, CutCells};
use cutwater::grid::Axis;
use cutwater::output::frames::{FrameKinds, FrameWriter};
use cutwater::output::manifest::{Manifest, RunOptions};
use cutwater::output::preview::{Colour, PreviewOptions, preview};
use cutwater::output::tables::{StepRow, StepTable};
use cutwater::scene::{CameraCut, Scene};
use cutwater::state::{
    ContactReport, CouplingReport, SolidDiagnosis, SolidReport, SolveReport, SolveStatus, State, StepReport,
};
use glam::DVec3;

use crate::output::{Decoded, f32s, flat, front_camera, pixel, python, read, report};

/// Two blocks of 1e6 Pa: the left one 0.2 m wide, 0.2 m high, 0.3 m deep about (0.25, 0.2, 0.3), the right one half as large.
const SCENE: &str = "[domain]
size = [1, 0.5, 0.5]
cells = [16, 8, 8]
[time]
duration = 1
[[solid]]
name = 'left'
mesh = { box = { size = [0.2, 0.2, 0.3], cells = [2, 2, 3] } }
placement = { translate = [0.25, 0.2, 0.3] }
density = 1000
young = 1e6
poisson = 0.25
[[solid]]
name = 'right'
mesh = { box = { size = [0.1, 0.1, 0.1], cells = [1, 1, 1] } }
placement = { translate = [0.75, 0.2, 0.4] }
density = 1000
young = 1e6
poisson = 0.25
";

pub(crate) struct Case {
    scene: Scene,
    pub(crate) solids: Solids,
    cut: CutCells,
    pub(crate) state: State,
}

impl Case {
    fn new() -> Case {
        Case::of(SCENE)
    }

    fn of(text: &str) -> Case {
        Case::in_folder(Path::new(""), text)
    }

    /// The scene blocks.toml of a folder.
    pub(crate) fn in_folder(folder: &Path, text: &str) -> Case {
        let mut scene = Scene::parse(&folder.join("blocks.toml"), text, &[], 1.0).unwrap();
        scene.camera = front_camera();
        let meshes = geometry::solid_meshes(&scene).unwrap();
        let solids = Solids::new(&scene, &meshes).unwrap();
        let grid = scene.grid();
        let mut state = State::at_rest(&grid);
        (state.displacement, state.node_velocity) = solids.initial_state(&scene);
        Case {
            cut: CutCells {
                open: Axis::ALL.map(|axis| vec![1.0; grid.n_faces(axis)]),
                solid_distance: vec![3.0 * grid.dx; grid.n_cells()],
            },
            scene,
            solids,
            state,
        }
    }

    /// Displaces the nodes of a body.
    pub(crate) fn displace(&mut self, body: usize, by: impl Fn(DVec3) -> DVec3) {
        for node in self.solids.bodies[body].nodes.clone() {
            self.state.displacement[node] = by(self.solids.rest[node]).to_array();
        }
    }

    pub(crate) fn writer(&self, run: &Path) -> FrameWriter {
        let kinds = FrameKinds::of(&self.scene);
        FrameWriter::create(run, &self.scene.name, self.scene.grid(), kinds).unwrap()
    }

    pub(crate) fn write(&self, writer: &mut FrameWriter) -> Result<(), Error> {
        writer.write(&self.state, &self.cut, &self.solids)
    }

    pub(crate) fn manifest(&self) -> Manifest {
        let options = RunOptions { backend: "cpu".into(), frames: 24, scale: 1.0, overrides: Vec::new() };
        let manifest = Manifest::new(&self.scene, options, None);
        manifest.with_solids(&self.scene, &self.solids).unwrap()
    }

    /// A run of two frames: as it is, and with the right block moved 0.1 m to the left and the left one pulled by a tenth.
    fn run(&mut self, run: &Path) {
        self.manifest().write(run).unwrap();
        let mut writer = self.writer(run);
        self.write(&mut writer).unwrap();
        self.state.frame = 1;
        self.state.time = 1.0 / 24.0;
        self.displace(0, |x| 0.1 * (x.x - 0.25) * DVec3::X);
        self.displace(1, |_| -0.1 * DVec3::X);
        self.write(&mut writer).unwrap();
    }
}

#[test]
fn solids_read_back_exactly() {
    let Some(python) = python() else { return };
    let run = tempfile::tempdir().unwrap();
    let mut case = Case::new();
    assert_eq!(FrameKinds::of(&case.scene), FrameKinds { solids: true, ..FrameKinds::default() });
    // One pulled along x, one turned inside out along y.
    let stretch = 0.125;
    case.displace(0, |x| stretch * (x.x - 0.25) * DVec3::X);
    case.displace(1, |x| -1.5 * (x.y - 0.2) * DVec3::Y);
    let n = case.solids.rest.len();
    case.state.node_velocity = (0..n).map(|node| [0, 1, 2].map(|axis| ((3 * node + axis) as f64).sin())).collect();
    case.state.frame = 7;
    case.state.time = 7.0 / 24.0;
    let mut writer = case.writer(run.path());
    case.write(&mut writer).unwrap();

    let frames = run.path().join("frames");
    let found = read(&python, &frames.join("blocks_000007.vtu"));
    let position = |node: usize, axis: usize| case.solids.rest[node][axis] + case.state.displacement[node][axis];
    let positions = (0..n).flat_map(|node| [0, 1, 2].map(|axis| position(node, axis)));
    assert_eq!(flat(&found["coordinates"]), f32s(positions));
    let corners = case.solids.elements.iter().flatten();
    assert_eq!(flat(&found["connectivity"]["TETRA"]), f32s(corners.map(|&node| f64::from(node))));
    let numbers = |values: &[[f64; 3]]| f32s(values.iter().flatten().copied());
    let of_nodes = |name: &str| flat(&found["points"][name]["values"]);
    assert_eq!(of_nodes("displacement"), numbers(&case.state.displacement));
    assert_eq!(of_nodes("velocity"), numbers(&case.state.node_velocity));

    // Pulled along x with the sides held, sigma_xx - sigma_yy = 2 mu e, and that is the von Mises stress; with x to -0.5 x the nearest
    // rotation turns about y or z, which leaves strains of -0.5, -2 or 0 along the axes.
    let mu = 1e6 / (2.0 * 1.25);
    let of_cells = |name: &str| flat(&found["cells"][name]["values"]);
    let (stress, det, owner) = (of_cells("von_mises"), of_cells("det_f"), of_cells("solid"));
    for (body, range) in (0..).zip(case.solids.bodies.iter().map(|body| body.elements.clone())) {
        for element in range {
            assert_eq!(owner[element], body as f32);
            let expected = [1.0 + stretch, -0.5][body];
            assert!((f64::from(det[element]) - expected).abs() < 1e-6);
            if body == 0 {
                let ratio = f64::from(stress[element]) / (2.0 * mu * stretch);
                assert!((ratio - 1.0).abs() < 1e-6, "{ratio}");
            } else {
                assert!(f64::from(stress[element]) > mu, "{}", stress[element]);
            }
        }
    }
    let series = read(&python, &frames.join("blocks_solids.pvd"));
    assert_eq!(series["times"][0].as_f64(), Some(7.0 / 24.0));
    assert_eq!(frames.read_dir().unwrap().count(), 2);
}

#[test]
fn a_node_that_is_not_finite_is_refused() {
    type Spoil = fn(&mut State, f64);
    let cases: [(&str, Spoil); 2] = [
        ("position of node 3", |state, bad| state.displacement[3][1] = bad),
        ("velocity of node 5", |state, bad| state.node_velocity[5][2] = bad),
    ];
    for (place, spoil) in cases {
        for bad in [f64::NAN, f64::NEG_INFINITY, 1e39] {
            let run = tempfile::tempdir().unwrap();
            let mut case = Case::new();
            spoil(&mut case.state, bad);
            let mut writer = case.writer(run.path());
            let error = case.write(&mut writer).unwrap_err().to_string();
            assert!(error.contains(place), "{error} does not name {place}");
            assert_eq!(run.path().join("frames").read_dir().unwrap().count(), 0);
        }
    }
}

fn solid_report() -> SolidReport {
    SolidReport {
        solve: SolveReport { unknowns: 321, iterations: 17, residual: 3.25e-9, status: SolveStatus::Stagnated },
        contact: ContactReport { solves: 5, unsettled: 2, next_halvings: Some(3), closing_rate: 0.0 },
        diagnosis: SolidDiagnosis {
            momentum: [1.0 / 3.0, -2e-17, 3e20],
            angular_momentum: [4.0, 5.5, -6.0],
            kinetic_energy: 7.5,
            elastic_energy: 8.5,
            potential_energy: -9.5,
            max_speed: 10.25,
            min_det: -0.125,
            inverted: 12,
        },
    }
}

#[test]
fn tables_of_solids_read_back_exactly() {
    let solid_columns = "solid_solves,unsettled_contacts,contact_halvings,solid_iterations,residual_v,solid_status,solid_unknowns,solid_momentum_x,solid_momentum_y,\
                         solid_momentum_z,solid_angular_momentum_x,solid_angular_momentum_y,solid_angular_momentum_z,\
                         solid_kinetic_energy,solid_elastic_energy,solid_potential_energy,solid_max_speed,min_det_f,inverted";
    let liquid_columns: Vec<&str> = StepTable::columns([true, false, false, false]).collect();
    for with_liquid in [false, true] {
        let run = tempfile::tempdir().unwrap();
        let liquid = report(0).liquid.filter(|_| with_liquid);
        let report = StepReport {
            dt: 0.25,
            wave_cfl: 0.125,
            dt_floored: false,
            liquid,
            solid: Some(solid_report()),
            coupling: with_liquid.then_some(CouplingReport {
                touching: true,
                condensed: false,
                force: [1.5, -2e-17, 3e20],
                correction: [0.0, 0.25, 1.0 / 3.0],
                overlap_cells: 7,
                overlap_depth: 0.125,
            }),
            seconds: vec![("solve", 0.5)],
            seconds_total: 0.5,
        };
        let row = StepRow { step: 4, time: 0.75, report: &report, volume_ratio: liquid.map(|_| 0.5) };
        let mut table = StepTable::create(run.path()).unwrap();
        table.push(&row).unwrap();
        let bare = StepReport { solid: None, coupling: None, ..report.clone() };
        let error = table.push(&StepRow { report: &bare, ..row });
        assert!(error.unwrap_err().to_string().contains("inverted"));
        table.flush().unwrap();
        let text = fs::read_to_string(run.path().join("steps.csv")).unwrap();
        let [head, values] = text.lines().collect::<Vec<_>>()[..] else { panic!("{text}") };
        let before = match with_liquid {
            true => liquid_columns[..liquid_columns.len() - 3].join(","),
            false => "step,t,dt".to_owned(),
        };
        let [coupling_columns, coupling] = match with_liquid {
            true => [
                ",touching,condensed,force_x,force_y,force_z,correction_x,correction_y,correction_z,overlap_cells,overlap_depth",
                ",1,0,1.5,-2e-17,3e20,0.0,0.25,0.3333333333333333,7,0.125",
            ],
            false => ["", ""],
        };
        assert_eq!(
            head,
            format!("{before},{solid_columns}{coupling_columns},wave_cfl,dt_floored,seconds_total,seconds_solve")
        );
        let expected = format!(
            "5,2,3,17,3.25e-9,stagnated,321,0.3333333333333333,-2e-17,3e20,4.0,5.5,-6.0,7.5,8.5,-9.5,10.25,-0.125,12{coupling},0.125,0,0.5,0.5"
        );
        assert!(values.starts_with("4,0.75,0.25,") && values.ends_with(&expected), "{values}");
        assert_eq!(values.split(',').count(), head.split(',').count());
    }
}

#[test]
fn the_manifest_names_solids_and_their_meshes() {
    let run = tempfile::tempdir().unwrap();
    let case = Case::new();
    let manifest = case.manifest();
    assert!(manifest.solid_frames && !manifest.markers && !manifest.fields);
    let [left, right] = &manifest.solids[..] else { panic!("{:?}", manifest.solids) };
    assert_eq!((&*left.name, left.nodes, left.elements), ("left", 3 * 3 * 4, 6 * 12));
    assert!((left.volume - 0.012).abs() < 1e-15 && (left.mass - 12.0).abs() < 1e-12);
    assert_eq!((right.nodes, right.elements), (8, 6));
    assert_eq!((&right.file, &right.sha256), (&None, &None));
    manifest.write(run.path()).unwrap();
    assert_eq!(Manifest::read(run.path()).unwrap(), manifest);
}

fn pictures(run: &Path, colour: Colour) -> Vec<PathBuf> {
    let options = PreviewOptions { animation: false, colour, ..PreviewOptions::default() };
    preview(run, &options, &mut |_, _| true).unwrap().pictures
}

/// Whether two pixels differ clearly.
fn differ(a: [i32; 3], b: [i32; 3]) -> bool {
    (0..3).any(|channel| (a[channel] - b[channel]).abs() > 40)
}

#[test]
fn pictures_show_solids_where_they_are() {
    let run = tempfile::tempdir().unwrap();
    Case::new().run(run.path());
    let files = pictures(run.path(), Colour::Solid);
    let names: Vec<_> = files.iter().map(|file| file.file_name().unwrap()).collect();
    assert_eq!(names, ["blocks_000000.png", "blocks_000001.png"]);
    let [first, second] = [0, 1].map(|frame| Decoded::read(&files[frame]));
    // Between the lines of the mesh, seen from the front; what is further back is nearer to the middle.
    let [left, right, gone, air] = [(0.21, 0.13), (0.725, 0.18), (0.78, 0.18), (0.5, 0.4)].map(|(x, y)| pixel(x, y));
    assert!(differ(first.at(left), first.at(air)), "no left block");
    assert!(differ(first.at(right), first.at(air)), "no right block");
    assert!(differ(first.at(left), first.at(right)), "one colour for both bodies");
    assert!(differ(first.at(gone), second.at(gone)), "the right block has not moved");
    let moved = pixel(0.63, 0.18);
    assert!(differ(first.at(moved), second.at(moved)), "the right block is not where it moved to");
    assert_eq!(first.at(air), second.at(air));
}

/// A ball in a hollow ball: whole, nothing is seen of it; cut through the middle, both show what they are made of, and the space between
/// them is seen. From the other side, too.
#[test]
fn solids_are_cut_open() {
    let text = "[domain]\nsize = [1, 0.5, 0.5]\ncells = [16, 8, 8]\n[time]\nduration = 1\n\
        [[solid]]\nname = 'shell'\nmesh = { shell = { radius = 0.2, thickness = 0.08, cell_size = 0.05 } }\n\
        placement = { translate = [0.5, 0.25, 0.25] }\ndensity = 1000\nyoung = 1e6\npoisson = 0.25\n\
        [[solid]]\nname = 'core'\nmesh = { sphere = { radius = 0.06, cell_size = 0.03 } }\n\
        placement = { translate = [0.5, 0.25, 0.25] }\ndensity = 1000\nyoung = 1e6\npoisson = 0.25\n";
    let draw = |cut: Option<CameraCut>, from: f64| {
        let run = tempfile::tempdir().unwrap();
        let mut case = Case::of(text);
        case.scene.camera.eye.z = 0.25 + from;
        case.scene.camera.cut = cut;
        case.manifest().write(run.path()).unwrap();
        let manifest = Manifest::read(run.path()).unwrap();
        assert_eq!(manifest, case.manifest());
        case.write(&mut case.writer(run.path())).unwrap();
        Decoded::read(&pictures(run.path(), Colour::Solid)[0])
    };
    // On the plane through the middle, which is 2.5 m before the eye as the front wall is for `pixel`.
    let [core, gap, wall, air] = [0.5, 0.59, 0.66, 0.9].map(|x| pixel(x, 0.251));
    let middle = CameraCut { axis: 2, at: 0.25 };
    for from in [2.5, -2.5] {
        let whole = draw(None, from);
        let cut = draw(Some(middle), from);
        assert!(!differ(whole.at(core), whole.at(wall)), "{from}: the shell hides what is in it");
        assert!(differ(cut.at(core), cut.at(wall)), "{from}: the ball in the shell is not seen");
        assert!(differ(cut.at(gap), cut.at(core)), "{from}: the space in the shell is not seen");
        assert!(differ(cut.at(wall), cut.at(air)), "{from}: the shell is hollow where it is cut");
        // Beyond what there is, it takes nothing; before it, everything.
        let far = |at: f64| draw(Some(CameraCut { axis: 2, at }), from);
        let [beyond, before] = if from > 0.0 { [0.49, 0.01] } else { [0.01, 0.49] }.map(far);
        assert_eq!(beyond.at(core), whole.at(core), "{from}");
        assert!(differ(before.at(core), whole.at(core)), "{from}");
    }
}

#[test]
fn colours_tell_stress_and_volume() {
    let run = tempfile::tempdir().unwrap();
    Case::new().run(run.path());
    let [left, right] = [(0.21, 0.13), (0.725, 0.18)].map(|(x, y)| pixel(x, y));
    for colour in [Colour::Stress, Colour::DetF] {
        let files = pictures(run.path(), colour);
        let [first, second] = [0, 1].map(|frame| Decoded::read(&files[frame]));
        assert!(differ(first.at(left), second.at(left)), "{colour:?}: no colour of stretch");
        // Nothing is stretched at first, so both bodies look alike but for the light.
        assert!(!differ(first.at(left), first.at(right)), "{colour:?}: colours of bodies");
        // The legend: its bar in the upper right corner has the largest value's colour above and the least one's below.
        let [x, above, below] = [first.size[0] - 12, 44, first.size[1] * 2 / 5 + 36];
        let bar = [above, below].map(|y| first.at([x, y]));
        assert!(differ(bar[0], bar[1]), "{colour:?}: no legend: {bar:?}");
        let yellow = |[red, green, blue]: [i32; 3]| red > 200 && green > 200 && blue < 80;
        assert_eq!(yellow(bar[0]), colour == Colour::Stress, "{bar:?}");
    }
}

#[test]
fn an_inverted_element_stands_out() {
    let run = tempfile::tempdir().unwrap();
    let mut case = Case::new();
    case.manifest().write(run.path()).unwrap();
    case.displace(0, |x| -2.0 * (x.z - 0.3) * DVec3::Z);
    case.write(&mut case.writer(run.path())).unwrap();
    let files = pictures(run.path(), Colour::DetF);
    let [red, green, blue] = Decoded::read(&files[0]).at(pixel(0.21, 0.13));
    assert!(red > 2 * green && blue > 2 * green, "{red} {green} {blue}");
}

#[test]
fn preview_of_solids_says_what_is_missing() {
    let run = tempfile::tempdir().unwrap();
    let mut case = Case::new();
    let tell = |colour: Colour| {
        let options = PreviewOptions { colour, ..PreviewOptions::default() };
        let error = preview(run.path(), &options, &mut |_, _| true).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    };
    case.manifest().write(run.path()).unwrap();
    assert!(tell(Colour::Solid).contains("blocks_000000.vtu"));
    case.scene.output.solids = false;
    case.manifest().write(run.path()).unwrap();
    assert!(tell(Colour::Solid).contains("output.solids"));
    assert!(tell(Colour::Stress).contains("output.solids"));
    case.scene.output.solids = true;
    case.run(run.path());
    let broken = run.path().join("frames/blocks_000001.vtu");
    let whole = fs::read_to_string(&broken).unwrap();
    fs::write(&broken, whole.replace("von_mises", "stress")).unwrap();
    let error = tell(Colour::Stress);
    assert!(error.contains("blocks_000001.vtu") && error.contains("no von_mises"), "{error}");
    fs::write(&broken, &whole[..whole.len() / 2]).unwrap();
    assert!(tell(Colour::Solid).contains("blocks_000001.vtu"));
}

#[test]
fn options_of_pictures_need_no_new_run() {
    let run = tempfile::tempdir().unwrap();
    Case::new().run(run.path());
    let draw = |options: &PreviewOptions| preview(run.path(), options, &mut |_, _| true);
    let small = PreviewOptions { size: Some([160, 90]), gif: true, ..PreviewOptions::default() };
    let report = draw(&small).unwrap();
    let scene = fs::read(&report.pictures[0]).unwrap();
    // Two frames at 24 a second: 4.17 hundredths of a second each, 8 together.
    let file = File::open(report.gif.unwrap()).unwrap();
    let mut gif = gif::DecodeOptions::new().read_info(file).unwrap();
    assert_eq!([gif.width(), gif.height()], [160, 90]);
    let mut delays = Vec::new();
    while let Some(frame) = gif.read_next_frame().unwrap() {
        delays.push(frame.delay);
    }
    assert_eq!(delays, [4, 4]);
    // From behind: the view changes, and only with options.
    let behind = PreviewOptions { eye: Some(DVec3::new(0.5, 0.25, -2.0)), ..small };
    let pictures = draw(&behind).unwrap().pictures;
    assert_ne!(fs::read(&pictures[0]).unwrap(), scene);
    let pictures = draw(&small).unwrap().pictures;
    assert_eq!(fs::read(&pictures[0]).unwrap(), scene);
    let target = DVec3::new(0.5, 0.25, 0.25);
    for (options, expected) in [
        (PreviewOptions { eye: Some(target), target: Some(target), ..small }, "the target itself"),
        (PreviewOptions { eye: Some(target + DVec3::Y), target: Some(target), ..small }, "looks along"),
        (PreviewOptions { up: Some(DVec3::ZERO), ..small }, "no direction"),
        (PreviewOptions { fov: Some(f64::NAN), ..small }, "field of view"),
        (PreviewOptions { eye: Some(DVec3::INFINITY), ..small }, "not finite"),
        (PreviewOptions { size: Some([8, 8]), ..small }, "8 x 8 pixels"),
        (PreviewOptions { cut: Some(CameraCut { axis: 2, at: 0.5 }), ..small }, "outside the domain"),
    ] {
        let error = draw(&options).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(expected), "{error}");
    }
}
