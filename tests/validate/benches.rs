//! Problems with known answers that benches measure: the limit of added mass of weak coupling, and tables 6.5 and 6.6 of the thesis.

use cutwater::gpu::AdapterChoice;
use cutwater::measure::bench_stability::{LimitRow, limits};
use cutwater::measure::bench_thesis::{Options, Row, ThesisTable, bench_thesis};
use cutwater::reference::larger;
use cutwater::scene::Precision;
use cutwater::sim::Backend;

use crate::Case;
use crate::lane::Lane;
use crate::page::{Line, Mark};
use crate::sheet::Sheet;

pub(crate) fn cases() -> Vec<Case> {
    let mut cases = vec![Case::new("limit", limit)];
    for table in [ThesisTable::T6_5, ThesisTable::T6_6] {
        for lane in Lane::PRECISE {
            let id = format!("T{}/{}", table.number(), lane.name());
            cases.push(Case::new(id, move |sheet| one_step(table, lane, sheet)));
        }
    }
    cases
}

/// A piston against a column of liquid in weak coupling: unstable above m_a / m_s = 1 + (w dt)^2 / 4, and without a spring no shorter
/// sub-step helps (van Brummelen 2009).
fn limit(sheet: &mut Sheet) {
    let run = limits().into_iter().map(|limit| limit.run(&Backend::Cpu));
    let rows: Result<Vec<LimitRow>, _> = run.collect();
    let rows = rows.unwrap_or_else(|error| panic!("{error}"));
    for row in &rows {
        let LimitRow {
            ratio,
            omega_dt,
            dt,
            ..
        } = row;
        let what = format!(
            "weak coupling, m_a/m_s = {ratio:.3}, w dt = {omega_dt}, dt = {dt} s: growth of the velocity per sub-step"
        );
        sheet.relative(&what, row.expected, row.got, row.tolerance);
    }
    let right = rows.iter().filter(|row| row.passed).count();
    sheet.holds(
        "weak coupling: columns that grow or fade as they have to",
        &format!("all {}", rows.len()),
        right.to_string(),
        right == rows.len(),
    );
    let free = |dt: f64| {
        let rows = rows.iter();
        let rows = rows.filter(move |row| row.omega_dt == 0.0 && row.dt == dt);
        rows.map(|row| [row.ratio, row.got]).collect::<Vec<_>>()
    };
    let [long, short] = [free(0.01), free(0.0025)];
    assert!(!long.is_empty() && long.len() == short.len(), "{rows:?}");
    let changes = long.iter().zip(&short);
    let changes = changes.map(|([_, long], [_, short])| (short / long - 1.0).abs());
    let what = "weak coupling without a spring: change of the growth in a quarter of the sub-step";
    sheet.at_most(what, changes.fold(0.0, larger), 0.05);
    sheet.chart(
        "weak coupling of a piston without a spring and a column",
        [
            "mass of the column over that of the piston",
            "growth per sub-step",
        ],
        vec![
            Line::new("theory", Mark::Theory, vec![[0.4, 0.4], [2.1, 2.1]]),
            Line::new("dt = 0.01 s", Mark::Points, long),
            Line::new("dt = 0.0025 s", Mark::Points, short),
        ],
    );
}

/// Tables 6.5 and 6.6: one sub-step from rest of a block in equilibrium. With pressures constant over a cell, as the thesis has them,
/// errors are the printed ones, and that of p is the weight of the liquid between the block's face and the centre of its cell. With
/// hydrostatic ones they fall with an order, from each grid to the next by more than the first. A solve on 80 cells takes the device of a CPU
/// minutes.
fn one_step(table: ThesisTable, lane: Lane, sheet: &mut Sheet) {
    let options = Options {
        tables: vec![table],
        grids: vec![5, 10, 20, 40, 80],
        frames: Vec::new(),
        precisions: lane.choose(Vec::new(), vec![Precision::Mixed], vec![Precision::F32]),
        repeats: 1,
        scenes: "scenes".into(),
        scale: 1.0,
        steps: 1,
        adapter: AdapterChoice::Best,
        resume: false,
    };
    let folder = tempfile::tempdir().expect("a folder for the tables");
    let found = bench_thesis(&options, folder.path(), &mut |_| {});
    let found = found.unwrap_or_else(|error| panic!("{error}"));
    let backend = lane.backend();
    let rows = found.rows.iter();
    let rows: Vec<&Row> = rows.filter(|row| row.backend == backend.name()).collect();
    let unsolved: Vec<&&Row> = rows
        .iter()
        .filter(|row| row.status != "converged")
        .collect();
    let got = unsolved.iter().map(|row| format!("{row:?}; ")).collect();
    sheet.holds("all solves", "converged", got, unsolved.is_empty());
    for row in &rows {
        let what = format!("block at rest, dx = {}, \"{}\"", row.dx, row.patch_pressure);
        if row.patch_pressure != "cell" {
            let errors = [row.error_p, row.error_v, row.error_u];
            sheet.told(&format!("{what}: errors of p, v, u"), {
                let [p, v, u] = errors.map(|error| format!("{error:.2e}"));
                format!("{p} Pa, {v}, {u} m/s")
            });
            if row.grid == 80 {
                sheet.at_most(&format!("{what}: error of p, Pa"), row.error_p, 1e-4);
            }
            continue;
        }
        for (of, printed, error, factor) in [
            ("p, Pa", row.thesis_p, row.error_p, 1.4),
            ("v, m/s", row.thesis_v, row.error_v, 2.0),
            ("u, m/s", row.thesis_u, row.error_u, 2.0),
        ] {
            let printed = printed.expect("the thesis has this grid");
            let what = format!("{what}: error of {of} (thesis)");
            sheet.within(&what, printed, error, factor);
        }
        // On two cells across the block other errors are as large.
        if row.grid > 5 {
            let what =
                format!("{what}: error of p over the weight of the liquid from face to centre");
            sheet.within(&what, 1.0, row.error_p_over_weight, 1.3);
        }
    }
    let ours = found.orders.iter();
    let mut ours = ours.filter(|order| order.backend == backend.name());
    let order = ours.find(|order| order.patch_pressure == "hydrostatic");
    let order = order.expect("solves converged on several grids");
    assert_eq!([order.coarsest, order.finest], [10, 80], "{order:?}");
    for (of, fitted, bound, least) in [
        ("p", order.order_p, 1.8, order.least_p),
        ("v", order.order_v, 1.5, order.least_v),
    ] {
        let what = format!("block at rest, \"hydrostatic\": order of the error of {of}");
        sheet.at_least(&format!("{what}, dx = 0.1 to 0.0125"), fitted, bound);
        sheet.at_least(&format!("{what}, least of a halving"), least, 1.0);
    }
    if lane != Lane::F64 {
        let errors = |row: &Row| [row.error_p, row.error_v, row.error_u];
        let pairs = found.rows.chunks_exact(2);
        let off = pairs.flat_map(|pair| {
            let [a, b] = [&pair[0], &pair[1]].map(errors);
            [0, 1, 2].map(|of| (a[of] - b[of]).abs())
        });
        let what = "block at rest: largest difference of an error from that in f64";
        sheet.at_most(what, off.fold(0.0, larger), 1e-5);
    }
    let line = |label: &str, mark: Mark, patches: &str, error: fn(&Row) -> Option<f64>| {
        let rows = rows.iter().filter(|row| row.patch_pressure == patches);
        let points = rows.filter_map(|row| Some([row.dx.log10(), error(row)?.log10()]));
        Line::new(label, mark, points.collect())
    };
    sheet.chart(
        &format!("table {} of the thesis, {}", table.number(), lane.name()),
        ["log10 of dx, m", "log10 of the error of p, Pa"],
        vec![
            line("thesis", Mark::Measured, "cell", |row| row.thesis_p),
            line("\"cell\"", Mark::Points, "cell", |row| Some(row.error_p)),
            line("\"hydrostatic\"", Mark::Points, "hydrostatic", |row| {
                Some(row.error_p)
            }),
        ],
    );
}
