//! A beam of which 35 to 152 elements are inverted hangs quietly after 240 implicit steps.

use cutwater::reference::larger;

use crate::Case;
use crate::lane::{Lane, Motion, largest};
use crate::sheet::Sheet;
use crate::solid_cases::{THROWS, hung_beam, inverted, thrown_about};

pub(crate) fn cases() -> Vec<Case> {
    Lane::ALL
        .into_iter()
        .map(|lane| Case::new(format!("inversion/{}", lane.name()), move |sheet| recovery(lane, sheet)))
        .collect()
}

/// The beam's own weight strains it by rho g L / E = 0.6 % at its top, and by some times that in the corners of the fixed end.
const LEAST_DET: f64 = 0.95;

fn recovery(lane: Lane, sheet: &mut Sheet) {
    let scene = hung_beam();
    for throw in THROWS {
        let (u, before) = thrown_about(&scene, throw);
        assert!((35..=152).contains(&before), "{before} inverted");
        let mut motion = Motion::as_users_do(lane, &scene, 1.0 / 120.0);
        motion.put(&u);
        for _ in 0..240 {
            motion.step();
        }
        let u = motion.state().displacement;
        let after = inverted(&motion.solids, &u);
        let elements = 0..motion.solids.elements.len();
        let determinants = elements.map(|element| motion.solids.stress_and_determinant(element, &u)[1]);
        sheet.holds(&format!("{before} of 336 elements inverted: after 240 steps"), "0", after.to_string(), after == 0);
        let worst = -determinants.fold(f64::NEG_INFINITY, |most, det| larger(most, -det));
        sheet.at_least(&format!("{before} inverted: least det F at the end"), worst, LEAST_DET);
        sheet.info(&format!("{before} inverted: largest displacement at the end, m"), format!("{:.4}", largest(&u)));
    }
}
