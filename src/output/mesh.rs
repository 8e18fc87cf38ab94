//! Tetrahedral meshes in VTK's XML format of unstructured grids (.vtu), which [`crate::geometry::read_tets`] reads back exactly
//! and ParaView shows with the quality of the elements.

use std::path::Path;

use vtkio::xml::Compressor;

use super::frames::{scalars, tetrahedra, write_compressed};
use crate::Error;
use crate::geometry::TetMesh;

/// Block size of vtkio's compression. It writes arrays of whole blocks incorrectly ([`super::frames`]), so a file with one is
/// not compressed.
const BLOCK: usize = 32768;

/// Writes points in f64 (m) and cells in the order of the elements, with cell data `mean_ratio` and `min_dihedral` (degrees) in
/// f32. Equal meshes result in equal files.
pub fn write_mesh(path: &Path, mesh: &TetMesh) -> Result<(), Error> {
    let (n, m) = (mesh.nodes.len(), mesh.elements.len());
    let shapes = mesh.elements.iter().map(|&element| mesh.shape(element));
    let (mean_ratio, min_dihedral): (Vec<f32>, Vec<f32>) = shapes
        .map(|shape| (shape.mean_ratio as f32, shape.min_dihedral as f32))
        .unzip();
    let points: Vec<f64> = mesh.nodes.iter().flat_map(|x| x.to_array()).collect();
    let cell_data = vec![
        scalars("mean_ratio", mean_ratio.into()),
        scalars("min_dihedral", min_dihedral.into()),
    ];
    let grid = tetrahedra(points.into(), &mesh.elements, Vec::new(), cell_data);
    // Points, connectivity, offsets, types, cell data.
    let bytes_of_arrays = [24 * n, 32 * m, 8 * m, m, 4 * m];
    let compressor = if bytes_of_arrays.iter().any(|bytes| bytes % BLOCK == 0) {
        Compressor::None
    } else {
        Compressor::ZLib
    };
    write_compressed(path, grid, compressor)
}
