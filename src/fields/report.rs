//! What a sub-step tells the host, read back once.

use crate::effects::Effects;
use crate::state::{Diagnosis, SolidDiagnosis};

/// The numbers of a sub-step, from the words of the report buffer; `shaders/common/report.wgsl` names the same words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Markers dropped since the state was put in place.
    pub markers_dropped: u32,
    /// Markers that left through open sides in this sub-step.
    pub left: u32,
    /// Markers that sank.
    pub sunk: u32,
    /// Markers that sources made.
    pub emitted: u32,
    /// Those that sources that start lacked, also where a body covers them.
    pub filled: u32,
    /// Relative rate at which volume control lets the liquid grow, 1/s.
    pub volume_rate: f64,
    /// Volume, momentum, energies, speed, divergence.
    pub diagnosis: Diagnosis,
}

impl Report {
    /// Words of the report buffer; more where liquid comes in or goes out.
    pub fn words(effects: &Effects) -> usize {
        if effects.exchange() { 24 } else { 16 }
    }

    /// Word that counts the markers dropped since the state was put in place.
    pub const DROPPED: usize = 0;
    /// Word that counts those that leave until `liquid_distance` has taken them into account.
    pub const LEAVING: usize = 17;

    /// The report in the words of the report buffer.
    pub fn from_words(words: &[u32]) -> Report {
        let single = |word: usize| single(words, word);
        let sum = |word: usize| sum(words, word);
        let count = |word: usize| words.get(word).copied().unwrap_or(0);
        Report {
            markers_dropped: words[Report::DROPPED],
            left: count(19),
            sunk: count(20),
            emitted: count(21),
            filled: count(22),
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

/// What the solids tell the host of a sub-step, from the words of their report buffer; `shaders/common/solid_report.wgsl` names
/// the same words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidReport {
    /// Momenta, energies, speed, worst element.
    pub diagnosis: SolidDiagnosis,
}

impl SolidReport {
    /// Words of the report buffer.
    pub const WORDS: usize = 22;

    /// The report in the words of the report buffer.
    pub fn from_words(words: &[u32]) -> SolidReport {
        let sum = |word: usize| sum(words, word);
        SolidReport {
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

/// What liquid and solids tell the host of a sub-step, from the words of their report buffer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CouplingReport {
    /// Whether a patch lies in a cell that is an unknown.
    pub touching: bool,
    /// Sum of J^T p, N.
    pub force: [f64; 3],
    /// Sum of the forces of the pressure's variation within cells, N.
    pub correction: [f64; 3],
}

impl CouplingReport {
    /// Word of the sum of J^T p.
    pub const FORCE: u32 = 2;
    /// Word of the other sum.
    pub const CORRECTION: u32 = 8;

    /// The report in the words of the report buffer.
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
