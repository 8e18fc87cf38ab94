//! `cargo fuzz run glb`
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    cutwater_fuzz::read("glb", bytes);
});
