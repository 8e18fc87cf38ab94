//! Scenes: TOML files, checked and converted to descriptions in SI units by [`Scene::load`].

mod camera;
mod document;
mod merge;
mod mesh_file;
mod probe;
mod read;
pub mod schema;
mod shape;
mod slab;
mod solid;
mod sources_sinks;
mod suggestions;
mod surface;
mod without;

use std::collections::BTreeMap;
use std::path::PathBuf;

use glam::{DMat3, DVec3};

use crate::grid::{Grid, Sides};

pub use camera::PICTURE_SIDES;
pub use document::Origins;
use document::{Origin, option};
pub use merge::{Part, from_toml, merge};
pub use mesh_file::MeshFile;
pub use read::MAX_FRAMES;
pub(crate) use read::MAX_VELOCITY;
pub(crate) use shape::box_reaches;
pub use slab::Slab;
pub use without::{override_option, without};

/// A checked scene, all in SI units. Lengths and times are finite, counts are positive, regions and obstacles have volume.
#[derive(Clone, Debug)]
pub struct Scene {
    /// File stem.
    pub name: String,
    /// Path of the scene file.
    pub file: PathBuf,
    /// Origins of its values, for [`Scene::at`].
    pub origins: Origins,
    /// SHA-256 of the file's text, all overrides and the scale, in hexadecimal.
    pub hash: String,
    /// Values that the file and the overrides give, as TOML by dotted key. A list without tables is one value.
    pub values: BTreeMap<String, String>,
    /// SHA-256 of the mesh files, in hexadecimal, by their paths from the scene's folder.
    pub meshes: BTreeMap<String, String>,
    /// Parts that were removed because they refer to one that an override removed ([`without`]), by key or name.
    pub removed: Vec<String>,
    /// `--scale`, already applied to [`Domain::cells`].
    pub scale: f64,
    /// `--set` overrides, as given, and removals ([`without`]).
    pub overrides: Vec<String>,
    /// Box, cells, gravity.
    pub domain: Domain,
    /// Duration and time steps.
    pub time: Time,
    /// The liquid, if the scene has one.
    pub liquid: Option<Liquid>,
    /// Elastic bodies.
    pub solids: Vec<Solid>,
    /// Rigid obstacles and containers.
    pub obstacles: Vec<Obstacle>,
    /// Regions that emit liquid.
    pub sources: Vec<Source>,
    /// Regions that remove liquid.
    pub sinks: Vec<Sink>,
    /// Measurements written to probes.csv.
    pub probes: Vec<Probe>,
    /// Solver settings of a sub-step.
    pub solver: Solver,
    /// Files of a run.
    pub output: Output,
    /// Settings of the liquid's surface mesh.
    pub surface: SurfaceMesh,
    /// Camera of `preview`.
    pub camera: Camera,
}

/// The domain: a box with walls on all sides except the open ones.
#[derive(Clone, Debug)]
pub struct Domain {
    /// Extents, m.
    pub size: DVec3,
    /// Cells along x, y, z; cubic to 1e-6.
    pub cells: [usize; 3],
    /// Gravity, m/s^2. With keyframes that at the start, and in the scene of a backend its mean over the last sub-step.
    pub gravity: DVec3,
    /// Gravity over time, ascending; empty if it is constant.
    pub gravity_keyframes: Vec<VectorKeyframe>,
    /// Sides through which liquid leaves, with pressure 0.
    pub open: Sides,
    /// Sides that are planes of symmetry: solids are cut there.
    pub symmetry: Sides,
    /// Plane problem, if it is one.
    pub slab: Option<Slab>,
    /// Coefficient of friction of the walls; default 0.
    pub friction: f64,
}

/// A vector at one time. Linear between keyframes, constant before the first and after the last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VectorKeyframe {
    /// s
    pub time: f64,
    /// In the unit of what it is for.
    pub value: DVec3,
}

impl VectorKeyframe {
    /// Value at a time (s) of at least one keyframe.
    pub fn at(keyframes: &[VectorKeyframe], time: f64) -> DVec3 {
        let after = keyframes.partition_point(|frame| frame.time <= time);
        let last = keyframes.len() - 1;
        let [a, b] = [after.saturating_sub(1), after.min(last)].map(|frame| keyframes[frame]);
        match b.time > a.time {
            true => a.value.lerp(b.value, ((time - a.time) / (b.time - a.time)).clamp(0.0, 1.0)),
            false => a.value,
        }
    }

    /// Mean between two times (s): an acceleration or a force has its exact impulse.
    pub fn mean(keyframes: &[VectorKeyframe], [from, to]: [f64; 2]) -> DVec3 {
        let at = |time| VectorKeyframe::at(keyframes, time);
        if to <= from {
            return at(from);
        }
        let within = keyframes.iter().map(|frame| frame.time);
        let within = within.filter(|time| (from..to).contains(time));
        let (mut sum, mut last) = (DVec3::ZERO, from);
        for time in within.chain([to]) {
            sum += 0.5 * (time - last) * (at(last) + at(time));
            last = time;
        }
        sum / (to - from)
    }
}

impl Domain {
    /// Mean gravity between two times (s), m/s^2.
    pub fn mean_gravity(&self, times: [f64; 2]) -> DVec3 {
        match &self.gravity_keyframes[..] {
            [] => self.gravity,
            keyframes => VectorKeyframe::mean(keyframes, times),
        }
    }

    /// Largest magnitude of gravity between two times (s), m/s^2.
    pub fn strongest_gravity(&self, [from, to]: [f64; 2]) -> f64 {
        let keyframes = &self.gravity_keyframes;
        if keyframes.is_empty() {
            return self.gravity.length();
        }
        // The magnitude of a linear function is largest at an end.
        let within = keyframes.iter().filter(|frame| (from..=to).contains(&frame.time));
        let ends = [from, to].map(|time| VectorKeyframe::at(keyframes, time));
        let all = within.map(|frame| frame.value).chain(ends);
        all.map(DVec3::length).fold(0.0, f64::max)
    }

    /// Largest magnitude of each component of gravity at any time, m/s^2.
    pub fn largest_gravity(&self) -> DVec3 {
        let keyframes = self.gravity_keyframes.iter();
        let all = keyframes.map(|frame| frame.value.abs());
        all.reduce(DVec3::max).unwrap_or(self.gravity.abs())
    }
}

/// Shortest sub-step over the duration.
pub const SHORTEST_STEP: f64 = 1e-7;

/// Duration and time steps.
#[derive(Clone, Debug)]
pub struct Time {
    /// s
    pub duration: f64,
    /// 1/s; default 24.
    pub frames_per_second: f64,
    /// Cells that the fastest point crosses in a sub-step; default 3.
    pub cfl: f64,
    /// A constant sub-step, s; divides the frame time.
    pub fixed_step: Option<f64>,
    /// Longest sub-step, s.
    pub max_step: Option<f64>,
}

/// The liquid.
#[derive(Clone, Debug)]
pub struct Liquid {
    /// kg/m^3; default 1000.
    pub density: f64,
    /// Initial liquid: the union of the regions, less those that subtract, in order.
    pub regions: Vec<Region>,
    /// Representation of the surface; default a level, with keys that act on markers alone markers.
    pub surface: Surface,
    /// Marker radius in cells; default 0.87.
    pub marker_radius: f64,
    /// Seed of the marker jitter; default 0.
    pub seed: u64,
    /// Whether the volume is controlled; default on with a surface that moves, always off with `fixed`.
    pub volume_control: bool,
    /// Liquid that may leave walls, obstacles and solids; default none.
    pub separation: Separation,
}

/// Representation of the liquid's surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    /// Union of spheres around markers.
    Markers,
    /// A level set on the grid, bounded by markers in a band below it.
    Level,
    /// The exact distance to the regions during the whole run.
    Fixed,
}

/// Cells whose liquid may leave the walls, obstacles and solids beside it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Separation {
    /// None: liquid is pulled along.
    None,
    /// All.
    Walls,
    /// Those beside air, and beside cells that separated in the last sub-step.
    FromAir,
}

/// A region of initial liquid.
#[derive(Clone, Debug)]
pub struct Region {
    /// Shape before its placement.
    pub shape: Shape,
    /// Placement of a box, ball, cylinder or mesh.
    pub placement: Placement,
    /// Whether it subtracts liquid.
    pub subtract: bool,
    /// Initial velocity, m/s.
    pub velocity: DVec3,
}

/// A solid shape in domain coordinates (m).
#[derive(Clone, Debug)]
pub enum Shape {
    /// An axis-aligned box before its placement.
    Box {
        /// Low corner.
        min: DVec3,
        /// High corner.
        max: DVec3,
    },
    /// A ball.
    Sphere {
        /// Centre.
        centre: DVec3,
        /// Radius.
        radius: f64,
    },
    /// A right circular cylinder.
    Cylinder {
        /// Centre of its base.
        base: DVec3,
        /// Unit axis from the base.
        axis: DVec3,
        /// Radius.
        radius: f64,
        /// Height along the axis.
        height: f64,
    },
    /// All points with (x - point) . normal < 0. Regions only.
    HalfSpace {
        /// A point of the plane.
        point: DVec3,
        /// Unit normal, out of the half space.
        normal: DVec3,
    },
    /// All points below y = level + amplitude cos(k . (x, z) + phase). Regions only; for waves.
    Wave {
        /// Mean height, m.
        level: f64,
        /// m
        amplitude: f64,
        /// Wave numbers along x and z, rad/m.
        wave_number: [f64; 2],
        /// rad
        phase: f64,
    },
    /// All points below a solitary wave, with its own velocity field. Regions only.
    Solitary(SolitaryWave),
    /// A closed triangle mesh (OBJ, STL, PLY).
    Mesh {
        /// OBJ, STL or PLY.
        file: MeshFile,
        /// Length unit of the file, m.
        unit: f64,
    },
}

/// Initial solitary wave over the floor y = 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolitaryWave {
    /// Depth of the water at rest, m.
    pub depth: f64,
    /// Height of the crest above the water at rest, m.
    pub height: f64,
    /// Coordinates x and z of a point of the crest, m.
    pub crest: [f64; 2],
    /// Unit vector of propagation along x and z.
    pub direction: [f64; 2],
    /// Magnitude of gravity, m/s^2, which determines the speed.
    pub gravity: f64,
}

/// Scale and rotation about the centre of a shape or mesh, then a translation.
///
/// The centre is [`Shape::centre`], the origin for boxes, balls and shells of solids, and the centre of the bounding box for
/// files.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// m
    pub translate: DVec3,
    /// A rotation.
    pub rotate: DMat3,
    /// Uniform scale.
    pub scale: f64,
    /// Position of the centre, m, instead of a translation. Only for files, whose centre is unknown before they are parsed.
    pub at: Option<DVec3>,
}

impl Default for Placement {
    /// The identity.
    fn default() -> Placement {
        Placement { translate: DVec3::ZERO, rotate: DMat3::IDENTITY, scale: 1.0, at: None }
    }
}

impl Placement {
    /// The same placement of a shape with this centre (m), with `at` converted to a translation.
    pub fn about(self, centre: DVec3) -> Placement {
        match self.at {
            Some(at) => Placement { translate: at - centre, at: None, ..self },
            None => self,
        }
    }

    /// Whether it is the identity.
    pub fn is_none(&self) -> bool {
        let Placement { translate, rotate, scale, at } = *self;
        translate == DVec3::ZERO && rotate == DMat3::IDENTITY && scale == 1.0 && at.is_none()
    }

    /// Placed position of a point of a shape with this centre, m.
    pub fn put(&self, x: DVec3, centre: DVec3) -> DVec3 {
        centre + self.scale * (self.rotate * (x - centre)) + self.translate
    }
}

/// An elastic body.
#[derive(Clone, Debug)]
pub struct Solid {
    /// Name, unique in the scene.
    pub name: String,
    /// Source of its tetrahedra.
    pub mesh: SolidMesh,
    /// Placement of the mesh. The placed mesh is the stress-free rest shape.
    pub placement: Placement,
    /// Factors of the placed mesh along the axes: 1 but across a [`Slab`].
    pub stretch: DVec3,
    /// Difference of the initial state from rest.
    pub initial: Initial,
    /// kg/m^3
    pub density: f64,
    /// Young's modulus, Pa.
    pub young: f64,
    /// Poisson's ratio, in (-1, 0.5).
    pub poisson: f64,
    /// Strain measure; default corotational.
    pub model: ElasticModel,
    /// Rayleigh damping: coefficient of the mass, 1/s; default 0.
    pub mass_damping: f64,
    /// Rayleigh damping: coefficient of the stiffness, s; default 0.
    pub stiffness_damping: f64,
    /// Coefficient of friction; default 0.
    pub friction: f64,
    /// Whether it touches other solids; default true.
    pub contact: bool,
    /// Indices of solids that it does not touch.
    pub no_contact_with: Vec<usize>,
    /// Whether its surface touches itself; default false.
    pub self_contact: bool,
    /// Constrained or scripted nodes.
    pub pins: Vec<Pin>,
    /// Forces.
    pub loads: Vec<Load>,
}

/// Source of the tetrahedra of a solid, in coordinates before the placement (m).
#[derive(Clone, Debug)]
pub enum SolidMesh {
    /// A box of cubes or bricks, each cut into six tetrahedra around one diagonal (Kuhn), centred at the origin.
    Box {
        /// Extents, m.
        size: DVec3,
        /// Bricks along x, y, z.
        cells: [usize; 3],
    },
    /// A ball about the origin.
    Sphere {
        /// Radius, m.
        radius: f64,
        /// Approximate length of an edge, m.
        cell_size: f64,
    },
    /// A hollow ball about the origin.
    Shell {
        /// Outer radius, m.
        radius: f64,
        /// m
        thickness: f64,
        /// Approximate length of an edge, m.
        cell_size: f64,
    },
    /// Tetrahedra of a Gmsh 4.1 .msh or a VTK .vtu file.
    File {
        /// .msh or .vtu.
        file: MeshFile,
        /// Length unit of the file, m.
        unit: f64,
    },
    /// The inside of a closed triangle mesh (OBJ, STL, PLY), filled.
    Surface {
        /// OBJ, STL or PLY.
        file: MeshFile,
        /// Length unit of the file, m.
        unit: f64,
        /// Approximate length of an edge, m.
        cell_size: f64,
    },
}

impl SolidMesh {
    /// The mesh file, if there is one.
    pub fn file(&self) -> Option<&MeshFile> {
        match self {
            SolidMesh::File { file, .. } | SolidMesh::Surface { file, .. } => Some(file),
            _ => None,
        }
    }
}

/// Difference of a solid's initial state from rest.
#[derive(Clone, Copy, Debug)]
pub struct Initial {
    /// Stretch along the domain's axes about the centroid of the rest shape; default 1. Negative factors invert the body.
    pub scale: DVec3,
    /// Velocity, m/s; default 0.
    pub velocity: DVec3,
    /// Angular velocity about the centroid, rad/s; default 0.
    pub spin: DVec3,
    /// Rows of a velocity gradient L about the centroid, 1/s: a node at x has L (x - centroid) more; default 0.
    pub velocity_gradient: [DVec3; 3],
}

impl Initial {
    /// The first key that moves nodes along an axis that they may not leave.
    pub(crate) fn moves_along(&self, axis: usize) -> Option<&'static str> {
        let gradient = self.velocity_gradient[axis] != DVec3::ZERO;
        let turns = (DVec3::ONE - DVec3::AXES[axis]) * self.spin != DVec3::ZERO;
        let keys = [
            (self.velocity[axis] != 0.0, "initial.velocity"),
            (turns, "initial.spin"),
            (gradient, "initial.velocity_gradient"),
            (self.scale[axis] != 1.0, "initial.scale"),
        ];
        keys.into_iter().find_map(|(moves, key)| moves.then_some(key))
    }
}

impl Default for Initial {
    /// At rest.
    fn default() -> Initial {
        Initial { scale: DVec3::ONE, velocity: DVec3::ZERO, spin: DVec3::ZERO, velocity_gradient: [DVec3::ZERO; 3] }
    }
}

/// Strain measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ElasticModel {
    /// In the corotational frame of each element.
    Corotational,
    /// In the frame of the rest shape: for small rotations only.
    Linear,
}

/// Nodes whose motion is prescribed in some components.
#[derive(Clone, Debug)]
pub struct Pin {
    /// Selects nodes with a rest position inside or on it.
    pub region: Shape,
    /// Prescribed components: x, y, z.
    pub components: [bool; 3],
    /// Keyframes of the nodes, ascending in time; empty for constrained nodes, which remain at rest.
    pub keyframes: Vec<Keyframe>,
    /// Centre of the keyframes' rotation, m; `None` for the centre of the region.
    pub pivot: Option<DVec3>,
}

/// Displacement of scripted nodes, or of an obstacle, at one time. Linear between keyframes, constant before the first and
/// after the last.
#[derive(Clone, Copy, Debug)]
pub struct Keyframe {
    /// s
    pub time: f64,
    /// From the rest position, m.
    pub translate: DVec3,
    /// Rotation axis, a unit vector through the centre of the pin's region ([`Shape::centre`]) or the obstacle's
    /// [`Motion::pivot`].
    pub axis: DVec3,
    /// Rotation angle, rad.
    pub angle: f64,
}

/// A prescribed acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Acceleration {
    /// First and last time, s.
    pub times: [f64; 2],
    /// m/s^2
    pub size: f64,
}

/// Largest part of a rotation about another axis, rad.
const ROUNDED_TURN: f64 = 1e-9;

impl Keyframe {
    /// Whether it moves points along an axis.
    pub(crate) fn moves_along(&self, axis: usize) -> bool {
        let turn = self.angle * self.axis;
        self.translate[axis] != 0.0 || turn.reject_from_normalized(DVec3::AXES[axis]).length() > ROUNDED_TURN
    }

    /// Rotation vector (axis times angle, rad) and translation (m) at a time (s) of at least one keyframe.
    pub fn pose(keyframes: &[Keyframe], time: f64) -> (DVec3, DVec3) {
        let after = keyframes.partition_point(|frame| frame.time <= time);
        let last = keyframes.len() - 1;
        let [a, b] = [after.saturating_sub(1), after.min(last)].map(|frame| &keyframes[frame]);
        let rotation = |frame: &Keyframe| frame.angle * frame.axis;
        let share = if b.time > a.time { (time - a.time) / (b.time - a.time) } else { 0.0 };
        (rotation(a).lerp(rotation(b), share), a.translate.lerp(b.translate, share))
    }

    /// Largest speed between a time and `span` (both s) later, m/s, of points within `radius` (m) of the centre of rotation.
    pub fn max_speed(keyframes: &[Keyframe], radius: f64, time: f64, span: f64) -> f64 {
        let pairs = keyframes.windows(2);
        let active = pairs.filter(|pair| pair[1].time > time && pair[0].time < time + span);
        let speeds = active.map(|pair| {
            let rotation = |frame: &Keyframe| frame.angle * frame.axis;
            let path = pair[1].translate.distance(pair[0].translate)
                + rotation(&pair[1]).distance(rotation(&pair[0])) * radius;
            path / (pair[1].time - pair[0].time)
        });
        speeds.fold(0.0, f64::max)
    }

    /// Accelerations of points within `radius` (m) of the centre of rotation: of turning, and of changes of velocity at
    /// keyframes, each spread over half of the intervals beside it. Before the first keyframe and after the last there is
    /// rest.
    pub fn accelerations(keyframes: &[Keyframe], radius: f64) -> Vec<Acceleration> {
        let mut all = Vec::new();
        // Velocity, angular velocity and length of an interval.
        let rest = (DVec3::ZERO, DVec3::ZERO, 0.0);
        let intervals = keyframes.windows(2).map(|pair| {
            let [a, b] = [&pair[0], &pair[1]];
            let span = b.time - a.time;
            let turned = b.angle * b.axis - a.angle * a.axis;
            ((b.translate - a.translate) / span, turned / span, span)
        });
        let mut last = rest;
        for (frame, next) in keyframes.iter().zip(intervals.chain([rest])) {
            let span = match (last.2, next.2) {
                (0.0, span) | (span, 0.0) => span,
                (before, after) => 0.5 * (before + after),
            };
            let jump = next.0.distance(last.0) + radius * next.1.distance(last.1);
            let turning = radius * next.1.length_squared();
            let mut add = |times: [f64; 2], size: f64| all.push(Acceleration { times, size });
            if jump > 0.0 {
                add([frame.time; 2], jump / span);
            }
            if turning > 0.0 {
                add([frame.time, frame.time + next.2], turning);
            }
            last = next;
        }
        all
    }

    /// The time of the next keyframe after a time, s.
    pub fn next_time(keyframes: &[Keyframe], time: f64) -> Option<f64> {
        let next = keyframes.iter().find(|frame| frame.time > time);
        next.map(|frame| frame.time)
    }
}

/// A force on a solid.
#[derive(Clone, Debug)]
pub struct Load {
    /// Selects nodes with a rest position inside or on it.
    pub region: Shape,
    /// Kind of load. With keyframes it has the value of the start.
    pub kind: LoadKind,
    /// Its force or traction over time; empty if it is constant.
    pub keyframes: Vec<VectorKeyframe>,
}

/// Kind of load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LoadKind {
    /// Total force, distributed equally among the nodes, N.
    Force(DVec3),
    /// Traction on the surface triangles with all nodes in the region, Pa of rest area.
    Traction(DVec3),
}

/// A rigid body, at rest or with a prescribed motion.
#[derive(Clone, Debug)]
pub struct Obstacle {
    /// Shape before its placement.
    pub shape: Shape,
    /// Initial position: x = centre + scale rotate (X - centre) + translate.
    pub placement: Placement,
    /// Whether it is a container: everything outside the shape is solid.
    pub inside_out: bool,
    /// Prescribed motion; `None` at rest.
    pub motion: Option<Motion>,
    /// Coefficient of friction; default 0.
    pub friction: f64,
}

/// Prescribed motion of an obstacle: x = pivot + rotation (X - pivot) + translate, X as placed.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Keyframes, ascending in time; at least one.
    pub keyframes: Vec<Keyframe>,
    /// Centre of rotation, m; default the centre of the placed shape, or of the bounding box of a mesh.
    pub pivot: Option<DVec3>,
}

/// A region that emits liquid.
#[derive(Clone, Debug)]
pub struct Source {
    /// Its shape.
    pub shape: Shape,
    /// Velocity of the emitted liquid, m/s; not zero. With a flow rate: the velocity without walls. With keyframes the largest.
    pub velocity: DVec3,
    /// Flow rate, m^3/s, whatever part of the source is covered by walls; `None` with a given velocity. With keyframes the largest.
    pub flow_rate: Option<f64>,
    /// Velocity over time, ascending, all along `velocity` and none larger; empty if it is constant.
    pub keyframes: Vec<VectorKeyframe>,
    /// Start time, s; default 0.
    pub start: f64,
    /// End time, s; default infinity.
    pub end: f64,
}

/// A region that removes liquid.
#[derive(Clone, Debug)]
pub struct Sink {
    /// Its shape.
    pub shape: Shape,
}

/// A measurement after every sub-step.
#[derive(Clone, Debug)]
pub struct Probe {
    /// Name, unique in the scene, and prefix of the [`Probe::columns`].
    pub name: String,
    /// Measured quantity.
    pub kind: ProbeKind,
}

impl Probe {
    /// Columns in probes.csv: the name, with `_x`, `_y`, `_z` for vectors and `_volume` for a solid.
    pub fn columns(&self) -> Vec<String> {
        let endings: &[&str] = match self.kind {
            ProbeKind::Height { .. }
            | ProbeKind::Pressure { .. }
            | ProbeKind::Front { .. }
            | ProbeKind::Flux { .. } => &[""],
            ProbeKind::Velocity { .. }
            | ProbeKind::Node { .. }
            | ProbeKind::SolidVelocity { .. }
            | ProbeKind::Force { .. }
            | ProbeKind::Reaction { .. } => &["_x", "_y", "_z"],
            ProbeKind::Solid { .. } => &["_x", "_y", "_z", "_volume"],
        };
        let name = |ending| format!("{}{ending}", self.name);
        endings.iter().map(name).collect()
    }

    /// Units of the columns.
    pub fn units(&self) -> &'static [&'static str] {
        match self.kind {
            ProbeKind::Height { .. } | ProbeKind::Front { .. } => &["m"],
            ProbeKind::Pressure { .. } => &["Pa"],
            ProbeKind::Flux { .. } => &["m^3/s"],
            ProbeKind::Velocity { .. } | ProbeKind::SolidVelocity { .. } | ProbeKind::Node { velocity: true, .. } => {
                &["m/s"; 3]
            }
            ProbeKind::Node { .. } => &["m"; 3],
            ProbeKind::Force { .. } | ProbeKind::Reaction { .. } => &["N"; 3],
            ProbeKind::Solid { .. } => &["m", "m", "m", "over that at rest"],
        }
    }
}

/// The axis against gravity's largest component; +y without gravity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Up {
    /// 0, 1, 2 for x, y, z.
    pub axis: usize,
    /// Whether the upward direction is negative.
    pub falling: bool,
}

impl Up {
    /// The upward direction for a gravity.
    pub fn against(gravity: DVec3) -> Up {
        match gravity == DVec3::ZERO {
            true => Up { axis: 1, falling: false },
            false => {
                let axis = gravity.abs().max_position();
                Up { axis, falling: gravity[axis] > 0.0 }
            }
        }
    }
}

/// Measured quantity of a probe.
#[derive(Clone, Debug)]
pub enum ProbeKind {
    /// Height of the highest liquid surface above the lowest side of the domain, along gravity, m.
    Height {
        /// A point of the vertical line, m.
        foot: DVec3,
        /// Upward direction.
        up: Up,
    },
    /// Pressure at a point, Pa.
    Pressure {
        /// m
        point: DVec3,
    },
    /// Velocity at a point, m/s; three columns.
    Velocity {
        /// m
        point: DVec3,
    },
    /// Largest coordinate of the liquid along an axis, or the smallest, m.
    Front {
        /// 0, 1, 2 for x, y, z.
        axis: usize,
        /// Whether it is the smallest.
        lower: bool,
    },
    /// Volume of liquid per second through a rectangle normal to an axis, towards larger coordinates, m^3/s.
    Flux {
        /// 0, 1, 2 for x, y, z.
        axis: usize,
        /// Lowest corner, m.
        min: DVec3,
        /// Highest corner, m, with the same coordinate along the axis.
        max: DVec3,
    },
    /// Displacement (m) or velocity (m/s) of nodes of a solid, their mean; three columns.
    Node {
        /// Index of the solid.
        solid: usize,
        /// The nodes.
        nodes: ProbedNodes,
        /// Whether the quantity is the velocity.
        velocity: bool,
    },
    /// Velocity of the centre of mass of a solid, m/s; three columns.
    SolidVelocity {
        /// Index of the solid.
        solid: usize,
    },
    /// Centre of mass of a solid, m, and its signed volume relative to rest; four columns.
    Solid {
        /// Index of the solid.
        solid: usize,
    },
    /// Force of the liquid on a solid, N: J^T p plus the correction for pressure that varies within cells.
    Force {
        /// Index of the solid.
        solid: usize,
    },
    /// Force of pins and scripts on a solid, N; three columns.
    Reaction {
        /// Index of the solid.
        solid: usize,
        /// Region at rest of the nodes that count; all without.
        region: Option<Shape>,
    },
}

/// Nodes of a probe.
#[derive(Clone, Debug)]
pub enum ProbedNodes {
    /// The node nearest to a rest point, m, the first of several.
    Nearest(DVec3),
    /// All nodes that rest in a region.
    Within(Shape),
}

impl ProbeKind {
    /// Whether it measures the liquid alone.
    pub fn measures_liquid(&self) -> bool {
        !self.measures_solid() && !self.measures_force()
    }

    /// Whether it measures the motion of a solid.
    pub fn measures_solid(&self) -> bool {
        matches!(
            self,
            ProbeKind::Node { .. }
                | ProbeKind::Solid { .. }
                | ProbeKind::SolidVelocity { .. }
                | ProbeKind::Reaction { .. }
        )
    }

    /// Whether it needs the velocities of nodes.
    pub fn needs_node_velocity(&self) -> bool {
        matches!(
            self,
            ProbeKind::Node { velocity: true, .. } | ProbeKind::SolidVelocity { .. } | ProbeKind::Reaction { .. }
        )
    }

    /// Whether it needs the forces of the liquid on nodes.
    pub fn measures_force(&self) -> bool {
        matches!(self, ProbeKind::Force { .. } | ProbeKind::Reaction { .. })
    }
}

/// Smallest theta of the ghost fluid method: the distance of the surface from a cell's centre, in cells.
///
/// A face that is hardly open has hardly any liquid to move, and its velocity, pressure over theta, is not bounded by the energy: liquid that is
/// trapped in a film under a drop would leave it at tens of times the speed of the impact. Faces whose aperture is below [`SLIVER`] have a larger
/// floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThetaFloor {
    /// Of faces open by [`SLIVER`] and more.
    pub whole: f64,
    /// Of faces that are about closed; between them the floor is linear in the aperture.
    pub closing: f64,
}

/// Aperture below which an open face is a small-aperture face. Also in `common/valid.wgsl`.
pub const SLIVER: f64 = 0.2;

impl ThetaFloor {
    /// The floor of a face with an aperture.
    #[inline]
    pub fn of(self, aperture: f64) -> f64 {
        self.whole.max(self.closing * (1.0 - aperture / SLIVER))
    }
}

impl From<f64> for ThetaFloor {
    /// The same for all faces.
    fn from(whole: f64) -> ThetaFloor {
        ThetaFloor { whole, closing: 0.0 }
    }
}

/// Solver settings of a sub-step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solver {
    /// Relative tolerance of the true residual; default 1e-8, with `f32` 1e-5.
    pub tolerance: f64,
    /// PCG iterations in all refinement steps; default 200.
    pub max_iterations: u32,
    /// Default `mixed`.
    pub precision: Precision,
    /// Default `multigrid`.
    pub preconditioner: Preconditioner,
    /// Smallest theta of the ghost fluid method; default 1e-2, with markers 0.15, with a level 1e-4 and on its slivers up to 0.15.
    pub theta_floor: ThetaFloor,
    /// Apertures below it close, and above one minus it open; default 1e-3, with nodal face areas 1e-2.
    pub area_clamp: f64,
    /// Source of the apertures beside elastic solids; default `clipped`.
    pub face_areas: FaceAreas,
    /// Coupling scheme of liquid and solids; default `strong`.
    pub coupling: CouplingScheme,
    /// Variation of the pressure within a cell, for the force on solids; default `hydrostatic`.
    pub pressure_on_patches: PatchPressure,
    /// Unknowns of a coupled solve on a GPU; default `auto`.
    pub formulation: Formulation,
    /// Contact of solids with each other; by default on where at least two may touch, except with weak couplings and f32, and with friction or
    /// `self_contact`.
    pub solid_contact: bool,
}

impl Default for Solver {
    fn default() -> Solver {
        Solver {
            tolerance: Precision::Mixed.default_tolerance(),
            max_iterations: 200,
            precision: Precision::Mixed,
            preconditioner: Preconditioner::Multigrid,
            theta_floor: ThetaFloor::from(1e-2),
            area_clamp: 1e-3,
            face_areas: FaceAreas::Clipped,
            coupling: CouplingScheme::Strong,
            pressure_on_patches: PatchPressure::Hydrostatic,
            formulation: Formulation::Auto,
            solid_contact: false,
        }
    }
}

/// Floating-point precision of the solve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// All in f32.
    F32,
    /// Unknowns and residual in f64, corrections in f32.
    Mixed,
    /// All in f64; needs an adapter with f64.
    F64,
}

macro_rules! names {
    ($($kind:ident: $($name:literal => $value:ident),*;)*) => { $(
        impl $kind {
            /// Names in files and options, and their values.
            pub const NAMES: &[(&'static str, $kind)] = &[$(($name, $kind::$value)),*];

            /// Name in files and tables.
            pub fn name(self) -> &'static str {
                match self {
                    $($kind::$value => $name),*
                }
            }
        }
    )* };
}
pub(crate) use names;
names! {
    Precision: "f32" => F32, "mixed" => Mixed, "f64" => F64;
    Preconditioner: "multigrid" => Multigrid, "jacobi" => Jacobi, "block_jacobi" => BlockJacobi;
    PatchPressure: "cell" => Cell, "hydrostatic" => Hydrostatic, "gradient" => Gradient;
}

impl Precision {
    /// Default of [`Solver::tolerance`].
    pub fn default_tolerance(self) -> f64 {
        match self {
            Precision::F32 => 1e-5,
            Precision::Mixed | Precision::F64 => 1e-8,
        }
    }
}

/// Source of the apertures beside elastic solids.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaceAreas {
    /// Patches of the solids' surfaces: every cut cell closes to rounding.
    Clipped,
    /// Distance at the corners of the cells (thesis, figure 5.2): cut cells close to a few percent.
    Nodal,
}

/// Coupling scheme of liquid and elastic solids. The last two are the baselines of the thesis's chapter 6.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CouplingScheme {
    /// Pressures and velocities in one solve.
    Strong,
    /// The pressure with the old velocities of the solids, then the solids under that pressure.
    Weak,
    /// The elasticity of the solids first, then pressures and velocities in one solve without stiffness.
    DampingOnly,
}

/// Unknowns of a coupled solve on a GPU. All choices have the same solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Formulation {
    /// Condensed with few wet nodes, else two-field.
    Auto,
    /// Pressures and velocities (thesis 5.25), on the device.
    TwoField,
    /// Pressures alone: the Schur complement, with the wet compliance computed on the CPU.
    Condensed,
}

/// Variation of the pressure within a cell, for the force on the patches of a solid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PatchPressure {
    /// Constant, as in the thesis. The error is the weight of the liquid between a patch and the centre.
    Cell,
    /// Gradient rho g, as in a liquid at rest.
    Hydrostatic,
    /// Gradient of the previous sub-step.
    Gradient,
}

/// Preconditioner of the conjugate gradients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preconditioner {
    /// One V-cycle of aggregation multigrid.
    Multigrid,
    /// The diagonal, for comparison.
    Jacobi,
    /// The diagonal, with 3x3 blocks for the nodes of solids in a coupled solve.
    BlockJacobi,
}

/// Files of a run.
#[derive(Clone, Copy, Debug)]
pub struct Output {
    /// VTP markers; default on with liquid.
    pub particles: bool,
    /// VTI fields; default off.
    pub fields: bool,
    /// VTU solids; default on with solids.
    pub solids: bool,
    /// The liquid's surface as PLY and VTP; default off.
    pub surface: bool,
    /// Interval of written frames; default 1.
    pub every: u64,
    /// Interval of checkpoints in frames, default 10; 0 for interruptions only.
    pub checkpoint_every: u64,
}

/// Settings of the surface mesh around markers, for files and pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceMesh {
    /// Distance of the surface from an isolated marker, cells; default 0.95. A flat surface lies 0.7 of it beyond its markers.
    pub radius: f64,
    /// Smoothing iterations at constant volume; default 20.
    pub smoothing: u32,
}

/// A pinhole camera.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Position, m; default from the domain. With keyframes that of the first one.
    pub eye: DVec3,
    /// Point in the middle of the picture, m.
    pub target: DVec3,
    /// Up.
    pub up: DVec3,
    /// Vertical field of view, degrees.
    pub fov: f64,
    /// Picture size, pixels.
    pub size: [usize; 2],
    /// Path, ascending in time; empty for a fixed camera.
    pub keyframes: Vec<CameraKeyframe>,
    /// Plane that cuts elastic solids open.
    pub cut: Option<CameraCut>,
}

/// A plane normal to an axis. Solids on the camera's side of it are not drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraCut {
    /// 0, 1 or 2.
    pub axis: usize,
    /// m
    pub at: f64,
}

/// Pose of a camera at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraKeyframe {
    /// s
    pub time: f64,
    /// Position, m.
    pub eye: DVec3,
    /// Point in the middle of the picture, m.
    pub target: DVec3,
    /// Vertical field of view, degrees.
    pub fov: f64,
}

impl Scene {
    /// Origin of a dotted key for errors: file, line and key, or the `--set`. An absent key has the line of its table.
    pub fn at(&self, key: &str) -> String {
        let file = self.file.display();
        match self.origins.get(key) {
            Some(Origin::Line(line)) => format!("{file}:{line}: {key}"),
            Some(Origin::Set(index)) => format!("{}: {key}", option(&self.overrides[index])),
            None => format!("{file}: {key}"),
        }
    }

    /// The grid of the scene.
    pub fn grid(&self) -> Grid {
        Grid { cells: self.domain.cells, dx: self.domain.size.x / self.domain.cells[0] as f64 }
    }

    /// Whether an obstacle has keyframes.
    pub fn obstacles_move(&self) -> bool {
        self.obstacles.iter().any(|obstacle| obstacle.motion.is_some())
    }

    /// Whether a wall, an obstacle or a solid has friction.
    pub fn has_friction(&self) -> bool {
        read::has_friction(&self.domain, &self.obstacles, &self.solids)
    }

    /// Number of frames, without frame 0, the initial state.
    pub fn n_frames(&self) -> u64 {
        (self.time.duration * self.time.frames_per_second).round().max(1.0) as u64
    }
}
