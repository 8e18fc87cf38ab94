//! Random drops of two bodies onto each other: none passes into the other.

use crate::Case;
use crate::drops::{MOST_ENERGY, QUARTER, SMALL_OVERLAP, drops};
use crate::sheet::Sheet;

/// Drops of a case. The suite has the first 200.
const DROPS: u64 = 2000;
const CASES: u64 = 5;

pub(crate) fn cases() -> Vec<Case> {
    let case = |number| Case::alone(format!("drops/{}", number + 1), move |sheet| pass(number, sheet));
    (0..CASES).map(case).collect()
}

fn pass(number: u64, sheet: &mut Sheet) {
    let drops = drops(number * DROPS..(number + 1) * DROPS);
    let what = format!("drops {} to {}", number * DROPS, (number + 1) * DROPS - 1);
    let share = |n: usize, of: usize| n as f64 / of as f64;
    let whole: Vec<_> = drops.iter().filter(|drop| !drop.crushed).collect();
    for drop in drops.iter().filter(|drop| drop.energy > MOST_ENERGY || !drop.crushed && drop.overlap > QUARTER) {
        println!("{drop:?}");
    }
    let deepest = whole.iter().map(|drop| drop.overlap).fold(0.0, f64::max);
    let fastest = drops.iter().map(|drop| drop.fastest).fold(0.0, f64::max);
    let energy = drops.iter().map(|drop| drop.energy).fold(1.0, f64::max);
    let met = drops.iter().filter(|drop| drop.met).count();
    let deep = whole.iter().filter(|drop| drop.overlap > SMALL_OVERLAP).count();
    let unsettled: u32 = drops.iter().map(|drop| drop.unsettled).sum();
    let sub_steps: u32 = drops.iter().map(|drop| drop.sub_steps).sum();
    sheet.at_most(&format!("{what}: largest overlap, m"), deepest, QUARTER);
    sheet.at_most(&format!("{what}: deeper than 0.5 mm"), share(deep, whole.len()), 0.1);
    sheet.at_most(&format!("{what}: largest energy / first energy"), energy, MOST_ENERGY);
    sheet.at_least(&format!("{what}: bodies met"), share(met, drops.len()), 0.9);
    sheet.at_least(&format!("{what}: no element turned inside out"), share(whole.len(), drops.len()), 0.8);
    sheet.info(&format!("{what}: fastest node, m/s"), format!("{fastest:.1}"));
    sheet.info(&format!("{what}: sub-steps with unsettled contacts"), format!("{unsettled} of {sub_steps}"));
}
