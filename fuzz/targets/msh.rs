//! `cargo fuzz run msh`
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    cutwater_fuzz::read("msh", bytes);
});
