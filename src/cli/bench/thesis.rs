//! `cutwater bench thesis`

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use cutwater::Error;
use cutwater::measure::bench_thesis::{Options, ThesisTable, bench_thesis};

use super::{PrecisionName, tell_machine};
use crate::cli::AdapterArgs;

#[derive(Debug, Args)]
pub(super) struct Thesis {
    /// Tables of the thesis
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [TableName::T6_5, TableName::T6_6])]
    tables: Vec<TableName>,
    /// Cells along the tank's height of 1 m, multiples of 5
    #[arg(long, value_delimiter = ',', default_values_t = [5, 10, 20, 40, 80])]
    grids: Vec<usize>,
    /// Precisions of the device, beside the f64 path
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [PrecisionName::Mixed])]
    precision: Vec<PrecisionName>,
    /// Timed sub-steps per row
    #[arg(long, default_value_t = 3)]
    repeats: usize,
    /// Folder of the results
    #[arg(long, default_value = "out/bench_thesis")]
    out: PathBuf,
    #[command(flatten)]
    adapter: AdapterArgs,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum TableName {
    #[value(name = "6.5")]
    T6_5,
    #[value(name = "6.6")]
    T6_6,
}

impl TableName {
    fn table(self) -> ThesisTable {
        match self {
            TableName::T6_5 => ThesisTable::T6_5,
            TableName::T6_6 => ThesisTable::T6_6,
        }
    }
}

impl Thesis {
    pub(super) fn run(&self) -> Result<(), Error> {
        let mut grids = self.grids.clone();
        grids.sort_unstable();
        grids.dedup();
        let options = Options {
            tables: self.tables.iter().map(|name| name.table()).collect(),
            grids,
            precisions: self.precision.iter().map(|name| name.precision()).collect(),
            repeats: self.repeats,
            adapter: self.adapter.choice(),
        };
        say!(
            "table  grid  path       patches      error of p (over printed), of v, of u               seconds (least, largest)"
        );
        let table = bench_thesis(&options, &self.out, &mut |row| {
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
        })?;
        say!("orders of p, v, u over dx = 0.1 to 0.0125 (least from one grid to the next)");
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
