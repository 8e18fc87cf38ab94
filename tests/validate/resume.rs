//! Runs that are killed and go on. No physics: what is expected is every byte of a run that nobody disturbs.

use cutwater::output::manifest::Manifest;

use crate::Case;
use crate::common::Random;
use crate::kills::{Killed, Run};
use crate::sheet::Sheet;

/// Kills of each case: 50 in all.
const KILLS: usize = 25;

pub(crate) fn cases() -> Vec<Case> {
    vec![
        Case::new("R1/f64", |sheet| kills(sheet, "cpu", LIQUID)),
        Case::new("R1/gpu", |sheet| kills(sheet, "gpu", BOTH)),
    ]
}

const LIQUID: &str = "[domain]
size = [1.5, 1.0, 0.5]
cells = [24, 16, 8]
[time]
duration = 0.5
[[liquid.region]]
box = { min = [0, 0, 0], max = [0.5, 0.75, 0.5] }
[[obstacle]]
box = { min = [1.0, 0.0, 0.1], max = [1.2, 0.3, 0.3] }
[[probe]]
name = \"front\"
front = { axis = \"x\" }
[output]
fields = true
checkpoint_every = 2
";

const BOTH: &str = "[domain]
size = [1, 1, 1]
cells = [12, 12, 12]
[time]
duration = 0.5
[[liquid.region]]
box = { min = [0, 0, 0], max = [1, 0.5, 1] }
velocity = [0.5, 0, -0.3]
[[solid]]
name = \"ball\"
mesh = { sphere = { radius = 0.15, cell_size = 0.1 } }
placement = { translate = [0.4, 0.4, 0.5] }
initial = { spin = [3, 0, 5] }
density = 600
young = 1e5
poisson = 0.35
[[solid]]
name = \"plate\"
mesh = { box = { size = [0.3, 0.1, 0.2], cells = [3, 1, 2] } }
placement = { translate = [0.3, 0.12, 0.2] }
density = 2000
young = 1e6
poisson = 0.4
[[solid.script]]
region = { box = { min = [0, 0, 0], max = [0.2, 1, 1] } }
keyframes = [{ t = 0 }, { t = 0.11, translate = [0.013, 0.1, 0] }, { t = 1, rotate = { axis = [0, 0, 1], degrees = 40 } }]
[[probe]]
name = \"push\"
force = { solid = \"ball\" }
[solver]
pressure_on_patches = \"gradient\"
[output]
checkpoint_every = 2
";

/// R1: every run equals one that nobody disturbed, to the bit, however often it was killed; at no time is a file half written.
fn kills(sheet: &mut Sheet, backend: &str, scene: &str) {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("dam.toml"), scene).expect("a file");
    let arguments = format!("run dam.toml --backend {backend}");
    let run = Run { folder: folder.path(), arguments: &arguments };
    let Killed { kills, from_checkpoint, runs } = run.killed(KILLS, &mut Random(0x6b69_6c6c));
    let what = format!("{backend}: kills of which nothing is to be seen in the end");
    sheet.holds(&what, &KILLS.to_string(), kills.to_string(), kills == KILLS);
    let what = format!("{backend}: kills that left a checkpoint, runs that came to their end");
    sheet.info(&what, format!("{from_checkpoint}, {runs}"));
    let whole = Manifest::read(&folder.path().join("whole")).expect("the run nobody disturbed");
    let seconds = whole.progress.seconds;
    sheet.info(&format!("{backend}: seconds of a run that nobody disturbs"), format!("{seconds:.1}"));
}
