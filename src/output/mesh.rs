//! Tetrahedral meshes in VTK's XML format of unstructured grids (.vtu), which [`crate::geometry::read_tets`] reads back exactly
//! and ParaView shows with the quality of the elements.

use std::path::Path;

use super::frames::{scalars, tetrahedra};
use super::vtk;
use crate::Error;
use crate::geometry::TetMesh;

/// Writes points in f64 (m) and cells in the order of the elements, with cell data `mean_ratio` and `min_dihedral` (degrees) in
/// f32. Equal meshes result in equal files.
pub fn write_mesh(path: &Path, mesh: &TetMesh) -> Result<(), Error> {
    let shapes = mesh.elements.iter().map(|&element| mesh.shape(element));
    let (mean_ratio, min_dihedral): (Vec<f32>, Vec<f32>) =
        shapes.map(|shape| (shape.mean_ratio as f32, shape.min_dihedral as f32)).unzip();
    let points: Vec<f64> = mesh.nodes.iter().flat_map(|x| x.to_array()).collect();
    let cell_data = vec![scalars("mean_ratio", mean_ratio.into()), scalars("min_dihedral", min_dihedral.into())];
    let grid = tetrahedra(points.into(), &mesh.elements, Vec::new(), cell_data);
    vtk::write(path, grid, vtk::SMALL)
}
