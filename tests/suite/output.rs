//! Files are read back by readers that share no code with the writers: fieldcompare and trimesh (Python) for VTK and PLY files, the csv and
//! png crates for tables and pictures.
//!
//! `CUTWATER_PYTHON` names the interpreter (default `python3`), `REQUIRE_READERS=1` makes a missing reader a failure;
//! `pip install -r tests/readers/requirements.txt` installs it.

use std::cell::RefCell;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

use cutwater::Error;
use cutwater::elastic::Solids;
use cutwater::geometry::{CutCells, Surface};
use cutwater::grid::{Axis, Grid, Sides};
use cutwater::output::frames::{FrameKinds, FrameWriter};
use cutwater::output::manifest::{AdapterRecord, Manifest, RunOptions, RunStatus};
use cutwater::output::preview::{PreviewOptions, preview};
use cutwater::output::tables::{ProbeTable, StepRow, StepTable};
use cutwater::scene::{self, Probe, ProbeKind, Scene, Up};
use cutwater::state::{Diagnosis, LiquidReport, SolveReport, SolveStatus, State, StepReport};
use glam::DVec3;
use serde_json::Value;

const BOTH: FrameKinds =
    FrameKinds { markers: true, fields: true, solids: false, moving_obstacles: false, surface: None };

/// The interpreter with the reader, or `None` after saying why.
pub(crate) fn python() -> Option<PathBuf> {
    python_with("fieldcompare")
}

/// The interpreter with a package.
pub(crate) fn python_with(package: &str) -> Option<PathBuf> {
    let python = std::env::var_os("CUTWATER_PYTHON").map_or_else(|| "python3".into(), PathBuf::from);
    let found = Command::new(&python).args(["-c", &format!("import {package}")]).output();
    let problem = match found {
        Ok(output) if output.status.success() => return Some(python),
        Ok(output) => String::from_utf8_lossy(&output.stderr).into_owned(),
        Err(error) => error.to_string(),
    };
    let required = std::env::var("REQUIRE_READERS").is_ok_and(|value| value == "1");
    assert!(!required, "REQUIRE_READERS=1 and {} cannot import {package}: {problem}", python.display());
    eprintln!("skipped for want of {package} in {}: {problem}", python.display());
    None
}

/// The independent reader, a process that answers each path with a line.
struct Reader(Child, BufReader<ChildStdout>);

impl Drop for Reader {
    fn drop(&mut self) {
        // Its input ends, so it does.
        self.0.stdin.take();
        let _ = self.0.wait();
    }
}

thread_local! {
    /// Starting one takes longer than reading a file, so a test starts one.
    static READER: RefCell<Option<Reader>> = const { RefCell::new(None) };
}

/// What the independent reader finds in a file.
pub(crate) fn read(python: &Path, file: &Path) -> Value {
    let start = || {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers/read_frames.py");
        let mut child = Command::new(python).arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let answers = BufReader::new(child.stdout.take().unwrap());
        Reader(child, answers)
    };
    READER.with_borrow_mut(|reader| {
        let Reader(child, answers) = reader.get_or_insert_with(start);
        writeln!(child.stdin.as_mut().unwrap(), "{}", file.display()).unwrap();
        let mut answer = String::new();
        answers.read_line(&mut answer).unwrap();
        assert!(!answer.is_empty(), "{} cannot be read", file.display());
        serde_json::from_str(&answer).unwrap()
    })
}

/// All numbers of a nested JSON list, in order, as f32.
pub(crate) fn flat(value: &Value) -> Vec<f32> {
    match value {
        Value::Array(items) => items.iter().flat_map(flat).collect(),
        number => vec![number.as_f64().unwrap() as f32],
    }
}

pub(crate) fn f32s(values: impl IntoIterator<Item = f64>) -> Vec<f32> {
    values.into_iter().map(|value| value as f32).collect()
}

/// A grid with three different extents, no array of which fills whole blocks, and a state with a different number everywhere.
fn synthetic() -> (Grid, State, CutCells) {
    let grid = Grid { cells: [4, 5, 6], dx: 0.1 };
    let mut state = State::at_rest(&grid);
    state.time = 1.0 / 24.0;
    state.frame = 1;
    state.step = 7;
    let wild = |seed: usize| move |i: usize| (1.0 + i as f64 / 7.0 + seed as f64).sin() * 10f64.powi(i as i32 % 9 - 4);
    for axis in Axis::ALL {
        state.velocity[axis.index()] = (0..grid.n_faces(axis)).map(wild(axis.index())).collect();
    }
    state.pressure = (0..grid.n_cells()).map(wild(3)).map(|p| 1e3 * p).collect();
    state.liquid_distance = (0..grid.n_cells()).map(wild(4)).collect();
    state.active = (0..grid.n_cells()).map(|cell| cell % 3 == 0).collect();
    state.markers =
        (0..50).map(|m| [0.4, 0.5, 0.6].map(|size| size * (0.5 + 0.5 * f64::sin(1.7 * f64::from(m) + size)))).collect();
    let cut = CutCells {
        open: Axis::ALL.map(|axis| vec![1.0; grid.n_faces(axis)]),
        solid_distance: (0..grid.n_cells()).map(wild(5)).collect(),
    };
    (grid, state, cut)
}

#[test]
fn frames_read_back_exactly() {
    let Some(python) = python() else { return };
    let run = tempfile::tempdir().unwrap();
    let (grid, mut state, cut) = synthetic();
    let mut writer = FrameWriter::create(run.path(), "a&b", grid, BOTH).unwrap();
    writer.write(&state, &cut, &Solids::default()).unwrap();

    let frames = run.path().join("frames");
    let markers = read(&python, &frames.join("a&b_000001.vtp"));
    assert_eq!(markers["dtype"], "float32");
    assert_eq!(flat(&markers["coordinates"]), f32s(state.markers.iter().flatten().copied()));
    let each_a_vertex: Vec<f32> = (0..state.markers.len()).map(|marker| marker as f32).collect();
    assert_eq!(flat(&markers["connectivity"]["POLY_VERTEX"]), each_a_vertex);
    // Inside the domain, linear interpolation in each direction is the sum over the eight nearest faces of its weights.
    let velocity = |x: [f64; 3]| Axis::ALL.map(|axis| interpolate(&grid, axis, &state.velocity[axis.index()], x));
    let found = &markers["points"]["velocity"];
    assert_eq!(found["dtype"], "float32");
    assert_eq!(found["values"][0].as_array().unwrap().len(), 3);
    for (written, expected) in flat(&found["values"]).iter().zip(state.markers.iter().flat_map(|&x| velocity(x))) {
        // Two orders of f64 summation may round to neighbouring f32.
        assert!((f64::from(*written) - expected).abs() <= 1.2e-7 * expected.abs(), "{written} is not {expected}");
    }
    let speeds = flat(&markers["points"]["speed"]["values"]);
    assert_eq!(speeds.len(), state.markers.len());
    for (speed, u) in speeds.iter().zip(flat(&found["values"]).chunks_exact(3)) {
        let expected = u.iter().map(|&u| f64::from(u).powi(2)).sum::<f64>().sqrt();
        assert!((f64::from(*speed) - expected).abs() <= 2.4e-7 * expected, "{speed} is not {expected}");
    }

    let fields = read(&python, &frames.join("a&b_000001.vti"));
    assert_eq!(flat(&fields["origin"]), [0.0; 3]);
    assert_eq!(flat(&fields["spacing"]), [0.1; 3]);
    assert_eq!(flat(&fields["extents"]), [4.0, 5.0, 6.0]);
    let cell_data = |name: &str| flat(&fields["cells"][name]["values"]);
    assert_eq!(cell_data("pressure"), f32s(state.pressure.iter().copied()));
    assert_eq!(cell_data("liquid_distance"), f32s(state.liquid_distance.iter().copied()));
    assert_eq!(cell_data("solid_distance"), f32s(cut.solid_distance.iter().copied()));
    assert_eq!(fields["cells"]["active"]["dtype"], "uint8");
    assert_eq!(cell_data("active"), f32s(state.active.iter().map(|&active| f64::from(active))));
    let mut centres = Vec::new();
    for k in 0..6 {
        for j in 0..5 {
            for i in 0..4 {
                let [u, v, w] = &state.velocity;
                centres.push(0.5 * (u[i + 5 * (j + 5 * k)] + u[i + 1 + 5 * (j + 5 * k)]));
                centres.push(0.5 * (v[i + 4 * (j + 6 * k)] + v[i + 4 * (j + 1 + 6 * k)]));
                centres.push(0.5 * (w[i + 4 * (j + 5 * k)] + w[i + 4 * (j + 5 * (k + 1))]));
            }
        }
    }
    assert_eq!(cell_data("velocity"), f32s(centres));

    state.frame = 2;
    state.time = 2.0 / 24.0;
    state.pressure[0] = -4.0;
    writer.write(&state, &cut, &Solids::default()).unwrap();
    let series = read(&python, &frames.join("a&b_fields.pvd"));
    assert_eq!(series["times"][0].as_f64(), Some(1.0 / 24.0));
    assert_eq!(series["times"][1].as_f64(), Some(2.0 / 24.0));
    assert_eq!(series["frames"].as_array().unwrap().len(), 2);
    assert_eq!(flat(&series["frames"][1]["cells"]["pressure"]["values"])[0], -4.0);
    let series = read(&python, &frames.join("a&b_markers.pvd"));
    assert_eq!(series["frames"].as_array().unwrap().len(), 2);
    assert_eq!(flat(&series["frames"][0]["points"]["speed"]["values"]), speeds);

    let mut left: Vec<String> =
        frames.read_dir().unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    left.sort();
    let expected =
        ["a&b_000001.vti", "a&b_000001.vtp", "a&b_000002.vti", "a&b_000002.vtp", "a&b_fields.pvd", "a&b_markers.pvd"];
    assert_eq!(left, expected, "nothing but the final names may be left");
}

/// Trilinear interpolation as a sum over faces of hat functions, clamped to the outermost faces.
fn interpolate(grid: &Grid, axis: Axis, faces: &[f64], x: [f64; 3]) -> f64 {
    let n = grid.faces(axis);
    (0..faces.len())
        .map(|face| {
            let ijk = grid.face_at(axis, face);
            let centre = grid.face_centre(axis, ijk);
            let weight: f64 = (0..3)
                .map(|a| {
                    let low = grid.face_centre(axis, [0; 3])[a];
                    let x = x[a].clamp(low, low + (n[a] - 1) as f64 * grid.dx);
                    (1.0 - ((x - centre[a]) / grid.dx).abs()).max(0.0)
                })
                .product();
            weight * faces[face]
        })
        .sum()
}

/// vtkio's compressed arrays break where the bytes of an array are a multiple of 32768; ours must not.
#[test]
fn whole_blocks_read_back() {
    let Some(python) = python() else { return };
    let run = tempfile::tempdir().unwrap();
    let grid = Grid { cells: [32; 3], dx: 1.0 / 32.0 };
    let mut state = State::at_rest(&grid);
    state.pressure = (0..grid.n_cells()).map(|cell| cell as f64).collect();
    let cut = CutCells {
        open: Axis::ALL.map(|axis| vec![1.0; grid.n_faces(axis)]),
        solid_distance: vec![3.0 * grid.dx; grid.n_cells()],
    };
    let kinds = FrameKinds { fields: true, ..FrameKinds::default() };
    FrameWriter::create(run.path(), "cube", grid, kinds).unwrap().write(&state, &cut, &Solids::default()).unwrap();
    let fields = read(&python, &run.path().join("frames/cube_000000.vti"));
    assert_eq!(flat(&fields["cells"]["pressure"]["values"]), f32s(state.pressure));
    assert_eq!(flat(&fields["cells"]["active"]["values"]), vec![0.0; grid.n_cells()]);
}

#[test]
fn no_markers_read_back() {
    let Some(python) = python() else { return };
    let run = tempfile::tempdir().unwrap();
    let (grid, mut state, cut) = synthetic();
    state.markers.clear();
    let kinds = FrameKinds { markers: true, ..FrameKinds::default() };
    FrameWriter::create(run.path(), "dry", grid, kinds).unwrap().write(&state, &cut, &Solids::default()).unwrap();
    let markers = read(&python, &run.path().join("frames/dry_000001.vtp"));
    assert_eq!(flat(&markers["coordinates"]), [0.0_f32; 0]);
    assert_eq!(flat(&markers["points"]["speed"]["values"]), [0.0_f32; 0]);
}

#[test]
fn obstacles_read_back() {
    let Some(python) = python() else { return };
    let run = tempfile::tempdir().unwrap();
    let writer = FrameWriter::create(run.path(), "two", Grid { cells: [4; 3], dx: 0.25 }, BOTH).unwrap();
    let tetrahedron = Surface {
        vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    };
    let triangle = Surface {
        vertices: vec![DVec3::new(0.1, 0.2, 0.3), DVec3::new(0.4, 0.5, 0.6), DVec3::splat(0.7)],
        triangles: vec![[2, 1, 0]],
    };
    writer.write_obstacles(&[tetrahedron.clone(), triangle.clone()]).unwrap();
    let found = read(&python, &run.path().join("frames/two_obstacles.vtp"));
    let points = tetrahedron.vertices.iter().chain(&triangle.vertices).flat_map(|x| x.to_array());
    assert_eq!(flat(&found["coordinates"]), f32s(points));
    let corners = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3, 6, 5, 4].map(f64::from);
    assert_eq!(flat(&found["connectivity"]["POLYGON"]), f32s(corners));
    assert_eq!(flat(&found["cells"]["obstacle"]["values"]), [0.0, 0.0, 0.0, 0.0, 1.0]);
}

/// NaN, infinity and what overflows f32 are refused with the name of the field and of the place, and leave no file.
#[test]
fn a_number_that_is_not_finite_is_refused() {
    type Spoil = fn(&mut State, &mut CutCells, f64);
    let cases: [(&str, Spoil); 5] = [
        ("pressure of cell (1, 2, 3)", |state, _, bad| state.pressure[1 + 4 * (2 + 5 * 3)] = bad),
        ("liquid_distance of cell (3, 4, 5)", |state, _, bad| state.liquid_distance[119] = bad),
        ("solid_distance of cell (0, 0, 0)", |_, cut, bad| cut.solid_distance[0] = bad),
        ("velocity of cell (1, 0, 0)", |state, _, bad| {
            state.markers.clear();
            state.velocity[0][2] = bad;
        }),
        ("position of marker 17", |state, _, bad| state.markers[17][1] = bad),
    ];
    for (place, spoil) in cases {
        for bad in [f64::NAN, f64::INFINITY, -1e39] {
            let run = tempfile::tempdir().unwrap();
            let (grid, mut state, mut cut) = synthetic();
            spoil(&mut state, &mut cut, bad);
            let error = FrameWriter::create(run.path(), "bad", grid, BOTH)
                .unwrap()
                .write(&state, &cut, &Solids::default())
                .unwrap_err();
            assert!(matches!(error, Error::Stage { step: 7, .. }), "{error:?}");
            assert!(error.to_string().contains(place), "{error} does not name {place}");
            assert_eq!(run.path().join("frames").read_dir().unwrap().count(), 0, "no file after {error}");
        }
    }
}

/// Where the final name cannot be taken, the error names it and no part is left behind.
#[test]
fn a_failed_write_leaves_nothing() {
    let run = tempfile::tempdir().unwrap();
    let (grid, state, cut) = synthetic();
    let mut writer = FrameWriter::create(run.path(), "blocked", grid, BOTH).unwrap();
    let frames = run.path().join("frames");
    std::fs::create_dir(frames.join("blocked_000001.vtp")).unwrap();
    let error = writer.write(&state, &cut, &Solids::default()).unwrap_err();
    assert!(error.to_string().contains("blocked_000001.vtp"), "{error}");
    assert_eq!(frames.read_dir().unwrap().count(), 1, "only the folder in the way");
}

pub(crate) fn report(step: u32) -> StepReport {
    let x = f64::from(step);
    StepReport {
        dt: 1e-3 / 3.0 + 1e-9 * x,
        wave_cfl: 0.1 / 3.0 + x,
        dt_floored: step == 1,
        liquid: Some(LiquidReport {
            solve: SolveReport {
                unknowns: 12_345,
                iterations: 17,
                residual: 3.3e-9,
                status: if step == 2 { SolveStatus::IterationLimit } else { SolveStatus::Converged },
            },
            closed_components: 1,
            diagnosis: Diagnosis {
                volume: 0.1 + x,
                momentum: [1.0 / 3.0, -2e-17, 3e20],
                kinetic_energy: 5.5,
                potential_energy: -6.5,
                max_speed: 7.25,
                divergence: 1e-11,
            },
            markers: 4000,
            dropped: 2,
            exchange: None,
            separation: None,
        }),
        solid: None,
        coupling: None,
        seconds: vec![("advect_markers", 0.25), ("solve", 0.5 + x)],
        seconds_total: 1.0 + x,
    }
}

#[test]
fn tables_read_back_exactly() {
    let run = tempfile::tempdir().unwrap();
    let mut steps = StepTable::create(run.path()).unwrap();
    for step in 0..3 {
        let report = report(step);
        let row =
            StepRow { step: step.into(), time: f64::from(step + 1) / 3.0, report: &report, volume_ratio: Some(0.999) };
        steps.push(&row).unwrap();
    }
    steps.flush().unwrap();
    let mut reader = csv::Reader::from_path(run.path().join("steps.csv")).unwrap();
    let head: Vec<String> = reader.headers().unwrap().iter().map(str::to_owned).collect();
    // What scripts of users read: not a name may change.
    let expected = "step,t,dt,iterations,residual_p,status,unknowns,divergence,volume,volume_ratio,momentum_x,momentum_y,\
                    momentum_z,kinetic_energy,potential_energy,max_speed,markers,markers_dropped,closed_components,wave_cfl,dt_floored,\
                    seconds_total,seconds_advect_markers,seconds_solve";
    assert_eq!(head.join(","), expected);
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 3);
    for (step, row) in (0..3).zip(&rows) {
        let value = |column: &str| &row[head.iter().position(|name| name == column).unwrap()];
        let number = |column: &str| value(column).parse::<f64>().unwrap();
        let StepReport { dt, dt_floored, wave_cfl, liquid, solid: _, coupling: _, seconds, seconds_total } =
            report(step);
        let LiquidReport { solve, closed_components, diagnosis, markers, dropped, exchange: _, separation: _ } =
            liquid.unwrap();
        assert_eq!(number("step"), f64::from(step));
        assert_eq!(number("t"), f64::from(step + 1) / 3.0);
        assert_eq!(number("dt"), dt);
        assert_eq!(number("iterations"), f64::from(solve.iterations));
        assert_eq!(number("residual_p"), solve.residual);
        assert_eq!(value("status"), if step == 2 { "iteration_limit" } else { "converged" });
        assert_eq!(number("unknowns"), solve.unknowns as f64);
        assert_eq!(number("divergence"), diagnosis.divergence);
        assert_eq!(number("volume"), diagnosis.volume);
        assert_eq!(number("volume_ratio"), 0.999);
        assert_eq!(["momentum_x", "momentum_y", "momentum_z"].map(number), diagnosis.momentum);
        assert_eq!(number("kinetic_energy"), diagnosis.kinetic_energy);
        assert_eq!(number("potential_energy"), diagnosis.potential_energy);
        assert_eq!(number("max_speed"), diagnosis.max_speed);
        assert_eq!(number("markers"), markers as f64);
        assert_eq!(number("markers_dropped"), dropped as f64);
        assert_eq!(number("closed_components"), closed_components as f64);
        assert_eq!(number("wave_cfl"), wave_cfl);
        assert_eq!(number("dt_floored"), f64::from(u8::from(dt_floored)));
        assert_eq!(number("seconds_total"), seconds_total);
        assert_eq!(number("seconds_solve"), seconds[1].1);
    }

    let probe = |name: &str, kind| Probe { name: name.into(), kind };
    let point = DVec3::ZERO;
    let probes = [
        probe("h, left", ProbeKind::Height { foot: point, up: Up::against(point) }),
        probe("jet", ProbeKind::Velocity { point }),
        probe("front", ProbeKind::Front { axis: 0, lower: false }),
    ];
    let mut table = ProbeTable::create(run.path(), &probes).unwrap();
    table.push(7, 0.1, &[1.0, 2.0, -3.0, 4e-12, 5.0]).unwrap();
    table.flush().unwrap();
    let mut reader = csv::Reader::from_path(run.path().join("probes.csv")).unwrap();
    assert_eq!(reader.headers().unwrap(), vec!["step", "t", "h, left", "jet_x", "jet_y", "jet_z", "front"]);
    let row: Vec<f64> = reader.records().next().unwrap().unwrap().iter().map(|x| x.parse().unwrap()).collect();
    assert_eq!(row, [7.0, 0.1, 1.0, 2.0, -3.0, 4e-12, 5.0]);
}

/// A run may go on on an adapter that times other stages, or none: each time stays in its column, and each row has all columns.
#[test]
fn a_table_goes_on_with_other_stages() {
    type Stages = [(&'static str, f64)];
    let all: &Stages = &[("advect_markers", 0.25), ("solve", 0.5)];
    let other: &Stages = &[("solve", 1.5), ("clip", 2.5)];
    let parts: [(&Stages, &Stages, &str, &str); 4] = [
        (all, &[], "seconds_advect_markers,seconds_solve", ",0.25,0.5|,,"),
        (all, other, "seconds_advect_markers,seconds_solve", ",0.25,0.5|,,1.5"),
        (other, all, "seconds_solve,seconds_clip", ",1.5,2.5|,0.5,"),
        (&[], all, "", "|"),
    ];
    for (first, second, columns, expected) in parts {
        let run = tempfile::tempdir().unwrap();
        let mut bytes = None;
        for (step, stages) in (0..).zip([first, second]) {
            let mut table = match bytes {
                None => StepTable::create(run.path()),
                Some(bytes) => StepTable::resume(run.path(), bytes),
            }
            .unwrap();
            let report = StepReport { seconds: stages.to_vec(), ..report(step) };
            let row = StepRow { step: step.into(), time: f64::from(step), report: &report, volume_ratio: Some(1.0) };
            table.push(&row).unwrap();
            bytes = Some(table.bytes(false).unwrap());
        }
        let text = std::fs::read_to_string(run.path().join("steps.csv")).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let after = |line: &str, total: &str| {
            let (_, stages) = line.rsplit_once(total).unwrap();
            stages.to_owned()
        };
        let head = after(lines[0], ",seconds_total");
        assert_eq!(head.trim_start_matches(','), columns);
        // In the order of the rows, whose seconds_total is 1.0 and 2.0.
        let rows = [after(lines[1], ",0,1.0"), after(lines[2], ",1,2.0")];
        assert_eq!(rows.join("|"), expected, "{text}");
    }
}

#[test]
fn tables_refuse_what_is_not_finite() {
    let run = tempfile::tempdir().unwrap();
    let mut steps = StepTable::create(run.path()).unwrap();
    let mut report = report(0);
    let push = |steps: &mut StepTable, report: &StepReport| {
        steps.push(&StepRow { step: 3, time: 0.0, report, volume_ratio: Some(1.0) })
    };
    push(&mut steps, &report).unwrap();
    report.liquid.as_mut().unwrap().diagnosis.kinetic_energy = f64::NAN;
    let error = push(&mut steps, &report).unwrap_err();
    assert!(matches!(error, Error::Stage { step: 3, .. }) && error.to_string().contains("kinetic_energy"), "{error}");
    let probes = [Probe { name: "p1".into(), kind: ProbeKind::Pressure { point: DVec3::ZERO } }];
    let error = ProbeTable::create(run.path(), &probes).unwrap().push(9, 0.0, &[f64::INFINITY]).unwrap_err();
    assert!(matches!(error, Error::Stage { step: 9, .. }) && error.to_string().contains("p1"), "{error}");
}

fn scene() -> Scene {
    Scene {
        name: "dam".into(),
        file: "/somewhere/private/dam.toml".into(),
        origins: scene::Origins::default(),
        hash: "0123abcd".into(),
        values: [("time.duration".into(), "2".into())].into(),
        meshes: [].into(),
        removed: Vec::new(),
        scale: 0.5,
        overrides: vec!["time.duration=2".into()],
        domain: scene::Domain {
            size: DVec3::new(1.0, 0.5, 0.5),
            cells: [16, 8, 8],
            gravity: -9.81 * DVec3::Y,
            gravity_keyframes: Vec::new(),
            open: Sides::default(),
            symmetry: Sides::default(),
            slab: None,
            friction: 0.0,
        },
        time: scene::Time { duration: 2.0, frames_per_second: 24.0, cfl: 3.0, fixed_step: None, max_step: None },
        liquid: Some(scene::Liquid {
            density: 1000.0,
            regions: Vec::new(),
            surface: scene::Surface::Markers,
            marker_radius: 0.87,
            seed: 0,
            volume_control: true,
            separation: scene::Separation::None,
        }),
        solids: Vec::new(),
        obstacles: Vec::new(),
        sources: Vec::new(),
        sinks: Vec::new(),
        probes: Vec::new(),
        solver: scene::Solver::default(),
        output: scene::Output {
            particles: true,
            solids: false,
            fields: false,
            surface: false,
            every: 1,
            checkpoint_every: 10,
        },
        surface: scene::SurfaceMesh::default(),
        camera: scene::Camera {
            eye: DVec3::new(1.5, 1.0, 2.0),
            target: DVec3::new(0.5, 0.2, 0.25),
            up: DVec3::Y,
            fov: 35.0,
            size: [320, 180],
            keyframes: Vec::new(),
            cut: None,
        },
    }
}

fn manifest(scene: &Scene) -> Manifest {
    let options =
        RunOptions { backend: "gpu".into(), frames: 48, scale: scene.scale, overrides: scene.overrides.clone() };
    let adapter = AdapterRecord {
        name: "a card".into(),
        driver: "a driver 1.2".into(),
        backend: "vulkan".into(),
        software: true,
        limits: [("max_storage_buffer_binding_size".to_owned(), 1u64 << 40)].into(),
    };
    Manifest::new(scene, options, Some(adapter))
}

#[test]
fn manifest_reads_back() {
    let run = tempfile::tempdir().unwrap();
    let scene = scene();
    let mut manifest = manifest(&scene);
    manifest.write(run.path()).unwrap();
    let text = std::fs::read_to_string(run.path().join("manifest.json")).unwrap();
    assert!(!text.contains("private"), "the scene's folder must not be in {text}");
    let json = crate::common::json(&text);
    assert_eq!(json["scene"]["file"], "dam.toml");
    assert_eq!(json["scene"]["sha256"], "0123abcd");
    assert_eq!(json["cutwater"], env!("CARGO_PKG_VERSION"));
    assert_eq!(json["adapter"]["limits"]["max_storage_buffer_binding_size"], 1u64 << 40);
    assert_eq!(json["progress"]["status"], "running");
    assert_eq!(json["marker_radius"].as_f64(), Some(0.87 / 16.0));
    assert!(!text.contains("solid"), "nothing of solids in {text}");
    manifest.progress.status = RunStatus::Finished;
    manifest.progress.frames_written = vec![0, 1, 2];
    manifest.write(run.path()).unwrap();
    assert_eq!(Manifest::read(run.path()).unwrap(), manifest);
    assert_eq!(run.path().read_dir().unwrap().count(), 1, "no temporary file is left");
    let error = Manifest::read(&run.path().join("elsewhere")).unwrap_err();
    assert_eq!(error.exit_code(), 2, "{error}");
}

/// A camera that looks along -z at a domain of 1 x 0.5 x 0.5 m from 2.5 m before its front wall, 20 degrees high.
pub(crate) fn front_camera() -> scene::Camera {
    scene::Camera {
        eye: DVec3::new(0.5, 0.25, 3.0),
        target: DVec3::new(0.5, 0.25, 0.0),
        up: DVec3::Y,
        fov: 20.0,
        size: [320, 180],
        keyframes: Vec::new(),
        cut: None,
    }
}

/// The pixel of a point on the front wall for [`front_camera`].
pub(crate) fn pixel(x: f64, y: f64) -> [usize; 2] {
    let unit = 90.0 / (10f64.to_radians().tan() * 2.5);
    [(160.0 + (x - 0.5) * unit) as usize, (90.0 - (y - 0.25) * unit) as usize]
}

pub(crate) struct Decoded {
    pub(crate) size: [usize; 2],
    rgb: Vec<u8>,
}

impl Decoded {
    pub(crate) fn read(path: &Path) -> Decoded {
        let file = BufReader::new(std::fs::File::open(path).unwrap());
        let mut reader = png::Decoder::new(file).read_info().unwrap();
        let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut rgb).unwrap();
        assert_eq!(info.color_type, png::ColorType::Rgb);
        Decoded { size: [info.width as usize, info.height as usize], rgb }
    }

    pub(crate) fn at(&self, [x, y]: [usize; 2]) -> [i32; 3] {
        let start = 3 * (x + self.size[0] * y);
        [0, 1, 2].map(|channel| i32::from(self.rgb[start + channel]))
    }
}

/// Writes a run of three frames: liquid on the left, the same further right with a drop, none.
fn write_run(run: &Path, scene: &Scene, obstacles: &[Surface]) {
    let grid = scene.grid();
    let kinds = FrameKinds::of(scene);
    let mut manifest = manifest(scene);
    manifest.obstacles = !obstacles.is_empty();
    manifest.write(run).unwrap();
    let mut writer = FrameWriter::create(run, &scene.name, grid, kinds).unwrap();
    writer.write_obstacles(obstacles).unwrap();
    let cut = CutCells {
        open: Axis::ALL.map(|axis| vec![1.0; grid.n_faces(axis)]),
        solid_distance: vec![3.0 * grid.dx; grid.n_cells()],
    };
    for frame in 0..3 {
        let mut state = State::at_rest(&grid);
        state.frame = frame;
        state.time = frame as f64 / 24.0;
        let wet = |x: DVec3| {
            let front = 0.35 + 0.1 * frame as f64;
            (x.x < front && x.y < 0.3) || (frame == 1 && x.distance(DVec3::new(0.8, 0.35, 0.25)) < 0.08)
        };
        let h = 0.5 * grid.dx;
        let [nx, ny, nz] = grid.cells.map(|n| 2 * n);
        for cell in (0..nx * ny * nz).filter(|_| frame < 2) {
            let x = DVec3::new((cell % nx) as f64, (cell / nx % ny) as f64, (cell / (nx * ny)) as f64);
            let x = (x + 0.5) * h;
            if wet(x) {
                state.markers.push(x.to_array());
            }
        }
        for cell in 0..grid.n_cells() {
            let inside = frame < 2 && wet(grid.cell_centre(grid.cell_at(cell)));
            state.liquid_distance[cell] = if inside { -grid.dx } else { grid.dx };
        }
        if scene.liquid.as_ref().unwrap().separation != scene::Separation::None {
            let separates = |cell| grid.cell_centre(grid.cell_at(cell)).abs_diff_eq(SEPARATED, 0.1 * grid.dx);
            state.separated = (0..grid.n_cells()).map(separates).collect();
        }
        writer.write(&state, &cut, &Solids::default()).unwrap();
    }
}

/// Centre of the only separated cell, m.
const SEPARATED: DVec3 = DVec3::new(0.53125, 0.40625, 0.46875);

#[test]
fn pictures_show_separated_cells() {
    let mut scene = scene();
    scene.camera = front_camera();
    let liquid = scene.liquid.as_mut().unwrap();
    (liquid.surface, liquid.separation) = (scene::Surface::Fixed, scene::Separation::Walls);
    let run = tempfile::tempdir().unwrap();
    write_run(run.path(), &scene, &[]);
    let [plain, shown] = [false, true].map(|separated| {
        let options = PreviewOptions { separated, animation: false, ..PreviewOptions::default() };
        Decoded::read(&preview(run.path(), &options, &mut |_, _| true).unwrap().pictures[0])
    });
    let at = pixel(SEPARATED.x, SEPARATED.y);
    let [red, green, blue] = shown.at(at);
    assert!(red > green + 60 && red > blue + 60, "{:?}", shown.at(at));
    let [red, green, _] = plain.at(at);
    assert!(red < green + 60, "{:?}", plain.at(at));
    // A run without separation does not say what cells are separated.
    scene.liquid.as_mut().unwrap().separation = scene::Separation::None;
    let run = tempfile::tempdir().unwrap();
    write_run(run.path(), &scene, &[]);
    let options = PreviewOptions { separated: true, ..PreviewOptions::default() };
    let error = preview(run.path(), &options, &mut |_, _| true).unwrap_err().to_string();
    assert!(error.contains("dam_000000.vti") && error.contains("without --separated"), "{error}");
}

fn is_liquid([red, green, blue]: [i32; 3]) -> bool {
    blue > green && green > red && blue - red > 40
}

#[test]
fn pictures_show_the_liquid_where_it_is() {
    for surface in [scene::Surface::Markers, scene::Surface::Fixed] {
        let run = tempfile::tempdir().unwrap();
        let mut scene = scene();
        scene.camera = front_camera();
        scene.liquid.as_mut().unwrap().surface = surface;
        write_run(run.path(), &scene, &[]);
        let mut told = Vec::new();
        let options = PreviewOptions::default();
        let report = preview(run.path(), &options, &mut |done, all| {
            told.push((done, all));
            true
        })
        .unwrap();
        assert_eq!(told, [(0, 3), (1, 3), (2, 3), (3, 3)]);
        let names: Vec<_> = report.pictures.iter().map(|path| path.file_name().unwrap().to_str().unwrap()).collect();
        assert_eq!(names, ["dam_000000.png", "dam_000001.png", "dam_000002.png"]);
        let [first, second, dry] = [0, 1, 2].map(|frame| Decoded::read(&report.pictures[frame]));
        assert_eq!(first.size, [320, 180]);
        for (x, y) in [(0.1, 0.1), (0.25, 0.2), (0.05, 0.25)] {
            assert!(
                is_liquid(first.at(pixel(x, y))),
                "{surface:?}: no liquid at {x}, {y}: {:?}",
                first.at(pixel(x, y))
            );
            assert!(!is_liquid(dry.at(pixel(x, y))), "{surface:?}: liquid in the dry frame at {x}, {y}");
        }
        assert!(is_liquid(second.at(pixel(0.8, 0.35))), "{surface:?}: no drop: {:?}", second.at(pixel(0.8, 0.35)));
        for (x, y) in [(0.8, 0.35), (0.55, 0.4), (0.2, 0.45)] {
            assert_eq!(first.at(pixel(x, y)), dry.at(pixel(x, y)), "{surface:?}: air at {x}, {y} looks different");
        }
    }
}

#[test]
fn obstacles_hide_what_is_behind_them_and_containers_are_open_to_the_eye() {
    let mut scene = scene();
    scene.camera = front_camera();
    let block = Surface::cuboid(DVec3::new(0.1, 0.05, 0.4), DVec3::new(0.2, 0.15, 0.6));
    let tank = Surface::cuboid(DVec3::splat(-0.01), DVec3::new(1.01, 0.51, 0.51)).inside_out();
    let looks = |obstacles: &[Surface]| {
        let run = tempfile::tempdir().unwrap();
        write_run(run.path(), &scene, obstacles);
        let options = PreviewOptions { animation: false, ..PreviewOptions::default() };
        let report = preview(run.path(), &options, &mut |_, _| true).unwrap();
        assert_eq!(report.animation, None);
        Decoded::read(&report.pictures[0])
    };
    let with_block = looks(&[block]);
    let [red, _, blue] = with_block.at(pixel(0.15, 0.1));
    assert!(red > blue, "the block sticks out of the front wall, and is orange: {:?}", with_block.at(pixel(0.15, 0.1)));
    assert!(is_liquid(with_block.at(pixel(0.3, 0.2))), "liquid beside the block");
    // One side of it in the front wall, where that of the liquid is too, a tenth of a metre into it: no speckles.
    let flush = Surface::cuboid(DVec3::new(0.2, 0.0, 0.3), DVec3::new(0.6, 0.2, 0.5));
    let with_flush = looks(&[flush]);
    for x in 0..24 {
        for y in 0..20 {
            let (x, y) = (0.21 + 0.005 * f64::from(x), 0.05 + 0.006 * f64::from(y));
            let [red, _, blue] = with_flush.at(pixel(x, y));
            assert!(red > blue, "liquid over the body's side at {x}, {y}");
        }
    }
    let with_tank = looks(&[tank]);
    assert!(is_liquid(with_tank.at(pixel(0.15, 0.1))), "liquid behind the tank's near wall");
    let [red, _, blue] = with_tank.at(pixel(0.8, 0.4));
    assert!((red - blue).abs() < 30 && blue < 200, "the tank's far wall: {:?}", with_tank.at(pixel(0.8, 0.4)));
}

/// The same files make the same pictures, byte for byte, whatever the number of threads.
#[test]
fn pictures_do_not_depend_on_threads() {
    let run = tempfile::tempdir().unwrap();
    let mut scene = scene();
    scene.output.fields = true;
    write_run(run.path(), &scene, &[Surface::sphere(DVec3::new(0.6, 0.1, 0.25), 0.08, 0.05)]);
    let bytes = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = PreviewOptions { size: Some([160, 90]), ..PreviewOptions::default() };
        let report = pool.install(|| preview(run.path(), &options, &mut |_, _| true)).unwrap();
        let files = report.pictures.iter().chain(&report.animation);
        files.map(|path| std::fs::read(path).unwrap()).collect::<Vec<_>>()
    };
    let once = bytes(1);
    assert_eq!(once.len(), 4);
    assert!(once == bytes(3), "three threads make other pictures than one");
}

/// Frames that were not written leave no hole in time.
#[test]
fn animation_shows_a_picture_until_the_next_frame() {
    let run = tempfile::tempdir().unwrap();
    let mut scene = scene();
    scene.camera = front_camera();
    write_run(run.path(), &scene, &[]);
    let frames = list(&run.path().join("frames"));
    for file in frames.iter().filter(|file| file.contains("_000001.")) {
        std::fs::remove_file(run.path().join("frames").join(file)).unwrap();
    }
    let report = preview(run.path(), &PreviewOptions::default(), &mut |_, _| true).unwrap();
    assert_eq!(report.pictures.len(), 2);
    let file = std::fs::File::open(report.animation.unwrap()).unwrap();
    let reader = png::Decoder::new(BufReader::new(file)).read_info().unwrap();
    let place = reader.info().frame_control().unwrap();
    assert_eq!((place.delay_num, place.delay_den), (1, 12), "two frames at 24 per second");
}

#[test]
fn pictures_can_be_interrupted() {
    let run = tempfile::tempdir().unwrap();
    let mut scene = scene();
    scene.camera = front_camera();
    write_run(run.path(), &scene, &[]);
    let error = preview(run.path(), &PreviewOptions::default(), &mut |done, _| done < 1);
    assert!(matches!(error, Err(Error::Interrupted)));
    assert_eq!(list(&run.path().join("preview")).len(), 1);
}

/// Names of the files in a folder.
fn list(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

/// The animation, put together as a browser does, shows the pictures.
#[test]
fn animation_shows_the_pictures() {
    let run = tempfile::tempdir().unwrap();
    let mut scene = scene();
    scene.camera = front_camera();
    write_run(run.path(), &scene, &[]);
    let report = preview(run.path(), &PreviewOptions::default(), &mut |_, _| true).unwrap();
    let file = std::fs::File::open(report.animation.unwrap()).unwrap();
    let mut reader = png::Decoder::new(BufReader::new(file)).read_info().unwrap();
    let control = *reader.info().animation_control().unwrap();
    assert_eq!((control.num_frames, control.num_plays), (3, 0));
    let mut canvas = vec![0; 3 * 320 * 180];
    for picture in &report.pictures {
        let mut rgba = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut rgba).unwrap();
        let place = *reader.info().frame_control().unwrap();
        assert_eq!((place.delay_num, place.delay_den), (1, 24), "24 frames per second");
        assert_eq!(place.blend_op, png::BlendOp::Over);
        for (row, pixels) in (0..).zip(rgba[..info.buffer_size()].chunks_exact(4 * info.width as usize)) {
            for (column, pixel) in (0..).zip(pixels.chunks_exact(4)).filter(|(_, pixel)| pixel[3] == 255) {
                let start = 3 * (place.x_offset + column + 320 * (place.y_offset + row)) as usize;
                canvas[start..start + 3].copy_from_slice(&pixel[..3]);
            }
        }
        assert!(canvas == Decoded::read(picture).rgb, "{} looks different in the animation", picture.display());
    }
}

#[test]
fn preview_without_frames_says_so() {
    let run = tempfile::tempdir().unwrap();
    let error = preview(run.path(), &PreviewOptions::default(), &mut |_, _| true).unwrap_err();
    assert!(matches!(error, Error::Input { .. }) && error.to_string().contains("manifest.json"), "{error}");
    manifest(&scene()).write(run.path()).unwrap();
    let error = preview(run.path(), &PreviewOptions::default(), &mut |_, _| true).unwrap_err();
    assert!(matches!(error, Error::Input { .. }) && error.to_string().contains("dam_000000.vtp"), "{error}");
    assert!(!run.path().join("preview").exists(), "no folder for pictures that are not made");
}

/// A frame file that is cut short is an error that names it.
#[test]
fn preview_names_a_broken_frame() {
    let run = tempfile::tempdir().unwrap();
    let scene = scene();
    write_run(run.path(), &scene, &[]);
    let broken = run.path().join("frames/dam_000001.vtp");
    let whole = std::fs::read(&broken).unwrap();
    std::fs::write(&broken, &whole[..whole.len() / 2]).unwrap();
    let error = preview(run.path(), &PreviewOptions::default(), &mut |_, _| true).unwrap_err();
    assert!(error.to_string().contains("dam_000001.vtp"), "{error}");
}
