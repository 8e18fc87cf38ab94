//! `cargo fuzz run vtu`
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    cutwater_fuzz::read("vtu", bytes);
});
