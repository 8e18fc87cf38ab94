//! Thesis, section 6.4: an elastic block at rest in a liquid at rest, both known exactly, as a slab between two walls.
//!
//! y is up, lengths are in m, and the liquid of density rho_f = 1 fills a tank to y = a = 0.8 under gravity g = -1. The block rests on
//! \[0, 0.4\] x \[0, 0.4\] and is deformed by
//!
//! ```text
//! x = alpha X + x1,  y = beta Y^2 + gamma Y + y1,  z = Z                                  (6.1)
//! beta = -alpha (y2 - y1) rho_f g / (2 tau0 (2 mu + lambda)),  gamma = (y2 - y1) / tau0 - beta tau0    (6.3, 6.4)
//! p = rho_f g (y - a)                                                                      (6.5)
//! T_R = P_xx(Y) + p(y(Y)) (2 beta Y + gamma) = -T_L                                        (6.6, 6.7)
//! T_T = P_yy(tau0) + alpha p(y2),  T_B = -P_yy(0) - alpha p(y1)                            (6.8, 6.9)
//! rho_s = alpha (y2 - y1) rho_f / tau0                                                     (6.10)
//! P_xx = (2 mu + lambda) (alpha - 1) + lambda (2 beta Y + gamma - 1)                       (6.2)
//! P_yy = (2 mu + lambda) (2 beta Y + gamma - 1) + lambda (alpha - 1)
//! ```
//!
//! The tractions T, per area at rest, complete the liquid's pressure to equilibrium. F is symmetric and positive: no element rotates. In three
//! dimensions the same law with F_zz = 1 has the same P_xx and P_yy; the walls along z carry P_zz.

use glam::DVec3;

use crate::Error;
use crate::elastic::Solids;
use crate::geometry::TetMesh;
use crate::scene::{Load, LoadKind, Scene, Shape, Solver};
use crate::state::State;

/// The scene but for what depends on the block and the grid.
const SCENE: &str = include_str!("plane_strain.toml");
/// Width of the tank, m; its height is 1 m.
const TANK: f64 = 0.8;
/// Cells and bricks across the slab.
const LAYERS: usize = 2;
/// a, m.
const LEVEL: f64 = 0.8;
/// L and tau0, m.
const EDGE: f64 = 0.4;
/// Bottom of the block at rest, m. Arbitrary: only differences of rest positions count.
const REST: f64 = 0.2;
/// rho_f, kg/m^3.
const DENSITY: f64 = 1.0;
/// g along y, m/s^2.
const GRAVITY: f64 = -1.0;

/// Points and weights of Gauss's rule on \[0, 1\] that is exact to degree 5.
const GAUSS: [[f64; 2]; 3] =
    [[0.112_701_665_379_258_31, 5.0 / 18.0], [0.5, 4.0 / 9.0], [0.887_298_334_620_741_7, 5.0 / 18.0]];

/// A choice of the block's material and deformation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneStrain {
    /// Shear modulus, Pa.
    pub mu: f64,
    /// First Lame parameter, Pa.
    pub lambda: f64,
    /// Stretch along x.
    pub alpha: f64,
    /// Bottom of the deformed block, m.
    pub y1: f64,
    /// Its top, m.
    pub y2: f64,
}

/// Block of table 6.5.
pub const TABLE_6_5: PlaneStrain = PlaneStrain { mu: 20.0, lambda: 10.0, alpha: 0.9, y1: 0.205, y2: 0.595 };

/// Block of table 6.6.
pub const TABLE_6_6: PlaneStrain = PlaneStrain { mu: 100.0, lambda: 100.0, alpha: 1.1, y1: 0.18, y2: 0.62 };

impl PlaneStrain {
    /// Weight of the liquid, rho_f |g|, N/m^3.
    pub const WEIGHT: f64 = -DENSITY * GRAVITY;

    /// 2 mu + lambda, Pa.
    fn modulus(&self) -> f64 {
        2.0 * self.mu + self.lambda
    }

    /// beta, 1/m.
    pub fn beta(&self) -> f64 {
        -self.alpha * (self.y2 - self.y1) * DENSITY * GRAVITY / (2.0 * EDGE * self.modulus())
    }

    /// gamma.
    pub fn gamma(&self) -> f64 {
        (self.y2 - self.y1) / EDGE - self.beta() * EDGE
    }

    /// F_yy at a height at rest, m.
    fn stretch(&self, y: f64) -> f64 {
        2.0 * self.beta() * y + self.gamma()
    }

    /// y of a height at rest, m.
    fn height(&self, y: f64) -> f64 {
        (self.beta() * y + self.gamma()) * y + self.y1
    }

    /// Pressure at a height, Pa.
    pub fn pressure(height: f64) -> f64 {
        DENSITY * GRAVITY * (height - LEVEL)
    }

    /// T_R at a height at rest, Pa.
    pub fn traction_right(&self, y: f64) -> f64 {
        let [stretch, pressure] = [self.stretch(y), PlaneStrain::pressure(self.height(y))];
        let stress = self.modulus() * (self.alpha - 1.0) + self.lambda * (stretch - 1.0);
        stress + pressure * stretch
    }

    /// T_T, and -T_B, Pa.
    pub fn tractions_up(&self) -> [f64; 2] {
        let along = |y: f64, end: f64| {
            let stress = self.modulus() * (self.stretch(y) - 1.0) + self.lambda * (self.alpha - 1.0);
            stress + self.alpha * PlaneStrain::pressure(end)
        };
        [along(EDGE, self.y2), along(0.0, self.y1)]
    }

    /// rho_s, kg/m^3.
    pub fn density(&self) -> f64 {
        self.alpha * (self.y2 - self.y1) * DENSITY / EDGE
    }

    /// Distance from the block's bottom, and by symmetry its top, to the centre of its cell, m. The error of a pressure that is constant over cells
    /// is rho g times that.
    pub fn distance(&self, dx: f64) -> f64 {
        let centre = ((self.y1 / dx).floor() + 0.5) * dx;
        (self.y1 - centre).abs()
    }

    /// The slab with `cells` cells along the tank's height, a multiple of 5, and bricks of half a cell.
    ///
    /// # Errors
    /// [`Error::Input`] when it has too many nodes.
    pub fn scene(&self, cells: usize, solver: Solver) -> Result<Scene, Error> {
        let dx = 1.0 / cells as f64;
        let [width, bricks] = [TANK / dx, 2.0 * EDGE / dx].map(|n| n.round() as usize);
        let thickness = LAYERS as f64 * dx;
        // The walls along z: the faces of the slab do not move across.
        let pins = [0.0, thickness].map(|z| {
            let [low, high] = [z - 0.1 * dx, z + 0.1 * dx];
            format!(
                "{{ region = {{ box = {{ min = [0, 0, {low:?}], max = [1, 1, {high:?}] }} }}, components = \"z\" }}"
            )
        });
        let overrides = [
            format!("domain.size[2]={thickness:?}"),
            format!("domain.cells=[{width}, {cells}, {LAYERS}]"),
            format!("solid[0].mesh.box.size[2]={thickness:?}"),
            format!("solid[0].mesh.box.cells=[{bricks}, {bricks}, {LAYERS}]"),
            format!("solid[0].placement.translate[2]={:?}", 0.5 * thickness),
            format!("solid[0].density={:?}", self.density()),
            format!("solid[0].young={:?}", self.mu * (3.0 * self.lambda + 2.0 * self.mu) / (self.lambda + self.mu)),
            format!("solid[0].poisson={:?}", 0.5 * self.lambda / (self.lambda + self.mu)),
            format!("solid[0].pin=[{}]", pins.join(", ")),
        ];
        let mut scene = Scene::parse(format!("section_6_4_{cells}.toml").as_ref(), SCENE, &overrides, 1.0)?;
        let mesh = TetMesh::new(&scene.solids[0], "section 6.4")?;
        scene.solids[0].loads = self.loads(&mesh, dx);
        scene.solver = solver;
        Ok(scene)
    }

    /// Deforms the block of a scene at its start.
    pub fn deform(&self, solids: &Solids, state: &mut State) {
        let middle = 0.5 * TANK;
        let moved = solids.rest.iter().map(|rest| {
            let y = rest.y - REST;
            [(self.alpha - 1.0) * (rest.x - middle), self.height(y) - rest.y, 0.0]
        });
        state.displacement = moved.collect();
    }

    /// The tractions as a force on each node of the four sides: their integrals times the shape functions over the sides' triangles,
    /// exact, since T_L and T_R are of degree 3 in Y.
    fn loads(&self, mesh: &TetMesh, dx: f64) -> Vec<Load> {
        let mut forces = vec![DVec3::ZERO; mesh.nodes.len()];
        let [top, bottom] = self.tractions_up();
        for nodes in mesh.surface() {
            let corners = nodes.map(|node| mesh.nodes[node as usize]);
            let [a, b, c] = corners;
            let cross = (b - a).cross(c - a);
            let (area, normal) = (0.5 * cross.length(), cross.normalize());
            let traction = |x: DVec3| {
                let right = normal.x * self.traction_right(x.y - REST);
                let up = if normal.y > 0.0 { top } else { bottom };
                DVec3::new(right, normal.y * up, 0.0)
            };
            if normal.z.abs() > 0.5 {
                continue;
            }
            // The triangle is a square with one side collapsed to the first corner.
            for [s, weight_s] in GAUSS {
                for [t, weight_t] in GAUSS {
                    let weights = [1.0 - s, s * (1.0 - t), s * t];
                    let x: DVec3 = weights.iter().zip(corners).map(|(w, x)| *w * x).sum();
                    let force = 2.0 * area * s * weight_s * weight_t * traction(x);
                    for (node, weight) in nodes.iter().zip(weights) {
                        forces[*node as usize] += weight * force;
                    }
                }
            }
        }
        let near = DVec3::splat(0.01 * dx);
        let loaded = mesh.nodes.iter().zip(forces).filter(|(_, force)| *force != DVec3::ZERO);
        loaded
            .map(|(&x, force)| Load {
                region: Shape::Box { min: x - near, max: x + near },
                kind: LoadKind::Force(force),
                keyframes: Vec::new(),
            })
            .collect()
    }
}
