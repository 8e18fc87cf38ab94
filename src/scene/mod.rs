//! Scenes: a TOML file, checked and turned into a description in SI units. [`Scene::load`] reads one.

mod camera;
mod document;
mod probe;
mod read;
pub mod schema;
mod shape;
mod solid;
mod surface;
mod tap;

use std::path::PathBuf;

use glam::{DMat3, DVec3};

use crate::grid::{Grid, Sides};

pub use camera::PICTURE_SIDES;
use document::Origin;
pub use document::Written;
pub use read::MAX_FRAMES;
pub(crate) use read::MAX_VELOCITY;

/// A checked scene, all in SI units. Lengths and times are finite, counts are positive, regions and obstacles have volume.
#[derive(Clone, Debug)]
pub struct Scene {
    /// File stem.
    pub name: String,
    /// The file it came from.
    pub file: PathBuf,
    /// Where in it its values are: see [`Scene::at`].
    pub written: Written,
    /// SHA-256 of the file's text, all overrides and the scale, in hexadecimal.
    pub hash: String,
    /// `--scale`, already applied to [`Domain::cells`].
    pub scale: f64,
    /// `--set` overrides, as given.
    pub overrides: Vec<String>,
    /// Box, cells, gravity.
    pub domain: Domain,
    /// Duration and time steps.
    pub time: Time,
    /// The liquid, where the scene has one.
    pub liquid: Option<Liquid>,
    /// Elastic bodies.
    pub solids: Vec<Solid>,
    /// Static obstacles and containers.
    pub obstacles: Vec<Obstacle>,
    /// Where liquid comes in.
    pub sources: Vec<Source>,
    /// Where it is taken away.
    pub sinks: Vec<Sink>,
    /// Measurements written to probes.csv.
    pub probes: Vec<Probe>,
    /// How the systems of a sub-step are made and solved.
    pub solver: Solver,
    /// What is written.
    pub output: Output,
    /// How the mesh of the liquid's surface is made.
    pub surface: SurfaceMesh,
    /// Where `preview` looks from.
    pub camera: Camera,
}

/// The box, walls on all sides but the open ones.
#[derive(Clone, Debug)]
pub struct Domain {
    /// Extents, m.
    pub size: DVec3,
    /// Cells along x, y, z; cubic to 1e-6.
    pub cells: [usize; 3],
    /// Gravity, m/s^2.
    pub gravity: DVec3,
    /// Sides through which liquid leaves: there the pressure is 0.
    pub open: Sides,
}

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
}

/// The liquid.
#[derive(Clone, Debug)]
pub struct Liquid {
    /// kg/m^3; default 1000.
    pub density: f64,
    /// Where it is at first: the union of the regions less those that subtract, in order.
    pub regions: Vec<Region>,
    /// How its surface is followed.
    pub surface: Surface,
    /// Marker radius in cells; default 0.87.
    pub marker_radius: f64,
    /// Seed of the marker jitter; default 0.
    pub seed: u64,
    /// Whether the volume is held; on by default with markers, always off with `fixed`.
    pub volume_control: bool,
}

/// How the liquid's surface is followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    /// By markers and a union of spheres.
    Markers,
    /// Not at all: the regions' exact distance, kept all run.
    Fixed,
}

/// A piece of liquid.
#[derive(Clone, Debug)]
pub struct Region {
    /// Its shape.
    pub shape: Shape,
    /// Whether it takes liquid away instead.
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
    /// All points below a solitary wave. Regions only; it brings a velocity of its own.
    Solitary(SolitaryWave),
    /// A closed triangle mesh (OBJ, STL, PLY).
    Mesh {
        /// Its file, relative to the scene's folder, resolved.
        file: PathBuf,
    },
}

/// A solitary wave over the floor y = 0, at the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolitaryWave {
    /// Of the water at rest, m.
    pub depth: f64,
    /// Of the crest above the water at rest, m.
    pub height: f64,
    /// x and z of a point of the crest, m.
    pub crest: [f64; 2],
    /// Where it goes: the unit vector along x and z.
    pub direction: [f64; 2],
    /// Downwards, m/s^2: its speed depends on it.
    pub gravity: f64,
}

/// Scale and rotation about the shape's own centre ([`Shape::centre`]), then translation, of an obstacle's shape or a solid's
/// mesh.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// m
    pub translate: DVec3,
    /// A rotation.
    pub rotate: DMat3,
    /// Uniform scale.
    pub scale: f64,
}

impl Default for Placement {
    /// Where the shape is.
    fn default() -> Placement {
        Placement {
            translate: DVec3::ZERO,
            rotate: DMat3::IDENTITY,
            scale: 1.0,
        }
    }
}

impl Placement {
    /// Where a point of a shape with this centre is put, m.
    pub fn put(&self, x: DVec3, centre: DVec3) -> DVec3 {
        centre + self.scale * (self.rotate * (x - centre)) + self.translate
    }
}

/// An elastic body.
#[derive(Clone, Debug)]
pub struct Solid {
    /// Name, unique in the scene.
    pub name: String,
    /// Where its tetrahedra come from.
    pub mesh: SolidMesh,
    /// Where the mesh is put. What comes out is the rest shape: it carries no stress.
    pub placement: Placement,
    /// How the state at the start differs from rest.
    pub initial: Initial,
    /// kg/m^3
    pub density: f64,
    /// Young's modulus, Pa.
    pub young: f64,
    /// Poisson's ratio, in (-1, 0.5).
    pub poisson: f64,
    /// How strain is measured; default corotational.
    pub model: ElasticModel,
    /// Rayleigh damping: coefficient of the mass, 1/s; default 0.
    pub mass_damping: f64,
    /// Rayleigh damping: coefficient of the stiffness, s; default 0.
    pub stiffness_damping: f64,
    /// Nodes held or moved in some or all components.
    pub pins: Vec<Pin>,
    /// Constant forces.
    pub loads: Vec<Load>,
}

/// Where the tetrahedra of a solid come from, in coordinates before the placement (m).
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
        /// Length of an edge, about, m.
        cell_size: f64,
    },
    /// A hollow ball about the origin.
    Shell {
        /// Outer radius, m.
        radius: f64,
        /// m
        thickness: f64,
        /// Length of an edge, about, m.
        cell_size: f64,
    },
    /// Tetrahedra of a Gmsh 4.1 .msh or a VTK .vtu file.
    File {
        /// The file, resolved.
        file: PathBuf,
    },
    /// The inside of a closed triangle mesh (OBJ, STL, PLY), filled.
    Surface {
        /// The file, resolved.
        file: PathBuf,
        /// Length of an edge, about, m.
        cell_size: f64,
    },
}

/// How the state of a solid at the start differs from rest.
#[derive(Clone, Copy, Debug)]
pub struct Initial {
    /// Stretch along the domain's axes about the centroid of the rest shape; default 1. Negative numbers turn the body inside out.
    pub scale: DVec3,
    /// Velocity, m/s; default 0.
    pub velocity: DVec3,
    /// Angular velocity about the centroid, rad/s; default 0.
    pub spin: DVec3,
}

impl Default for Initial {
    /// At rest.
    fn default() -> Initial {
        Initial {
            scale: DVec3::ONE,
            velocity: DVec3::ZERO,
            spin: DVec3::ZERO,
        }
    }
}

/// How strain is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ElasticModel {
    /// In the frame that turns with each element.
    Corotational,
    /// In the frame of the rest shape: for small rotations only.
    Linear,
}

/// Nodes whose motion is prescribed in some components.
#[derive(Clone, Debug)]
pub struct Pin {
    /// Holds nodes whose rest position is inside or on it.
    pub region: Shape,
    /// Prescribed components: x, y, z.
    pub components: [bool; 3],
    /// Times and placements of the nodes' rest positions, ascending in time; empty: the nodes stay where they start.
    pub keyframes: Vec<Keyframe>,
}

/// Where a script puts its nodes, or a motion its obstacle, at one time; between two, linear. Before the first and after the last,
/// nothing moves.
#[derive(Clone, Copy, Debug)]
pub struct Keyframe {
    /// s
    pub time: f64,
    /// From the rest position, m.
    pub translate: DVec3,
    /// Axis of the turn, a unit vector: about the centre of the pin's region ([`Shape::centre`]), or the obstacle's [`Motion::pivot`].
    pub axis: DVec3,
    /// Angle of the turn, rad.
    pub angle: f64,
}

impl Keyframe {
    /// The turn (axis times angle, rad) and the translation (m) at a time (s), given at least one keyframe.
    pub fn pose(keyframes: &[Keyframe], time: f64) -> (DVec3, DVec3) {
        let after = keyframes.partition_point(|frame| frame.time <= time);
        let last = keyframes.len() - 1;
        let [a, b] = [after.saturating_sub(1), after.min(last)].map(|frame| &keyframes[frame]);
        let turn = |frame: &Keyframe| frame.angle * frame.axis;
        let share = if b.time > a.time {
            (time - a.time) / (b.time - a.time)
        } else {
            0.0
        };
        (
            turn(a).lerp(turn(b), share),
            a.translate.lerp(b.translate, share),
        )
    }

    /// The time of the next keyframe after a time, s.
    pub fn next_time(keyframes: &[Keyframe], time: f64) -> Option<f64> {
        let next = keyframes.iter().find(|frame| frame.time > time);
        next.map(|frame| frame.time)
    }
}

/// A constant force on a solid.
#[derive(Clone, Debug)]
pub struct Load {
    /// Acts on nodes whose rest position is inside or on it.
    pub region: Shape,
    /// How it acts.
    pub kind: LoadKind,
}

/// How a load acts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LoadKind {
    /// A force shared out in equal parts among the nodes, N.
    Force(DVec3),
    /// A traction on the surface triangles with all nodes in the region, Pa of rest area.
    Traction(DVec3),
}

/// A rigid body that stands still, or moves as its keyframes say.
#[derive(Clone, Debug)]
pub struct Obstacle {
    /// Its shape.
    pub shape: Shape,
    /// Where the shape is put: x = centre + scale rotate (X - centre) + translate.
    pub placement: Placement,
    /// A container: solid is everything outside the shape.
    pub inside_out: bool,
    /// How it moves; `None` where it stands still.
    pub motion: Option<Motion>,
}

/// How an obstacle moves: x = pivot + turn (X - pivot) + translate, X where its placement puts it.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Times, turns and translations, ascending in time; at least one.
    pub keyframes: Vec<Keyframe>,
    /// What it turns about, m; by default the centre of the shape, or of the box around a mesh, where its placement puts it.
    pub pivot: Option<DVec3>,
}

/// A region that emits liquid.
#[derive(Clone, Debug)]
pub struct Source {
    /// Its shape.
    pub shape: Shape,
    /// Velocity of the liquid in it, m/s; not zero. With a flow rate that without walls.
    pub velocity: DVec3,
    /// Volume per second to emit whatever walls cover, m^3/s; `None` where the velocity is given.
    pub flow_rate: Option<f64>,
    /// It runs from this time on, s; default 0.
    pub start: f64,
    /// It runs up to this time, s; default for ever.
    pub end: f64,
}

/// A region that takes liquid away.
#[derive(Clone, Debug)]
pub struct Sink {
    /// Its shape.
    pub shape: Shape,
}

/// A measurement, taken after every sub-step.
#[derive(Clone, Debug)]
pub struct Probe {
    /// Name, unique in the scene; names its [`Probe::columns`].
    pub name: String,
    /// What is measured.
    pub kind: ProbeKind,
}

impl Probe {
    /// Its columns in probes.csv: the name; `_x`, `_y`, `_z` after it for a velocity, a displacement, a centre or a force; and
    /// `_volume` for a solid.
    pub fn columns(&self) -> Vec<String> {
        let endings: &[&str] = match self.kind {
            ProbeKind::Height { .. } | ProbeKind::Pressure { .. } | ProbeKind::Front { .. } => {
                &[""]
            }
            ProbeKind::Velocity { .. } | ProbeKind::Node { .. } | ProbeKind::Force { .. } => {
                &["_x", "_y", "_z"]
            }
            ProbeKind::Solid { .. } => &["_x", "_y", "_z", "_volume"],
        };
        let name = |ending| format!("{}{ending}", self.name);
        endings.iter().map(name).collect()
    }
}

/// The axis against gravity's largest component; y upwards without gravity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Up {
    /// 0, 1, 2 for x, y, z.
    pub axis: usize,
    /// Whether coordinates fall on the way up.
    pub falling: bool,
}

impl Up {
    /// Against a gravity.
    pub fn against(gravity: DVec3) -> Up {
        match gravity == DVec3::ZERO {
            true => Up {
                axis: 1,
                falling: false,
            },
            false => {
                let axis = gravity.abs().max_position();
                Up {
                    axis,
                    falling: gravity[axis] > 0.0,
                }
            }
        }
    }
}

/// What a probe measures.
#[derive(Clone, Copy, Debug)]
pub enum ProbeKind {
    /// Height of the highest liquid surface, against gravity, above the side of the domain that gravity points to, m.
    Height {
        /// A point of the line along which it is measured, m.
        foot: DVec3,
        /// The way up.
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
    /// Largest coordinate along an axis that the liquid reaches, m.
    Front {
        /// 0, 1, 2 for x, y, z.
        axis: usize,
    },
    /// Displacement from rest of the node of a solid that is nearest to a point at rest, the first of several, m; three columns.
    Node {
        /// Index of the solid.
        solid: usize,
        /// m, where the node is at rest.
        rest_point: DVec3,
    },
    /// Centre of mass of a solid, m, and its volume over that at rest (signed: an inverted element counts against); four columns.
    Solid {
        /// Index of the solid.
        solid: usize,
    },
    /// Force of the liquid on a solid, N: J^T p and what pressure does that varies within cells, summed over its nodes.
    Force {
        /// Index of the solid.
        solid: usize,
    },
}

impl ProbeKind {
    /// Whether it measures the liquid alone.
    pub fn of_liquid(&self) -> bool {
        !self.of_solid() && !self.of_force()
    }

    /// Whether it measures where a solid is.
    pub fn of_solid(&self) -> bool {
        matches!(self, ProbeKind::Node { .. } | ProbeKind::Solid { .. })
    }

    /// Whether it measures what the liquid does to a solid.
    pub fn of_force(&self) -> bool {
        matches!(self, ProbeKind::Force { .. })
    }
}

/// How the systems of a sub-step are made and solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solver {
    /// Relative tolerance of the true residual; default 1e-8, with `f32` 1e-5.
    pub tolerance: f64,
    /// PCG iterations in all rounds; default 200.
    pub max_iterations: u32,
    /// Default `mixed`.
    pub precision: Precision,
    /// Default `multigrid`.
    pub preconditioner: Preconditioner,
    /// Smallest theta of the ghost fluid method; default 1e-2, with markers 0.15.
    pub theta_floor: f64,
    /// Open fractions below it close and above one minus it open; default 1e-3, with nodal face areas 1e-2.
    pub area_clamp: f64,
    /// Where the open areas beside elastic solids come from; default `clipped`.
    pub face_areas: FaceAreas,
    /// How liquid and elastic solids are solved for where they touch; default `strong`.
    pub coupling: CouplingScheme,
    /// How pressure varies over a cell where it acts on a solid; default `hydrostatic`.
    pub pressure_on_patches: PatchPressure,
    /// What the corrections of a coupled solve on a GPU are made of; default `auto`.
    pub formulation: Formulation,
}

impl Default for Solver {
    fn default() -> Solver {
        Solver {
            tolerance: Precision::Mixed.default_tolerance(),
            max_iterations: 200,
            precision: Precision::Mixed,
            preconditioner: Preconditioner::Multigrid,
            theta_floor: 1e-2,
            area_clamp: 1e-3,
            face_areas: FaceAreas::Clipped,
            coupling: CouplingScheme::Strong,
            pressure_on_patches: PatchPressure::Hydrostatic,
            formulation: Formulation::Auto,
        }
    }
}

/// What the unknowns and the residual are held in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// All in f32.
    F32,
    /// Unknowns and residual in f64, corrections in f32.
    Mixed,
    /// All in f64; the adapter must have it.
    F64,
}

impl Precision {
    /// The tolerance of a scene that gives none.
    pub fn default_tolerance(self) -> f64 {
        match self {
            Precision::F32 => 1e-5,
            Precision::Mixed | Precision::F64 => 1e-8,
        }
    }
}

/// Where the open areas beside elastic solids come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaceAreas {
    /// From the patches of the solids' surfaces, so that every cut cell closes.
    Clipped,
    /// From the distance at the corners of the cells (thesis, figure 5.2); cut cells close to some percent.
    Nodal,
}

/// How liquid and elastic solids are solved for where they touch. The last two are what chapter 6 of the thesis compares with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CouplingScheme {
    /// Pressures and velocities in one solve.
    Strong,
    /// The pressure against the solids' velocities before the sub-step, then the solids under that pressure.
    Weak,
    /// The solids' elasticity by itself first, then pressures and velocities in one solve that knows of mass and damping alone.
    DampingOnly,
}

/// What the corrections of a coupled solve on a GPU are made of. The answer is the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Formulation {
    /// Condensed where the liquid wets few nodes, else two-field.
    Auto,
    /// Pressures and velocities (thesis 5.25), all on the device.
    TwoField,
    /// Pressures alone, with the inverse of the solids' matrix among the wet nodes, made on the CPU.
    Condensed,
}

/// How pressure varies over a cell where it acts on the patches of a solid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PatchPressure {
    /// Not at all, as in the thesis: off by the weight of the liquid between a patch and the centre.
    Cell,
    /// As in a liquid at rest: with gradient rho g.
    Hydrostatic,
    /// With the gradient that the sub-step before left.
    Gradient,
}

/// What preconditions the conjugate gradients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preconditioner {
    /// One V-cycle of aggregation multigrid.
    Multigrid,
    /// The diagonal, for comparison.
    Jacobi,
    /// The same with the 3x3 blocks of the nodes of solids, where one solve is for both.
    BlockJacobi,
}

/// What a run writes.
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
    /// Every how many frames; default 1.
    pub every: u64,
    /// Frames from one checkpoint to the next; 0: only where the run is interrupted. Default 10.
    pub checkpoint_every: u64,
}

/// How the mesh of the liquid's surface is made from markers, for files and for pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceMesh {
    /// Distance of the surface from a marker alone, cells; default 0.95. A flat surface lies 0.7 of it beyond its
    /// outermost markers.
    pub radius: f64,
    /// Rounds of smoothing, which keep the volume; default 20.
    pub smoothing: u32,
}

/// A pinhole camera.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Position, m; default from the domain. With keyframes, that of the first.
    pub eye: DVec3,
    /// Point in the middle of the picture, m.
    pub target: DVec3,
    /// Up.
    pub up: DVec3,
    /// Vertical opening, degrees.
    pub fov: f64,
    /// Picture size, pixels.
    pub size: [usize; 2],
    /// Its path, ascending in time; empty: it rests.
    pub keyframes: Vec<CameraKeyframe>,
    /// Where pictures show elastic solids cut open, so that one sees what is in them.
    pub cut: Option<CameraCut>,
}

/// A plane across an axis: what lies on the camera's side of it is not drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraCut {
    /// 0, 1 or 2.
    pub axis: usize,
    /// m
    pub at: f64,
}

/// Where a camera is at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraKeyframe {
    /// s
    pub time: f64,
    /// Position, m.
    pub eye: DVec3,
    /// Point in the middle of the picture, m.
    pub target: DVec3,
    /// Vertical opening, degrees.
    pub fov: f64,
}

impl Scene {
    /// Where a value was written, for errors, by its dotted key: file, line and key, or the `--set`. Where it is left out, its table's line.
    pub fn at(&self, key: &str) -> String {
        let file = self.file.display();
        match self.written.at(key) {
            Some(Origin::Line(line)) => format!("{file}:{line}: {key}"),
            Some(Origin::Set(index)) => format!("--set {}: {key}", self.overrides[index]),
            None => format!("{file}: {key}"),
        }
    }

    /// The grid of the scene.
    pub fn grid(&self) -> Grid {
        Grid {
            cells: self.domain.cells,
            dx: self.domain.size.x / self.domain.cells[0] as f64,
        }
    }

    /// Whether an obstacle has keyframes.
    pub fn obstacles_move(&self) -> bool {
        self.obstacles
            .iter()
            .any(|obstacle| obstacle.motion.is_some())
    }

    /// Frames of the whole run; frame 0 is the initial state and not counted.
    pub fn n_frames(&self) -> u64 {
        (self.time.duration * self.time.frames_per_second)
            .round()
            .max(1.0) as u64
    }
}
