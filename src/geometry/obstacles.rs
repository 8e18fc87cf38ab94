//! `clip` for obstacles: apertures and distances, once for static obstacles and in every sub-step for moving ones.
//!
//! Moving obstacles are clipped on top of the static ones, so a sub-step updates only the grid lines and cells near moving
//! obstacles. The result depends on the time alone.

use glam::{DMat3, DQuat, DVec3};

use super::clip::{Clipping, OpenFractions, clip, open_fractions};
use super::distance::{BAND, Body, RigidDisplacement};
use super::solid_clip::line_sums;
use super::{ContactField, CutCells, RigidVelocity, Surface, SurfaceFriction, clamp_open, close_walls, is_wall};
use crate::error::Error;
use crate::grid::{Axis, Grid, Sides};
use crate::scene::{Acceleration, Keyframe, Motion, Obstacle, Scene};

/// Apertures and distances of the obstacles, and the raw apertures to which solids add.
#[derive(Clone, Debug)]
pub struct ObstacleCut {
    /// Face apertures per axis, neither clamped nor closed at the walls.
    pub(super) raw: [Vec<f64>; 3],
    pub(super) open_sides: Sides,
    /// Clamped and closed apertures, and distances.
    pub cut: CutCells,
    /// Of walls and static obstacles.
    friction: SurfaceFriction,
    moving: Option<Box<MovingObstacles>>,
}

#[derive(Clone, Debug)]
struct MovingObstacles {
    grid: Grid,
    area_clamp: f64,
    field: ContactField,
    /// Apertures and distances of the static obstacles.
    static_cut: CutCells,
    static_raw: [Vec<f64>; 3],
    /// Faces that differ from those of the static obstacles.
    changed_faces: [Vec<usize>; 3],
    flux: Vec<(usize, f64)>,
    walls: Vec<(usize, DVec3)>,
}

/// A moving obstacle.
#[derive(Clone, Debug)]
pub(super) struct MovingBody {
    /// Placed, before the motion.
    rest: Body,
    pub(super) motion: Motion,
    /// Centre of rotation, m.
    pivot: DVec3,
    /// Greatest distance of a vertex from the pivot, m.
    pub(super) radius: f64,
    /// Coefficient of friction.
    pub(super) friction: f64,
}

/// Step of the difference quotient of a velocity, relative to the time to the next keyframe.
const DIFFERENCE_STEP: f64 = 1e-6;

/// Closure defect of a grid line of apertures that rounding explains.
const CLOSURE_TOLERANCE: f64 = 1e-12;

/// Apertures and distances of all obstacles at the start. Aperture changes add up; the distance is that of the union.
pub fn obstacle_cut(scene: &Scene, grid: &Grid) -> Result<ObstacleCut, Error> {
    let mut solid_distance = vec![BAND * grid.dx; grid.n_cells()];
    let mut clippings = Vec::new();
    let rubs = scene.obstacles.iter().any(|obstacle| obstacle.motion.is_none() && obstacle.friction > 0.0);
    let mut friction = SurfaceFriction {
        walls: scene.domain.friction,
        at_rest: if rubs { vec![0.0; grid.n_cells()] } else { Vec::new() },
    };
    let mut start = 1.0;
    let mut bodies = Vec::new();
    for (number, obstacle) in scene.obstacles.iter().enumerate() {
        let name = scene.at(&format!("obstacle[{number}]"));
        if let Some(motion) = &obstacle.motion {
            let body = MovingBody::new(Body::before_walls(obstacle, &name, grid)?, motion, obstacle.friction);
            // Tested at the start alone: a moving surface remains closed.
            body.ensure_closed(&name, grid)?;
            start += body.rest.at_infinity();
            bodies.push(body);
            continue;
        }
        let body = Body::new(obstacle, &name, grid)?;
        start += body.at_infinity();
        let clipping = clip(&body.surface, grid);
        ensure_closed(&name, &body.surface, &clipping, grid)?;
        clippings.push(clipping);
        for (cell, (union, body)) in solid_distance.iter_mut().zip(body.distance(grid)).enumerate() {
            if rubs && body < *union {
                friction.at_rest[cell] = obstacle.friction;
            }
            *union = union.min(body);
        }
    }
    let OpenFractions { faces: raw, .. } = open_fractions(grid, start, &clippings);
    let area_clamp = scene.solver.area_clamp;
    let clamped = |open: &f64| clamp_open(*open, area_clamp);
    let mut open = raw.each_ref().map(|open| open.iter().map(clamped).collect());
    let open_sides = scene.domain.open;
    close_walls(grid, open_sides, &mut open);
    let cut = CutCells { open, solid_distance };
    let mut all = ObstacleCut { raw: raw.clone(), open_sides, cut: cut.clone(), friction, moving: None };
    if !bodies.is_empty() {
        all.moving = Some(Box::new(MovingObstacles {
            grid: *grid,
            area_clamp,
            field: all.contact_field(grid).with_moving(bodies),
            static_cut: cut,
            static_raw: raw,
            changed_faces: Default::default(),
            flux: Vec::new(),
            walls: Vec::new(),
        }));
        all.move_to(0.0, 0.0);
    }
    Ok(all)
}

/// Number of the obstacle in which a point (m) lies deepest at the start, if any.
pub fn deepest_obstacle(scene: &Scene, grid: &Grid, x: DVec3) -> Result<Option<usize>, Error> {
    let mut deepest = None;
    let mut least = 0.0;
    for (number, obstacle) in scene.obstacles.iter().enumerate() {
        let name = scene.at(&format!("obstacle[{number}]"));
        let rest = Body::before_walls(obstacle, &name, grid)?;
        let body = match &obstacle.motion {
            Some(motion) => MovingBody::new(rest, motion, obstacle.friction).at(0.0),
            None => rest,
        };
        let distance = body.signed_distance(x);
        if distance < least {
            (deepest, least) = (Some(number), distance);
        }
    }
    Ok(deepest)
}

/// Refuses a surface that is not closed: the apertures along a grid line end at another value than they start.
fn ensure_closed(name: &str, surface: &Surface, clipping: &Clipping, grid: &Grid) -> Result<(), Error> {
    let defect = Axis::ALL.map(|axis| line_sums(grid, axis, clipping).1).into_iter().fold(0.0, f64::max);
    // Rounding of positions enters areas: 1e-12 holds for bodies within 200 cells of the origin.
    let [low, high] = surface.bounds();
    let reach = low.abs().max(high.abs()).max_element() / (200.0 * grid.dx);
    let tolerance = CLOSURE_TOLERANCE * reach.max(1.0);
    if defect <= tolerance {
        return Ok(());
    }
    Err(Error::input(
        name,
        format!(
            "a surface is not closed: the apertures along a grid line differ by {defect:e} between start and end, allowed is {tolerance:e}"
        ),
        "repair the surfaces of mesh obstacles, and keep bodies near the domain",
    ))
}

impl ObstacleCut {
    /// A closed domain without obstacles.
    pub fn none(grid: &Grid) -> ObstacleCut {
        let raw = Axis::ALL.map(|axis| vec![1.0; grid.n_faces(axis)]);
        let mut open = raw.clone();
        let open_sides = Sides::default();
        close_walls(grid, open_sides, &mut open);
        let solid_distance = vec![BAND * grid.dx; grid.n_cells()];
        let cut = CutCells { open, solid_distance };
        ObstacleCut { raw, open_sides, cut, friction: SurfaceFriction::default(), moving: None }
    }

    /// Apertures and distances of the static obstacles.
    pub fn static_cut(&self) -> &CutCells {
        self.moving.as_ref().map_or(&self.cut, |moving| &moving.static_cut)
    }

    /// The obstacles as nodes of solids meet them.
    pub fn contact_field(&self, grid: &Grid) -> ContactField {
        match &self.moving {
            Some(moving) => moving.field.clone(),
            None => {
                let mut field = ContactField::at_rest(grid, self.cut.solid_distance.clone());
                field.friction = self.friction.clone();
                field
            }
        }
    }

    /// Whether the scene has moving obstacles.
    pub fn has_moving(&self) -> bool {
        self.moving.is_some()
    }

    /// Faces per axis, and cells, that differ from those of the static obstacles.
    pub(super) fn changed(&self) -> ([&[usize]; 3], &[usize]) {
        match &self.moving {
            Some(moving) => (moving.changed_faces.each_ref().map(Vec::as_slice), moving.field.changed()),
            None => ([&[]; 3], &[]),
        }
    }

    /// J v of the moving obstacles: per cell with patches, ascending, the volume flux out of the cell, m^3/s.
    pub fn flux(&self) -> &[(usize, f64)] {
        self.moving.as_ref().map_or(&[], |moving| &moving.flux)
    }

    /// Cells within three cells of a moving obstacle, and nearer to it than to static ones, ascending; with the velocity of
    /// its rigid motion at the cell centre, m/s. Along the normal that is the velocity of the surface.
    pub fn wall_velocities(&self) -> &[(usize, DVec3)] {
        self.moving.as_ref().map_or(&[], |moving| &moving.walls)
    }

    /// The wall velocity of a cell, if it has one.
    pub fn wall_velocity(&self, cell: usize) -> Option<DVec3> {
        let walls = self.wall_velocities();
        let at = walls.binary_search_by_key(&cell, |(cell, _)| *cell);
        at.ok().map(|at| walls[at].1)
    }

    /// Copies the keyframes of the moving obstacles of a scene that has the same obstacles otherwise. Positions change with the next
    /// [`ObstacleCut::move_to`].
    pub fn follow(&mut self, scene: &Scene) {
        if let Some(moving) = &mut self.moving {
            moving.field.follow(scene);
        }
    }

    /// Upper bound of the speed of all obstacles between a time and `span` (both s) later, m/s.
    pub fn max_speed(&self, time: f64, span: f64) -> f64 {
        let moving = self.moving.as_ref();
        moving.map_or(0.0, |moving| moving.field.max_speed(time, span))
    }

    /// Prescribed accelerations of all obstacles.
    pub fn accelerations(&self) -> Vec<Acceleration> {
        let moving = self.moving.as_ref();
        moving.map_or(Vec::new(), |moving| moving.field.accelerations())
    }

    /// Moves the obstacles to a time (s). Their velocities lead to their poses dt (s) later; with dt = 0 they are
    /// instantaneous.
    pub fn move_to(&mut self, time: f64, dt: f64) {
        let Some(moving) = &mut self.moving else {
            return;
        };
        moving.restore(&mut self.raw, &mut self.cut);
        let (grid, area_clamp) = (moving.grid, moving.area_clamp);
        let now = moving.field.moved_to(time, dt);
        let field = &moving.field;
        let (surface, body_of) = joined(now.iter().map(|body| &body.surface));
        let clipping = clip(&surface, &grid);

        for axis in Axis::ALL {
            let a = axis.index();
            for (face, change) in line_sums(&grid, axis, &clipping).0 {
                self.raw[a][face] = moving.static_raw[a][face] + change;
                if !is_wall(&grid, self.open_sides, axis, grid.face_at(axis, face)) {
                    self.cut.open[a][face] = clamp_open(self.raw[a][face], area_clamp);
                }
                moving.changed_faces[a].push(face);
            }
        }

        for &cell in field.changed() {
            self.cut.solid_distance[cell] = field.distance[cell];
        }
        let walls = field.changed().iter().filter_map(|&cell| {
            let centre = grid.cell_centre(grid.cell_at(cell));
            Some((cell, field.velocity(centre)?))
        });
        moving.walls = walls.collect();

        let mut flux: Vec<(usize, f64)> = Vec::new();
        let mut patches: Vec<_> = clipping.patches.iter().collect();
        patches.sort_by_key(|patch| patch.cell);
        for patches in patches.chunk_by(|a, b| a.cell == b.cell) {
            let parts = patches.iter().map(|patch| {
                let velocity = &field.motions[body_of[patch.triangle]];
                patch.area * patch.normal.dot(velocity.at(patch.centroid))
            });
            flux.push((patches[0].cell, parts.sum()));
        }
        moving.flux = flux;
    }
}

impl MovingObstacles {
    fn restore(&mut self, raw: &mut [Vec<f64>; 3], cut: &mut CutCells) {
        for (a, faces) in self.changed_faces.iter_mut().enumerate() {
            for face in faces.drain(..) {
                raw[a][face] = self.static_raw[a][face];
                cut.open[a][face] = self.static_cut.open[a][face];
            }
        }
        for &cell in self.field.changed() {
            cut.solid_distance[cell] = self.static_cut.solid_distance[cell];
        }
    }
}

impl MovingBody {
    fn new(rest: Body, motion: &Motion, friction: f64) -> MovingBody {
        let [low, high] = rest.surface.bounds();
        let pivot = motion.pivot.unwrap_or(0.5 * (low + high));
        let distances = rest.surface.vertices.iter().map(|x| x.distance(pivot));
        let radius = distances.fold(0.0, f64::max);
        MovingBody { rest, motion: motion.clone(), pivot, radius, friction }
    }

    fn ensure_closed(&self, name: &str, grid: &Grid) -> Result<(), Error> {
        let surface = self.at(0.0).surface;
        ensure_closed(name, &surface, &clip(&surface, grid), grid)
    }

    fn pose(&self, time: f64) -> (DQuat, DVec3) {
        let (rotation, translate) = Keyframe::pose(&self.motion.keyframes, time);
        (DQuat::from_scaled_axis(rotation), translate)
    }

    /// The body at a time (s), including its sides on walls.
    pub(super) fn at(&self, time: f64) -> Body {
        let (rotation, translate) = self.pose(time);
        self.rest.moved(&RigidDisplacement { pivot: self.pivot, rotation: DMat3::from_quat(rotation), translate })
    }

    /// Mean velocity over dt (s) from a time on; instantaneous with dt = 0.
    pub(super) fn velocity(&self, time: f64, dt: f64) -> RigidVelocity {
        let span = match Keyframe::next_time(&self.motion.keyframes, time) {
            _ if dt > 0.0 => dt,
            Some(next) => DIFFERENCE_STEP * (next - time),
            None => 1.0,
        };
        let [(from, here), (to, there)] = [self.pose(time), self.pose(time + span)];
        RigidVelocity {
            velocity: (there - here) / span,
            spin: (to * from.inverse()).to_scaled_axis() / span,
            centre: self.pivot + here,
        }
    }
}

/// The union of surfaces, and the surface of each triangle.
fn joined<'a>(surfaces: impl Iterator<Item = &'a Surface>) -> (Surface, Vec<usize>) {
    let (mut all, mut body_of) = (Surface::default(), Vec::new());
    for (number, surface) in surfaces.enumerate() {
        let first = all.vertices.len() as u32;
        all.vertices.extend(&surface.vertices);
        let triangles = surface.triangles.iter();
        all.triangles.extend(triangles.map(|triangle| triangle.map(|vertex| vertex + first)));
        body_of.resize(all.triangles.len(), number);
    }
    (all, body_of)
}

/// Surfaces of all obstacles for pictures, normals towards the liquid.
#[derive(Clone, Debug)]
pub struct ObstacleSurfaces {
    bodies: Vec<(Surface, Option<MovingBody>)>,
}

impl ObstacleSurfaces {
    /// The surfaces before their motion.
    pub fn new(scene: &Scene, grid: &Grid) -> Result<ObstacleSurfaces, Error> {
        let body = |(number, obstacle): (usize, &Obstacle)| {
            let name = scene.at(&format!("obstacle[{number}]"));
            let body = Body::before_walls(obstacle, &name, grid)?;
            let surface = body.surface.clone();
            let motion = obstacle.motion.as_ref();
            Ok((surface, motion.map(|motion| MovingBody::new(body, motion, obstacle.friction))))
        };
        let bodies = scene.obstacles.iter().enumerate().map(body);
        Ok(ObstacleSurfaces { bodies: bodies.collect::<Result<_, Error>>()? })
    }

    /// The surfaces at a time, s.
    pub fn at(&self, time: f64) -> Vec<Surface> {
        let bodies = self.bodies.iter();
        bodies
            .map(|(surface, moving)| match moving {
                Some(body) => body.at(time).surface,
                None => surface.clone(),
            })
            .collect()
    }
}
