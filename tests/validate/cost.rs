//! The cost class of each case.

use std::collections::BTreeSet;

use Class::{Default, Full, Quick};

/// How much of the validation a run covers. A class contains the cheaper ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Class {
    /// `--quick`: at most 5 minutes on two cores with a software driver.
    Quick,
    /// At most 60 minutes.
    Default,
    /// `--full`: whatever it costs.
    Full,
}

impl Class {
    pub(crate) const ALL: [Class; 3] = [Quick, Default, Full];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Quick => "quick",
            Default => "default",
            Full => "full",
        }
    }
}

/// Cost class of all cases: the first pattern that matches an id counts. A pattern has as many segments, separated by `/`, as the id; `*` matches
/// any segment and `a|b` one of two.
///
/// Hard materials: the `f64` path runs the 12 combinations of each scene, the device three of them. The scenes together contain all 12, which
/// [`check`] asserts.
const CLASSES: &[(Class, &str)] = &[
    (Quick, "F1|F2|F3|F9|F11|free_fall"),
    (Quick, "F4/coarse"),
    (Default, "F4|F5|F7|F8|F10|F12|volume"),
    (Default, "F5/square"),
    (Default, "F8/separated"),
    (Default, "F13/*"),
    // Informational: without volume control.
    (Full, "volume/without"),
    (Quick, "C2|C3"),
    (Quick, "C5/f64"),
    (Default, "C1|C4"),
    (Default, "C3|C5/*"),
    (Quick, "A2|B2|closed/*"),
    (Quick, "A6|B1|plate|L1/f64"),
    (Quick, "limit"),
    (Default, "A1|A2|A5|A6|B1|W1|plate|L1/*"),
    (Default, "T6.2"),
    (Quick, "T6.5/f64"),
    (Default, "T6.6/f64"),
    // The solve on 80 cells takes a software driver minutes.
    (Full, "T6.5|T6.6/mixed"),
    (Default, "T6.5|T6.6/coarse/mixed"),
    // Informational: the methods that the thesis rejects.
    (Full, "T/stability/weak|damping_only"),
    (Full, "T/light_dino"),
    (Quick, "T/frames/platform|conditioning_40"),
    (Default, "T/*"),
    (Default, "T/stability|frames/*"),
    (Quick, "S1|S2|S7|S8|S12/*"),
    (Quick, "S3/2 layers/*"),
    (Quick, "S4|S9|S10|S11|inversion/f64"),
    (Quick, "S10|S11/mixed"),
    (Quick, "S13/*/f64"),
    (Default, "S3/modes"),
    (Default, "S3|S13/*/*"),
    (Default, "S4|S9|inversion/*"),
    (Quick, "scenes/bouncing_ball/10/f64"),
    (Quick, "scenes/cantilever/05/f64"),
    (Quick, "scenes/hanging_beam/03/f64"),
    (Quick, "scenes/material_stack/06/f64"),
    (Quick, "scenes/spinning_block/09/f64"),
    (Quick, "scenes/squashed_cube/08/f64"),
    (Default, "scenes/*/*/f64"),
    (Default, "scenes/bouncing_ball/02|06|10/mixed"),
    (Default, "scenes/cantilever/01|05|09/mixed"),
    (Default, "scenes/dinosaur_step/04|08|12/mixed"),
    (Default, "scenes/hanging_beam/03|07|11/mixed"),
    (Default, "scenes/material_stack/02|06|10/mixed"),
    (Default, "scenes/spinning_block/01|05|09/mixed"),
    (Default, "scenes/squashed_cube/04|08|12/mixed"),
    (Full, "scenes/*/*/mixed"),
    (Full, "drops/*"),
    (Default, "R1/*"),
];

fn matches(pattern: &str, id: &str) -> bool {
    let (patterns, segments) = (pattern.split('/'), id.split('/'));
    patterns.clone().count() == segments.clone().count()
        && patterns
            .zip(segments)
            .all(|(pattern, segment)| pattern == "*" || pattern.split('|').any(|name| name == segment))
}

/// Index into [`CLASSES`].
fn pattern_of(id: &str) -> usize {
    let found = CLASSES.iter().position(|(_, pattern)| matches(pattern, id));
    found.unwrap_or_else(|| panic!("case {id} has no cost class: add a pattern to CLASSES in cost.rs"))
}

/// Cost class of a case.
pub(crate) fn class_of(id: &str) -> Class {
    CLASSES[pattern_of(id)].0
}

/// Panics where a pattern matches no case, or where the device misses a combination of the hard materials in a default run.
pub(crate) fn check<'a>(ids: impl Iterator<Item = &'a str> + Clone) {
    let used: BTreeSet<usize> = ids.clone().map(pattern_of).collect();
    for (number, (_, pattern)) in CLASSES.iter().enumerate() {
        assert!(used.contains(&number), "no case is left to {pattern} in CLASSES of cost.rs: remove it");
    }
    for number in 1..=12 {
        let end = format!("/{number:02}/mixed");
        let mut ids = ids.clone().filter(|id| id.starts_with("scenes/") && id.ends_with(&end));
        assert!(ids.any(|id| class_of(id) <= Default), "no default case ends with {end}");
    }
}

/// Cases and seconds of a class.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sum {
    pub(crate) cases: usize,
    /// s
    pub(crate) seconds: f64,
}

/// Sums per class, from the ids and seconds of cases.
pub(crate) fn sums<'a>(cases: impl Iterator<Item = (&'a str, f64)>) -> [Sum; 3] {
    let mut sums = [Sum { cases: 0, seconds: 0.0 }; 3];
    for (id, seconds) in cases {
        let sum = &mut sums[class_of(id) as usize];
        sum.cases += 1;
        sum.seconds += seconds;
    }
    sums
}
