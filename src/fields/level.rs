//! The arrays of a level set on the device.

use crate::Error;
use crate::arrays;
use crate::gpu::{Gpu, WG_SIZE, groups};
use crate::grid::Padded;
use crate::state::State;

use super::LiquidPlan;

/// Parameters of a sub-step for a level.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct LevelStep {
    /// Seed of the jitter.
    pub seed: u32,
    /// Number of the sub-step.
    pub number: u32,
    /// Slots for markers.
    pub capacity: u32,
    /// Courant number of the surface ([`TimeStep::courant`](crate::reference::TimeStep::courant)).
    pub courant: f32,
    /// Slots freed after seeds filled all of them, for the rest of the seeds; else 0.
    pub freed: u32,
    /// Volume that sources renew ([`renewed_volume`](crate::reference::renewed_volume)), volumes of a cell; 0 without.
    pub renewed: f32,
    /// Unused.
    pub pad_0: u32,
    /// Unused.
    pub pad_1: u32,
}

/// Words of the numbers of markers (`common/marker_counts.wgsl`).
const MARKER_COUNTS: usize = 6;
/// Words of the sums over spray.
const SPRAY_SUMS: usize = 12;

arrays! {
    /// Arrays of a level set in the device layout ([`Padded`]). Levels are in cells. All but `component` hold on the band alone; outside it
    /// they contain values of earlier sub-steps.
    pub struct LevelBuffers in "level" {
        fields {
            plan: LiquidPlan,
            padded: Padded,
        }
        arrays {
            /// Parameters of the sub-step.
            uniform level_step: LevelStep [LevelStep { capacity: plan.n_markers as u32, ..LevelStep::default() }] as "level.step",
            /// phi*: the level after its transport. During `advect_level` the departure points (`common/departure_words.wgsl`).
            pub array carried_level: f32 [padded.len()],
            /// The level after the last stage that changed it.
            pub array new_level: f32 [padded.len()],
            /// Scratch: the level during a stage, the first-order transport in `advect_level`.
            pub array next_level: f32 [padded.len()],
            /// First-order transport of the face velocities in `advect_velocity`: sections of x, y, z faces, m/s.
            pub array carried_velocity: f32 [3 * padded.len()],
            /// The same of small-aperture faces through unblended velocities.
            pub array sliver_velocity: f32 [3 * padded.len()] if plan.effects.cuts(),
            /// Distance to the interface during `redistance`, before and after a pass; with a minus at interface cells, where it
            /// stays. After the passes `eikonal_now` has the mixed level.
            pub array eikonal_now: f32 [padded.len()],
            /// The other of the two.
            pub array eikonal_next: f32 [padded.len()],
            /// Per quad: lanes in thin liquid, from `bound_level` on.
            pub array thin: u32 [padded.quads],
            /// Per quad: lanes near thick liquid, during `bound_level`.
            pub array thin_next: u32 [padded.quads],
            /// F: fraction of the surroundings that markers fill, -1 where it is unknown.
            pub array occupancy: f32 [padded.len()],
            /// Sums of the markers' weights, in units of 2^-20. Zero outside the stage `occupancy`.
            pub array marker_weights: u32 [padded.len()],
            /// Density difference and weight of a cell during `excess`, before and after a pass.
            pub array density_now: [f32; 2] [padded.len()],
            /// The other of the two.
            pub array density_next: [f32; 2] [padded.len()],
            /// e: density of the markers less that of liquid.
            pub array excess: f32 [padded.len()],
            /// Label of the liquid component of each cell: the index of one of its cells, 0 for none. Labels of a state that was
            /// written are its numbers until the first sub-step. 0 outside the band too.
            pub array component: u32 [padded.len()],
            /// Label before the sub-step at the departure point of each cell.
            pub array component_origin: u32 [padded.len()],
            /// Target volume of each component, at its label, in volumes of a cell.
            pub array component_volume: f32 [padded.len()],
            /// Volume of each component, at its label, and whether it has a free surface (`common/component_sums.wgsl`).
            pub array component_sums: [u32; 2] [padded.len()],
            /// Sums over all components: volume, shares of the targets (`common/component_sums.wgsl`).
            pub array component_totals: u32 [4],
            /// Markers that landed less those that took off in this sub-step, at the label of the component beside them. Zero
            /// but from `landing` to `spray`.
            pub array component_flights: i32 [padded.len()],
            /// Velocity of the markers, m/s, and 1 for spray. Between `advect_markers` and `spray` that of spray alone; 2 for spray that lands during
            /// `landing`.
            pub array marker_velocity: [f32; 4] [plan.n_markers],
            /// Workgroups x, y, z for the used slots of the markers, and their number. `marker_band` adds those that it seeds; the host knows
            /// them after the sub-step ([`Step::n_markers`](super::Step)), so kernels after that stage compare with this number.
            pub array marker_args: u32 [4],
            /// The workgroups for the used slots and for the band in `landing`: none in a sub-step without spray.
            pub array landing_args: u32 [8],
            /// Numbers of markers in the sub-step: `common/marker_counts.wgsl`.
            pub array marker_counts: u32 [MARKER_COUNTS],
            /// Sums over the markers that fly (`common/spray_sums.wgsl`).
            pub array spray_sums: u32 [SPRAY_SUMS],
            /// Sites that get a marker, per quad in the list of the band: a bit each, eight per lane.
            pub array seeds: u32 [padded.quads],
        }
        views {
            // Volumes that come from the components before the sub-step, at the old labels.
            overlaps = density_now while LiquidComponents..=LiquidComponents, free MarkerBand..=VolumeShift,
            // Parts of the old targets, at the new labels, and zero after the stage.
            shares = density_next while LiquidComponents..=LiquidComponents, free MarkerBand..=VolumeShift,
            // With separation: bounds of the level at walls and bodies, cells; the first half.
            separation_bounds = density_next while AdvectLevel..=Redistance, free MarkerBand..=Redistance,
            // Areas of the surfaces, at the labels.
            areas = density_next while VolumeShift..=VolumeShift, free LiquidComponents..=VolumeShift,
            // Sums of the weights of markers that land, per face.
            landing_weight = carried_velocity while Landing..=Landing, free Forces..=AdvectVelocity,
            // Distances of the filled parts of the cells, m.
            filled_distances = next_level while Diagnose..=Diagnose, free Excess..=Diagnose,
            // Liquid in each cell with a label, in volumes of a cell.
            liquid_volumes = next_level while LiquidComponents..=LiquidComponents, free LiquidComponents..=Excess,
        }
        parts {}
    }
}

impl LevelBuffers {
    /// Allocates all arrays; `None` without a level.
    pub fn new(gpu: &Gpu, plan: LiquidPlan) -> Result<Option<LevelBuffers>, Error> {
        let level = plan.effects.level;
        let new = || LevelBuffers::allocate(gpu, plan, plan.grid.padded());
        level.then(new).transpose()
    }

    /// Writes seed and number of a sub-step, the Courant number of its surface, and the volume that sources renew, volumes of a cell.
    pub fn write_step(&self, gpu: &Gpu, numbers: [u32; 2], courant: f64, renewed: f64) {
        self.write(gpu, numbers, [courant, renewed], 0);
    }

    /// Writes the slots freed after seeds filled all of them, with seed and number of the sub-step.
    pub fn write_freed(&self, gpu: &Gpu, numbers: [u32; 2], freed: usize) {
        self.write(gpu, numbers, [0.0; 2], freed as u32);
    }

    fn write(&self, gpu: &Gpu, [seed, number]: [u32; 2], [courant, renewed]: [f64; 2], freed: u32) {
        let step = LevelStep {
            seed,
            number,
            capacity: self.plan.n_markers as u32,
            courant: courant as f32,
            freed,
            renewed: renewed as f32,
            ..LevelStep::default()
        };
        gpu.upload(&self.level_step, &[step]);
    }

    /// Writes velocities and spray of a state's markers, before all work submitted later.
    pub fn write_markers(&self, gpu: &Gpu, state: &State) {
        let pairs = state.marker_velocity.iter().zip(&state.spray);
        let words = pairs.map(|(v, &spray)| {
            let [x, y, z] = v.map(|component| component as f32);
            [x, y, z, f32::from(u8::from(spray))]
        });
        self.write_velocities(gpu, words.collect());
        self.write_used(gpu, state.markers.len());
    }

    /// Writes the used slots. In free ones there is no spray.
    fn write_velocities(&self, gpu: &Gpu, mut words: Vec<[f32; 4]>) {
        words.resize(words.len().max(self.marker_velocity.len()), [0.0; 4]);
        gpu.upload(&self.marker_velocity, &words);
    }

    /// Writes the number of used slots, with those reserved for new markers of sources.
    pub fn write_used(&self, gpu: &Gpu, used: usize) {
        let used = used as u32;
        let [x, y, z] = groups(used.div_ceil(WG_SIZE));
        gpu.upload(&self.marker_args, &[x, y, z, used]);
    }

    /// Waits for all submitted work and reads the bounds of the level at walls and bodies, from `advect_level` to `redistance`: cells in
    /// the device layout. `None` without separation.
    pub fn read_separation_bounds(&self, gpu: &Gpu) -> Result<Option<Vec<f32>>, Error> {
        if !self.plan.effects.separation {
            return Ok(None);
        }
        let mut bounds = gpu.download(&self.density_next)?.into_flattened();
        bounds.truncate(self.padded.len());
        Ok(Some(bounds))
    }

    /// Waits for all submitted work and reads velocities and spray of the live markers into a state. `alive`: see
    /// [`LiquidBuffers::read_state`](super::LiquidBuffers::read_state).
    pub fn read_markers(&self, gpu: &Gpu, alive: &[bool], state: &mut State) -> Result<(), Error> {
        let words = gpu.download(&self.marker_velocity)?;
        let live = || alive.iter().zip(&words).filter(|(alive, _)| **alive);
        let velocity = live().map(|(_, &[x, y, z, _])| [x, y, z].map(f64::from));
        state.marker_velocity = velocity.collect();
        state.spray = live().map(|(_, word)| word[3] != 0.0).collect();
        Ok(())
    }

    /// Removes the slots of markers that are not alive, as [`LiquidBuffers::compact`](super::LiquidBuffers::compact) does.
    pub fn compact(&self, gpu: &Gpu, alive: &[bool]) -> Result<(), Error> {
        let words = gpu.download(&self.marker_velocity)?;
        let live = alive.iter().zip(words).filter(|(alive, _)| **alive);
        let kept: Vec<[f32; 4]> = live.map(|(_, word)| word).collect();
        self.write_used(gpu, kept.len());
        self.write_velocities(gpu, kept);
        Ok(())
    }

    /// Writes the components and targets of a state, before all work submitted later. The labels are its numbers.
    pub fn write_components(&self, gpu: &Gpu, state: &State) {
        let grid = &self.plan.grid;
        let labels = match state.component.is_empty() {
            true => vec![0; self.padded.len()],
            false => self.padded.pad(grid.cells, &state.component, |label| label),
        };
        let targets = state.component_volume.iter();
        let targets = targets.map(|volume| (volume / grid.cell_volume()) as f32);
        let targets: Vec<f32> = [0.0].into_iter().chain(targets).collect();
        gpu.upload(&self.component, &labels);
        gpu.upload(&self.component_volume, &targets);
    }

    /// Waits for all submitted work and reads components and targets into a state. Components have numbers in the order of
    /// their labels, which after a sub-step is that of their first cells.
    pub fn read_components(&self, gpu: &Gpu, state: &mut State) -> Result<(), Error> {
        let grid = &self.plan.grid;
        let labels = gpu.download(&self.component)?;
        let labels = self.padded.unpad(grid.cells, &labels, |label| label);
        let targets = gpu.download(&self.component_volume)?;
        let mut known: Vec<u32> = labels.iter().copied().filter(|&label| label > 0).collect();
        known.sort_unstable();
        known.dedup();
        let number = |label| match label {
            0 => 0,
            _ => known.partition_point(|&known| known <= label) as u32,
        };
        state.component = labels.into_iter().map(number).collect();
        let target = |&label: &u32| f64::from(targets[label as usize]) * grid.cell_volume();
        state.component_volume = known.iter().map(target).collect();
        Ok(())
    }
}
