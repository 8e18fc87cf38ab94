//! What the tests share: the device, random numbers, comparisons.

use std::sync::OnceLock;

use cutwater::gpu::{AdapterChoice, Gpu};

/// The one device of the test process; `None`, with the reason printed, where there is no adapter. `REQUIRE_GPU=1` makes a
/// missing adapter a failure.
pub(crate) fn gpu() -> Option<&'static Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    GPU.get_or_init(|| match Gpu::new(&AdapterChoice::Best) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let required = std::env::var("REQUIRE_GPU").is_ok_and(|value| value == "1");
            assert!(!required, "REQUIRE_GPU=1 and {error}");
            eprintln!("skipped for want of a GPU: {error}");
            None
        }
    })
    .as_ref()
}

/// SplitMix64 (Steele, Lea and Flood 2014): repeatable random numbers.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    /// 64 random bits.
    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [low, high).
    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }
}
