//! A deforming mesh as binary glTF 2.0.
//!
//! The first frame is the mesh; every later one is a morph target, the differences of positions and normals from it. One animation moves the weights:
//! at the time of a frame its own weight is 1, in between two weights change linearly.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use glam::Vec3;
use gltf::binary::{Glb, Header};
use gltf::json;
use json::accessor::{ComponentType, GenericComponentType, Type};
use json::animation::{Channel, Interpolation, Property, Sampler};
use json::buffer::{Target, View};
use json::mesh::{MorphTarget, Primitive, Semantic};
use json::validation::Checked::Valid;
use json::{Accessor, Index, Root};

use super::super::atomic::write_atomically;
use crate::Error;

/// Frames of a mesh.
#[derive(Default)]
pub(super) struct Animation {
    /// s
    times: Vec<f32>,
    /// Positions (m) and normals of each frame.
    frames: Vec<[Vec<Vec3>; 2]>,
}

impl Animation {
    pub(super) fn push(&mut self, time: f64, vertices: Vec<Vec3>, normals: Vec<Vec3>) {
        self.times.push(time as f32);
        self.frames.push([vertices, normals]);
    }

    /// Writes the file. Texture coordinates, from the lower left corner, may be empty.
    pub(super) fn write(
        self,
        path: &Path,
        name: &str,
        texture: &[[f32; 2]],
        triangles: &[[u32; 3]],
    ) -> Result<(), Error> {
        let n_targets = self.frames.len() - 1;
        let mut file = Builder::default();
        let [vertices, normals] = &self.frames[0];
        let mut attributes = BTreeMap::new();
        attributes.insert(Valid(Semantic::Positions), file.vectors(vertices, true));
        attributes.insert(Valid(Semantic::Normals), file.vectors(normals, false));
        if !texture.is_empty() {
            // From the upper left corner in glTF.
            let uv: Vec<f32> = texture.iter().flat_map(|&[u, v]| [u, 1.0 - v]).collect();
            let uv = file.push(bytemuck::cast_slice(&uv), ComponentType::F32, Type::Vec2, texture.len(), VERTICES);
            attributes.insert(Valid(Semantic::TexCoords(0)), uv);
        }
        let corners: &[u32] = bytemuck::cast_slice(triangles);
        let indices = file.push(
            bytemuck::cast_slice(corners),
            ComponentType::U32,
            Type::Scalar,
            corners.len(),
            Some(Target::ElementArrayBuffer),
        );
        let mut targets = Vec::with_capacity(n_targets);
        for [x, normal] in &self.frames[1..] {
            let differences = |now: &[Vec3], then: &[Vec3]| -> Vec<Vec3> {
                now.iter().zip(then).map(|(now, then)| now - then).collect()
            };
            targets.push(MorphTarget {
                positions: Some(file.vectors(&differences(x, vertices), true)),
                normals: Some(file.vectors(&differences(normal, normals), false)),
                tangents: None,
            });
        }
        let mut root = Root::default();
        root.asset.generator = Some(format!("cutwater {}", env!("CARGO_PKG_VERSION")));
        let mesh = root.push(json::Mesh {
            extensions: None,
            extras: Default::default(),
            name: Some(name.to_owned()),
            primitives: vec![Primitive {
                attributes,
                extensions: None,
                extras: Default::default(),
                indices: Some(indices),
                material: None,
                mode: Valid(json::mesh::Mode::Triangles),
                targets: (n_targets > 0).then_some(targets),
            }],
            weights: (n_targets > 0).then(|| vec![0.0; n_targets]),
        });
        let node = root.push(json::Node { mesh: Some(mesh), name: Some(name.to_owned()), ..json::Node::default() });
        let scene =
            root.push(json::Scene { extensions: None, extras: Default::default(), name: None, nodes: vec![node] });
        root.scene = Some(scene);
        if n_targets > 0 {
            let n = self.times.len();
            let input = file.push(bytemuck::cast_slice(&self.times), ComponentType::F32, Type::Scalar, n, None);
            let [first, .., last] = self.times[..] else { unreachable!("a frame and a target") };
            file.accessors[input.value()].min = Some(vec![first].into());
            file.accessors[input.value()].max = Some(vec![last].into());
            let mut weights = vec![0.0_f32; n * n_targets];
            for frame in 1..n {
                weights[frame * n_targets + frame - 1] = 1.0;
            }
            let output =
                file.push(bytemuck::cast_slice(&weights), ComponentType::F32, Type::Scalar, weights.len(), None);
            root.animations.push(json::Animation {
                extensions: None,
                extras: Default::default(),
                channels: vec![Channel {
                    sampler: Index::new(0),
                    target: json::animation::Target {
                        extensions: None,
                        extras: Default::default(),
                        node,
                        path: Valid(Property::MorphTargetWeights),
                    },
                    extensions: None,
                    extras: Default::default(),
                }],
                name: Some(name.to_owned()),
                samplers: vec![Sampler {
                    extensions: None,
                    extras: Default::default(),
                    input,
                    interpolation: Valid(Interpolation::Linear),
                    output,
                }],
            });
        }
        let Builder { accessors, views, data } = file;
        root.accessors = accessors;
        root.buffer_views = views;
        root.buffers.push(json::Buffer {
            byte_length: data.len().into(),
            name: None,
            uri: None,
            extensions: None,
            extras: Default::default(),
        });
        let text = json::serialize::to_vec(&root).map_err(|problem| Error::output(path, problem))?;
        // Chunks and file have 32-bit lengths.
        if data.len() + text.len() + 64 > u32::MAX as usize {
            let problem = "the animation has more than 4 GiB, the limit of glTF; use the .ply files, or a coarser mesh";
            return Err(Error::output(path, problem));
        }
        let glb = Glb {
            header: Header {
                magic: *b"glTF",
                version: 2,
                // The length is computed when it is written.
                length: 0,
            },
            json: Cow::Owned(text),
            bin: Some(Cow::Owned(data)),
        };
        let bytes = glb.to_vec().map_err(|problem| Error::output(path, problem))?;
        write_atomically(path, &bytes)
    }
}

const VERTICES: Option<Target> = Some(Target::ArrayBuffer);

/// Accessors with their data, each in a view of its own.
#[derive(Default)]
struct Builder {
    accessors: Vec<Accessor>,
    views: Vec<View>,
    data: Vec<u8>,
}

impl Builder {
    /// Components are 4 bytes wide, so that all views are aligned.
    fn push(
        &mut self,
        bytes: &[u8],
        component: ComponentType,
        type_: Type,
        count: usize,
        target: Option<Target>,
    ) -> Index<Accessor> {
        self.views.push(View {
            buffer: Index::new(0),
            byte_length: bytes.len().into(),
            byte_offset: Some(self.data.len().into()),
            byte_stride: None,
            name: None,
            target: target.map(Valid),
            extensions: None,
            extras: Default::default(),
        });
        self.data.extend(bytes);
        self.accessors.push(Accessor {
            buffer_view: Some(Index::new(self.views.len() as u32 - 1)),
            byte_offset: Some(0_usize.into()),
            count: count.into(),
            component_type: Valid(GenericComponentType(component)),
            extensions: None,
            extras: Default::default(),
            type_: Valid(type_),
            min: None,
            max: None,
            name: None,
            normalized: false,
            sparse: None,
        });
        Index::new(self.accessors.len() as u32 - 1)
    }

    /// Vectors of the vertices; positions need their bounds.
    fn vectors(&mut self, values: &[Vec3], bounded: bool) -> Index<Accessor> {
        let index = self.push(bytemuck::cast_slice(values), ComponentType::F32, Type::Vec3, values.len(), VERTICES);
        if bounded {
            let infinite = [Vec3::INFINITY, Vec3::NEG_INFINITY];
            let [low, high] = values.iter().fold(infinite, |[low, high], &x| [low.min(x), high.max(x)]);
            let accessor = &mut self.accessors[index.value()];
            accessor.min = Some(low.to_array().to_vec().into());
            accessor.max = Some(high.to_array().to_vec().into());
        }
        index
    }
}
