//! Solids at rest under load: the cantilever of the tables (S2) and its convergence to beam theory (S4).

use cutwater::scene::ElasticModel;

use crate::Case;
use crate::lane::{Lane, Motion};
use crate::sheet::Sheet;
use crate::solid_cases::{TIMOSHENKO, cantilever, cantilever_table, tip, worst_of_nodal_table};
use crate::solid_scene::scene_of;

pub(crate) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for lane in Lane::ALL {
        cases.push(Case::new(format!("S2/{}", lane.name()), move |sheet| nodal_displacements(lane, sheet)));
    }
    for lane in Lane::PRECISE {
        cases.push(Case::new(format!("S4/{}", lane.name()), move |sheet| convergence(lane, sheet)));
    }
    cases
}

/// Seconds of a step: 50 times as long as the slowest swing.
const LONG: f64 = 50.0;

fn nodal_displacements(lane: Lane, sheet: &mut Sheet) {
    for (name, model) in [("linear", ElasticModel::Linear), ("corotational", ElasticModel::Corotational)] {
        let mut solid = cantilever([10, 2, 2]);
        solid.model = model;
        let mut motion = Motion::new(lane, &scene_of(vec![solid]), LONG);
        let u = motion.static_displacement(lane.choose(1e-10, 1e-10, 1e-5));
        sheet.at_most(
            &format!("{name} cantilever: worst of 99 nodes, over the tip's displacement"),
            worst_of_nodal_table(&motion.solids, &u),
            1e-4,
        );
    }
}

fn convergence(lane: Lane, sheet: &mut Sheet) {
    let mut excess = Vec::new();
    for row in &cantilever_table()[1..] {
        let layers = row.cells[1];
        let mut motion = Motion::new(lane, &scene_of(vec![cantilever(row.cells)]), LONG);
        let u = motion.static_displacement(1e-8);
        let found = tip(&motion.solids, &u);
        let what = format!("tip of the cantilever with {layers} layers, m (scikit-fem)");
        sheet.relative(&what, row.tip, found, 1e-4);
        sheet.info(&format!("{layers} layers, part of Timoshenko's deflection"), format!("{:.4}", found / TIMOSHENKO));
        excess.push(TIMOSHENKO / found - 1.0);
    }
    for (number, pair) in excess.windows(2).enumerate() {
        let [from, to] = [2, 4].map(|layers| layers << number);
        let what = format!("order of the stiffness from {from} to {to} layers");
        sheet.at_least(&what, (pair[0] / pair[1]).log2(), 1.6);
    }
}
