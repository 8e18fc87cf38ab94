//! Diagnostics of a sub-step, read back once.

use crate::effects::Effects;
use crate::state::{Diagnosis, SolidDiagnosis};

/// Diagnostics of the liquid, from the words of the report buffer (`shaders/common/report.wgsl`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Markers dropped since the state was written.
    pub markers_dropped: u32,
    /// Markers that crossed open sides in this sub-step.
    pub left: u32,
    /// Markers deleted in sinks.
    pub sunk: u32,
    /// Markers emitted by sources.
    pub emitted: u32,
    /// Markers missing in sources at their start, including those that a body covers.
    pub filled: u32,
    /// Spray of a level after it has moved in this sub-step.
    pub flying: u32,
    /// Spray that was dropped or left in this sub-step.
    pub spray_lost: u32,
    /// Markers of a level deleted below the band.
    pub deleted: u32,
    /// Markers of a level seeded where liquid enters the band.
    pub seeded: u32,
    /// Markers that `marker_band` could not seed for want of slots.
    pub missing: u32,
    /// Volumes that a level exchanged in this sub-step.
    pub exchanged: Exchanged,
    /// Growth rate of the volume by volume control, relative, 1/s.
    pub volume_rate: f64,
    /// Volume, momentum, energies, speed, divergence.
    pub diagnosis: Diagnosis,
}

/// Exchange of a level in a sub-step. Volumes are in volumes of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exchanged {
    /// Spray that left through open sides.
    pub left_spray: u32,
    /// Spray that sank.
    pub sunk_spray: u32,
    /// Volume of the liquid that left through open sides.
    pub left: f64,
    /// Volume of the liquid that sank.
    pub sunk: f64,
    /// Volume of first fillings of sources.
    pub filled: f64,
    /// Volume that the limits of the targets added.
    pub limited: f64,
    /// Volume of all components afterwards.
    pub liquid: f64,
}

impl Report {
    /// Words of the report buffer; more with sources, sinks or open sides, and with a level.
    pub fn words(effects: &Effects) -> usize {
        match (effects.level, effects.exchange()) {
            (true, true) => 41,
            (true, false) => 29,
            (false, true) => 24,
            (false, false) => 16,
        }
    }

    /// Index of the number of markers dropped since the state was written.
    pub const DROPPED: usize = 0;
    /// Index of the number of deleted markers that `liquid_distance` has not yet subtracted from the controlled
    /// volume.
    pub const LEAVING: usize = 17;

    /// Decodes the words of the report buffer.
    pub fn from_words(words: &[u32]) -> Report {
        let single = |word: usize| single(words, word);
        let sum = |word: usize| sum(words, word);
        let count = |word: usize| words.get(word).copied().unwrap_or(0);
        // Two words in units of 2^-23 (`shaders/common/component_sums.wgsl`).
        let volume = |word: usize| {
            let [low, high] = [count(word), count(word + 1)].map(u64::from);
            (high << 32 | low) as i64 as f64 / f64::from(1 << 23)
        };
        Report {
            markers_dropped: words[Report::DROPPED],
            left: count(19),
            sunk: count(20),
            emitted: count(21),
            filled: count(22),
            flying: count(24),
            spray_lost: count(25),
            deleted: count(26),
            seeded: count(27),
            missing: count(28),
            exchanged: Exchanged {
                left_spray: count(29),
                sunk_spray: count(30),
                left: volume(31),
                sunk: volume(33),
                filled: volume(35),
                limited: volume(37),
                liquid: volume(39),
            },
            volume_rate: single(1),
            diagnosis: Diagnosis {
                max_speed: single(2),
                divergence: single(3),
                volume: sum(4),
                potential_energy: sum(6),
                momentum: [sum(8), sum(10), sum(12)],
                kinetic_energy: sum(14),
            },
        }
    }
}

/// Diagnostics of the solids, from the words of their report buffer (`shaders/common/solid_report.wgsl`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidReport {
    /// Momenta, energies, speed, worst element.
    pub diagnosis: SolidDiagnosis,
    /// See [`ContactReport`](crate::state::ContactReport), but 0 where rows hold contacts.
    pub closing_rate: f64,
}

impl SolidReport {
    /// Words of the report buffer.
    pub const WORDS: usize = 22;

    /// Decodes the words of the report buffer.
    pub fn from_words(words: &[u32]) -> SolidReport {
        let sum = |word: usize| sum(words, word);
        SolidReport {
            closing_rate: single(words, 3),
            diagnosis: SolidDiagnosis {
                max_speed: single(words, 0),
                min_det: single(words, 1),
                inverted: words[2] as usize,
                momentum: [sum(4), sum(6), sum(8)],
                kinetic_energy: sum(10),
                angular_momentum: [sum(12), sum(14), sum(16)],
                elastic_energy: sum(18),
                potential_energy: sum(20),
            },
        }
    }
}

/// Diagnostics of the coupling, from the words of its report buffer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CouplingReport {
    /// Whether a patch lies in an active cell.
    pub touching: bool,
    /// Sum of J^T p, N.
    pub force: [f64; 3],
    /// Sum of the forces due to pressure variation within cells, N.
    pub correction: [f64; 3],
}

impl CouplingReport {
    /// Index of the sum of J^T p.
    pub const FORCE: u32 = 2;
    /// Index of the sum of the correction.
    pub const CORRECTION: u32 = 8;

    /// Decodes the words of the report buffer.
    pub fn from_words(words: &[u32]) -> CouplingReport {
        let vector = |first: u32| [0, 2, 4].map(|at| sum(words, first as usize + at));
        CouplingReport {
            touching: words[0] != 0,
            force: vector(CouplingReport::FORCE),
            correction: vector(CouplingReport::CORRECTION),
        }
    }
}

fn single(words: &[u32], word: usize) -> f64 {
    f64::from(f32::from_bits(words[word]))
}

fn sum(words: &[u32], word: usize) -> f64 {
    single(words, word) + single(words, word + 1)
}
