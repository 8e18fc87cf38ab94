//! Initial liquid: distance to its regions, markers, velocity.

use std::sync::LazyLock;

use glam::{DVec3, I64Vec3};
use rayon::prelude::*;

use super::distance::Solid;
use super::placing::outside;
use super::{CutCells, MovedMesh, is_wall, solitary};
use crate::error::{Error, rounded};
use crate::grid::{Axis, Grid};
use crate::scene::{Liquid, Placement, Region, Scene, Shape, Surface, box_reaches};
use crate::state::State;

/// The regions of a liquid, prepared for distance queries.
pub struct Regions {
    parts: Vec<Part>,
}

struct Part {
    solid: Solid,
    subtract: bool,
    velocity: DVec3,
}

impl Part {
    /// Velocity of the liquid at a point, m/s: that of the region plus that of a solitary wave.
    fn velocity_at(&self, x: DVec3) -> DVec3 {
        self.velocity + self.solid.velocity(x)
    }
}

impl Regions {
    /// The regions of a liquid in a domain of this size (m). `at` returns the origin of a key for errors.
    pub fn new(liquid: &Liquid, size: DVec3, at: impl Fn(&str) -> String) -> Result<Regions, Error> {
        let parts = liquid.regions.iter().enumerate().map(|(number, region)| {
            let place = || at(&format!("liquid.region[{number}]"));
            let solid = Solid::placed(&region.shape, &region.placement);
            let solid = solid.map_err(|error| error.within(&place()))?;
            if let Solid::Mesh(mesh) = &solid
                && !box_reaches(mesh.bounds(), size)
            {
                return Err(outside(mesh.bounds(), size, &place()));
            }
            Ok(Part { solid, subtract: region.subtract, velocity: region.velocity })
        });
        Ok(Regions { parts: parts.collect::<Result<_, Error>>()? })
    }

    /// The regions without flat sides on or beyond walls of the domain, which are no free surface.
    pub fn beyond_walls(self, grid: &Grid) -> Regions {
        let parts = self
            .parts
            .into_iter()
            .map(|part| Part { solid: part.solid.beyond_walls(grid, &Placement::default(), DVec3::ZERO), ..part });
        Regions { parts: parts.collect() }
    }

    /// Signed distance at a point, m, negative in the liquid: the union, in order, less the regions that subtract.
    ///
    /// Exact outside a union and inside a single region (waves: to first order). Inside overlapping or touching regions it
    /// is a lower bound of the depth.
    pub fn distance(&self, x: DVec3) -> f64 {
        self.parts.iter().fold(f64::INFINITY, |distance, part| {
            let own = part.solid.distance(x);
            if part.subtract { distance.max(-own) } else { distance.min(own) }
        })
    }

    /// Initial velocity at a point, m/s: that of the last region that contains it. `None` outside.
    pub fn velocity(&self, x: DVec3) -> Option<DVec3> {
        self.parts.iter().fold(None, |velocity, part| {
            if part.solid.distance(x) >= 0.0 { velocity } else { (!part.subtract).then(|| part.velocity_at(x)) }
        })
    }

    /// Velocity of the nearest region that adds liquid within `reach` (m), m/s; of equals the last.
    fn nearest_velocity(&self, x: DVec3, reach: f64) -> Option<DVec3> {
        let adding = self.parts.iter().rev().filter(|part| !part.subtract);
        let distances = adding.map(|part| (part.solid.distance(x), part));
        distances
            .filter(|&(distance, _)| distance <= reach)
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, part)| part.velocity_at(x))
    }
}

/// Largest component of the initial velocity, m/s.
pub fn initial_speed(liquid: &Liquid) -> f64 {
    let speed = |region: &Region| {
        let own = match &region.shape {
            Shape::Solitary(wave) => solitary::fastest(wave),
            _ => 0.0,
        };
        region.velocity.abs().max_element() + own
    };
    liquid.regions.iter().map(speed).fold(0.0, f64::max)
}

/// Distance from the regions up to which faces have an initial velocity, cells. The marker surface is bumpy, and all faces of
/// its cells need velocities.
const VELOCITY_REACH: f64 = 2.0;

/// Distance of `surface = "fixed"` at all cell centres, m.
///
/// Sides on walls and between touching or overlapping regions are no free surface. The distance is clamped to the sum of the
/// domain's sides, for domains full of liquid. Positive everywhere without a liquid.
pub fn liquid_distance(scene: &Scene, grid: &Grid) -> Result<Vec<f64>, Error> {
    let Some(surface) = LiquidSurface::new(scene, grid)? else {
        return Ok(vec![grid.dx; grid.n_cells()]);
    };
    let far = grid.size().element_sum();
    Ok((0..grid.n_cells())
        .into_par_iter()
        .map(|cell| {
            let x = grid.cell_centre(grid.cell_at(cell));
            surface.distance(x).clamp(-far, far)
        })
        .collect())
}

/// The free surface of the initial liquid.
pub struct LiquidSurface {
    regions: Regions,
    size: DVec3,
    dx: f64,
}

impl LiquidSurface {
    /// Coincidence tolerance of sides, cells: far above the rounding of scene values, far below the resolution of a cell.
    const NEAR: f64 = 1e-6;
    /// Depth of the search for the free surface, cells: theta and the liquid's volume depend on smaller depths only.
    const DEPTH: f64 = 2.0;
    /// Number of depths in that search.
    const SHELLS: usize = 8;

    /// The surface of a scene; `None` without a liquid.
    pub fn new(scene: &Scene, grid: &Grid) -> Result<Option<LiquidSurface>, Error> {
        let Some(liquid) = &scene.liquid else {
            return Ok(None);
        };
        let regions = Regions::new(liquid, grid.size(), |key| scene.at(key))?;
        Ok(Some(LiquidSurface { regions: regions.beyond_walls(grid), size: grid.size(), dx: grid.dx }))
    }

    /// Signed distance at a point, m, negative in the liquid.
    ///
    /// The regions' own distance for a single region, or with air behind the nearest point of the surface. Otherwise the
    /// depth below the free surface along many directions, exact for axis-aligned surfaces and to about 2 % for others.
    pub fn distance(&self, x: DVec3) -> f64 {
        let own = self.regions.distance(x);
        let parts = &self.regions.parts;
        let alone = parts.len() == 1 && !matches!(parts[0].solid, Solid::Mesh(_));
        if alone || own <= -Self::DEPTH * self.dx || !self.no_air(x) || self.air_behind(x, own) {
            return own;
        }
        let depth = self.depth(x);
        // A point on the free surface itself is air.
        if depth > 2.0 * Self::NEAR * self.dx { -depth } else { own.max(0.0) }
    }

    /// Whether a point is beyond the walls, in the liquid, or on a side between two regions.
    fn no_air(&self, x: DVec3) -> bool {
        let near = Self::NEAR * self.dx;
        if x.cmple(DVec3::ZERO).any() || x.cmpge(self.size).any() {
            return true;
        }
        let wet = |x: DVec3| self.regions.distance(x) < 0.0;
        let between = |&direction: &DVec3| wet(x + 10.0 * near * direction) && wet(x - 10.0 * near * direction);
        let distance = self.regions.distance(x);
        distance < 0.0 || (distance <= near && DIRECTIONS.iter().any(between))
    }

    /// Whether the nearest point of the surface, at the distance `own` (m), has air behind it.
    fn air_behind(&self, x: DVec3, own: f64) -> bool {
        let step = 1e-4 * self.dx;
        let gradient = DVec3::from_array(
            DVec3::AXES.map(|axis| self.regions.distance(x + step * axis) - self.regions.distance(x - step * axis)),
        );
        own < 0.0 && !self.no_air(x + (10.0 * Self::NEAR * self.dx - own) * gradient.normalize_or_zero())
    }

    /// Depth below the free part of the surface, m, up to two cells.
    fn depth(&self, x: DVec3) -> f64 {
        let shell = Self::DEPTH / Self::SHELLS as f64 * self.dx;
        for number in 1..=Self::SHELLS {
            let mut depth = number as f64 * shell;
            let air = |direction: &DVec3, depth: f64| !self.no_air(x + depth * *direction);
            let mut reached = false;
            for direction in DIRECTIONS.iter() {
                if !air(direction, depth) {
                    continue;
                }
                reached = true;
                let mut low = shell * (number - 1) as f64;
                // Bisection down to rounding.
                for _ in 0..50 {
                    let middle = 0.5 * (low + depth);
                    if air(direction, middle) {
                        depth = middle;
                    } else {
                        low = middle;
                    }
                }
            }
            if reached {
                return depth;
            }
        }
        Self::DEPTH * self.dx
    }
}

/// Least depth of markers below the free surface, cells: spheres of the default radius 0.87 dx then reach the surface on
/// average.
const DEPTH: f64 = 0.67;

/// Markers along each edge of a cell.
const PER_EDGE: usize = 2;

/// Margin of the jitter on each side of a sub-cell. No marker starts within 0.01 dx of a wall, where advection would move it.
const MARGIN: f64 = 0.02;

/// Search directions for the free surface, besides the gradient: those between points of a 5^3 lattice, including all axes.
static DIRECTIONS: LazyLock<Vec<DVec3>> = LazyLock::new(|| {
    let steps = || -2..=2_i64;
    let lattice = steps().flat_map(|z| steps().flat_map(move |y| steps().map(move |x| I64Vec3::new(x, y, z))));
    lattice
        .filter(|step| *step != I64Vec3::ZERO && step.to_array().iter().any(|c| c % 2 != 0))
        .map(|step| step.as_dvec3().normalize())
        .collect()
});

/// Markers of the regions, m, 2 x 2 x 2 jittered per cell, in the order of the cells; coordinates are f32 numbers.
///
/// Markers lie in the liquid, outside solids, and at least 0.67 dx below the free surface. The free surface has air behind it,
/// not a wall, an obstacle or another region.
pub fn seed_markers(scene: &Scene, grid: &Grid, cut_cells: &CutCells) -> Result<Vec<[f64; 3]>, Error> {
    let Some(liquid) = &scene.liquid else {
        return Ok(Vec::new());
    };
    let bodies = !scene.obstacles.is_empty() || !scene.solids.is_empty();
    let in_solid = |x| bodies && grid.sample_cells(&cut_cells.solid_distance, x) < 0.0;
    let seeding = Seeding {
        regions: Regions::new(liquid, grid.size(), |key| scene.at(key))?,
        size: grid.size(),
        dx: grid.dx,
        in_solid,
    };
    let rows: Vec<Vec<[f64; 3]>> = (0..grid.n_cells())
        .into_par_iter()
        .step_by(grid.cells[0])
        .map(|row| {
            (row..row + grid.cells[0])
                .flat_map(|cell| candidates(grid, liquid.seed, cell))
                .filter(|&x| seeding.accepts(x))
                .map(|x| x.to_array())
                .collect()
        })
        .collect();
    Ok(rows.concat())
}

/// Numbers of regions that add liquid but contain no initial marker, or with a fixed surface no cell centre.
pub fn empty_regions(scene: &Scene, markers: &[[f64; 3]]) -> Result<Vec<usize>, Error> {
    let Some(liquid) = &scene.liquid else {
        return Ok(Vec::new());
    };
    let grid = scene.grid();
    let parts = Regions::new(liquid, grid.size(), |key| scene.at(key))?.parts;
    let adding = parts.iter().enumerate().filter(|(_, part)| !part.subtract);
    let empty = adding.filter(|(_, part)| {
        let holds = |x: DVec3| part.solid.distance(x) < 0.0;
        !match liquid.surface {
            Surface::Markers => markers.par_iter().any(|&x| holds(x.into())),
            Surface::Level | Surface::Fixed => {
                (0..grid.n_cells()).into_par_iter().any(|cell| holds(grid.cell_centre(grid.cell_at(cell))))
            }
        }
    });
    Ok(empty.map(|(number, _)| number).collect())
}

/// Approximate number of cells that [`estimate_markers`] samples.
const SAMPLED_CELLS: usize = 1 << 15;

/// Estimate of the number of markers beside these solids, to about a percent; with a level of the liquid full of them.
///
/// Samples one random cell in each run of cells. On small grids it is exact, except for markers within rounding of an obstacle
/// or near a solid's surface.
pub fn estimate_markers(scene: &Scene, grid: &Grid, solids: &MovedMesh) -> Result<usize, Error> {
    let Some(liquid) = scene.liquid.as_ref().filter(|liquid| liquid.surface != Surface::Fixed) else {
        return Ok(0);
    };
    let bodies = super::bodies(scene, grid).collect::<Result<Vec<_>, _>>()?;
    let solids = solids.closed();
    let seeding = Seeding {
        regions: Regions::new(liquid, grid.size(), |key| scene.at(key))?,
        size: grid.size(),
        dx: grid.dx,
        in_solid: |x| {
            bodies.iter().any(|body| body.contains(x)) || solids.as_ref().is_some_and(|solids| solids.contains(x))
        },
    };
    let run = grid.n_cells().div_ceil(SAMPLED_CELLS);
    let markers: usize = (0..grid.n_cells().div_ceil(run))
        .into_par_iter()
        .map(|number| {
            let place = scramble(number as u64) % run as u64;
            let cell = number * run + place as usize;
            let inside = cell < grid.n_cells();
            let places = inside.then(|| candidates(grid, liquid.seed, cell));
            places.into_iter().flatten().filter(|&x| seeding.accepts(x)).count()
        })
        .sum();
    Ok(markers * run)
}

/// Selects markers among the candidates.
struct Seeding<S> {
    regions: Regions,
    size: DVec3,
    dx: f64,
    /// Whether a point lies in an obstacle or solid.
    in_solid: S,
}

impl<S: Fn(DVec3) -> bool> Seeding<S> {
    fn no_air(&self, x: DVec3) -> bool {
        x.cmple(DVec3::ZERO).any() || x.cmpge(self.size).any() || self.regions.distance(x) < 0.0 || (self.in_solid)(x)
    }

    /// Outward direction by central differences over a cell.
    fn out(&self, x: DVec3) -> DVec3 {
        let gradient = DVec3::from_array(DVec3::AXES.map(|axis| {
            let step = 0.5 * self.dx * axis;
            self.regions.distance(x + step) - self.regions.distance(x - step)
        }));
        gradient.normalize_or_zero()
    }

    fn accepts(&self, x: DVec3) -> bool {
        let depth = DEPTH * self.dx;
        let distance = self.regions.distance(x);
        let under_air = |direction: DVec3| !self.no_air(x + depth * direction);
        distance < 0.0
            && !(self.in_solid)(x)
            && (distance <= -depth || !(under_air(self.out(x)) || DIRECTIONS.iter().copied().any(under_air)))
    }
}

/// Jittered candidates of a cell.
fn candidates(grid: &Grid, seed: u64, cell: usize) -> impl Iterator<Item = DVec3> {
    let [i, j, k] = grid.cell_at(cell);
    let corner = DVec3::new(i as f64, j as f64, k as f64);
    (0..PER_EDGE.pow(3)).map(move |index| {
        let mut bits = seed;
        for number in [cell, index] {
            bits = scramble(bits ^ number as u64);
        }
        let place = [index % PER_EDGE, index / PER_EDGE % PER_EDGE, index / PER_EDGE.pow(2)];
        let place = DVec3::from_array(place.map(|part| {
            bits = scramble(bits);
            // The upper 53 bits as a number in [0, 1).
            let jitter = (bits >> 11) as f64 / (1_u64 << 53) as f64;
            (part as f64 + MARGIN + (1.0 - 2.0 * MARGIN) * jitter) / PER_EDGE as f64
        }));
        ((corner + place) * grid.dx).as_vec3().as_dvec3()
    })
}

/// A bijection of 64-bit integers that scatters neighbours: the output function of SplitMix64 (Steele, Lea and Flood 2014).
fn scramble(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// State before the first sub-step: markers or the fixed distance, and face velocities.
///
/// A face has the velocity of the region that contains its centre or a neighbouring cell centre. Other faces have that of the
/// nearest region within two cells, or 0. Volumes follow with the first diagnosis, solids with
/// [`crate::elastic::Solids::initial_state`]. A scene in which no cell has liquid is an error.
pub fn initial_state(scene: &Scene, grid: &Grid, cut_cells: &CutCells) -> Result<State, Error> {
    let Some(liquid) = &scene.liquid else {
        return Ok(State::default());
    };
    let mut state = State::at_rest(grid);
    let some = match liquid.surface {
        Surface::Markers => {
            state.markers = seed_markers(scene, grid, cut_cells)?;
            !state.markers.is_empty()
        }
        Surface::Level | Surface::Fixed => {
            state.liquid_distance = liquid_distance(scene, grid)?;
            let phi = &state.liquid_distance;
            Axis::ALL.into_iter().any(|axis| {
                let open = cut_cells.open[axis.index()].iter().enumerate();
                open.filter(|(_, open)| **open > 0.0).any(|(face, _)| {
                    let sides = grid.face_sides(axis, grid.face_at(axis, face));
                    sides.into_iter().flatten().any(|cell| phi[cell] < 0.0)
                })
            })
        }
    };
    if !some && (scene.sources.is_empty() || !liquid.regions.is_empty()) {
        let [nx, ny, nz] = grid.cells;
        return Err(Error::input(
            scene.at("liquid.region"),
            format!(
                "no cell of the {nx} x {ny} x {nz} has liquid: the regions are thinner than about 1.5 cells of {} m, or obstacles cover them",
                rounded(grid.dx)
            ),
            "use more cells (domain.cells, --scale), larger regions, or smaller obstacles",
        ));
    }
    let at_rest = |region: &Region| region.velocity == DVec3::ZERO && !matches!(region.shape, Shape::Solitary(_));
    if liquid.regions.iter().all(at_rest) {
        return Ok(state);
    }
    let regions = Regions::new(liquid, grid.size(), |key| scene.at(key))?;
    for (axis, velocity) in Axis::ALL.into_iter().zip(&mut state.velocity) {
        velocity.par_iter_mut().enumerate().for_each(|(face, velocity)| {
            let at = grid.face_at(axis, face);
            if !is_wall(grid, scene.domain.open, axis, at) {
                let sides = grid.face_sides(axis, at).into_iter().flatten();
                let mut centres = sides.map(|cell| grid.cell_centre(grid.cell_at(cell)));
                let x = grid.face_centre(axis, at);
                *velocity = regions
                    .velocity(x)
                    .or_else(|| centres.find_map(|x| regions.velocity(x)))
                    .or_else(|| regions.nearest_velocity(x, VELOCITY_REACH * grid.dx))
                    .map_or(0.0, |velocity| velocity[axis.index()]);
            }
        });
    }
    Ok(state)
}
