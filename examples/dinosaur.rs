//! Makes the mesh of the toy dinosaur, `scenes/meshes/dinosaur.vtu`:
//!
//! ```text
//! cargo run --release --example dinosaur -- scenes/meshes/dinosaur.vtu
//! ```
//!
//! The shape is a function: rounded cones (capsules with two radii) and ellipsoids, blended where they meet, cut flat under the feet.
//! Its surface is drawn by marching tetrahedra on a fine grid and filled with tetrahedra like any other closed surface. The same
//! command makes the same file, byte for byte; a test compares it with the one in the repository.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;

use cutwater::geometry::{Surface, TetMesh, fill};
use cutwater::output::write_mesh;
use glam::DVec3;

/// Edge length of the tetrahedra, m: the size that makes about 1400 nodes and 5900 elements.
const CELL_SIZE: f64 = 0.0545;

/// Cells of the grid on which the surface is drawn, m: fine against the tetrahedra.
const GRID: f64 = 0.015;

/// Width of the fillets between parts, m.
const BLEND: f64 = 0.05;

/// A corner of the grid. Its odd fractions keep the plane of the soles, and the toy's own of symmetry, off the grid's nodes.
const LOW: [f64; 3] = [-0.7061, -0.0473, -0.2237];

/// Cells of the grid.
const CELLS: [usize; 3] = [84, 56, 30];

/// A cone with rounded ends.
struct Limb {
    from: [f64; 3],
    to: [f64; 3],
    /// At both ends.
    radii: [f64; 2],
}

const fn limb(from: [f64; 3], to: [f64; 3], radii: [f64; 2]) -> Limb {
    Limb { from, to, radii }
}

/// What lies in the plane of symmetry, z = 0: x forwards, y up, m.
const SPINE: [Limb; 10] = [
    // Trunk.
    limb([-0.13, 0.35, 0.0], [0.11, 0.34, 0.0], [0.125, 0.115]),
    // Neck.
    limb([0.13, 0.37, 0.0], [0.24, 0.48, 0.0], [0.085, 0.062]),
    limb([0.24, 0.48, 0.0], [0.30, 0.60, 0.0], [0.062, 0.052]),
    limb([0.30, 0.60, 0.0], [0.35, 0.69, 0.0], [0.052, 0.048]),
    // Head and snout.
    limb([0.37, 0.71, 0.0], [0.41, 0.705, 0.0], [0.06, 0.055]),
    limb([0.41, 0.70, 0.0], [0.49, 0.675, 0.0], [0.05, 0.038]),
    // Tail.
    limb([-0.15, 0.36, 0.0], [-0.28, 0.32, 0.0], [0.105, 0.068]),
    limb([-0.28, 0.32, 0.0], [-0.41, 0.25, 0.0], [0.068, 0.05]),
    limb([-0.41, 0.25, 0.0], [-0.53, 0.21, 0.0], [0.05, 0.038]),
    limb([-0.53, 0.21, 0.0], [-0.64, 0.22, 0.0], [0.038, 0.028]),
];

/// What is there on both sides.
const SIDES: [Limb; 4] = [
    limb([0.12, 0.29, 0.085], [0.13, 0.03, 0.115], [0.062, 0.048]),
    limb([0.13, 0.02, 0.115], [0.155, 0.012, 0.117], [0.05, 0.047]),
    limb([-0.14, 0.30, 0.085], [-0.15, 0.03, 0.115], [0.075, 0.05]),
    limb([-0.15, 0.02, 0.115], [-0.125, 0.012, 0.117], [0.053, 0.048]),
];

/// The belly, an ellipsoid: centre and half axes, m.
const BELLY: [[f64; 3]; 2] = [[-0.02, 0.31, 0.0], [0.2, 0.12, 0.14]];

impl Limb {
    /// Distance to the axis less the radius there: 0 on the surface, negative inside.
    fn value(&self, x: DVec3) -> f64 {
        let [from, to] = [self.from, self.to].map(DVec3::from_array);
        let along = ((x - from).dot(to - from) / from.distance_squared(to)).clamp(0.0, 1.0);
        x.distance(from + along * (to - from)) - self.radii[0] - along * (self.radii[1] - self.radii[0])
    }
}

/// The lesser of two values, less a fillet where they are nearly equal (Quilez's quadratic smooth minimum).
fn blended(a: f64, b: f64) -> f64 {
    let near = (BLEND - (a - b).abs()).max(0.0);
    a.min(b) - 0.25 * near * near / BLEND
}

/// The shape: negative inside, about the distance near the surface, m.
fn value(x: DVec3) -> f64 {
    let [centre, axes] = BELLY.map(DVec3::from_array);
    let scaled = (x - centre) / axes;
    // Exact on the surface; the shortest half axis makes it a distance across the flanks.
    let belly = (scaled.length() - 1.0) * axes.min_element();
    let mirrored = DVec3::new(x.x, x.y, x.z.abs());
    let spine = SPINE.iter().map(|limb| limb.value(x));
    let sides = SIDES.iter().map(|limb| limb.value(mirrored));
    spine.chain(sides).fold(belly, blended).max(-x.y)
}

/// The surface of the shape by marching tetrahedra: six in each cell of the grid, its value linear between nodes.
fn surface() -> Surface {
    let node = |at: [usize; 3]| DVec3::from_array([0, 1, 2].map(|axis| LOW[axis] + GRID * at[axis] as f64));
    let number = |at: [usize; 3]| at[0] + (CELLS[0] + 1) * (at[1] + (CELLS[1] + 1) * at[2]);
    let places = (0..=CELLS[2]).flat_map(|k| (0..=CELLS[1]).flat_map(move |j| (0..=CELLS[0]).map(move |i| [i, j, k])));
    let values: Vec<f64> = places.map(|at| value(node(at))).collect();
    let mut surface = Surface::default();
    let mut vertices = BTreeMap::new();
    let mut vertex = |inside: [usize; 3], outside: [usize; 3]| {
        let known = vertices.entry((number(inside), number(outside)));
        *known.or_insert_with(|| {
            let [a, b] = [inside, outside].map(node);
            let [at_a, at_b] = [inside, outside].map(|at| values[number(at)]);
            let share = at_a / (at_a - at_b);
            surface.vertices.push(a + share * (b - a));
            surface.vertices.len() as u32 - 1
        })
    };
    let mut triangles = Vec::new();
    for k in 0..CELLS[2] {
        for j in 0..CELLS[1] {
            for i in 0..CELLS[0] {
                // The six ways along the edges from the low to the high corner, and whether each is an even order of the axes.
                for (axes, even) in [
                    ([0, 1, 2], true),
                    ([1, 2, 0], true),
                    ([2, 0, 1], true),
                    ([0, 2, 1], false),
                    ([2, 1, 0], false),
                    ([1, 0, 2], false),
                ] {
                    let mut corners = [[i, j, k]; 4];
                    for (step, axis) in axes.into_iter().enumerate() {
                        for corner in &mut corners[step + 1..] {
                            corner[axis] += 1;
                        }
                    }
                    if !even {
                        corners.swap(2, 3);
                    }
                    // Positively oriented; the faces of corner 0, 1, 2, 3 counter-clockwise from outside.
                    const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];
                    let inside = corners.map(|corner| values[number(corner)] < 0.0);
                    let of = |wanted: bool| (0..4).filter(move |&corner| inside[corner] == wanted);
                    match of(true).count() {
                        1 => {
                            let tip = of(true).next().unwrap_or_default();
                            triangles.push(FACES[tip].map(|other| vertex(corners[tip], corners[other])));
                        }
                        2 => {
                            let pair: Vec<usize> = of(true).collect();
                            // The face of one inner corner turns around the other: behind it come both outer ones.
                            let around = FACES[pair[0]];
                            let at = around.iter().position(|&c| c == pair[1]).unwrap_or_default();
                            let (next, last) = (around[(at + 1) % 3], around[(at + 2) % 3]);
                            let quad = [(pair[0], next), (pair[0], last), (pair[1], last), (pair[1], next)]
                                .map(|(a, b)| vertex(corners[a], corners[b]));
                            triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
                        }
                        3 => {
                            let tip = of(false).next().unwrap_or_default();
                            let [a, b, c] = FACES[tip].map(|other| vertex(corners[other], corners[tip]));
                            triangles.push([a, c, b]);
                        }
                        _ => {}
                    }
                }
            }
        }
    }
    surface.triangles = triangles;
    surface
}

/// The mesh, m.
pub(crate) fn dinosaur() -> TetMesh {
    let surface = surface();
    assert_eq!(surface.fault(), None);
    fill(&surface, CELL_SIZE).expect("the surface has no fault and the cells are smaller")
}

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    let [out] = arguments.as_slice() else {
        eprintln!("usage: dinosaur OUT.vtu");
        return ExitCode::from(2);
    };
    match write_mesh(Path::new(out), &dinosaur()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            error.exit_code().into()
        }
    }
}
