//! Surfaces as binary little-endian PLY files.

use std::path::Path;

use glam::Vec3;
use ply_rs_bw::ply::{Addable, ElementDef, Encoding, Ply, PropertyAccess, PropertyDef, PropertyType, ScalarType};
use ply_rs_bw::writer::Writer;

use super::atomic::write_atomically;
use crate::Error;

/// Triangles with data of their vertices.
pub(super) struct ShadedMesh<'a> {
    /// m
    pub(super) vertices: &'a [Vec3],
    pub(super) normals: &'a [Vec3],
    /// m/s
    pub(super) velocity: Option<&'a [Vec3]>,
    /// From the lower left corner.
    pub(super) texture: Option<&'a [[f32; 2]]>,
    pub(super) triangles: &'a [[u32; 3]],
}

/// Position (m), normal, velocity (m/s), texture coordinates, with the names of Blender, MeshLab and trimesh.
const VERTEX_PROPERTIES: [&str; 11] = ["x", "y", "z", "nx", "ny", "nz", "vx", "vy", "vz", "s", "t"];
const FACE_PROPERTY: &str = "vertex_indices";

enum Element {
    Vertex([f32; 11]),
    Face([i32; 3]),
}

impl PropertyAccess for Element {
    fn new() -> Element {
        Element::Face([0; 3])
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        let place = VERTEX_PROPERTIES.iter().position(|known| *known == name)?;
        match self {
            Element::Vertex(values) => Some(values[place]),
            Element::Face(_) => None,
        }
    }

    fn get_list_int(&self, name: &str) -> Option<&[i32]> {
        match self {
            Element::Face(corners) if name == FACE_PROPERTY => Some(corners),
            _ => None,
        }
    }
}

pub(super) fn write(path: &Path, mesh: &ShadedMesh) -> Result<(), Error> {
    let mut vertex = ElementDef::new("vertex".to_owned());
    for (place, name) in VERTEX_PROPERTIES.into_iter().enumerate() {
        let absent = match place {
            6..9 => mesh.velocity.is_none(),
            9.. => mesh.texture.is_none(),
            _ => false,
        };
        if !absent {
            let kind = PropertyType::Scalar(ScalarType::Float);
            vertex.properties.add(PropertyDef::new(name.to_owned(), kind));
        }
    }
    let mut face = ElementDef::new("face".to_owned());
    let kind = PropertyType::List(ScalarType::UChar, ScalarType::Int);
    face.properties.add(PropertyDef::new(FACE_PROPERTY.to_owned(), kind));
    let vertices = mesh.vertices.iter().zip(mesh.normals).enumerate();
    let vertices = vertices.map(|(number, (x, normal))| {
        let mut values = [0.0; 11];
        values[0..3].copy_from_slice(&x.to_array());
        values[3..6].copy_from_slice(&normal.to_array());
        if let Some(velocity) = mesh.velocity {
            values[6..9].copy_from_slice(&velocity[number].to_array());
        }
        if let Some(texture) = mesh.texture {
            values[9..11].copy_from_slice(&texture[number]);
        }
        Element::Vertex(values)
    });
    let corners = mesh.triangles.iter();
    let faces = corners.map(|corners| Element::Face(corners.map(|corner| corner as i32)));
    let mut ply = Ply::new();
    ply.header.encoding = Encoding::BinaryLittleEndian;
    ply.header.comments.push("m, m/s".to_owned());
    for (element, payload) in [(vertex, vertices.collect()), (face, faces.collect::<Vec<_>>())] {
        ply.payload.insert(element.name.clone(), payload);
        ply.header.elements.add(element);
    }
    let mut bytes = Vec::new();
    Writer::new().write_ply(&mut bytes, &mut ply).map_err(|problem| Error::output(path, problem))?;
    write_atomically(path, &bytes)
}
