//! `cutwater compare`

use crate::Error;
use crate::measure::compare::{Comparison, compare};

use super::{AdapterArgs, SMALLER_SCENE, SceneArgs, without_backend};

/// Check every stage of the GPU path against the f64 path
#[derive(Debug, clap::Args)]
pub(super) struct Compare {
    #[command(flatten)]
    scene: SceneArgs,
    /// Frames to compare, all sub-steps of each
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..))]
    frames: u64,
    #[command(flatten)]
    adapter: AdapterArgs,
}

impl Compare {
    pub(super) fn run(&self) -> Result<(), Error> {
        let scene = self.scene.load()?;
        let choice = self.adapter.choice();
        let comparison = compare(&scene, self.frames, &choice, &mut |_, _| {})
            .map_err(|error| without_backend(error, SMALLER_SCENE))?;
        print(&comparison);
        comparison.verdict()
    }
}

fn print(comparison: &Comparison) {
    say!("adapter: {}", comparison.adapter);
    say!("{} sub-steps; the worst of all:", comparison.steps);
    say!(
        "{:16} {:20} {:>9} {:>9} {:>9} {:>9} {:7} {:>7}  where the ratio is largest",
        "stage",
        "quantity",
        "largest",
        "RMS",
        "bound",
        "ratio",
        "unit",
        "excused"
    );
    for row in &comparison.rows {
        if row.worst.is_none() && row.excused == 0 {
            continue;
        }
        say!(
            "{:16} {:20} {:9.2e} {:9.2e} {:9.2e} {:9.2e} {:7} {:7}  {}{}{}",
            row.stage,
            row.quantity,
            row.largest,
            row.rms(),
            row.worst.map_or(0.0, |worst| worst.bound),
            row.ratio(),
            row.unit,
            row.excused,
            if row.breached() { "BREACH " } else { "" },
            match row.excuses_too_much() {
                true => format!("({} may be excused) ", row.most_excused()),
                false => String::new(),
            },
            match row.worst {
                None => "nothing compared".to_owned(),
                Some(_) if row.largest == 0.0 => "equal everywhere".to_owned(),
                Some(worst) => format!("sub-step {}: {}", worst.step, worst.place),
            },
        );
    }
}
