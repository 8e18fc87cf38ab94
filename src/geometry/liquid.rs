//! The liquid at the start: the distance to its regions, its markers, its velocity.

use std::sync::LazyLock;

use glam::{DVec3, I64Vec3};
use rayon::prelude::*;

use super::distance::Solid;
use super::placing::{outside, reaches};
use super::{CutCells, MovedMesh, is_wall, solitary};
use crate::error::{Error, rounded};
use crate::grid::{Axis, Grid};
use crate::scene::{Liquid, Placement, Region, Scene, Shape, Surface};
use crate::state::State;

/// The regions of a liquid with their shapes ready for distances.
pub struct Regions {
    parts: Vec<Part>,
}

struct Part {
    solid: Solid,
    subtract: bool,
    velocity: DVec3,
}

impl Part {
    /// Velocity of its liquid at a point, m/s: the region's and, of a solitary wave, its own.
    fn velocity_at(&self, x: DVec3) -> DVec3 {
        self.velocity + self.solid.velocity(x)
    }
}

impl Regions {
    /// The regions of a liquid in a domain of this size (m); reads the files of meshes. Errors begin with where one was written, which
    /// `at` tells by its key.
    pub fn new(
        liquid: &Liquid,
        size: DVec3,
        at: impl Fn(&str) -> String,
    ) -> Result<Regions, Error> {
        let parts = liquid.regions.iter().enumerate().map(|(number, region)| {
            let place = || at(&format!("liquid.region[{number}]"));
            let solid = Solid::placed(&region.shape, &region.placement);
            let solid = solid.map_err(|error| error.within(&place()))?;
            if let Solid::Mesh(mesh) = &solid
                && !reaches(mesh.bounds(), size)
            {
                return Err(outside(mesh.bounds(), size, &place()));
            }
            Ok(Part {
                solid,
                subtract: region.subtract,
                velocity: region.velocity,
            })
        });
        Ok(Regions {
            parts: parts.collect::<Result<_, Error>>()?,
        })
    }

    /// The regions without the flat sides that lie on or beyond walls of the domain, which are no free surface.
    pub fn beyond_walls(self, grid: &Grid) -> Regions {
        let parts = self.parts.into_iter().map(|part| Part {
            solid: part
                .solid
                .beyond_walls(grid, &Placement::default(), DVec3::ZERO),
            ..part
        });
        Regions {
            parts: parts.collect(),
        }
    }

    /// Signed distance at a point, m, negative in the liquid: the least over the regions, in order; a region that subtracts
    /// limits it from below by its negative. Exact outside a union and inside a single region (waves: to first order);
    /// where regions overlap or touch, the depth inside is at least what it says.
    pub fn distance(&self, x: DVec3) -> f64 {
        self.parts.iter().fold(f64::INFINITY, |distance, part| {
            let own = part.solid.distance(x);
            if part.subtract {
                distance.max(-own)
            } else {
                distance.min(own)
            }
        })
    }

    /// Initial velocity at a point of the liquid, m/s: that of the last region that holds it. `None` outside.
    pub fn velocity(&self, x: DVec3) -> Option<DVec3> {
        self.parts.iter().fold(None, |velocity, part| {
            if part.solid.distance(x) >= 0.0 {
                velocity
            } else {
                (!part.subtract).then(|| part.velocity_at(x))
            }
        })
    }

    /// Velocity of the nearest region that adds liquid, m/s, if it is within `reach` (m); of the last among several.
    fn nearest_velocity(&self, x: DVec3, reach: f64) -> Option<DVec3> {
        let adding = self.parts.iter().rev().filter(|part| !part.subtract);
        let distances = adding.map(|part| (part.solid.distance(x), part));
        distances
            .filter(|&(distance, _)| distance <= reach)
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, part)| part.velocity_at(x))
    }
}

/// Largest component of a velocity that the regions give their liquid, m/s.
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

/// How far outside the regions faces start with the velocity of the nearest, cells: the surface that markers make is bumpy, and
/// every face beside a cell in it is taken for one with a velocity.
const VELOCITY_REACH: f64 = 2.0;

/// The regions' distance at all cell centres, m: the liquid of `surface = "fixed"`. Sides on walls, and those where regions
/// touch or overlap, are no free surface. At most the sum of the domain's sides either way: a domain that is full has no
/// surface at all. Positive everywhere without a liquid.
pub fn liquid_distance(scene: &Scene, grid: &Grid) -> Result<Vec<f64>, Error> {
    let Some(liquid) = &scene.liquid else {
        return Ok(vec![grid.dx; grid.n_cells()]);
    };
    let fixed = FixedSurface {
        regions: Regions::new(liquid, grid.size(), |key| scene.at(key))?.beyond_walls(grid),
        size: grid.size(),
        dx: grid.dx,
    };
    let far = grid.size().element_sum();
    Ok((0..grid.n_cells())
        .into_par_iter()
        .map(|cell| {
            let x = grid.cell_centre(grid.cell_at(cell));
            fixed.distance(x).clamp(-far, far)
        })
        .collect())
}

/// The regions of `surface = "fixed"`, for the distance to the free part of their surface.
struct FixedSurface {
    regions: Regions,
    size: DVec3,
    dx: f64,
}

impl FixedSurface {
    /// Two sides closer than this to a point, in cells, are one: far above the rounding of a scene's numbers and far below
    /// anything that a cell can tell.
    const NEAR: f64 = 1e-6;
    /// Depth up to which the free part is looked for, cells: what theta and the liquid's volume read is nearer.
    const DEPTH: f64 = 2.0;
    /// Depths looked at on the way there.
    const SHELLS: usize = 8;

    /// Signed distance at a point, m. The regions' own where one region alone makes the surface, or the nearest point of
    /// their surface has air behind it; the depth below sides that have none is looked for in [`DIRECTIONS`], which meets
    /// surfaces along the axes exactly and others to about 2 %.
    fn distance(&self, x: DVec3) -> f64 {
        let own = self.regions.distance(x);
        let parts = &self.regions.parts;
        let alone = parts.len() == 1 && !matches!(parts[0].solid, Solid::Mesh(_));
        if alone || own <= -Self::DEPTH * self.dx || !self.no_air(x) || self.air_behind(x, own) {
            return own;
        }
        let depth = self.depth(x);
        // On the free surface itself: air, as beside the seam.
        if depth > 2.0 * Self::NEAR * self.dx {
            -depth
        } else {
            own.max(0.0)
        }
    }

    /// Whether there is no air at a point: beyond the walls, in the liquid, or on a side that has liquid in front and behind.
    fn no_air(&self, x: DVec3) -> bool {
        let near = Self::NEAR * self.dx;
        if x.cmple(DVec3::ZERO).any() || x.cmpge(self.size).any() {
            return true;
        }
        let wet = |x: DVec3| self.regions.distance(x) < 0.0;
        let between = |&way: &DVec3| wet(x + 10.0 * near * way) && wet(x - 10.0 * near * way);
        let distance = self.regions.distance(x);
        distance < 0.0 || (distance <= near && DIRECTIONS.iter().any(between))
    }

    /// Whether the nearest point of the surface, at the distance `own` (m), has air behind it.
    fn air_behind(&self, x: DVec3, own: f64) -> bool {
        let step = 1e-4 * self.dx;
        let gradient = DVec3::from_array(DVec3::AXES.map(|axis| {
            self.regions.distance(x + step * axis) - self.regions.distance(x - step * axis)
        }));
        own < 0.0
            && !self.no_air(x + (10.0 * Self::NEAR * self.dx - own) * gradient.normalize_or_zero())
    }

    /// Depth below the free part of the surface, m, up to two cells.
    fn depth(&self, x: DVec3) -> f64 {
        let shell = Self::DEPTH / Self::SHELLS as f64 * self.dx;
        for number in 1..=Self::SHELLS {
            let mut depth = number as f64 * shell;
            let air = |way: &DVec3, depth: f64| !self.no_air(x + depth * *way);
            let mut found = false;
            for way in DIRECTIONS.iter() {
                if !air(way, depth) {
                    continue;
                }
                found = true;
                let mut low = shell * (number - 1) as f64;
                // Halves the shell down to the rounding of its depth.
                for _ in 0..50 {
                    let middle = 0.5 * (low + depth);
                    if air(way, middle) {
                        depth = middle;
                    } else {
                        low = middle;
                    }
                }
            }
            if found {
                return depth;
            }
        }
        Self::DEPTH * self.dx
    }
}

/// Depth below the free part of a region's surface from which on there are markers, cells. Marker spheres of the default
/// radius 0.87 dx around them reach up to the surface on average.
const DEPTH: f64 = 0.67;

/// Markers along each edge of a cell.
const PER_EDGE: usize = 2;

/// Share of a sub-cell, on each side, that jitter leaves free: with it no marker starts nearer than 0.01 dx to a wall, where
/// the advection would move it.
const MARGIN: f64 = 0.02;

/// Directions in which a marker looks for the free surface, besides straight out of the liquid: those between points of a 5^3
/// lattice, all axes among them.
static DIRECTIONS: LazyLock<Vec<DVec3>> = LazyLock::new(|| {
    let steps = || -2..=2_i64;
    let lattice = steps()
        .flat_map(|z| steps().flat_map(move |y| steps().map(move |x| I64Vec3::new(x, y, z))));
    lattice
        .filter(|step| *step != I64Vec3::ZERO && step.to_array().iter().any(|c| c % 2 != 0))
        .map(|step| step.as_dvec3().normalize())
        .collect()
});

/// Markers of the regions, m: 2 x 2 x 2 per cell, each at a random place in its eighth of the cell, kept where it is in the
/// liquid, outside solids, and deeper than 0.67 dx below the free part of the surface. The free part has air behind it: not
/// a wall, an obstacle or another region. Coordinates are f32 numbers; the order is that of the cells.
pub fn seed_markers(
    scene: &Scene,
    grid: &Grid,
    cut_cells: &CutCells,
) -> Result<Vec<[f64; 3]>, Error> {
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
                .filter(|&x| seeding.keeps(x))
                .map(|x| x.to_array())
                .collect()
        })
        .collect();
    Ok(rows.concat())
}

/// The regions, by number, that add liquid of which the cells hold nothing: no marker of the first state or, where the surface is
/// fixed, no centre of a cell lies in them.
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
            Surface::Fixed => (0..grid.n_cells())
                .into_par_iter()
                .any(|cell| holds(grid.cell_centre(grid.cell_at(cell)))),
        }
    });
    Ok(empty.map(|(number, _)| number).collect())
}

/// Cells that [`estimate_markers`] looks at, about.
const SAMPLED_CELLS: usize = 1 << 15;

/// How many markers [`seed_markers`] will make beside these solids, to about a percent: those of every so many cells, one in each run of
/// cells at a random place. Exact on small grids but for markers within the rounding of an obstacle's surface, or so near to a solid's
/// that the distances at the centres of cells decide.
pub fn estimate_markers(scene: &Scene, grid: &Grid, solids: &MovedMesh) -> Result<usize, Error> {
    let Some(liquid) = scene
        .liquid
        .as_ref()
        .filter(|liquid| liquid.surface == Surface::Markers)
    else {
        return Ok(0);
    };
    let bodies = super::bodies(scene, grid).collect::<Result<Vec<_>, _>>()?;
    let solids = solids.closed();
    let seeding = Seeding {
        regions: Regions::new(liquid, grid.size(), |key| scene.at(key))?,
        size: grid.size(),
        dx: grid.dx,
        in_solid: |x| {
            bodies.iter().any(|body| body.holds(x))
                || solids.as_ref().is_some_and(|solids| solids.holds(x))
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
            places
                .into_iter()
                .flatten()
                .filter(|&x| seeding.keeps(x))
                .count()
        })
        .sum();
    Ok(markers * run)
}

/// Decides which candidates become markers.
struct Seeding<S> {
    regions: Regions,
    size: DVec3,
    dx: f64,
    /// Whether a point lies in an obstacle.
    in_solid: S,
}

impl<S: Fn(DVec3) -> bool> Seeding<S> {
    fn no_air(&self, x: DVec3) -> bool {
        x.cmple(DVec3::ZERO).any()
            || x.cmpge(self.size).any()
            || self.regions.distance(x) < 0.0
            || (self.in_solid)(x)
    }

    /// Straight out of the liquid, between the directions of the lattice: central differences over a cell.
    fn out(&self, x: DVec3) -> DVec3 {
        let gradient = DVec3::from_array(DVec3::AXES.map(|axis| {
            let step = 0.5 * self.dx * axis;
            self.regions.distance(x + step) - self.regions.distance(x - step)
        }));
        gradient.normalize_or_zero()
    }

    fn keeps(&self, x: DVec3) -> bool {
        let depth = DEPTH * self.dx;
        let distance = self.regions.distance(x);
        let under_air = |way: DVec3| !self.no_air(x + depth * way);
        distance < 0.0
            && !(self.in_solid)(x)
            && (distance <= -depth
                || !(under_air(self.out(x)) || DIRECTIONS.iter().copied().any(under_air)))
    }
}

/// The jittered places of a cell's markers.
fn candidates(grid: &Grid, seed: u64, cell: usize) -> impl Iterator<Item = DVec3> {
    let [i, j, k] = grid.cell_at(cell);
    let corner = DVec3::new(i as f64, j as f64, k as f64);
    (0..PER_EDGE.pow(3)).map(move |index| {
        let mut bits = seed;
        for number in [cell, index] {
            bits = scramble(bits ^ number as u64);
        }
        let place = [
            index % PER_EDGE,
            index / PER_EDGE % PER_EDGE,
            index / PER_EDGE.pow(2),
        ];
        let place = DVec3::from_array(place.map(|part| {
            bits = scramble(bits);
            // The upper 53 bits, as a number in [0, 1).
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

/// The state before the first step: markers or the fixed distance, and on every face the velocity of the region that holds
/// its centre or the centre of a cell beside it, else that of the nearest region within two cells; 0 on walls and elsewhere.
/// Volumes are left to the first diagnosis, and solids to [`crate::elastic::Solids::initial_state`]. Without liquid in the scene, nothing;
/// regions in which no cell finds liquid, all of them, are an error.
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
        Surface::Fixed => {
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
    let at_rest = |region: &Region| {
        region.velocity == DVec3::ZERO && !matches!(region.shape, Shape::Solitary(_))
    };
    if liquid.regions.iter().all(at_rest) {
        return Ok(state);
    }
    let regions = Regions::new(liquid, grid.size(), |key| scene.at(key))?;
    for (axis, velocity) in Axis::ALL.into_iter().zip(&mut state.velocity) {
        velocity
            .par_iter_mut()
            .enumerate()
            .for_each(|(face, velocity)| {
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
