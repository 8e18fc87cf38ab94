//! `clip`, for obstacles: what they leave of the grid, once for those that stand still and in every sub-step for those that move.
//!
//! Obstacles that move are cut out of what those that stand still leave, so a sub-step does the grid lines and the cells near those that
//! move. What comes out depends on the time alone.

use glam::{DMat3, DQuat, DVec3};

use super::clip::{Clipping, OpenFractions, clip, open_fractions};
use super::distance::{BAND, Body, Rigid};
use super::solid_clip::line_sums;
use super::{CutCells, Surface, clamp_open, close_walls, is_wall};
use crate::error::Error;
use crate::grid::{Axis, Grid, Sides};
use crate::scene::{Keyframe, Motion, Obstacle, Scene};

/// What the obstacles leave of the grid, and what of it other bodies add to.
#[derive(Clone, Debug)]
pub struct ObstacleCut {
    /// Open fraction of every face per axis, neither clamped nor closed at the walls.
    pub(super) raw: [Vec<f64>; 3],
    /// Sides of the domain that are no walls.
    pub(super) open_sides: Sides,
    /// The same, clamped and closed, with the distance.
    pub cut: CutCells,
    moving: Option<Box<MovingObstacles>>,
}

/// The obstacles that move.
#[derive(Clone, Debug)]
struct MovingObstacles {
    grid: Grid,
    area_clamp: f64,
    bodies: Vec<MovingBody>,
    /// What those leave that stand still.
    still: CutCells,
    still_raw: [Vec<f64>; 3],
    /// Faces and cells in which it is not what all leave.
    changed_faces: [Vec<usize>; 3],
    changed_cells: Vec<usize>,
    flux: Vec<(usize, f64)>,
    walls: Vec<(usize, DVec3)>,
}

/// One of them.
#[derive(Clone, Debug)]
struct MovingBody {
    /// Where its placement puts it.
    rest: Body,
    motion: Motion,
    /// m
    pivot: DVec3,
    /// Furthest vertex from the pivot, m.
    radius: f64,
}

/// How a rigid body moves at one moment: v(x) = velocity + spin x (x - centre). Nothing flows through its closed surface in sum.
#[derive(Clone, Copy, Debug)]
struct Twist {
    /// m/s
    velocity: DVec3,
    /// rad/s
    spin: DVec3,
    /// m
    centre: DVec3,
}

impl Twist {
    fn at(&self, x: DVec3) -> DVec3 {
        self.velocity + self.spin.cross(x - self.centre)
    }
}

/// Part of the way to the next keyframe over which the velocity of a moment is taken.
const MOMENT: f64 = 1e-6;

/// Largest difference between the start and the end of a line of open fractions that rounding explains.
const CLOSURE_TOLERANCE: f64 = 1e-12;

/// Open areas and distances of all obstacles of a scene, those that move where they start. Their contributions to the open fractions add;
/// the distance is that of their union.
///
/// # Errors
/// [`Error::Input`] when a mesh file cannot be used, or is not closed.
pub fn obstacle_cut(scene: &Scene, grid: &Grid) -> Result<ObstacleCut, Error> {
    let mut solid_distance = vec![BAND * grid.dx; grid.n_cells()];
    let mut clippings = Vec::new();
    let mut start = 1.0;
    let mut bodies = Vec::new();
    for (number, obstacle) in scene.obstacles.iter().enumerate() {
        let name = scene.at(&format!("obstacle[{number}]"));
        if let Some(motion) = &obstacle.motion {
            let body = MovingBody::new(Body::before_walls(obstacle, &name, grid)?, motion);
            // Where it starts: what moves stays closed.
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
        for (union, body) in solid_distance.iter_mut().zip(body.distance(grid)) {
            *union = union.min(body);
        }
    }
    let OpenFractions { faces: raw, .. } = open_fractions(grid, start, &clippings);
    let area_clamp = scene.solver.area_clamp;
    let clamped = |open: &f64| clamp_open(*open, area_clamp);
    let mut open = raw
        .each_ref()
        .map(|open| open.iter().map(clamped).collect());
    let open_sides = scene.domain.open;
    close_walls(grid, open_sides, &mut open);
    let cut = CutCells {
        open,
        solid_distance,
    };
    let mut all = ObstacleCut {
        raw: raw.clone(),
        open_sides,
        cut: cut.clone(),
        moving: None,
    };
    if !bodies.is_empty() {
        all.moving = Some(Box::new(MovingObstacles {
            grid: *grid,
            area_clamp,
            bodies,
            still: cut,
            still_raw: raw,
            changed_faces: Default::default(),
            changed_cells: Vec::new(),
            flux: Vec::new(),
            walls: Vec::new(),
        }));
        all.move_to(0.0, 0.0);
    }
    Ok(all)
}

/// The obstacle that a point (m) lies deepest in at the start, by number; `None` where it lies in none.
///
/// # Errors
/// [`Error::Input`] when a mesh file cannot be used.
pub fn deepest_obstacle(scene: &Scene, grid: &Grid, x: DVec3) -> Result<Option<usize>, Error> {
    let mut deepest = None;
    let mut least = 0.0;
    for (number, obstacle) in scene.obstacles.iter().enumerate() {
        let name = scene.at(&format!("obstacle[{number}]"));
        let rest = Body::before_walls(obstacle, &name, grid)?;
        let body = match &obstacle.motion {
            Some(motion) => MovingBody::new(rest, motion).at(0.0),
            None => rest,
        };
        let distance = body.signed_distance(x);
        if distance < least {
            (deepest, least) = (Some(number), distance);
        }
    }
    Ok(deepest)
}

/// Refuses a surface along a grid line of which the open areas do not end as they start.
fn ensure_closed(
    name: &str,
    surface: &Surface,
    clipping: &Clipping,
    grid: &Grid,
) -> Result<(), Error> {
    let defect = Axis::ALL
        .map(|axis| line_sums(grid, axis, clipping).1)
        .into_iter()
        .fold(0.0, f64::max);
    // Positions carry their rounding into areas: 1e-12 is for bodies within 200 cells of the origin.
    let [low, high] = surface.bounds();
    let reach = low.abs().max(high.abs()).max_element() / (200.0 * grid.dx);
    let tolerance = CLOSURE_TOLERANCE * reach.max(1.0);
    if defect <= tolerance {
        return Ok(());
    }
    Err(Error::input(
        name,
        format!(
            "along a grid line the open areas end {defect:e} from where they start, allowed {tolerance:e}: a surface is not closed"
        ),
        "repair the surfaces of mesh obstacles, and keep bodies near the domain",
    ))
}

impl ObstacleCut {
    /// What no obstacles leave in a closed domain: everything but the walls.
    pub fn none(grid: &Grid) -> ObstacleCut {
        let raw = Axis::ALL.map(|axis| vec![1.0; grid.n_faces(axis)]);
        let mut open = raw.clone();
        let open_sides = Sides::default();
        close_walls(grid, open_sides, &mut open);
        let solid_distance = vec![BAND * grid.dx; grid.n_cells()];
        let cut = CutCells {
            open,
            solid_distance,
        };
        ObstacleCut {
            raw,
            open_sides,
            cut,
            moving: None,
        }
    }

    /// What those leave that stand still.
    pub fn still(&self) -> &CutCells {
        self.moving
            .as_ref()
            .map_or(&self.cut, |moving| &moving.still)
    }

    /// Whether some move.
    pub fn move_at_all(&self) -> bool {
        self.moving.is_some()
    }

    /// Faces per axis, and cells, that need not be as those leave them that stand still.
    pub(super) fn changed(&self) -> ([&[usize]; 3], &[usize]) {
        match &self.moving {
            Some(moving) => (
                moving.changed_faces.each_ref().map(Vec::as_slice),
                &moving.changed_cells,
            ),
            None => ([&[]; 3], &[]),
        }
    }

    /// J v of those that move: per cell with patches, ascending, the volume that they take from it in a second, m^3/s.
    pub fn flux(&self) -> &[(usize, f64)] {
        self.moving.as_ref().map_or(&[], |moving| &moving.flux)
    }

    /// The cells within three cells of an obstacle that moves, and nearer to it than to those that stand still, ascending; each with the
    /// velocity that the obstacle would have at its centre, m/s. Along the way to the surface that is the surface's own.
    pub fn walls(&self) -> &[(usize, DVec3)] {
        self.moving.as_ref().map_or(&[], |moving| &moving.walls)
    }

    /// That of a cell, where it has one.
    pub fn wall(&self, cell: usize) -> Option<DVec3> {
        let walls = self.walls();
        let found = walls.binary_search_by_key(&cell, |(cell, _)| *cell);
        found.ok().map(|at| walls[at].1)
    }

    /// The speed that no obstacle is above from a time on for so long (both s), m/s.
    pub fn max_speed(&self, time: f64, span: f64) -> f64 {
        let bodies = self.moving.iter().flat_map(|moving| &moving.bodies);
        bodies.fold(0.0, |speed, body| speed.max(body.max_speed(time, span)))
    }

    /// Puts the obstacles that move where they are at a time (s), with the velocities that take them to where they are dt (s) later;
    /// with those of the moment where dt is 0.
    pub fn move_to(&mut self, time: f64, dt: f64) {
        let Some(moving) = &mut self.moving else {
            return;
        };
        moving.restore(&mut self.raw, &mut self.cut);
        let (grid, area_clamp) = (moving.grid, moving.area_clamp);
        let now: Vec<(Body, Twist)> = moving
            .bodies
            .iter()
            .map(|body| (body.at(time).beyond_walls(&grid), body.twist(time, dt)))
            .collect();
        let (surface, body_of) = joined(now.iter().map(|(body, _)| &body.surface));
        let clipping = clip(&surface, &grid);

        for axis in Axis::ALL {
            let a = axis.index();
            for (face, change) in line_sums(&grid, axis, &clipping).0 {
                self.raw[a][face] = moving.still_raw[a][face] + change;
                if !is_wall(&grid, self.open_sides, axis, grid.face_at(axis, face)) {
                    self.cut.open[a][face] = clamp_open(self.raw[a][face], area_clamp);
                }
                moving.changed_faces[a].push(face);
            }
        }

        let mut walls: Vec<(usize, DVec3)> = Vec::new();
        for (body, twist) in &now {
            let velocity = |cell| twist.at(grid.cell_centre(grid.cell_at(cell)));
            for (cell, distance) in body.near(&grid) {
                let nearest = &mut self.cut.solid_distance[cell];
                if distance < *nearest {
                    *nearest = distance;
                    moving.changed_cells.push(cell);
                    if distance > -BAND * grid.dx {
                        walls.push((cell, velocity(cell)));
                    }
                }
            }
        }
        moving.changed_cells.sort_unstable();
        moving.changed_cells.dedup();
        // Of several that come near a cell the last was the nearest; the order of bodies is kept among equals.
        walls.sort_by_key(|&(cell, _)| cell);
        walls.reverse();
        walls.dedup_by_key(|(cell, _)| *cell);
        walls.reverse();
        moving.walls = walls;

        let mut flux: Vec<(usize, f64)> = Vec::new();
        let mut patches: Vec<_> = clipping.patches.iter().collect();
        patches.sort_by_key(|patch| patch.cell);
        for patches in patches.chunk_by(|a, b| a.cell == b.cell) {
            let parts = patches.iter().map(|patch| {
                let (_, twist) = &now[body_of[patch.triangle]];
                patch.area * patch.normal.dot(twist.at(patch.centroid))
            });
            flux.push((patches[0].cell, parts.sum()));
        }
        moving.flux = flux;
    }
}

impl MovingObstacles {
    /// Puts back what those leave that stand still.
    fn restore(&mut self, raw: &mut [Vec<f64>; 3], cut: &mut CutCells) {
        for (a, faces) in self.changed_faces.iter_mut().enumerate() {
            for face in faces.drain(..) {
                raw[a][face] = self.still_raw[a][face];
                cut.open[a][face] = self.still.open[a][face];
            }
        }
        for cell in self.changed_cells.drain(..) {
            cut.solid_distance[cell] = self.still.solid_distance[cell];
        }
    }
}

impl MovingBody {
    fn new(rest: Body, motion: &Motion) -> MovingBody {
        let [low, high] = rest.surface.bounds();
        let pivot = motion.pivot.unwrap_or(0.5 * (low + high));
        let ways = rest.surface.vertices.iter().map(|x| x.distance(pivot));
        let radius = ways.fold(0.0, f64::max);
        MovingBody {
            rest,
            motion: motion.clone(),
            pivot,
            radius,
        }
    }

    fn ensure_closed(&self, name: &str, grid: &Grid) -> Result<(), Error> {
        let surface = self.at(0.0).surface;
        ensure_closed(name, &surface, &clip(&surface, grid), grid)
    }

    fn pose(&self, time: f64) -> (DQuat, DVec3) {
        let (turn, translate) = Keyframe::pose(&self.motion.keyframes, time);
        (DQuat::from_scaled_axis(turn), translate)
    }

    /// Where it is, its sides on walls not yet left out.
    fn at(&self, time: f64) -> Body {
        let (turn, translate) = self.pose(time);
        self.rest.moved(&Rigid {
            pivot: self.pivot,
            turn: DMat3::from_quat(turn),
            translate,
        })
    }

    /// How it moves from a time on for dt (s), or at that moment where dt is 0.
    fn twist(&self, time: f64, dt: f64) -> Twist {
        let span = match Keyframe::next_time(&self.motion.keyframes, time) {
            _ if dt > 0.0 => dt,
            Some(next) => MOMENT * (next - time),
            None => 1.0,
        };
        let [(from, here), (to, there)] = [self.pose(time), self.pose(time + span)];
        Twist {
            velocity: (there - here) / span,
            spin: (to * from.inverse()).to_scaled_axis() / span,
            centre: self.pivot + here,
        }
    }

    /// As [`ObstacleCut::max_speed`].
    fn max_speed(&self, time: f64, span: f64) -> f64 {
        let frames = self.motion.keyframes.windows(2);
        let met = frames.filter(|pair| pair[1].time > time && pair[0].time < time + span);
        let speeds = met.map(|pair| {
            let turn = |frame: &Keyframe| frame.angle * frame.axis;
            let way = (pair[1].translate - pair[0].translate).length()
                + (turn(&pair[1]) - turn(&pair[0])).length() * self.radius;
            way / (pair[1].time - pair[0].time)
        });
        speeds.fold(0.0, f64::max)
    }
}

/// Several surfaces as one, and which of them each triangle is of.
fn joined<'a>(surfaces: impl Iterator<Item = &'a Surface>) -> (Surface, Vec<usize>) {
    let (mut all, mut body_of) = (Surface::default(), Vec::new());
    for (number, surface) in surfaces.enumerate() {
        let first = all.vertices.len() as u32;
        all.vertices.extend(&surface.vertices);
        let triangles = surface.triangles.iter();
        all.triangles
            .extend(triangles.map(|triangle| triangle.map(|vertex| vertex + first)));
        body_of.resize(all.triangles.len(), number);
    }
    (all, body_of)
}

/// The surfaces of all obstacles, for pictures. Normals point to the liquid.
#[derive(Clone, Debug)]
pub struct ObstacleSurfaces {
    bodies: Vec<(Surface, Option<MovingBody>)>,
}

impl ObstacleSurfaces {
    /// Reads mesh files once: a run does not need them any more.
    ///
    /// # Errors
    /// [`Error::Input`] when a mesh file cannot be used.
    pub fn new(scene: &Scene, grid: &Grid) -> Result<ObstacleSurfaces, Error> {
        let body = |(number, obstacle): (usize, &Obstacle)| {
            let name = scene.at(&format!("obstacle[{number}]"));
            let body = Body::before_walls(obstacle, &name, grid)?;
            let surface = body.surface.clone();
            let motion = obstacle.motion.as_ref();
            Ok((surface, motion.map(|motion| MovingBody::new(body, motion))))
        };
        let bodies = scene.obstacles.iter().enumerate().map(body);
        Ok(ObstacleSurfaces {
            bodies: bodies.collect::<Result<_, Error>>()?,
        })
    }

    /// Where they are at a time, s.
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
