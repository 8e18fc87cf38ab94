//! What a sub-step tells the host, read back once.

use crate::state::Diagnosis;

/// The numbers of a sub-step, from the words of the report buffer; `shaders/common/report.wgsl` names the same words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Markers dropped so far.
    pub markers_dropped: u32,
    /// Relative rate at which volume control lets the liquid grow, 1/s.
    pub volume_rate: f64,
    /// Volume, momentum, energies, speed, divergence.
    pub diagnosis: Diagnosis,
}

impl Report {
    /// Words of the report buffer.
    pub const WORDS: usize = 16;
    /// Word that counts the markers dropped so far.
    pub const DROPPED: usize = 0;

    /// The report in the words of the report buffer.
    pub fn from_words(words: &[u32]) -> Report {
        let single = |word: usize| f64::from(f32::from_bits(words[word]));
        let sum = |word: usize| single(word) + single(word + 1);
        Report {
            markers_dropped: words[Report::DROPPED],
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
