//! Ordinary and ugly solids for the twin tests. What the device holds in f32 is an f32 here too, so both paths start from the
//! same numbers.

use cutwater::elastic::{Body, Solids, lame_parameters, rest_shape};
use cutwater::fields::{SolidBuffers, SolidPlan};
use cutwater::geometry::{ContactField, RigidVelocity, TetMesh};
use cutwater::gpu::{Gpu, Real};
use cutwater::grid::Grid;
use cutwater::scene::ElasticModel;
use cutwater::state::State;
use glam::{DMat3, DVec3};

use crate::common::Random;
use crate::liquid_case::{EPS, GRAVITY, single};

/// The six tetrahedra of a brick around one diagonal, as corners with bits x, y, z (Kuhn).
const KUHN: [[usize; 4]; 6] = [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];

/// A box of bricks, cut into tetrahedra.
pub(crate) fn lattice(low: DVec3, size: DVec3, cells: [usize; 3]) -> TetMesh {
    let at = |[i, j, k]: [usize; 3]| i + (cells[0] + 1) * (j + (cells[1] + 1) * k);
    let mut mesh = TetMesh::default();
    for k in 0..=cells[2] {
        for j in 0..=cells[1] {
            for i in 0..=cells[0] {
                let part = |n: usize, axis: usize| n as f64 / cells[axis] as f64;
                let part = DVec3::new(part(i, 0), part(j, 1), part(k, 2));
                mesh.nodes.push(low + part * size);
            }
        }
    }
    for k in 0..cells[2] {
        for j in 0..cells[1] {
            for i in 0..cells[0] {
                for corners in KUHN {
                    let corner = |c: usize| at([i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)]);
                    mesh.elements.push(corners.map(|c| corner(c) as u32));
                }
            }
        }
    }
    mesh
}

/// What a body is made of.
#[derive(Clone, Copy)]
pub(crate) struct Material {
    /// kg/m^3
    pub(crate) density: f64,
    /// Pa
    pub(crate) young: f64,
    pub(crate) poisson: f64,
    pub(crate) model: ElasticModel,
    /// tau_M (1/s), tau_K (s).
    pub(crate) damping: [f64; 2],
}

pub(crate) const RUBBER: Material =
    Material { density: 1100.0, young: 1e6, poisson: 0.4, model: ElasticModel::Corotational, damping: [0.0, 0.0] };

/// Solids of these meshes, nothing prescribed, no load.
pub(crate) fn solids(parts: &[(TetMesh, Material)]) -> Solids {
    let mut solids = Solids::default();
    for (number, (mesh, material)) in parts.iter().enumerate() {
        let (first_node, first_element) = (solids.rest.len(), solids.elements.len());
        let nodes: Vec<DVec3> = mesh.nodes.iter().map(|x| x.as_vec3().as_dvec3()).collect();
        solids.mass.resize(first_node + nodes.len(), 0.0);
        for element in &mesh.elements {
            let (gradients, volume) = rest_shape(element.map(|node| nodes[node as usize]));
            assert!(volume > 0.0, "orientation of the mesh");
            solids.gradients.push(gradients);
            solids.volume.push(volume);
            solids.elements.push(element.map(|n| n + first_node as u32));
            for node in element {
                solids.mass[first_node + *node as usize] += 0.25 * material.density * volume;
            }
        }
        solids.rest.extend(nodes);
        let [lambda, mu] = lame_parameters(material.young, material.poisson);
        solids.bodies.push(Body {
            name: format!("body {number}"),
            nodes: first_node..solids.rest.len(),
            elements: first_element..solids.elements.len(),
            triangles: 0..0,
            density: material.density,
            lambda,
            mu,
            model: material.model,
            mass_damping: single(material.damping[0]),
            stiffness_damping: single(material.damping[1]),
            friction: 0.0,
            contact: true,
            no_contact_with: Vec::new(),
            self_contact: false,
        });
    }
    solids.mass.iter_mut().for_each(|mass| *mass = single(*mass));
    let n = solids.rest.len();
    solids.prescribed = vec![[false; 3]; n];
    solids.load = vec![DVec3::ZERO; n];
    solids
}

/// Solids in a state.
pub(crate) struct SolidCase {
    pub(crate) name: &'static str,
    pub(crate) grid: Grid,
    pub(crate) solids: Solids,
    /// m
    pub(crate) displacement: Vec<[f64; 3]>,
    /// m/s
    pub(crate) velocity: Vec<[f64; 3]>,
    /// What prescribed components move with, m/s; empty without scripts.
    pub(crate) scripted: Vec<[f64; 3]>,
    /// Distance of cell centres to the obstacles, m; empty without.
    pub(crate) solid_distance: Vec<f64>,
    /// Motion of the obstacle, if it moves.
    pub(crate) motion: Option<RigidVelocity>,
    /// s
    pub(crate) dt: f64,
}

impl SolidCase {
    /// At rest in a domain of 1.2 x 1.2 x 2 m.
    pub(crate) fn new(name: &'static str, solids: Solids) -> SolidCase {
        let n = solids.rest.len();
        SolidCase {
            name,
            grid: Grid { cells: [12, 12, 20], dx: 0.1 },
            solids,
            displacement: vec![[0.0; 3]; n],
            velocity: vec![[0.0; 3]; n],
            scripted: Vec::new(),
            solid_distance: Vec::new(),
            motion: None,
            dt: single(1.0 / 120.0),
        }
    }

    /// Puts every node where `x` says, as nearly as two f32 can.
    pub(crate) fn deformed(mut self, x: impl Fn(DVec3) -> DVec3) -> SolidCase {
        for (u, &rest) in self.displacement.iter_mut().zip(&self.solids.rest) {
            *u = pair(x(rest) - rest);
        }
        self
    }

    /// Adds noise to displacement (m) and velocity (m/s).
    pub(crate) fn shaken(mut self, length: f64, speed: f64) -> SolidCase {
        let mut random = Random(self.displacement.len() as u64);
        for u in &mut self.displacement {
            let noise = DVec3::from(std::array::from_fn(|_| random.uniform(-length, length)));
            *u = pair(DVec3::from(*u) + noise);
        }
        for v in self.velocity.iter_mut().flatten() {
            *v = single(random.uniform(-speed, speed));
        }
        self
    }

    /// The scalar type that the device uses.
    pub(crate) fn reals(gpu: &Gpu) -> Vec<Real> {
        let mut reals = vec![Real::F32];
        reals.extend(gpu.has_f64().then_some(Real::F64));
        reals
    }

    /// The state, and no liquid.
    pub(crate) fn state(&self) -> State {
        let mut state = State::at_rest(&self.grid);
        state.displacement.clone_from(&self.displacement);
        state.node_velocity.clone_from(&self.velocity);
        state
    }

    /// The device's buffers in this state.
    pub(crate) fn upload(&self, gpu: &Gpu, real: Real) -> SolidBuffers {
        let plan = SolidPlan {
            scripts: !self.scripted.is_empty(),
            obstacles: !self.solid_distance.is_empty(),
            n_moving: self.motion.iter().len(),
            ..SolidPlan::new(self.grid, &self.solids, real)
        };
        let buffers = SolidBuffers::new(gpu, plan, &self.solids).unwrap();
        buffers.write_state(gpu, &self.state());
        buffers.write_prescribed(gpu, &self.scripted);
        buffers.write_motions(gpu, &self.obstacles());
        gpu.upload(&buffers.step, &[buffers.step_of(GRAVITY.into(), self.dt)]);
        buffers
    }

    /// The obstacles.
    pub(crate) fn obstacles(&self) -> ContactField {
        let mut distance = self.solid_distance.clone();
        distance.resize(self.grid.n_cells(), 3.0 * self.grid.dx);
        let mut field = ContactField::at_rest(&self.grid, distance);
        if let Some(motion) = self.motion {
            field.nearest = vec![1; self.grid.n_cells()];
            field.motions = vec![motion];
        }
        field
    }

    /// Largest magnitude of a velocity component, m/s.
    pub(crate) fn speed(&self) -> f64 {
        let components = self.velocity.iter().chain(&self.scripted).flatten();
        components.fold(0.0, |fastest, v| f64::max(fastest, v.abs()))
    }
}

/// Half the distance between neighbouring numbers of a scalar type around 1.
pub(crate) fn eps(real: Real) -> f64 {
    match real {
        Real::F32 => EPS,
        Real::F64 => 0.5 * f64::EPSILON,
    }
}

/// The nearest sums of two f32.
pub(crate) fn pair(u: DVec3) -> [f64; 3] {
    u.to_array().map(|u| single(u) + single(u - single(u)))
}

/// The hanging beam of the base scene, bent by half a radian (numerics.md): rest shape along z, 2 x 2 x 14 bricks.
pub(crate) fn bent_beam() -> SolidCase {
    let low = DVec3::new(0.43, 0.47, 0.24);
    let mesh = lattice(low, DVec3::new(0.08, 0.08, 0.56), [2, 2, 14]);
    SolidCase::new("bent beam", solids(&[(mesh, RUBBER)])).deformed(|x| {
        let s = 0.8 - x.z;
        let (angle, curvature, xi) = (0.5 * s / 0.56, 0.5 / 0.56, x.x - 0.47);
        DVec3::new(
            0.47 + (1.0 - angle.cos()) / curvature + xi * angle.cos(),
            x.y + 0.02 * (3.0 * s).sin(),
            0.8 - angle.sin() / curvature + xi * angle.sin(),
        )
    })
}

/// All cases. Nodes and elements are no multiples of a workgroup on purpose.
pub(crate) fn cases() -> Vec<SolidCase> {
    let middle = DVec3::splat(0.6);
    let cube = || lattice(DVec3::splat(0.4), DVec3::splat(0.4), [3, 2, 2]);
    let one = || {
        solids(&[(
            TetMesh {
                nodes: vec![
                    middle,
                    middle + DVec3::new(0.25, 0.0, 0.125),
                    middle + DVec3::new(0.0, 0.5, 0.0),
                    middle + DVec3::new(0.0, -0.125, 0.25),
                ],
                elements: vec![[0, 1, 2, 3]],
            },
            RUBBER,
        )])
    };
    let stiff = Material { density: 7800.0, young: 2e11, poisson: 0.3, damping: [0.5, 1e-3], ..RUBBER };
    let linear = Material { young: 1e3, poisson: 0.49, model: ElasticModel::Linear, damping: [0.0, 0.25], ..RUBBER };
    let stack = || {
        let other = lattice(DVec3::new(0.3, 0.35, 0.9), DVec3::new(0.5, 0.4, 0.6), [2, 1, 3]);
        solids(&[(cube(), RUBBER), (other, linear), (one_tetrahedron(), stiff)])
    };
    let squash = |scale: DVec3| move |x: DVec3| middle + scale * (x - middle);
    let mut scripted = SolidCase::new("scripted", stack()).shaken(1e-3, 3.0);
    let mut random = Random(5);
    for node in 0..scripted.solids.rest.len() {
        scripted.solids.prescribed[node] = std::array::from_fn(|_| random.uniform(0.0, 1.0) < 0.4);
        scripted.scripted.push(std::array::from_fn(|_| single(random.uniform(-2.0, 2.0))));
    }
    let mut pinned = SolidCase::new("outside", stack()).shaken(2.0, 5.0);
    for node in 0..pinned.solids.rest.len() {
        pinned.solids.prescribed[node] = std::array::from_fn(|axis| (node + axis) % 3 == 0);
    }
    // Held along an edge, in the middle of it too, and in a corner.
    let held = |name, shift: f64, speed: f64, held: &dyn Fn(DVec3) -> bool| {
        let mut case = SolidCase::new(name, solids(&[(cube(), RUBBER)])).shaken(shift, speed);
        for node in 0..case.solids.rest.len() {
            if held(case.solids.rest[node]) {
                case.solids.prescribed[node] = [true; 3];
                (case.displacement[node], case.velocity[node]) = ([0.0; 3], [0.0; 3]);
            }
        }
        case
    };
    // Rollers on two faces: it moves and turns in the plane y, z.
    let mut rollers = SolidCase::new("on rollers", solids(&[(cube(), RUBBER)])).shaken(1e-2, 4.0);
    for node in 0..rollers.solids.rest.len() {
        let x = rollers.solids.rest[node].x;
        if !(0.41..0.79).contains(&x) {
            rollers.solids.prescribed[node] = [true, false, false];
            (rollers.displacement[node][0], rollers.velocity[node][0]) = (0.0, 0.0);
        }
    }
    let on_edge = |x: DVec3| x.x < 0.41 && x.y < 0.41;
    let mut denormal = SolidCase::new("denormals", one()).shaken(1e-41, 1e-40);
    denormal.displacement[1] = pair(DVec3::new(1e-30, -1e-38, 5e-45));
    vec![
        bent_beam(),
        bent_beam().shaken(1e-2, 4.0),
        SolidCase::new("one element", one()).shaken(0.05, 1.0),
        SolidCase::new("at rest", stack()),
        held("on a hinge", 1e-2, 4.0, &on_edge),
        held("held in a point", 1e-2, 4.0, &|x| on_edge(x) && x.z < 0.41),
        held("at rest on a hinge", 0.0, 0.0, &on_edge),
        rollers,
        SolidCase::new("turned", solids(&[(cube(), RUBBER)]))
            .deformed(|x| middle + DMat3::from_axis_angle(DVec3::ONE.normalize(), 2.5) * (x - middle)),
        SolidCase::new("squashed", solids(&[(cube(), RUBBER)])).deformed(squash(DVec3::splat(0.5))).shaken(1e-3, 1.0),
        SolidCase::new("inside out", solids(&[(cube(), RUBBER)]))
            .deformed(squash(DVec3::splat(-1.0)))
            .shaken(1e-2, 1.0),
        SolidCase::new("mirrored", solids(&[(cube(), RUBBER)])).deformed(squash(DVec3::new(1.0, 1.0, -1.0))),
        SolidCase::new("flat", solids(&[(cube(), RUBBER)])).deformed(squash(DVec3::new(1.0, 1.0, 0.0))),
        SolidCase::new("on a line", solids(&[(cube(), RUBBER)])).deformed(squash(DVec3::new(0.0, 1.0, 0.0))),
        SolidCase::new("in a point", solids(&[(cube(), RUBBER)])).deformed(squash(DVec3::ZERO)),
        SolidCase::new("needles", solids(&[(cube(), RUBBER)]))
            .deformed(squash(DVec3::new(0.1, 3.0, 0.1)))
            .shaken(1e-3, 1.0),
        SolidCase::new("crumpled", solids(&[(cube(), RUBBER)])).shaken(0.5, 10.0),
        scripted,
        pinned,
        denormal,
    ]
}

/// A small tetrahedron of its own.
fn one_tetrahedron() -> TetMesh {
    let low = DVec3::new(0.125, 0.125, 1.5);
    TetMesh {
        nodes: vec![
            low,
            low + DVec3::new(0.125, 0.0, 0.0),
            low + DVec3::new(0.0, 0.125, 0.0),
            low + DVec3::new(0.0, 0.0, 0.125),
        ],
        elements: vec![[0, 1, 2, 3]],
    }
}
