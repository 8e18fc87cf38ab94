//! The added-mass limit of weak coupling.

use cutwater::reference::larger;
use cutwater::sim::Backend;

use crate::Case;
use crate::added_mass::{Column, DISTANCE, columns};
use crate::page::{Line, Mark};
use crate::sheet::Sheet;

pub(crate) fn cases() -> Vec<Case> {
    vec![Case::new("limit", limit)]
}

/// Weak coupling of a piston and a column of liquid: growth of the velocity per sub-step, the root of a cubic (van Brummelen 2009). The bound, 5 %, is the
/// distance of the closest columns from the limit of stability, m_a / m_s = 1 + (w dt)^2 / 4.
fn limit(sheet: &mut Sheet) {
    let found = columns().into_iter().map(|column| (column, column.measure(&Backend::Cpu)));
    let found: Vec<(Column, f64)> = found.collect();
    for (column, got) in &found {
        let (ratio, Column { omega_dt, dt, .. }) = (column.ratio(), column);
        let what = format!(
            "weak coupling, m_a/m_s = {ratio:.3}, w dt = {omega_dt}, dt = {dt} s: growth of the velocity per sub-step"
        );
        sheet.relative(&what, column.growth(), *got, DISTANCE);
        let beyond = column.over > 1.0;
        let side = if beyond { "more than 1" } else { "at most 1" };
        sheet.holds(&format!("{what}, side of the limit"), side, format!("{got:.4}"), (*got > 1.0) == beyond);
    }
    let free = |dt: f64| {
        let free = found.iter().filter(move |(column, _)| column.omega_dt == 0.0 && column.dt == dt);
        free.map(|(column, got)| [column.ratio(), *got]).collect::<Vec<_>>()
    };
    let [long, short] = [free(0.01), free(0.0025)];
    assert!(!long.is_empty() && long.len() == short.len(), "{found:?}");
    let changes = long.iter().zip(&short);
    let changes = changes.map(|([_, long], [_, short])| (short / long - 1.0).abs());
    let what = "weak coupling without a spring: change of the growth in a quarter of the sub-step";
    sheet.at_most(what, changes.fold(0.0, larger), DISTANCE);
    sheet.chart(
        "weak coupling of a piston without a spring and a column",
        ["mass of the column over that of the piston", "growth per sub-step"],
        vec![
            Line::new("theory", Mark::Theory, vec![[0.4, 0.4], [2.1, 2.1]]),
            Line::new("dt = 0.01 s", Mark::Points, long),
            Line::new("dt = 0.0025 s", Mark::Points, short),
        ],
    );
}
