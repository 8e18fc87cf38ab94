//! Single elements and small meshes: stiffness (S1), patch test (S7), rotations that carry no force (S8), polar decomposition (S12).

use std::path::PathBuf;

use cutwater::geometry::TetMesh;
use cutwater::output::write_mesh;
use cutwater::reference::larger;
use cutwater::scene::{ElasticModel, Scene, Solid, SolidMesh};
use glam::{DMat3, DVec3};

use crate::Case;
use crate::common::Random;
use crate::lane::{Lane, Motion, Probe, affine, largest};
use crate::sheet::Sheet;
use crate::solid_cases::{held, region};
use crate::solid_scene::{block, rows, scene_of};

pub(crate) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for lane in Lane::ALL {
        let name = lane.name();
        cases.push(Case::new(format!("S1/{name}"), move |sheet| element_stiffness(lane, sheet)));
        cases.push(Case::new(format!("S7/{name}"), move |sheet| patch_test(lane, sheet)));
        cases.push(Case::new(format!("S8/{name}"), move |sheet| turned_bodies(lane, sheet)));
        cases.push(Case::new(format!("S12/{name}"), move |sheet| polar_decomposition(lane, sheet)));
    }
    cases
}

/// A scene of solids with these meshes (m), E = 1000 Pa, nu = 0.3.
fn scene_of_meshes(meshes: &[TetMesh]) -> (Scene, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let solid = |(number, mesh): (usize, &TetMesh)| {
        let file: PathBuf = folder.path().join(format!("{number}.vtu"));
        write_mesh(&file, mesh).unwrap();
        Solid {
            name: format!("solid_{number}"),
            mesh: SolidMesh::File { file: file.into(), unit: 1.0 },
            young: 1000.0,
            placement: Default::default(),
            ..block([1.0; 3], [1; 3])
        }
    };
    let mut scene = scene_of(meshes.iter().enumerate().map(solid).collect());
    scene.domain.size = DVec3::splat(64.0);
    (scene, folder)
}

/// A tetrahedron with these corners (m), in the middle of the domain.
fn one_element(corners: [[f64; 3]; 4]) -> TetMesh {
    TetMesh { nodes: corners.map(|x| DVec3::splat(32.0) + DVec3::from(x)).to_vec(), elements: vec![[0, 1, 2, 3]] }
}

/// Columns of K: forces of unit displacements in the linear model, against scikit-fem.
fn element_stiffness(lane: Lane, sheet: &mut Sheet) {
    let unit = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let skew = [[0.1, 0.2, 0.3], [1.2, 0.1, 0.0], [0.3, 1.1, 0.2], [0.2, 0.4, 1.3]];
    let (mut scene, _folder) = scene_of_meshes(&[unit, skew].map(one_element));
    for solid in &mut scene.solids {
        solid.model = ElasticModel::Linear;
    }
    let mut probe = Probe::new(lane, &scene);
    let mut found = [[[0.0; 12]; 12]; 2];
    // A power of two: the columns have no rounding of their own.
    let size = 2.0_f64.powi(-8);
    for column in 0..12 {
        let mut u = [[0.0; 3]; 8];
        for first in [0, 4] {
            u[first + column / 3][column % 3] = size;
        }
        let elements = probe.elements(&u);
        for (matrix, forces) in found.iter_mut().zip(&elements.forces) {
            for row in 0..12 {
                matrix[row][column] = forces[row / 3][row % 3] / size;
            }
        }
    }
    for (name, matrix) in ["unit", "skew"].into_iter().zip(&found) {
        let (mut worst, mut most): (f64, f64) = (0.0, 0.0);
        for row in rows(include_str!("../data/tet4_stiffness.csv")) {
            if row[0] != name {
                continue;
            }
            let number: usize = row[1].parse().unwrap();
            for (ours, table) in matrix[number].iter().zip(&row[2..]) {
                let table: f64 = table.parse().unwrap();
                worst = larger(worst, (ours - table).abs());
                most = most.max(table.abs());
            }
        }
        let what = format!("stiffness of the {name} tetrahedron, worst entry over largest (ten digits)");
        // The table has ten digits, f32 seven.
        sheet.at_most(&what, worst / most, lane.choose(2e-10, 2e-10, 1e-6));
        let asymmetry =
            (0..144).map(|at| (matrix[at / 12][at % 12] - matrix[at % 12][at / 12]).abs()).fold(0.0, larger);
        let what = format!("asymmetry of the {name} tetrahedron's stiffness over largest entry");
        sheet.at_most(&what, asymmetry / most, lane.choose(1e-13, 1e-13, 1e-6));
    }
}

/// The nodes of an irregular block, those on its surface held: an affine displacement there is exact inside.
fn patch_test(lane: Lane, sheet: &mut Sheet) {
    let mut mesh = TetMesh::new(&block([1.0; 3], [4; 3]), "patch").unwrap();
    let mut random = Random(7);
    let outside = |x: DVec3| x.min_element() < 1e-9 || x.max_element() > 1.0 - 1e-9;
    for x in &mut mesh.nodes {
        if !outside(*x) {
            *x += DVec3::from_array(std::array::from_fn(|_| random.uniform(-0.05, 0.05)));
        }
        *x += DVec3::splat(32.0);
    }
    let (mut scene, _folder) = scene_of_meshes(&[mesh]);
    let (low, high) = (DVec3::splat(32.0), DVec3::splat(33.0));
    for axis in DVec3::AXES {
        for plane in [region(low, high - axis), region(low + axis, high)] {
            scene.solids[0].pins.push(held(plane, [true; 3]));
        }
    }
    scene.solids[0].young = 1e6;
    let stretch =
        DMat3::from_cols(DVec3::new(1.08, 0.03, -0.02), DVec3::new(0.03, 0.95, 0.04), DVec3::new(-0.02, 0.04, 1.05));
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    for (name, matrix) in
        [("small", DMat3::IDENTITY + 1e-3 * (stretch - DMat3::IDENTITY)), ("stretched and turned", turn * stretch)]
    {
        let mut probe = Probe::new(lane, &scene);
        let exact = affine(&probe.solids, matrix, DVec3::splat(32.5));
        let free: Vec<bool> = probe.solids.prescribed.iter().map(|held| *held == [false; 3]).collect();
        assert_eq!(free.iter().filter(|free| **free).count(), 27);
        let elements = probe.elements(&exact);
        let rest = probe.largest_on_nodes(&elements, |node| free[node]) / (1e6 * 0.25 * 0.25);
        let what = format!("patch test, {name}: force on free nodes over E times the area of a brick's side");
        sheet.at_most(&what, rest, lane.choose(1e-13, 1e-13, 1e-6));

        let mut start = exact.clone();
        for (u, free) in start.iter_mut().zip(&free) {
            if *free {
                *u = u.map(|u| u + 0.02 * random.uniform(-1.0, 1.0));
            }
        }
        let mut motion = Motion::new(lane, &scene, 10.0);
        motion.put(&start);
        let found = motion.static_displacement(lane.choose(1e-12, 1e-11, 1e-6));
        let errors: Vec<[f64; 3]> =
            found.iter().zip(&exact).map(|(a, b)| std::array::from_fn(|axis| a[axis] - b[axis])).collect();
        // Lengths are those of the block, 1 m.
        let what = format!("patch test, {name}: displacement inside, of the block's side");
        sheet.at_most(&what, largest(&errors), lane.choose(1e-10, 1e-9, 1e-6));
    }
}

/// A body turned by any angle about any axis carries no force.
fn turned_bodies(lane: Lane, sheet: &mut Sheet) {
    let side = 0.25;
    let mut solid = block([0.5; 3], [2; 3]);
    solid.placement.translate = DVec3::splat(2.0);
    let scene = scene_of(vec![solid]);
    let mut probe = Probe::new(lane, &scene);
    let mut random = Random(3);
    let mut axes = vec![DVec3::X, DVec3::Y, DVec3::Z, DVec3::ONE, DVec3::new(1.0, -1.0, 0.0)];
    for _ in 0..5 {
        axes.push(DVec3::from_array(std::array::from_fn(|_| random.uniform(-1.0, 1.0))));
    }
    let angles = [1e-6, 1e-3, 0.017, 0.3, 1.0, 1.5, 2.0, 2.5, 3.0, 3.1, 3.13, std::f64::consts::PI, 4.0, 5.5];
    let (mut worst, mut at) = (0.0, String::new());
    for axis in &axes {
        for angle in angles {
            let turn = DMat3::from_axis_angle(axis.normalize(), angle);
            let u = affine(&probe.solids, turn, DVec3::splat(2.0));
            let elements = probe.elements(&u);
            let force = probe.largest_on_nodes(&elements, |_| true) / (1e6 * side * side);
            if force >= worst {
                (worst, at) = (force, format!("{angle} rad about {axis:.2}"));
            }
        }
    }
    let what = format!(
        "force on a node of a turned block over E times the area of a brick's side, worst of {} turns",
        axes.len() * angles.len()
    );
    // The rounding unit, times a displacement of 7 sides of a brick, times 24 elements around a node.
    sheet.at_most(&what, worst, lane.choose(1e-13, 1e-13, 1e-5));
    sheet.info("where", at);
}

/// Rotations of the table's deformation gradients.
fn polar_decomposition(lane: Lane, sheet: &mut Sheet) {
    let unit = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let (scene, _folder) = scene_of_meshes(&[one_element(unit)]);
    let mut probe = Probe::new(lane, &scene);
    let mut cases = 0;
    for row in rows(include_str!("../data/polar_decomposition.csv")) {
        let numbers: Vec<f64> = row[1..].iter().map_while(|x| x.parse().ok()).collect();
        let by_rows = |at: usize| DMat3::from_cols_slice(&numbers[at..at + 9]).transpose();
        let (f, exact) = (by_rows(0), by_rows(9));
        let u = affine(&probe.solids, f, DVec3::splat(32.0));
        let [x, y, z] = probe.elements(&u).rotated[0];
        // The gradients at rest are the unit vectors.
        let r = DMat3::from_cols(x, y, z);
        let size = |m: DMat3| m.to_cols_array().into_iter().map(|x| x * x).sum::<f64>().sqrt();
        let most = |m: DMat3| m.to_cols_array().into_iter().fold(0.0, |most, x| larger(most, x.abs()));
        let bound = lane.choose(1e-12, 1e-12, 1e-6);
        let name = row[0];
        sheet.at_most(&format!("{name}: det R - 1"), (r.determinant() - 1.0).abs(), bound);
        let excess = size(f - r) / size(f - exact) - 1.0;
        if name == "inverted_mirror" {
            // Its three smallest singular values are equal: no nearest rotation is the nearest.
            sheet.at_most(&format!("{name}: |F - R| above the least, relative"), excess, 1e-6);
        } else {
            sheet.at_most(&format!("{name}: largest error of R"), most(r - exact), bound);
        }
        cases += 1;
    }
    assert_eq!(cases, 9);
}
