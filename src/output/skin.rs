//! Skins: render meshes of the solids, carried along by their tetrahedra, and the obstacles, as files for renderers.
//!
//! - `NAME_SOLID_%06d.ply`: position, normal, velocity and texture coordinates of each vertex
//! - `NAME_SOLID.glb`: the animated mesh as glTF 2.0, a morph target for each frame after the first; weights are linear in time
//! - `NAME_obstacles.ply`, and of moving ones `NAME_obstacles_%06d.ply`
//! - on request the same as `.obj`, and the surface of the liquid as `NAME_%06d.obj`
//!
//! Vertices are embedded in the rest shape ([`Embedding`]). All files go to `DIR/frames/`.

mod animation;

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use vtkio::Vtk;
use vtkio::model::{DataSet, IOBuffer, Piece, VertexNumbers};

use super::frames::moved_obstacles_file;
use super::manifest::Manifest;
use super::obj;
use super::ply::{self, ShadedMesh};
use super::preview::{array, frame_files, points, read_surface, unreadable};
use super::surface::LiquidSurface;
use crate::Error;
use crate::geometry::{Embedding, RenderMesh, TetMesh, bounds, read_render_mesh};
use animation::Animation;

/// Files that are written.
#[derive(Clone, Debug, Default)]
pub struct SkinOptions {
    /// Mesh files of solids by name, in the coordinates of the solid's own mesh file; other solids have the boundary of their tetrahedra.
    pub meshes: Vec<(String, PathBuf)>,
    /// Whether `.obj` files are written too, those of the liquid included.
    pub obj: bool,
}

/// Files written for a solid, the obstacles or the liquid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkinReport {
    /// Name of the solid, `"obstacles"` or `"liquid"`.
    pub name: String,
    /// Vertices, in the last frame.
    pub vertices: usize,
    /// Triangles, in the last frame.
    pub triangles: usize,
    /// Frames written.
    pub frames: usize,
    /// The animated file of a solid.
    pub animation: Option<PathBuf>,
    /// Largest distance of a vertex outside the tetrahedra at rest, m.
    pub farthest: f64,
    /// Longest side of the solid at rest, m.
    pub size: f64,
    /// Longest side of the mesh at rest, m.
    pub length: f64,
}

/// Writes the skins of all solids and the obstacles of a run. `progress` is called with the number of finished and of all frames; those of the
/// liquid count separately.
///
/// # Errors
/// [`Error::Input`] for a folder or mesh that does not serve, with the cure.
pub fn skins(
    run: &Path,
    SkinOptions { meshes: files, obj }: &SkinOptions,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Vec<SkinReport>, Error> {
    let manifest = Manifest::read(run)?;
    let folder = run.join("frames");
    let name = &manifest.scene.name;
    let refuse = |problem: String, cure: String| Err(Error::input(run.display().to_string(), problem, cure));
    let surfaces = manifest.solid_frames || manifest.obstacles;
    let of_liquid = match obj {
        true => liquid_files(&folder, &manifest, surfaces)?,
        false => Vec::new(),
    };
    if !surfaces && of_liquid.is_empty() {
        let cure = "run a scene with solids and output.solids on, or with obstacles; --obj also writes liquid";
        return refuse("the run has no frames of solids, and no obstacles".to_owned(), cure.to_owned());
    }
    let names: Vec<&str> = manifest.solids.iter().map(|solid| solid.name.as_str()).collect();
    for (number, (solid, _)) in files.iter().enumerate() {
        let problem = if !names.contains(&solid.as_str()) {
            format!("the run has no solid {solid:?}")
        } else if files[..number].iter().any(|(other, _)| other == solid) {
            format!("solid {solid:?} has two skins")
        } else {
            continue;
        };
        return refuse(problem, format!("give one of each of {names:?}"));
    }
    if manifest.obstacles && names.contains(&"obstacles") {
        let cure = "give the solid another name";
        return refuse(
            "files of solid \"obstacles\" and of the obstacles have equal names".to_owned(),
            cure.to_owned(),
        );
    }
    let numbers = &manifest.progress.frames_written;
    let file = |frame: u64| folder.join(format!("{name}_{frame:06}.vtu"));
    let mut skins = Vec::new();
    let mut first = None;
    if manifest.solid_frames {
        let Some(&number) = numbers.first() else {
            return refuse("the run has no frame yet".to_owned(), "let `cutwater run` write a frame first".to_owned());
        };
        let frame = first.insert(Frame::read(&file(number))?);
        for (number, solid) in manifest.solids.iter().enumerate() {
            let given = files.iter().find(|(name, _)| *name == solid.name);
            let given = given.map(|(_, file)| file.as_path());
            skins.push(Skin::new(frame, number, given, solid.placed)?);
        }
    }
    let mut reports = Vec::new();
    if manifest.obstacles {
        reports.push(obstacles(&folder, name, (numbers, *obj))?);
    }
    let n_frames = of_liquid.len() + if manifest.solid_frames { numbers.len() } else { 0 };
    if !of_liquid.is_empty() {
        reports.push(liquid(&folder, &manifest, &of_liquid, &mut |done| progress(done, n_frames))?);
    }
    let Some(first) = first else {
        return Ok(reports);
    };
    let mut animations: Vec<Animation> = skins.iter().map(|_| Animation::default()).collect();
    for (done, &number) in numbers.iter().enumerate() {
        progress(of_liquid.len() + done, n_frames);
        let frame = Frame::read(&file(number))?;
        if frame.elements != first.elements {
            return refuse(
                format!("frame {number} has other tetrahedra than the first one"),
                "run the scene again with --overwrite".to_owned(),
            );
        }
        for ((skin, animation), solid) in skins.iter().zip(&mut animations).zip(&names) {
            let [vertices, velocity] = [&frame.nodes, &frame.velocity].map(|values| single(&skin.embedding.at(values)));
            let normals = skin.normals(&vertices);
            let mesh = ShadedMesh {
                vertices: &vertices,
                normals: &normals,
                velocity: Some(&velocity),
                texture: (!skin.texture.is_empty()).then_some(&skin.texture),
                triangles: &skin.triangles,
            };
            write(&folder.join(format!("{name}_{solid}_{number:06}.ply")), &mesh, *obj)?;
            animation.push(number as f64 / manifest.frames_per_second, vertices, normals);
        }
    }
    progress(n_frames, n_frames);
    for ((skin, animation), solid) in skins.into_iter().zip(animations).zip(names) {
        let path = folder.join(format!("{name}_{solid}.glb"));
        animation.write(&path, solid, &skin.texture, &skin.triangles)?;
        reports.push(SkinReport {
            name: solid.to_owned(),
            vertices: skin.embedding.corners.len(),
            triangles: skin.triangles.len(),
            frames: numbers.len(),
            animation: Some(path),
            farthest: skin.embedding.farthest,
            size: skin.size,
            length: skin.length,
        });
    }
    Ok(reports)
}

/// Writes the `.ply` file, and on request the `.obj` file beside it; without, an earlier one is removed.
fn write(path: &Path, mesh: &ShadedMesh, obj: bool) -> Result<(), Error> {
    ply::write(path, mesh)?;
    let text = path.with_extension("obj");
    match obj {
        true => obj::write(&text, mesh),
        false if text.exists() => fs::remove_file(&text).map_err(|problem| Error::unwritten(&text, &problem)),
        false => Ok(()),
    }
}

/// The files of the frames that show the surface of the liquid. A run without frames is an error unless there are `others`.
fn liquid_files(folder: &Path, manifest: &Manifest, others: bool) -> Result<Vec<(u64, PathBuf)>, Error> {
    let files = match frame_files(folder, manifest) {
        Err(_) if others => return Ok(Vec::new()),
        files => files?.into_iter(),
    };
    Ok(files.filter_map(|(number, files)| Some((number, files.liquid?))).collect())
}

/// Writes the surface of the liquid as `.obj`. `progress` is called with the number of finished frames.
fn liquid(
    folder: &Path,
    manifest: &Manifest,
    files: &[(u64, PathBuf)],
    progress: &mut dyn FnMut(usize),
) -> Result<SkinReport, Error> {
    let mut report = SkinReport { name: "liquid".to_owned(), frames: files.len(), ..SkinReport::default() };
    for (done, (number, file)) in files.iter().enumerate() {
        progress(done);
        let LiquidSurface { vertices, normals, triangles } = &read_surface(file, manifest)?;
        let mesh = ShadedMesh { vertices, normals, velocity: None, texture: None, triangles };
        obj::write(&folder.join(format!("{}_{number:06}.obj", manifest.scene.name)), &mesh)?;
        (report.vertices, report.triangles) = (vertices.len(), triangles.len());
    }
    Ok(report)
}

/// Tetrahedra of a frame.
struct Frame {
    /// m
    nodes: Vec<DVec3>,
    /// Positions at rest, m.
    rest: Vec<DVec3>,
    /// m/s
    velocity: Vec<DVec3>,
    elements: Vec<[u32; 4]>,
    /// Solid of each element.
    solid: Vec<i32>,
}

impl Frame {
    fn read(path: &Path) -> Result<Frame, Error> {
        let missing = |what: &str| unreadable(path, format!("no {what}"));
        let data = Vtk::import(path).map_err(|problem| unreadable(path, problem))?.data;
        let DataSet::UnstructuredGrid { pieces, .. } = data else {
            return Err(missing("tetrahedra"));
        };
        let Some(Piece::Inline(piece)) = pieces.into_iter().next() else {
            return Err(missing("inline data"));
        };
        let vectors = |values: Option<IOBuffer>, what: &str| -> Result<Vec<DVec3>, Error> {
            let values = values.and_then(points).ok_or_else(|| missing(what))?;
            Ok(values.into_iter().map(Vec3::as_dvec3).collect())
        };
        let data = &piece.data;
        let displacement = vectors(array(&data.point, "displacement"), "displacement")?;
        let velocity = vectors(array(&data.point, "velocity"), "velocity")?;
        let solid = array(&data.cell, "solid").and_then(IOBuffer::into_vec::<i32>);
        let solid = solid.ok_or_else(|| missing("numbers of solids"))?;
        let nodes = vectors(Some(piece.points), "f32 points")?;
        let VertexNumbers::XML { connectivity, .. } = piece.cells.cell_verts else {
            return Err(missing("tetrahedra"));
        };
        let n = nodes.len();
        let whole = connectivity.iter().all(|&node| (node as usize) < n)
            && [displacement.len(), velocity.len()] == [n; 2]
            && connectivity.len() == 4 * solid.len();
        if !whole {
            return Err(missing("data of all nodes and tetrahedra"));
        }
        let corners = connectivity.chunks_exact(4);
        Ok(Frame {
            rest: nodes.iter().zip(&displacement).map(|(x, u)| x - u).collect(),
            nodes,
            velocity,
            elements: corners.map(|of| [0, 1, 2, 3].map(|corner| of[corner] as u32)).collect(),
            solid,
        })
    }
}

/// A mesh embedded in the tetrahedra of a solid.
struct Skin {
    embedding: Embedding,
    texture: Vec<[f32; 2]>,
    triangles: Vec<[u32; 3]>,
    /// Vertices of one group share their normal: those at one place, with equal normals in the file if that has normals.
    group: Vec<u32>,
    size: f64,
    length: f64,
}

impl Skin {
    /// The mesh of a file placed as the solid was, or the boundary of the solid.
    fn new(frame: &Frame, solid: usize, file: Option<&Path>, placed: Option<[[f64; 3]; 4]>) -> Result<Skin, Error> {
        let owned = frame.elements.iter().zip(&frame.solid);
        let owned = owned.filter(|(_, owner)| **owner == solid as i32);
        let tets = TetMesh { nodes: frame.rest.clone(), elements: owned.map(|(element, _)| *element).collect() };
        let mesh = match file {
            None => boundary(&tets),
            Some(file) => {
                let mut mesh = read_render_mesh(file)?;
                let placed = placed.ok_or_else(|| {
                    let cure = "run the scene again: an earlier version wrote the run";
                    Error::input(file.display().to_string(), "the run does not record where its mesh was placed", cure)
                })?;
                let [x, y, z, origin] = placed.map(DVec3::from);
                for vertex in &mut mesh.vertices {
                    *vertex = origin + x * vertex.x + y * vertex.y + z * vertex.z;
                }
                mesh
            }
        };
        let used = tets.elements.iter().flatten().map(|&node| tets.nodes[node as usize]);
        let [low, high] = bounds(used);
        let embedding = Embedding::new(&tets, &mesh.vertices);
        let size = (high - low).max_element();
        if let Some(file) = file.filter(|_| embedding.farthest > 0.5 * size) {
            let problem = format!(
                "the mesh reaches {:.3} m out of solid number {solid}, which is {size:.3} m long",
                embedding.farthest
            );
            let cure = "give a mesh in the units and axes of the solid's own mesh file";
            return Err(Error::input(file.display().to_string(), problem, cure));
        }
        let [low, high] = bounds(mesh.vertices.iter().copied());
        let length = (high - low).max_element();
        Ok(Skin { embedding, group: groups(&mesh), texture: mesh.texture, triangles: mesh.triangles, size, length })
    }

    /// Unit normals, area-weighted over the triangles of each group.
    fn normals(&self, vertices: &[Vec3]) -> Vec<Vec3> {
        let mut sums = vec![Vec3::ZERO; vertices.len()];
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|vertex| vertices[vertex as usize]);
            let area = (b - a).cross(c - a);
            for vertex in triangle {
                sums[self.group[*vertex as usize] as usize] += area;
            }
        }
        let groups = self.group.iter();
        groups.map(|&group| sums[group as usize].try_normalize().unwrap_or(Vec3::Y)).collect()
    }
}

/// The boundary of a solid with its own numbers of vertices.
fn boundary(tets: &TetMesh) -> RenderMesh {
    let mut mesh = RenderMesh::default();
    let mut numbers = HashMap::new();
    for triangle in tets.surface() {
        mesh.triangles.push(triangle.map(|node| {
            *numbers.entry(node).or_insert_with(|| {
                mesh.vertices.push(tets.nodes[node as usize]);
                mesh.vertices.len() as u32 - 1
            })
        }));
    }
    mesh
}

/// Number of the first vertex of the group of each vertex.
fn groups(mesh: &RenderMesh) -> Vec<u32> {
    let mut known = HashMap::new();
    let vertices = (0..).zip(&mesh.vertices);
    vertices
        .map(|(number, x)| {
            // Exporters round the normals of one vertex in several faces alike; a hundredth is far below a crease.
            let normal = mesh.normals.get(number as usize).and_then(|normal| normal.try_normalize());
            let normal = normal.map(|normal| (100.0 * normal).round().as_ivec3());
            let place = x.to_array().map(|x| (x + 0.0).to_bits());
            *known.entry((place, normal)).or_insert(number)
        })
        .collect()
}

fn single(values: &[DVec3]) -> Vec<Vec3> {
    values.iter().map(|x| x.as_vec3()).collect()
}

/// Writes the obstacles, at rest and in each frame in which they moved.
fn obstacles(folder: &Path, name: &str, (numbers, obj): (&[u64], bool)) -> Result<SkinReport, Error> {
    let mut report = SkinReport { name: "obstacles".to_owned(), ..SkinReport::default() };
    let moved = numbers.iter().map(|&frame| folder.join(moved_obstacles_file(name, frame)));
    let files = [folder.join(format!("{name}_obstacles.vtp"))].into_iter().chain(moved.filter(|file| file.is_file()));
    for file in files {
        let missing = || unreadable(&file, "no triangles");
        let data = Vtk::import(&file).map_err(|problem| unreadable(&file, problem))?.data;
        let DataSet::PolyData { pieces, .. } = data else {
            return Err(missing());
        };
        let Some(Piece::Inline(piece)) = pieces.into_iter().next() else {
            return Err(missing());
        };
        let vertices = points(piece.points).ok_or_else(missing)?;
        let Some(VertexNumbers::XML { connectivity, .. }) = piece.polys else {
            return Err(missing());
        };
        if connectivity.iter().any(|&corner| corner as usize >= vertices.len()) {
            return Err(missing());
        }
        let triangles: Vec<[u32; 3]> =
            connectivity.chunks_exact(3).map(|of| [0, 1, 2].map(|corner| of[corner] as u32)).collect();
        // Edges of boxes and cylinders stay sharp: each triangle has corners of its own.
        let (mut corners, mut normals) = (Vec::new(), Vec::new());
        for triangle in &triangles {
            let of = triangle.map(|vertex| vertices[vertex as usize]);
            let [a, b, c] = of;
            corners.extend(of);
            normals.extend([(b - a).cross(c - a).try_normalize().unwrap_or(Vec3::Y); 3]);
        }
        let numbers: Vec<u32> = (0..corners.len() as u32).collect();
        let triangles: Vec<[u32; 3]> = numbers.chunks_exact(3).map(|of| [of[0], of[1], of[2]]).collect();
        let mesh =
            ShadedMesh { vertices: &corners, normals: &normals, velocity: None, texture: None, triangles: &triangles };
        write(&file.with_extension("ply"), &mesh, obj)?;
        (report.vertices, report.triangles) = (corners.len(), triangles.len());
        report.frames += 1;
    }
    Ok(report)
}
