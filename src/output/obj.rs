//! Surfaces as Wavefront OBJ files: text, without velocities.

use std::fmt::Write;
use std::path::Path;

use super::atomic::write_atomically;
use super::ply::ShadedMesh;
use crate::Error;

/// Writes positions (m), texture coordinates and normals. Numbers are the shortest that read back as the same f32.
pub(super) fn write(path: &Path, mesh: &ShadedMesh) -> Result<(), Error> {
    let mut text = "# m\n".to_owned();
    let mut line = |kind: &str, values: &[f32]| {
        text.push_str(kind);
        values.iter().try_for_each(|value| write!(text, " {value}"))?;
        writeln!(text)
    };
    let vertices = mesh.vertices.iter().map(|x| ("v", x.to_array().to_vec()));
    let texture = mesh.texture.into_iter().flatten().map(|st| ("vt", st.to_vec()));
    let normals = mesh.normals.iter().map(|normal| ("vn", normal.to_array().to_vec()));
    let in_memory = "a string takes all";
    vertices.chain(texture).chain(normals).try_for_each(|(kind, values)| line(kind, &values)).expect(in_memory);
    let corner = |vertex: u32| {
        let number = vertex + 1;
        match mesh.texture {
            Some(_) => format!(" {number}/{number}/{number}"),
            None => format!(" {number}//{number}"),
        }
    };
    for triangle in mesh.triangles {
        let [a, b, c] = triangle.map(corner);
        writeln!(text, "f{a}{b}{c}").expect(in_memory);
    }
    write_atomically(path, text.as_bytes())
}
