//! `cutwater bench thesis`

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use cutwater::Error;
use cutwater::measure::bench_thesis::{
    Options, Row, SceneRow, SystemRow, ThesisTable, Told, bench_thesis,
};

use super::{PrecisionName, at_least_once, tell_machine};
use crate::cli::AdapterArgs;

#[derive(Debug, Args)]
pub(super) struct Thesis {
    /// Tables of the thesis
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "T,..",
        default_value = "6.1,6.2,6.3,6.4,6.5,6.6"
    )]
    tables: Vec<TableName>,
    /// Cells along an edge of the dam break of tables 6.2 to 6.4, or along the tank's height of 1 m of tables 6.5 and 6.6, multiples of
    /// 5 [default: 40,60 for table 6.2, 50,60 for 6.3 and 6.4, 5,10,20,40,80 for 6.5 and 6.6]
    #[arg(long, value_delimiter = ',', value_name = "N,N,..")]
    grids: Vec<usize>,
    /// Folder of the scenes of table 6.1
    #[arg(long, default_value = "scenes")]
    scenes: PathBuf,
    /// Multiply domain.cells of the scenes of table 6.1, rounded
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    /// Sub-steps of the scenes of table 6.1 that are timed, from their start
    #[arg(long, default_value_t = 5, value_parser = at_least_once())]
    steps: usize,
    /// Frames of the dam break, 24 a second, whose states are taken for tables 6.2 to 6.4
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "N,N,..",
        default_value = "10,40,80"
    )]
    frames: Vec<u64>,
    /// Precisions of the device, beside the f64 path
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "P,..",
        default_value = "mixed"
    )]
    precision: Vec<PrecisionName>,
    /// Timed runs per row; no more are begun where they have taken 20 s
    #[arg(long, default_value_t = 3, value_parser = at_least_once())]
    repeats: usize,
    /// Folder of the results; those of an earlier run are removed, but with --resume the rows of tables 6.2 to 6.4
    #[arg(long, default_value = "out/bench_thesis")]
    out: PathBuf,
    /// Keep the rows of tables 6.2 to 6.4 that runs on this machine with this --precision and these --repeats left in the folder, and
    /// measure the others
    #[arg(long)]
    resume: bool,
    #[command(flatten)]
    adapter: AdapterArgs,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum TableName {
    #[value(name = "6.1")]
    T6_1,
    #[value(name = "6.2")]
    T6_2,
    #[value(name = "6.3")]
    T6_3,
    #[value(name = "6.4")]
    T6_4,
    #[value(name = "6.5")]
    T6_5,
    #[value(name = "6.6")]
    T6_6,
}

impl TableName {
    fn table(self) -> ThesisTable {
        match self {
            TableName::T6_1 => ThesisTable::T6_1,
            TableName::T6_2 => ThesisTable::T6_2,
            TableName::T6_3 => ThesisTable::T6_3,
            TableName::T6_4 => ThesisTable::T6_4,
            TableName::T6_5 => ThesisTable::T6_5,
            TableName::T6_6 => ThesisTable::T6_6,
        }
    }
}

impl Thesis {
    pub(super) fn run(&self) -> Result<(), Error> {
        let mut tables: Vec<ThesisTable> = self.tables.iter().map(|name| name.table()).collect();
        let (mut grids, mut frames) = (self.grids.clone(), self.frames.clone());
        tables.sort_unstable();
        tables.dedup();
        grids.sort_unstable();
        grids.dedup();
        frames.sort_unstable();
        frames.dedup();
        let options = Options {
            tables,
            grids,
            scenes: self.scenes.clone(),
            scale: self.scale,
            steps: self.steps,
            frames,
            precisions: self.precision.iter().map(|name| name.precision()).collect(),
            repeats: self.repeats,
            adapter: self.adapter.choice(),
            resume: self.resume,
        };
        let mut headed = [false; 3];
        let table = bench_thesis(&options, &self.out, &mut |row| match row {
            Told::Scene(row) => {
                if !std::mem::replace(&mut headed[0], true) {
                    say!(
                        "table  scene            path       cells, nodes, elements (over printed)           seconds (least, largest)  of the projection  sub-steps a frame"
                    );
                }
                tell_scene(row);
            }
            Told::System(row) => {
                if !std::mem::replace(&mut headed[1], true) {
                    say!(
                        "table  grid nodes frame  path       solver                        nonzeros  log10 c  iterations  seconds (least, largest)"
                    );
                }
                tell_system(row);
            }
            Told::Accuracy(row) => {
                if !std::mem::replace(&mut headed[2], true) {
                    say!(
                        "table  grid  path       patches      error of p (over printed), of v, of u               seconds (least, largest)"
                    );
                }
                tell_accuracy(row);
            }
        })?;
        if let Some(row) = table.scenes.first() {
            say!(
                "printed, of all scenes: {} to {} s, {} to {} s of the projection, {} sub-steps a frame",
                row.thesis_seconds_least,
                row.thesis_seconds_largest,
                row.thesis_projection_least,
                row.thesis_projection_largest,
                row.thesis_sub_steps_per_frame,
            );
        }
        if !table.means.is_empty() {
            say!("means, and over how many states (printed, ratio)");
        }
        for mean in &table.means {
            let printed = match (mean.thesis, mean.ratio) {
                (Some(thesis), Some(ratio)) => format!("({thesis}, {ratio:.3})"),
                _ => String::new(),
            };
            say!(
                "{:5}  {:4} {:5}  {:3} {:5}  {:30} {:15} {:.4e}  {} {printed}",
                mean.table,
                mean.grid,
                mean.nodes,
                mean.backend,
                mean.precision,
                format!("{} {}", mean.formulation, mean.solver),
                mean.quantity,
                mean.mean,
                mean.states,
            );
        }
        if !table.growth.is_empty() {
            say!("powers of the cells along an edge (of the printed numbers)");
        }
        for growth in &table.growth {
            let nodes = growth
                .nodes
                .map_or(String::new(), |nodes| nodes.to_string());
            let printed = growth
                .thesis
                .map_or(String::new(), |thesis| format!("({thesis:.2})"));
            say!(
                "{:5}  {:5}  {:3} {:5}  {:30} {:15} {:.2} {printed}",
                growth.table,
                nodes,
                growth.backend,
                growth.precision,
                format!("{} {}", growth.formulation, growth.solver),
                growth.quantity,
                growth.exponent,
            );
        }
        if !table.orders.is_empty() {
            say!("orders of p, v, u over dx = 0.1 to 0.0125 (least from one grid to the next)");
        }
        for order in &table.orders {
            say!(
                "{:5}  {:6} {:5}  {:11}  {:5.2} ({:5.2})  {:5.2} ({:5.2})  {:5.2} ({:5.2})",
                order.table,
                order.backend,
                order.precision,
                order.patch_pressure,
                order.order_p,
                order.least_p,
                order.order_v,
                order.least_v,
                order.order_u,
                order.least_u,
            );
        }
        tell_machine(&table.machine);
        say!("tables and picture: {}", self.out.display());
        Ok(())
    }
}

fn tell_scene(row: &SceneRow) {
    let over = |here: usize, ratio: f64| format!("{here} ({ratio:.2})");
    say!(
        "{:5}  {:15}  gpu {:5}  {:>14}  {:>12}  {:>12}  {:.4} ({:.4}, {:.4})  {}  {:.2}  {}",
        row.table,
        row.scene,
        row.precision,
        over(row.cells, row.ratio_cells),
        over(row.nodes, row.ratio_nodes),
        over(row.elements, row.ratio_elements),
        row.seconds_median,
        row.seconds_min,
        row.seconds_max,
        row.projection_median
            .map_or(String::new(), |seconds| format!("{seconds:.4}")),
        row.sub_steps_per_frame,
        row.status,
    );
}

fn tell_system(row: &SystemRow) {
    let or_nothing = |text: Option<String>| text.unwrap_or_default();
    say!(
        "{:5}  {:4} {:5} {:5}  {:3} {:5}  {:28} {:>9}  {:>7}  {:>10}  {} {}",
        row.table,
        row.grid,
        row.nodes,
        row.frame,
        row.backend,
        row.precision,
        format!("{} {}", row.formulation, row.solver),
        or_nothing(row.nonzeros.map(|n| n.to_string())),
        or_nothing(row.log10_condest.map(|c| format!("{c:.3}"))),
        or_nothing(row.iterations.map(|n| n.to_string())),
        match (row.seconds_median, row.seconds_min, row.seconds_max) {
            (Some(median), Some(min), Some(max)) => format!("{median:.4} ({min:.4}, {max:.4})"),
            _ => String::new(),
        },
        row.status.unwrap_or_default(),
    );
}

fn tell_accuracy(row: &Row) {
    let over = |error: f64, ratio: Option<f64>| match ratio {
        Some(ratio) => format!("{error:.2e} ({ratio:.2})"),
        None => format!("{error:.2e}       "),
    };
    say!(
        "{:5}  {:4}  {:3} {:5}  {:11}  {}  {}  {}  {:.4} ({:.4}, {:.4}) {}",
        row.table,
        row.grid,
        row.backend,
        row.precision,
        row.patch_pressure,
        over(row.error_p, row.ratio_p),
        over(row.error_v, row.ratio_v),
        over(row.error_u, row.ratio_u),
        row.seconds_median,
        row.seconds_min,
        row.seconds_max,
        row.status,
    );
}
