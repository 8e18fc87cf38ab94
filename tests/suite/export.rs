//! `export`: what it writes is one consistent system, on both paths the same.

use std::fs;
use std::path::Path;

use cutwater::linalg::{Csr, SymbolicCholesky, norm, read_matrix, read_vector};
use cutwater::measure::export::{Meta, Options, export};
use cutwater::scene::Scene;
use cutwater::sim::Backend;
use serde_json::Value;

use crate::cli::list;
use crate::common::{adapter, assert_has, gpu, json, project_scene as scene};
use crate::solid_cases::{held, region};
use crate::solid_scene::{block, scene_of};

/// What the files hold.
struct Files {
    meta: Meta,
    matrix: Csr,
    rhs: Vec<f64>,
    pressure: Vec<f64>,
    cells: Vec<[usize; 3]>,
    json: Value,
}

impl Files {
    fn new(scene: &Scene, backend: Backend, step: u64) -> Files {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("new/system");
        let options = Options { backend, step, start: None, out: out.clone() };
        let meta = export(scene, &options).unwrap();
        let text = |name: &str| fs::read_to_string(out.join(name)).unwrap();
        let banner = "%%MatrixMarket matrix coordinate real symmetric";
        assert_eq!(text("spd.mtx").lines().next(), Some(banner));
        let cells = text("cells.csv");
        let mut lines = cells.lines();
        assert_eq!(lines.next(), Some("row,i,j,k,x,y,z"));
        let cell = |(row, line): (usize, &str)| {
            let fields: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
            assert_eq!(fields[0], (row + 1) as f64);
            let ijk: [usize; 3] = std::array::from_fn(|a| fields[1 + a] as usize);
            let x = scene.grid().cell_centre(ijk).to_array();
            assert_eq!(x, [fields[4], fields[5], fields[6]]);
            ijk
        };
        Files {
            matrix: read_matrix(&out.join("spd.mtx")).unwrap(),
            rhs: read_vector(&out.join("spd_rhs.mtx")).unwrap(),
            pressure: read_vector(&out.join("solution.mtx")).unwrap(),
            cells: lines.enumerate().map(cell).collect(),
            json: json(text("meta.json")),
            meta,
        }
    }

    /// ||b - A x|| / ||b|| of what was read.
    fn residual(&self) -> f64 {
        let rows = 0..self.matrix.n_rows();
        let residual: Vec<f64> = rows
            .map(|row| {
                let product = self.matrix.row(row).map(|(at, value)| value * self.pressure[at]);
                self.rhs[row] - product.sum::<f64>()
            })
            .collect();
        norm(&residual) / norm(&self.rhs)
    }

    /// What must hold of every export.
    fn check(&self, scene: &Scene) {
        let Files { meta, matrix, json, .. } = self;
        let n = meta.unknowns;
        assert!(n > 100);
        assert_eq!([matrix.n_rows(), matrix.n_columns()], [n; 2]);
        assert_eq!([self.rhs.len(), self.pressure.len(), self.cells.len()], [n; 3]);
        assert_eq!(matrix.n_entries(), meta.entries);
        for (row, column, value) in matrix.triplets() {
            assert_eq!(matrix.get(column, row), value);
            assert_eq!(value > 0.0, row == column, "an M-matrix");
            let [a, b] = [self.cells[row], self.cells[column]];
            let apart: usize = (0..3).map(|axis| a[axis].abs_diff(b[axis])).sum();
            assert!(apart <= 1, "row {row}, column {column}");
        }
        // B itself, of an inner cell without a wall or surface: dt dx / rho times 6, -1, ...
        let inner = (0..n).find(|&row| matrix.row(row).count() == 7).unwrap();
        let unit = meta.dt * meta.dx / json["density"].as_f64().unwrap();
        let ratio = matrix.row(inner).map(|(_, value)| value).fold(f64::INFINITY, f64::min) / unit;
        assert!(-1.0 - 1e-12 < ratio && ratio < 0.0, "{ratio}");
        let residual = self.residual();
        assert!(residual <= 1.1 * meta.residual + 1e-14, "{residual} read, {} written", meta.residual);
        assert_eq!(meta.status, "converged");
        assert_eq!(json["unknowns"], n);
        assert_eq!(json["dt"], meta.dt);
        assert_eq!(json["tolerance"], scene.solver.tolerance);
        assert_eq!(json["scene"], scene.name.as_str());
    }
}

#[test]
fn the_cpu_path_exports_what_it_solved() {
    let scene = scene("dam_break_liquid", 0.25, &[]);
    for step in [0, 2] {
        let files = Files::new(&scene, Backend::Cpu, step);
        files.check(&scene);
        assert!(files.residual() <= scene.solver.tolerance);
        assert_eq!(files.meta.step, step);
    }
}

#[test]
fn a_sub_step_after_the_end_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene("dam_break_liquid", 0.25, &["time.duration=0.05"]);
    let mut backends = vec![Backend::Cpu];
    backends.extend(gpu().map(|_| Backend::Gpu(adapter())));
    for backend in backends {
        let options = Options { backend, step: 1000, start: None, out: folder.path().join("system") };
        let refused = export(&scene, &options).unwrap_err().to_string();
        assert_has(&refused, &["--step 1000", "the scene is over after"]);
        assert!(!options.out.exists());
    }
}

/// A block in a pool.
const BOTH: &str = "[domain]
size = [1, 1, 1]
cells = [8, 8, 8]
[time]
duration = 0.2
frames_per_second = 24
[[liquid.region]]
box = { min = [0, 0, 0], max = [1, 0.5, 1] }
[[solid]]
name = \"block\"
mesh = { box = { size = [0.3, 0.3, 0.3], cells = [2, 2, 2] } }
placement = { translate = [0.5, 0.3, 0.5] }
density = 2000.0
young = 1e6
poisson = 0.4
";

#[test]
fn an_export_replaces_all_of_an_earlier_one() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("both.toml");
    fs::write(&file, BOTH).unwrap();
    let both = Scene::load(&file, &[], 1.0).unwrap();
    let liquid = scene("dam_break_liquid", 0.25, &["time.duration=0.05"]);
    let into = |out: &Path, step: u64| Options { backend: Backend::Cpu, step, start: None, out: out.to_owned() };
    let same = folder.path().join("same");
    let mut left = Vec::new();
    // Each writes files that the next does not.
    for (number, scene) in [both, two_blocks(), liquid.clone()].iter().enumerate() {
        let alone = folder.path().join(number.to_string());
        for out in [&same, &alone] {
            fs::create_dir_all(out).unwrap();
            fs::write(out.join("notes.txt"), "of the user").unwrap();
            export(scene, &into(out, 0)).unwrap();
        }
        left = list(&same);
        assert_eq!(left, list(&alone));
        for name in &left {
            let [a, b] = [&same, &alone].map(|out| fs::read(out.join(name)).unwrap());
            assert!(a == b, "{name}");
        }
    }
    // One that fails takes nothing away.
    export(&liquid, &into(&same, 1000)).unwrap_err();
    assert_eq!(list(&same), left);
    // Where a run followed, the folder is no longer that of an export alone.
    fs::write(same.join("manifest.json"), "{}").unwrap();
    let error = export(&liquid, &into(&same, 0)).unwrap_err();
    assert!(error.to_string().contains("holds a run"), "{error}");
}

#[test]
fn a_folder_of_something_else_is_refused() {
    let scene = scene("dam_break_liquid", 0.25, &[]);
    for (name, text) in [
        ("manifest.json", "{}"),
        ("spd.mtx", "of another program"),
        ("nodes.csv", "n,x\n"),
        ("meta.json", "{\"cutwater\": \"0.1.0\", \"step\": 3}"),
        ("meta.json", "{"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        fs::write(out.join(name), text).unwrap();
        let options = Options { backend: Backend::Cpu, step: 0, start: None, out: out.to_owned() };
        let error = export(&scene, &options).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{error}");
        let told = error.to_string();
        assert!(told.contains(name) && told.contains("--out"), "{told}");
        assert_eq!(list(out), [name]);
        assert_eq!(fs::read_to_string(out.join(name)).unwrap(), text);
    }
}

#[test]
fn the_gpu_path_exports_what_it_stored() {
    let Some(gpu) = gpu() else { return };
    // Rounding of the potential to f32, where the device has no f64.
    let rounded = if gpu.has_f64() { 0.0 } else { 1e-4 };
    for scene in [scene("dam_break_liquid", 0.25, &[]), scene("hydrostatic_block", 0.5, &[])] {
        let files = Files::new(&scene, Backend::Gpu(adapter()), 1);
        files.check(&scene);
        let allowed = scene.solver.tolerance + rounded;
        assert!(files.residual() <= allowed, "{}", files.residual());
    }
}

#[test]
fn both_paths_export_the_same_system() {
    let Some(_) = gpu() else { return };
    let scene = scene("sphere_half_full", 0.5, &[]);
    let cpu = Files::new(&scene, Backend::Cpu, 0);
    let gpu = Files::new(&scene, Backend::Gpu(adapter()), 0);
    assert_eq!(cpu.cells, gpu.cells);
    let close = |a: f64, b: f64, size: f64| (a - b).abs() <= 1e-5 * size;
    for (one, two) in cpu.matrix.triplets().zip(gpu.matrix.triplets()) {
        assert_eq!([one.0, one.1], [two.0, two.1]);
        assert!(close(one.2, two.2, one.2.abs()), "{one:?} {two:?}");
    }
    for (a, b) in [(&cpu.rhs, &gpu.rhs), (&cpu.pressure, &gpu.pressure)] {
        let size = a.iter().fold(0.0, |size: f64, value| size.max(value.abs()));
        let pairs = a.iter().zip(b);
        assert!(pairs.into_iter().all(|(&a, &b)| close(a, b, size)));
    }
}

#[test]
fn liquid_without_a_surface_is_singular_and_has_an_answer() {
    let full = ["liquid.region[0].half_space.point=[0.0, 0.99, 0.0]"];
    let scene = scene("hydrostatic_block", 0.5, &full);
    let mut backends = vec![Backend::Cpu];
    if gpu().is_some_and(|gpu| gpu.has_f64()) {
        backends.push(Backend::Gpu(adapter()));
    }
    for backend in backends {
        let files = Files::new(&scene, backend, 0);
        files.check(&scene);
        assert_eq!(files.json["closed_components"], 1);
        let largest = |field: &[f64]| field.iter().fold(0.0, |size: f64, x| size.max(x.abs()));
        for field in [&files.rhs, &files.pressure] {
            let mean = field.iter().sum::<f64>() / field.len() as f64;
            assert!(mean.abs() <= 1e-12 * largest(field), "mean {mean:e}");
        }
        for row in 0..files.matrix.n_rows() {
            let sum: f64 = files.matrix.row(row).map(|(_, value)| value).sum();
            assert!(sum.abs() <= 1e-12 * files.matrix.get(row, row), "row {row}");
        }
    }
}

/// Two blocks, one of them damped and held by its low side, sheared by a start velocity.
fn two_blocks() -> Scene {
    let mut low = block([0.4, 0.3, 0.2], [4, 3, 2]);
    low.pins = vec![held(region([0.0; 3], [0.001, 1.0, 1.0]), [true, true, false])];
    low.placement.translate += glam::DVec3::new(0.0, 0.5, 0.5);
    (low.mass_damping, low.stiffness_damping) = (0.5, 0.01);
    low.initial.velocity = [0.0, 0.2, -0.1].into();
    let mut high = block([0.2; 3], [2, 2, 2]);
    high.name = "other".to_owned();
    high.placement.translate = [2.0, 2.0, 2.0].into();
    high.initial.scale = [1.0, 0.9, 1.1].into();
    (high.young, high.poisson) = (2e5, 0.45);
    scene_of(vec![low, high])
}

/// What the files of solids hold.
struct SolidFiles {
    meta: Meta,
    json: Value,
    /// M, K, S, and S on the free components.
    matrices: [Csr; 4],
    rhs: Vec<f64>,
    velocity: Vec<f64>,
    nodes: String,
}

impl SolidFiles {
    fn new(scene: &Scene, backend: Backend, step: u64) -> SolidFiles {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_owned();
        let options = Options { backend, step, start: None, out: out.clone() };
        let meta = export(scene, &options).unwrap();
        let text = |name: &str| fs::read_to_string(out.join(name)).unwrap();
        SolidFiles {
            matrices: ["M.mtx", "K.mtx", "S.mtx", "spd.mtx"].map(|name| read_matrix(&out.join(name)).unwrap()),
            rhs: read_vector(&out.join("spd_rhs.mtx")).unwrap(),
            velocity: read_vector(&out.join("solution.mtx")).unwrap(),
            nodes: text("nodes.csv"),
            json: json(text("meta.json")),
            meta,
        }
    }

    /// What must hold whatever the path; `eps`: rounding of the path.
    fn check(&self, scene: &Scene, eps: f64) {
        let [mass, stiffness, all, spd] = &self.matrices;
        let n = self.json["nodes"].as_u64().unwrap() as usize;
        assert_eq!(n, 5 * 4 * 3 + 27);
        for matrix in [mass, stiffness, all] {
            assert_eq!([matrix.n_rows(), matrix.n_columns()], [3 * n; 2]);
        }
        let (mut rows, mut total) = (vec![0; 3 * n], [0.0; 2]);
        let mut lines = self.nodes.lines();
        assert_eq!(lines.next(), Some("node,solid,rest_x,rest_y,rest_z,row_x,row_y,row_z"));
        let dt = self.meta.dt;
        for (node, line) in lines.enumerate() {
            let fields: Vec<&str> = line.split(',').collect();
            assert_eq!(fields[0], node.to_string());
            let solid = scene.solids.iter().position(|s| s.name == fields[1]).unwrap();
            total[solid] += mass.get(3 * node, 3 * node);
            let held = solid == 0 && fields[2].parse::<f64>().unwrap().abs() < 1e-9;
            let body = &scene.solids[solid];
            let [zeta_m, zeta_k] = [1.0 / dt + body.mass_damping, dt + body.stiffness_damping];
            for axis in 0..3 {
                let component = 3 * node + axis;
                rows[component] = fields[5 + axis].parse().unwrap();
                assert_eq!(rows[component] == 0, held && axis < 2, "{line}");
                let mut shifts = [0.0; 3];
                for (column, value) in stiffness.row(component) {
                    shifts[column % 3] += value;
                    let wanted = zeta_k * value + zeta_m * mass.get(component, column);
                    let found = all.get(component, column);
                    let size = all.get(component, component);
                    assert!((found - wanted).abs() <= 1e-6 * size, "{found}, wanted {wanted}");
                }
                let size = stiffness.get(component, component);
                assert!(
                    shifts.iter().all(|sum| sum.abs() <= 100.0 * eps * size),
                    "a translation is strained: {shifts:?} of {size}"
                );
            }
        }
        for (total, volume) in total.iter().zip([0.4 * 0.3 * 0.2, 0.008]) {
            assert!((total / (1000.0 * volume) - 1.0).abs() < 1e-6, "{total} kg");
        }
        // spd.mtx is S without the prescribed components.
        let unknowns: Vec<usize> = (0..3 * n).filter(|&at| rows[at] > 0).collect();
        assert_eq!(unknowns.len(), self.meta.unknowns);
        assert_eq!([spd.n_rows(), self.rhs.len(), self.velocity.len()], [unknowns.len(); 3]);
        assert_eq!(spd.n_entries(), self.meta.entries);
        for (row, &component) in unknowns.iter().enumerate() {
            assert_eq!(rows[component], row + 1);
            for (column, value) in spd.row(row) {
                assert_eq!(value, all.get(component, unknowns[column]));
            }
        }
        // It is positive definite, and the answer solves it.
        let symbolic = SymbolicCholesky::new(spd).unwrap();
        let mut direct = self.rhs.clone();
        symbolic.factorise(spd).unwrap().solve(&mut direct);
        let off: Vec<f64> = direct.iter().zip(&self.velocity).map(|(a, b)| a - b).collect();
        assert!(norm(&off) <= 1e-6 * norm(&direct), "{} m/s", norm(&off));
        assert!(self.meta.residual <= 2.0 * scene.solver.tolerance + 100.0 * eps);
        let damped = &self.json["solids"][0];
        assert_eq!(damped["tau_m"], 0.5);
        assert_eq!(self.json["solids"][1]["name"], "other");
    }
}

#[test]
fn solids_export_mass_stiffness_and_system() {
    let scene = two_blocks();
    let cpu = SolidFiles::new(&scene, Backend::Cpu, 2);
    cpu.check(&scene, 1e-15);
    let Some(gpu) = gpu() else { return };
    let eps = if gpu.has_f64() { 1e-15 } else { 1e-6 };
    let device = SolidFiles::new(&scene, Backend::Gpu(adapter()), 2);
    device.check(&scene, eps);
    // Masses in f32, and two sub-steps of rounding.
    for (one, two) in cpu.matrices.iter().zip(&device.matrices) {
        for (row, column, value) in one.triplets() {
            let size = (one.get(row, row) * one.get(column, column)).sqrt();
            let off = (two.get(row, column) - value).abs();
            assert!(off <= 1e-4 * size, "{row}, {column}: {off} of {size}");
        }
    }
}
