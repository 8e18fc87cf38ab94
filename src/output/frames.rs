//! Frame files in VTK's XML formats with a `.pvd` series per kind. Markers, obstacles and liquid surfaces are VTP, cell fields
//! VTI, solids VTU. Liquid surfaces are written as PLY too.
//!
//! Data are f32, little endian, compressed by zlib.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use vtkio::model::{
    Attribute, Attributes, CellType, Cells, DataArray, DataSet, Extent, IOBuffer, ImageDataPiece, Piece, PolyDataPiece,
    UnstructuredGridPiece, VertexNumbers,
};

use super::atomic::{create_folder, write_atomically};
use super::ply::{self, ShadedMesh};
use super::surface::{DROP_CORNERS, LiquidSurface};
use super::vtk;
use crate::Error;
use crate::elastic::Solids;
use crate::geometry::{self, CutCells};
use crate::grid::Grid;
use crate::scene::{Scene, Surface, SurfaceMesh};
use crate::state::State;

/// Kinds of frame files of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameKinds {
    /// `NAME_%06d.vtp`
    pub markers: bool,
    /// `NAME_%06d.vti`
    pub fields: bool,
    /// `NAME_%06d.vtu`
    pub solids: bool,
    /// `NAME_obstacles_%06d.vtp`, for moving obstacles
    pub moving_obstacles: bool,
    /// `NAME_%06d.ply` and `NAME_surface_%06d.vtp`
    pub surface: Option<SurfaceSource>,
}

/// Source of the liquid's surface mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SurfaceSource {
    /// The markers.
    Markers(SurfaceMesh),
    /// A level set outside bodies, and a drop for each marker that flies.
    Level,
    /// The distance at cell centres of a fixed surface.
    Distance,
}

impl SurfaceSource {
    /// The source for a representation of the surface.
    fn of(surface: Surface, settings: SurfaceMesh) -> SurfaceSource {
        match surface {
            Surface::Markers => SurfaceSource::Markers(settings),
            Surface::Level => SurfaceSource::Level,
            Surface::Fixed => SurfaceSource::Distance,
        }
    }
}

impl FrameKinds {
    /// The kinds that a scene requests. A level and a fixed surface always have fields, the source of their pictures.
    pub fn of(scene: &Scene) -> FrameKinds {
        let surface = scene.liquid.as_ref().map(|liquid| liquid.surface);
        FrameKinds {
            markers: scene.output.particles && surface.is_some_and(|surface| surface != Surface::Fixed),
            fields: scene.output.fields || surface.is_some_and(|surface| surface != Surface::Markers),
            solids: scene.output.solids && !scene.solids.is_empty(),
            moving_obstacles: scene.obstacles_move(),
            surface: surface.filter(|_| scene.output.surface).map(|surface| SurfaceSource::of(surface, scene.surface)),
        }
    }
}

/// Writer of the frames of one run.
#[derive(Debug)]
pub struct FrameWriter {
    folder: PathBuf,
    name: String,
    grid: Grid,
    markers: Option<Series>,
    fields: Option<Series>,
    solids: Option<Series>,
    obstacles: Option<Series>,
    surface: Option<(Series, SurfaceSource)>,
}

impl FrameWriter {
    /// Creates `run/frames` if absent. `name` is the scene's.
    pub fn create(run: &Path, name: &str, grid: Grid, kinds: FrameKinds) -> Result<FrameWriter, Error> {
        let folder = run.join("frames");
        create_folder(&folder)?;
        let series =
            |enabled: bool, kind: &str| enabled.then(|| Series::new(folder.join(format!("{name}_{kind}.pvd"))));
        let markers = series(kinds.markers, "markers");
        let fields = series(kinds.fields, "fields");
        let solids = series(kinds.solids, "solids");
        let obstacles = series(kinds.moving_obstacles, "obstacles");
        let surface = series(kinds.surface.is_some(), "surface").zip(kinds.surface);
        Ok(FrameWriter { folder, name: name.to_owned(), grid, markers, fields, solids, obstacles, surface })
    }

    /// Writes the surfaces of the obstacles with normals towards the liquid; no file without obstacles. Cell data:
    /// `obstacle` (index).
    pub fn write_obstacles(&self, obstacles: &[geometry::Surface]) -> Result<(), Error> {
        if obstacles.is_empty() {
            return Ok(());
        }
        let path = self.folder.join(format!("{}_obstacles.vtp", self.name));
        vtk::write(&path, obstacles_file(obstacles), vtk::FAST)
    }

    /// Writes the moving obstacles of the state's frame, and their series.
    pub fn write_moved_obstacles(&mut self, state: &State, obstacles: &[geometry::Surface]) -> Result<(), Error> {
        let Some(series) = &mut self.obstacles else {
            return Ok(());
        };
        let file_name = moved_obstacles_file(&self.name, state.frame);
        vtk::write(&self.folder.join(&file_name), obstacles_file(obstacles), vtk::FAST)?;
        series.add(state.time, &file_name);
        series.write()
    }

    /// Resumes after frames that were written before; the series then contain exactly these frames.
    pub fn resume(&mut self, frames: &[u64], frames_per_second: f64) -> Result<(), Error> {
        let surface = self.surface.as_mut().map(|(series, _)| series);
        let series = [
            (self.markers.as_mut(), "", "vtp"),
            (self.fields.as_mut(), "", "vti"),
            (self.solids.as_mut(), "", "vtu"),
            (surface, "_surface", "vtp"),
        ];
        for (series, kind, extension) in series {
            let Some(series) = series else { continue };
            for &frame in frames {
                let file = format!("{}{kind}_{frame:06}.{extension}", self.name);
                series.add(frame as f64 / frames_per_second, &file);
            }
            series.write()?;
        }
        let Some(series) = &mut self.obstacles else {
            return Ok(());
        };
        for &frame in frames {
            let file = moved_obstacles_file(&self.name, frame);
            series.add(frame as f64 / frames_per_second, &file);
        }
        series.write()
    }

    /// Writes the state's frame, and the series.
    ///
    /// A value that is not finite in f32 is an error with field and position; no file is written then.
    pub fn write(&mut self, state: &State, cut: &CutCells, bodies: &Solids) -> Result<(), Error> {
        let FrameWriter { folder, name, grid, markers, fields, solids, surface, .. } = self;
        let stem = format!("{name}_{:06}", state.frame);
        let markers_file = markers.is_some().then(|| markers_file(grid, state)).transpose()?;
        let fields_file = fields.is_some().then(|| fields_file(grid, state, cut)).transpose()?;
        let solids_file = solids.is_some().then(|| solids_file(bodies, state)).transpose()?;
        let surface =
            surface.as_mut().map(|(series, source)| Ok((series, surface_of(grid, state, cut, source)?))).transpose()?;
        for (series, file, extension) in
            [(markers, markers_file, "vtp"), (fields, fields_file, "vti"), (solids, solids_file, "vtu")]
        {
            if let (Some(series), Some(file)) = (series, file) {
                let file_name = format!("{stem}.{extension}");
                vtk::write(&folder.join(&file_name), file, vtk::FAST)?;
                series.add(state.time, &file_name);
                series.write()?;
            }
        }
        if let Some((series, surface)) = surface {
            let mesh = ShadedMesh {
                vertices: &surface.mesh.vertices,
                normals: &surface.mesh.normals,
                velocity: Some(&surface.velocity),
                texture: None,
                triangles: &surface.mesh.triangles,
            };
            ply::write(&folder.join(format!("{stem}.ply")), &mesh)?;
            let file_name = format!("{name}_surface_{:06}.vtp", state.frame);
            vtk::write(&folder.join(&file_name), surface_file(surface), vtk::FAST)?;
            series.add(state.time, &file_name);
            series.write()?;
        }
        Ok(())
    }
}

/// File name of the moving obstacles in a frame.
pub(super) fn moved_obstacles_file(name: &str, frame: u64) -> String {
    format!("{name}_obstacles_{frame:06}.vtp")
}

/// The surfaces of obstacles, m. Cell data: `obstacle` (index).
fn obstacles_file(obstacles: &[geometry::Surface]) -> DataSet {
    let (mut points, mut triangles) = (Vec::new(), Vec::new());
    let mut index = Vec::new();
    for (ix, obstacle) in (0_i32..).zip(obstacles) {
        let first = (points.len() / 3) as u32;
        let vertices = obstacle.vertices.iter();
        points.extend(vertices.flat_map(|x| x.as_vec3().to_array()));
        let corners = obstacle.triangles.iter();
        triangles.extend(corners.map(|corners| corners.map(|corner| first + corner)));
        index.extend(obstacle.triangles.iter().map(|_| ix));
    }
    poly_data(PolyDataPiece {
        points: points.into(),
        polys: Some(polygons(&triangles)),
        data: Attributes { point: Vec::new(), cell: vec![scalars("obstacle", index.into())] },
        ..Default::default()
    })
}

/// Surface of the liquid with velocities.
pub(super) struct MovingSurface {
    pub(super) mesh: LiquidSurface,
    /// Velocity of each vertex, m/s, trilinear from the faces.
    pub(super) velocity: Vec<Vec3>,
}

/// The liquid's surface as in the files of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceTriangles {
    /// Positions within the domain, m.
    pub vertices: Vec<[f32; 3]>,
    /// Unit vertex normals out of the liquid.
    pub normals: Vec<[f32; 3]>,
    /// Velocities of the vertices, m/s.
    pub velocity: Vec<[f32; 3]>,
    /// Corners, counter-clockwise seen from outside the liquid.
    pub triangles: Vec<[u32; 3]>,
}

impl SurfaceTriangles {
    /// The surface of a state; empty without liquid.
    ///
    /// # Errors
    /// [`Error::Stage`] where the state has a value that is not finite, or its markers have no mesh.
    pub fn new(scene: &Scene, state: &State, cut: &CutCells) -> Result<SurfaceTriangles, Error> {
        let Some(liquid) = &scene.liquid else {
            return Ok(SurfaceTriangles::default());
        };
        let source = SurfaceSource::of(liquid.surface, scene.surface);
        let MovingSurface { mesh, velocity } = surface_of(&scene.grid(), state, cut, &source)?;
        let arrays = |vectors: Vec<Vec3>| vectors.into_iter().map(|x| x.to_array()).collect();
        Ok(SurfaceTriangles {
            vertices: arrays(mesh.vertices),
            normals: arrays(mesh.normals),
            velocity: arrays(velocity),
            triangles: mesh.triangles,
        })
    }
}

fn surface_of(grid: &Grid, state: &State, cut: &CutCells, source: &SurfaceSource) -> Result<MovingSurface, Error> {
    let cells = |field: &str, values: &[f64]| {
        let cells = values.iter().enumerate();
        let checked = cells.map(|(cell, &value)| finite(state, field, value, || cell_name(grid, cell)));
        checked.collect::<Result<Vec<f32>, Error>>()
    };
    let distance = || cells("liquid_distance", &state.liquid_distance);
    let mesh = match source {
        SurfaceSource::Markers(settings) => {
            let mut markers = Vec::with_capacity(state.markers.len());
            for (marker, position) in state.markers.iter().enumerate() {
                let place = || format!("marker {marker}");
                let mut x = Vec3::ZERO;
                for axis in 0..3 {
                    x[axis] = finite(state, "position", position[axis], place)?;
                }
                markers.push(x);
            }
            LiquidSurface::from_markers(&markers, grid, settings)
        }
        SurfaceSource::Level => {
            let solid_distance = cells("solid_distance", &cut.solid_distance)?;
            LiquidSurface::from_level(&distance()?, &solid_distance, grid)
        }
        SurfaceSource::Distance => LiquidSurface::from_distance(&distance()?, grid),
    };
    let mut mesh = mesh.map_err(|problem| Error::Stage {
        stage: "write_frame",
        step: state.step,
        problem: format!("no mesh of the liquid's surface: {problem}"),
    })?;
    let mut velocity = Vec::with_capacity(mesh.vertices.len());
    for (vertex, x) in mesh.vertices.iter().enumerate() {
        let place = || format!("vertex {vertex} of the surface");
        let sampled = grid.velocity_at(&state.velocity, x.as_dvec3());
        let mut u = Vec3::ZERO;
        for axis in 0..3 {
            u[axis] = finite(state, "velocity", sampled[axis], place)?;
        }
        velocity.push(u);
    }
    let flying = (0..state.spray.len()).filter(|&marker| state.spray[marker]);
    let mut drops = Vec::new();
    for marker in flying {
        let place = || format!("marker {marker}");
        let (mut x, mut u) = (Vec3::ZERO, Vec3::ZERO);
        for axis in 0..3 {
            x[axis] = finite(state, "position", state.markers[marker][axis], place)?;
            u[axis] = finite(state, "velocity", state.marker_velocity[marker][axis], place)?;
        }
        drops.push(x);
        velocity.extend([u; DROP_CORNERS]);
    }
    mesh.add_spray(&drops, grid);
    Ok(MovingSurface { mesh, velocity })
}

/// Triangles (m); point data `Normals`, out of the liquid, and `velocity` (m/s).
fn surface_file(MovingSurface { mesh, velocity }: MovingSurface) -> DataSet {
    let numbers = |vectors: Vec<Vec3>| -> Vec<f32> { vectors.into_iter().flat_map(|x| x.to_array()).collect() };
    let normals =
        Attribute::DataArray(DataArray { data: numbers(mesh.normals).into(), ..DataArray::normals("Normals") });
    let piece = PolyDataPiece {
        polys: Some(polygons(&mesh.triangles)),
        points: numbers(mesh.vertices).into(),
        data: Attributes { point: vec![normals, vectors("velocity", numbers(velocity))], cell: Vec::new() },
        ..Default::default()
    };
    poly_data(piece)
}

fn polygons(triangles: &[[u32; 3]]) -> VertexNumbers {
    VertexNumbers::XML {
        connectivity: triangles.iter().flatten().map(|&corner| corner.into()).collect(),
        offsets: (1..=triangles.len() as u64).map(|triangle| 3 * triangle).collect(),
    }
}

/// Marker positions (m) as points, with point data `velocity` (m/s, of spray its own, else trilinear from the faces), `speed`, and with a level `spray`
/// (1 for markers that fly).
fn markers_file(grid: &Grid, state: &State) -> Result<DataSet, Error> {
    let n = state.markers.len();
    let mut points = Vec::with_capacity(3 * n);
    let mut velocity = Vec::with_capacity(3 * n);
    let mut speed = Vec::with_capacity(n);
    for (marker, &position) in state.markers.iter().enumerate() {
        let place = || format!("marker {marker}");
        // Before the velocity, which a nonfinite position would spoil.
        for x in position {
            points.push(finite(state, "position", x, place)?);
        }
        let u = state.velocity_of_marker(grid, marker);
        for u in u.to_array() {
            velocity.push(finite(state, "velocity", u, place)?);
        }
        speed.push(finite(state, "speed", u.length(), place)?);
    }
    let n = n as u64;
    let mut point = vec![vectors("velocity", velocity), scalars("speed", speed.into())];
    // A level may have no markers, but every frame of a run has the same arrays.
    if !state.component.is_empty() {
        let spray: Vec<u8> = state.spray.iter().map(|&spray| spray.into()).collect();
        point.push(scalars("spray", spray.into()));
    }
    let piece = PolyDataPiece {
        points: points.into(),
        verts: Some(VertexNumbers::XML { connectivity: (0..n).collect(), offsets: (1..=n).collect() }),
        data: Attributes { point, cell: Vec::new() },
        ..Default::default()
    };
    Ok(poly_data(piece))
}

/// Cell data: `pressure` (Pa), `liquid_distance` (m), `velocity` (m/s, mean of opposite faces), `active`, `solid_distance` (m), and with separation
/// `separated`.
fn fields_file(grid: &Grid, state: &State, cut: &CutCells) -> Result<DataSet, Error> {
    let cells = |field: &str, values: &[f64]| -> Result<Vec<f32>, Error> {
        values.iter().enumerate().map(|(cell, &value)| finite(state, field, value, || cell_name(grid, cell))).collect()
    };
    let mut velocity = Vec::with_capacity(3 * grid.n_cells());
    for cell in 0..grid.n_cells() {
        for mean in grid.cell_velocity(&state.velocity, cell).to_array() {
            velocity.push(finite(state, "velocity", mean, || cell_name(grid, cell))?);
        }
    }
    let active: Vec<u8> = state.active.iter().map(|&active| active.into()).collect();
    let extent = Extent::Ranges(grid.cells.map(|n| 0..=n as i32));
    let mut cell = vec![
        scalars("pressure", cells("pressure", &state.pressure)?.into()),
        scalars("liquid_distance", cells("liquid_distance", &state.liquid_distance)?.into()),
        vectors("velocity", velocity),
        scalars("active", active.into()),
        scalars("solid_distance", cells("solid_distance", &cut.solid_distance)?.into()),
    ];
    if !state.separated.is_empty() {
        let separated: Vec<u8> = state.separated.iter().map(|&separated| separated.into()).collect();
        cell.push(scalars("separated", separated.into()));
    }
    let data = Attributes { point: Vec::new(), cell };
    let piece = ImageDataPiece { extent: extent.clone(), data };
    Ok(DataSet::ImageData {
        extent,
        origin: [0.0; 3],
        // vtkio's spacings are f32, which shifts a corner of 512 cells by at most 3e-5 of a cell.
        spacing: [grid.dx as f32; 3],
        meta: None,
        pieces: vec![Piece::Inline(Box::new(piece))],
    })
}

/// Positions of all nodes (m) and tetrahedra.
///
/// Point data: `displacement` from rest (m), `velocity` (m/s). Cell data: `von_mises` stress (Pa), `det_f`, `solid` (index of
/// the body).
fn solids_file(solids: &Solids, state: &State) -> Result<DataSet, Error> {
    let vectors_of = |field: &str, value: &dyn Fn(usize) -> DVec3| -> Result<Vec<f32>, Error> {
        let mut written = Vec::with_capacity(3 * solids.rest.len());
        for node in 0..solids.rest.len() {
            for x in value(node).to_array() {
                written.push(finite(state, field, x, || format!("node {node}"))?);
            }
        }
        Ok(written)
    };
    let displacement = |node: usize| DVec3::from_array(state.displacement[node]);
    let velocity = |node: usize| DVec3::from_array(state.node_velocity[node]);
    let points = vectors_of("position", &|node| solids.rest[node] + displacement(node))?;
    let data = vec![
        vectors("displacement", vectors_of("displacement", &displacement)?),
        vectors("velocity", vectors_of("velocity", &velocity)?),
    ];
    let n = solids.elements.len();
    let stresses: Vec<[f64; 2]> =
        (0..n).into_par_iter().map(|element| solids.stress_and_determinant(element, &state.displacement)).collect();
    let cells = |field: &str, which: usize| -> Result<IOBuffer, Error> {
        let values = stresses.iter().enumerate();
        let values =
            values.map(|(element, values)| finite(state, field, values[which], || format!("element {element}")));
        Ok(values.collect::<Result<Vec<f32>, Error>>()?.into())
    };
    let owners = (0_i32..).zip(&solids.bodies);
    let owners: Vec<i32> = owners.flat_map(|(solid, body)| body.elements.clone().map(move |_| solid)).collect();
    let cell_data = vec![
        scalars("von_mises", cells("von_mises", 0)?),
        scalars("det_f", cells("det_f", 1)?),
        scalars("solid", owners.into()),
    ];
    Ok(tetrahedra(points.into(), &solids.elements, data, cell_data))
}

/// An unstructured grid of tetrahedra; `points` has 3 numbers per node.
pub(super) fn tetrahedra(
    points: IOBuffer,
    elements: &[[u32; 4]],
    point_data: Vec<Attribute>,
    cell_data: Vec<Attribute>,
) -> DataSet {
    let n = elements.len();
    let corners = elements.iter().flatten();
    let piece = UnstructuredGridPiece {
        points,
        cells: Cells {
            cell_verts: VertexNumbers::XML {
                connectivity: corners.map(|&node| node.into()).collect(),
                offsets: (1..=n as u64).map(|element| 4 * element).collect(),
            },
            types: vec![CellType::Tetra; n],
        },
        data: Attributes { point: point_data, cell: cell_data },
    };
    DataSet::UnstructuredGrid { meta: None, pieces: vec![Piece::Inline(Box::new(piece))] }
}

fn cell_name(grid: &Grid, cell: usize) -> String {
    let [i, j, k] = grid.cell_at(cell);
    format!("cell ({i}, {j}, {k})")
}

/// The value in f32; an error if that is not finite.
fn finite(state: &State, field: &str, value: f64, place: impl FnOnce() -> String) -> Result<f32, Error> {
    let written = value as f32;
    if written.is_finite() {
        return Ok(written);
    }
    let problem = format!("{field} of {} is {value:?}; frame {} is not written", place(), state.frame);
    Err(Error::Stage { stage: "write_frame", step: state.step, problem })
}

pub(super) fn scalars(name: &str, values: IOBuffer) -> Attribute {
    Attribute::DataArray(DataArray { data: values, ..DataArray::scalars(name, 1) })
}

fn vectors(name: &str, values: Vec<f32>) -> Attribute {
    Attribute::DataArray(DataArray { data: values.into(), ..DataArray::vectors(name) })
}

fn poly_data(piece: PolyDataPiece) -> DataSet {
    DataSet::PolyData { meta: None, pieces: vec![Piece::Inline(Box::new(piece))] }
}

/// A ParaView collection of files and their times, which vtkio lacks.
#[derive(Debug)]
struct Series {
    path: PathBuf,
    entries: String,
}

impl Series {
    fn new(path: PathBuf) -> Series {
        Series { path, entries: String::new() }
    }

    /// `file` is in the folder of the collection.
    fn add(&mut self, time: f64, file: &str) {
        let file = file.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
        self.entries += &format!("    <DataSet timestep=\"{time:?}\" group=\"\" part=\"0\" file=\"{file}\"/>\n");
    }

    fn write(&self) -> Result<(), Error> {
        let text = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n  \
             <Collection>\n{}  </Collection>\n</VTKFile>\n",
            self.entries
        );
        write_atomically(&self.path, text.as_bytes())
    }
}
