//! `cutwater skin`

use std::path::PathBuf;

use crate::Error;
use crate::output::skin::{SkinOptions, skins};

use super::bar::progress_bar;

/// Write the solids of a run as surfaces that follow their tetrahedra, and its obstacles: .ply per frame, .glb with the animation
#[derive(Debug, clap::Args)]
pub(super) struct Skin {
    /// Folder of the run
    run: PathBuf,
    /// Render mesh of a solid (.obj, .stl, .ply, .glb), in the units and axes of its mesh file; may be repeated. Default: the boundary of its tetrahedra
    #[arg(long = "mesh", value_name = "SOLID=FILE", value_parser = pair)]
    meshes: Vec<(String, PathBuf)>,
    /// Write .obj files too, without velocities: of solids, obstacles and the liquid's surface
    #[arg(long)]
    obj: bool,
}

/// Vertices farther outside than this share of the solid's length may be those of another mesh.
const FAR: f64 = 0.1;
/// Meshes shorter than this share of it may have other units.
const SMALL: f64 = 0.5;

fn pair(text: &str) -> Result<(String, PathBuf), String> {
    let (solid, file) = text.split_once('=').ok_or_else(|| "write SOLID=FILE, such as crate=crate.obj".to_owned())?;
    Ok((solid.to_owned(), PathBuf::from(file)))
}

impl Skin {
    pub(super) fn run(&self) -> Result<(), Error> {
        super::ensure_run(&self.run, "skin")?;
        let bar = progress_bar("{wide_bar} {pos}/{len}");
        let options = SkinOptions { meshes: self.meshes.clone(), obj: self.obj };
        let reports = skins(&self.run, &options, &mut |done, all| {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
        })?;
        bar.finish_and_clear();
        for report in reports {
            let name = &report.name;
            say!(
                "{name}: {} vertices, {} triangles, {} frames{}",
                report.vertices,
                report.triangles,
                report.frames,
                report.animation.map_or_else(String::new, |path| format!(", {}", path.display()))
            );
            let doubt = if report.farthest > FAR * report.size {
                format!("reaches {:.3} m out of its tetrahedra", report.farthest)
            } else if report.length < SMALL * report.size {
                format!("is {:.3} m long, the solid {:.3} m", report.length, report.size)
            } else {
                continue;
            };
            warn!("warning: the skin of {name} {doubt}; is it in the units and axes of the solid's mesh file?");
        }
        Ok(())
    }
}
