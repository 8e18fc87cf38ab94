//! Triangle meshes as their files have them: vertices split at seams, texture coordinates, normals; not necessarily closed.

use std::path::Path;

use glam::DVec3;

use super::Surface;
use super::mesh_file::{self, Problem};
use crate::error::Error;

/// A mesh for pictures. Units and axes are those of its file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RenderMesh {
    /// Positions.
    pub vertices: Vec<DVec3>,
    /// Texture coordinates of the vertices, from the lower left corner of the picture, as in OBJ and PLY; empty if the file has none.
    pub texture: Vec<[f32; 2]>,
    /// Normals of the vertices, not necessarily of unit length; empty if the file has none.
    pub normals: Vec<DVec3>,
    /// Vertex numbers of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

impl RenderMesh {
    /// The triangles alone.
    pub(super) fn into_surface(self) -> Surface {
        Surface { vertices: self.vertices, triangles: self.triangles }
    }
}

impl From<Surface> for RenderMesh {
    fn from(surface: Surface) -> RenderMesh {
        RenderMesh { vertices: surface.vertices, triangles: surface.triangles, ..RenderMesh::default() }
    }
}

/// Reads a mesh that need not be closed.
pub fn read_render_mesh(file: &Path) -> Result<RenderMesh, Error> {
    let mesh = mesh_file::parse_render_mesh(&mesh_file::load(file)?, file)?;
    let fault = |problem: String, cure| Err(Problem::new(problem, cure).in_file(file));
    if mesh.triangles.is_empty() {
        return fault("no triangles".to_owned(), "give a mesh of triangles or polygons");
    }
    if let Some(at) = mesh.vertices.iter().position(|x| !x.is_finite()) {
        return fault(format!("vertex {} is not finite", at + 1), "repair the coordinates in a mesh tool");
    }
    Ok(mesh)
}
