//! `cutwater mesh`

use std::path::{Path, PathBuf};

use crate::Error;
use crate::geometry::{self, ElementShape, Surface, TetFile, TetMesh};
use crate::output::write_mesh;

/// Check a mesh of a solid, or fill a closed surface: counts, volume, worst element
#[derive(Debug, clap::Args)]
pub(super) struct Mesh {
    /// Tetrahedra (.msh of Gmsh 4.1, .vtu) or a closed surface (.obj, .stl, .ply, .glb)
    file: PathBuf,
    /// Factor of all coordinates of the file: 0.001 for a mesh in mm
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    scale: f64,
    /// Approximate edge of the tetrahedra that fill a surface, m, after --scale
    #[arg(long, value_name = "METRES")]
    cell_size: Option<f64>,
    /// Write the tetrahedra to this .vtu file
    #[arg(long, value_name = "FILE.vtu")]
    out: Option<PathBuf>,
}

impl Mesh {
    pub(super) fn run(&self) -> Result<(), Error> {
        if let Some(out) = &self.out
            && extension(out) != "vtu"
        {
            return Err(Error::input(
                format!("--out {}", out.display()),
                "meshes are written as .vtu only",
                "give a name that ends in .vtu",
            ));
        }
        if !(self.scale.is_finite() && self.scale > 0.0) {
            return Err(Error::input(
                format!("--scale {}", self.scale),
                "is no factor of lengths",
                "give a number above zero, such as 0.001 for a mesh in mm",
            ));
        }
        let (tets, surface) = self.read()?;
        let file = self.file.display();
        let faults = [surface.as_ref().and_then(Surface::fault), tets.mesh.fault()];
        if self.scale != 1.0
            && let Some(fault) = faults.into_iter().flatten().next()
        {
            let what = format!("{file}, with --scale {}", self.scale);
            return Err(Error::input(what, fault.problem, fault.cure));
        }
        say!("{file}");
        for note in &tets.notes {
            say!("  note: {note}");
        }
        say_counts(&tets.mesh, surface.as_ref());
        say_shapes(&tets);
        if let Some(out) = &self.out {
            write_mesh(out, &tets.mesh)?;
            say!("written: {}", out.display());
        }
        Ok(())
    }

    /// The scaled tetrahedra of the file, and the surface that they fill.
    fn read(&self) -> Result<(TetFile, Option<Surface>), Error> {
        let file = self.file.display().to_string();
        let is_surface = match extension(&self.file).as_str() {
            "obj" | "stl" | "ply" | "glb" | "gltf" => true,
            "msh" | "vtu" => false,
            _ if self.file.is_dir() => {
                return Err(Error::input(file, "is a folder, not a mesh", "give the path of a mesh file in it"));
            }
            "toml" => {
                return Err(Error::input(
                    file,
                    "is a scene, not a mesh",
                    "check it with `cutwater plan`, or give the mesh file that it names",
                ));
            }
            _ => {
                return Err(Error::input(
                    file,
                    "unknown kind of mesh file",
                    "give tetrahedra (.msh of Gmsh 4.1, .vtu) or a closed surface (.obj, .stl, .ply, .glb)",
                ));
            }
        };
        match (is_surface, self.cell_size) {
            (true, None) => Err(Error::input(
                file,
                "a surface, and no --cell-size",
                "give the edge of the tetrahedra in m: at most a third of the thinnest part",
            )),
            (false, Some(_)) => Err(Error::input(
                format!("{file}: --cell-size"),
                "only surfaces (.obj, .stl, .ply, .glb) are filled",
                "remove it",
            )),
            (true, Some(cell_size)) => {
                let surface = geometry::read_mesh(&self.file)?.map(|x| self.scale * x);
                let filled = geometry::fill(&surface, cell_size);
                let mesh = filled.map_err(|fault| Error::input(&file, fault.problem, fault.cure))?;
                let tets = TetFile { numbers: (0..mesh.elements.len() as u64).collect(), mesh, notes: Vec::new() };
                Ok((tets, Some(surface)))
            }
            (false, None) => {
                let mut tets = geometry::read_tets(&self.file)?;
                tets.mesh = tets.mesh.scaled(self.scale);
                Ok((tets, None))
            }
        }
    }
}

fn extension(file: &Path) -> String {
    let extension = file.extension().unwrap_or_default();
    extension.to_string_lossy().to_lowercase()
}

fn say_counts(mesh: &TetMesh, filled: Option<&Surface>) {
    let triangles = mesh.surface();
    let boundary = Surface { vertices: mesh.nodes.clone(), triangles };
    let parts = match mesh.components() {
        1 => "1 part".to_owned(),
        n => format!("{n} parts"),
    };
    say!("  {} nodes, {} tetrahedra, {parts}", mesh.nodes.len(), mesh.elements.len());
    say!("  {} surface triangles, {:.6e} m^2", boundary.triangles.len(), boundary.area());
    let pinches = mesh.pinched_edges();
    if pinches > 0 {
        say!("  note: the surface touches itself along {pinches} edges");
    }
    say!("  volume {:.6e} m^3", mesh.volume());
    if let Some(surface) = filled {
        say!(
            "  volume of the surface {:.6e} m^3: the mesh differs by {:+.2} %",
            surface.volume(),
            100.0 * (mesh.volume() / surface.volume() - 1.0)
        );
        say!("  area of the surface {:.6e} m^2", surface.area());
    }
    let [low, high] = mesh.bounds();
    say!("  from {low} to {high} m");
}

fn say_shapes(tets: &TetFile) {
    let mesh = &tets.mesh;
    let shapes: Vec<ElementShape> = mesh.elements.iter().map(|&e| mesh.shape(e)).collect();
    let range = |value: fn(&ElementShape) -> f64| {
        shapes
            .iter()
            .map(value)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
    };
    let mean = shapes.iter().map(|s| s.mean_ratio).sum::<f64>() / shapes.len() as f64;
    let [low, high] = range(|s| s.mean_ratio);
    say!("  mean ratio {low:.3} to {high:.3}, on average {mean:.3} (1: regular, 0: flat)");
    let ([least, _], [_, most]) = (range(|s| s.min_dihedral), range(|s| s.max_dihedral));
    say!("  angles between faces {least:.1} to {most:.1} degrees");
    let [smallest, largest] = range(|s| s.volume);
    say!("  volumes of elements {smallest:.3e} to {largest:.3e} m^3");
    if let Some((worst, shape)) = mesh.worst_element() {
        say!(
            "  worst: element {}, mean ratio {:.3}, angles {:.1} to {:.1} degrees, aspect {:.2}, volume {:.3e} m^3",
            tets.numbers[worst],
            shape.mean_ratio,
            shape.min_dihedral,
            shape.max_dihedral,
            shape.aspect,
            shape.volume
        );
    }
}
