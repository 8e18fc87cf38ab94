//! What a sub-step tells the host, read back once.

use crate::gpu::RealBuffer;

/// The numbers of a sub-step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Markers dropped so far.
    pub markers_dropped: u32,
}

impl Report {
    /// Scalars of the report buffer; the first one holds words instead.
    pub const REALS: usize = 10;
    /// Word: markers dropped so far.
    pub const DROPPED: usize = 0;

    /// The report in the words of the report buffer.
    pub fn from_words(buffer: &RealBuffer, words: &[u32]) -> Report {
        let _reals = buffer.widen(words);
        Report {
            markers_dropped: words[Report::DROPPED],
        }
    }
}
