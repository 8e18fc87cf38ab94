//! The three ways a scene of solids is computed, behind one face.

use cutwater::elastic::{Solids, forces};
use cutwater::gpu::AdapterChoice;
use cutwater::linalg::dot;
use cutwater::reference::larger;
use cutwater::scene::{Precision, Scene};
use cutwater::sim::{Backend, GpuPath, Simulation};
use cutwater::state::{SolidReport, SolveStatus, State};
use cutwater::step::Stage;
use glam::{DMat3, DVec3};

use crate::solid_modes::{sized, weights};
use crate::solid_scene::solids_of;

/// Tolerance of solves in f32.
const F32_TOLERANCE: f64 = 1e-6;

/// Where and how precisely a case is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lane {
    /// The f64 path.
    F64,
    /// The device: unknowns and residual in f64, corrections in f32.
    Mixed,
    /// The device, all in f32.
    F32,
}

impl Lane {
    pub(crate) const ALL: [Lane; 3] = [Lane::F64, Lane::Mixed, Lane::F32];
    /// Those whose numbers are good to more than six digits.
    pub(crate) const PRECISE: [Lane; 2] = [Lane::F64, Lane::Mixed];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Lane::F64 => "f64",
            Lane::Mixed => "mixed",
            Lane::F32 => "f32",
        }
    }

    /// Where it is computed.
    pub(crate) fn backend(self) -> Backend {
        match self {
            Lane::F64 => Backend::Cpu,
            Lane::Mixed | Lane::F32 => Backend::Gpu(AdapterChoice::Best),
        }
    }

    /// One of three numbers.
    pub(crate) fn choose<T>(self, f64: T, mixed: T, f32: T) -> T {
        match self {
            Lane::F64 => f64,
            Lane::Mixed => mixed,
            Lane::F32 => f32,
        }
    }

    /// The scene in the precision of this lane.
    fn in_precision(self, scene: &Scene) -> Scene {
        let mut scene = scene.clone();
        scene.solver.precision = match self {
            Lane::F32 => Precision::F32,
            _ => Precision::Mixed,
        };
        if self == Lane::F32 {
            scene.solver.tolerance = scene.solver.tolerance.max(F32_TOLERANCE);
        }
        scene
    }

    /// The same, solved as well as it can.
    fn adapt(self, scene: &Scene) -> Scene {
        let mut scene = self.in_precision(scene);
        scene.solver.tolerance = self.choose(1e-10, 1e-10, F32_TOLERANCE);
        scene.solver.max_iterations = 5000;
        scene
    }
}

/// A scene of solids in motion.
pub(crate) struct Motion {
    pub(crate) solids: Solids,
    pub(crate) simulation: Simulation,
    lane: Lane,
    /// s
    pub(crate) dt: f64,
}

impl Motion {
    /// With steps of dt (s), in the state that the scene starts in, solved as well as the lane can.
    pub(crate) fn new(lane: Lane, scene: &Scene, dt: f64) -> Motion {
        Motion::of(lane, lane.adapt(scene), dt)
    }

    /// The same, solved as the scene says.
    pub(crate) fn as_users_do(lane: Lane, scene: &Scene, dt: f64) -> Motion {
        Motion::of(lane, lane.in_precision(scene), dt)
    }

    fn of(lane: Lane, mut scene: Scene, dt: f64) -> Motion {
        // Every step ends a frame: no dt is stretched to fit one.
        scene.time.frames_per_second = 1.0 / dt;
        scene.time.fixed_step = Some(dt);
        Motion { solids: solids_of(&scene), simulation: Simulation::new(&scene, &lane.backend()).unwrap(), lane, dt }
    }

    pub(crate) fn state(&self) -> State {
        self.simulation.state().unwrap()
    }

    /// Puts the nodes somewhere else, at rest.
    pub(crate) fn put(&mut self, displacement: &[[f64; 3]]) {
        let mut state = self.state();
        state.displacement = displacement.to_vec();
        state.node_velocity = vec![[0.0; 3]; displacement.len()];
        self.simulation.reset(&state).unwrap();
    }

    /// One step. In f32 a tolerance may be missed; in the others that is a failure.
    pub(crate) fn step(&mut self) -> SolidReport {
        let report = self.simulation.step().unwrap();
        let solid = report.solid.unwrap();
        let status = solid.solve.status;
        let excused = self.lane == Lane::F32 && status == SolveStatus::Stagnated;
        assert!(excused || status == SolveStatus::Converged, "the solve ended with {report:?}");
        solid
    }

    /// Displacement (m) under the loads, from rest, by steps so long that inertia counts for little; `accuracy`: relative to the largest.
    pub(crate) fn static_displacement(&mut self, accuracy: f64) -> Vec<[f64; 3]> {
        for _ in 0..30 {
            self.step();
            let state = self.state();
            let [u, v] = [&state.displacement, &state.node_velocity].map(|x| largest(x));
            if u > 0.0 && self.dt * v <= accuracy * u {
                return state.displacement;
            }
        }
        panic!("the load is not carried after 30 steps");
    }

    /// Amplitudes of a shape of unit modal mass in a motion that starts from it, at rest: one per step.
    pub(crate) fn ring(&mut self, shape: &[f64], size: f64, steps: usize) -> Vec<f64> {
        let weights = weights(&self.solids, shape);
        self.put(&sized(shape, size));
        (0..steps)
            .map(|_| {
                self.step();
                dot(&weights, self.state().displacement.as_flattened())
            })
            .collect()
    }

    /// Momentum (kg m/s) and angular momentum about the origin (kg m^2/s), from the state, with the masses that the lane has.
    pub(crate) fn momenta(&self) -> [DVec3; 2] {
        let State { displacement, node_velocity, .. } = self.state();
        let mut sums = [DVec3::ZERO; 2];
        for (node, (u, v)) in displacement.iter().zip(&node_velocity).enumerate() {
            let mass = self.solids.mass[node];
            let mass = self.lane.choose(mass, f64::from(mass as f32), f64::from(mass as f32));
            let momentum = mass * DVec3::from(*v);
            sums[0] += momentum;
            sums[1] += (self.solids.rest[node] + DVec3::from(*u)).cross(momentum);
        }
        sums
    }
}

/// Largest magnitude of a component; not a number where one is not.
pub(crate) fn largest(x: &[[f64; 3]]) -> f64 {
    let components = x.as_flattened().iter();
    components.fold(0.0, |largest, x| larger(largest, x.abs()))
}

/// Elements of a scene in a state.
pub(crate) struct Elements {
    /// R g_a of corners 1, 2, 3, 1/m.
    pub(crate) rotated: Vec<[DVec3; 3]>,
    /// K x* - b at the four corners, N.
    pub(crate) forces: Vec<[DVec3; 4]>,
}

/// Shows elements in one state after another.
pub(crate) struct Probe {
    pub(crate) solids: Solids,
    device: Option<GpuPath>,
}

impl Probe {
    pub(crate) fn new(lane: Lane, scene: &Scene) -> Probe {
        let scene = lane.adapt(scene);
        let device = match lane {
            Lane::F64 => None,
            _ => Some(GpuPath::open(&scene, &AdapterChoice::Best).unwrap()),
        };
        Probe { solids: solids_of(&scene), device }
    }

    /// With these displacements, m.
    pub(crate) fn elements(&mut self, displacement: &[[f64; 3]]) -> Elements {
        match &mut self.device {
            None => Self::of_reference(&self.solids, displacement),
            Some(device) => Self::of_device(device, displacement),
        }
    }

    fn of_reference(solids: &Solids, displacement: &[[f64; 3]]) -> Elements {
        let elements = 0..solids.elements.len();
        let all = elements.map(|element| {
            let (gradients, volume) = (&solids.gradients[element], solids.volume[element]);
            let body = solids.body_of_element(element);
            let deformation = solids.deformation(element, displacement);
            let turned = [1, 2, 3].map(|corner| deformation.rotation * gradients[corner]);
            let forces = forces(gradients, volume, &deformation, body.lambda, body.mu);
            (turned, forces)
        });
        let (rotated, forces) = all.unzip();
        Elements { rotated, forces }
    }

    fn of_device(device: &mut GpuPath, displacement: &[[f64; 3]]) -> Elements {
        device
            .write_state(&State {
                displacement: displacement.to_vec(),
                node_velocity: vec![[0.0; 3]; displacement.len()],
                ..State::default()
            })
            .unwrap();
        let mut seen = None;
        let observer = &mut |stage: Stage, path: &GpuPath| {
            if stage == Stage::SolidMatrices {
                seen = path.snapshot()?.solids;
            }
            Ok(())
        };
        device.step_observed(observer).unwrap();
        let seen = seen.expect("a scene of solids has this stage");
        let elements = 0..seen.rotated[0].len();
        let all = elements.map(|element| {
            let turned = [0, 1, 2].map(|corner| {
                let [x, y, z, _] = seen.rotated[corner][element];
                DVec3::new(x, y, z)
            });
            let [a, b, c] = [0, 1, 2].map(|corner| DVec3::from(seen.element_forces[corner][element]));
            (turned, [-(a + b + c), a, b, c])
        });
        let (rotated, forces) = all.unzip();
        Elements { rotated, forces }
    }

    /// Largest force that all elements together put on a node, N.
    pub(crate) fn largest_on_nodes(&self, elements: &Elements, counts: impl Fn(usize) -> bool) -> f64 {
        let mut sums = vec![DVec3::ZERO; self.solids.rest.len()];
        for (nodes, forces) in self.solids.elements.iter().zip(&elements.forces) {
            for (node, force) in nodes.iter().zip(forces) {
                sums[*node as usize] += force;
            }
        }
        let counted = sums.iter().enumerate().filter(|(node, _)| counts(*node));
        counted.fold(0.0, |most, (_, force)| larger(most, force.length()))
    }
}

/// Displacements that take nodes to where a matrix puts them about a point.
pub(crate) fn affine(solids: &Solids, matrix: DMat3, about: DVec3) -> Vec<[f64; 3]> {
    let difference = matrix - DMat3::IDENTITY;
    let nodes = solids.rest.iter();
    nodes.map(|&x| (difference * (x - about)).to_array()).collect()
}
