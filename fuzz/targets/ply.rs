//! `cargo fuzz run ply`
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    cutwater_fuzz::read("ply", bytes);
});
