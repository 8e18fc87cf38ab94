//! Shaded pictures of a run from its files: `manifest.json` and `frames/`.
//!
//! A ray tracer on the CPU in f32. It draws the liquid's surface with refraction, Fresnel reflection and absorption, and
//! elastic solids by body, stress or change of volume. It also draws obstacles, soft shadows, the floor with a labelled
//! grid, and the edges of the domain. Pixels are independent, so pictures do not depend on the number of threads.

mod liquid;
mod picture;
mod shade;
mod solids;
mod triangles;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec2, Vec3};
use vtkio::Vtk;
use vtkio::model::{Attribute, Attributes, DataSet, IOBuffer, Piece, VertexNumbers};

use super::atomic::create_folder;
use super::frames::moved_obstacles_file;
use super::manifest::Manifest;
use super::surface::LiquidSurface;
use crate::Error;
use crate::grid::Grid;
use crate::scene::{Camera, CameraCut, PICTURE_SIDES, SurfaceMesh};
use liquid::Liquid;
use picture::Picture;
use shade::{PictureScene, View};
use solids::{Scale, SolidFrame, SolidSurface};
use triangles::{HalfSpace, Owner, Triangle, Triangles};

pub(crate) use picture::ensure_whole_png;

/// Highest frame rate that browsers play at its speed, 1/s.
const FASTEST_ANIMATION: f64 = 50.0;

const DARK: [u8; 3] = [40, 46, 54];

/// Quantity that colours elastic solids.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Colour {
    /// The body.
    #[default]
    Solid,
    /// Von Mises stress, Pa.
    Stress,
    /// det F: volume over volume at rest.
    DetF,
}

impl Colour {
    fn field(self) -> Option<&'static str> {
        match self {
            Colour::Solid => None,
            Colour::Stress => Some("von_mises"),
            Colour::DetF => Some("det_f"),
        }
    }
}

/// Options of `preview`.
#[derive(Clone, Copy, Debug)]
pub struct PreviewOptions {
    /// Picture size, pixels; default the scene's.
    pub size: Option<[usize; 2]>,
    /// Interval of drawn frames; at least 1.
    pub every: usize,
    /// Whether to write the animation too.
    pub animation: bool,
    /// Whether to write it as GIF as well.
    pub gif: bool,
    /// Quantity that colours elastic solids.
    pub colour: Colour,
    /// Whether separated cells are shown as red cubes.
    pub separated: bool,
    /// Position of the camera, m; default the scene's. This, a target or a field of view put the camera to rest.
    pub eye: Option<DVec3>,
    /// Point in the middle of the picture, m.
    pub target: Option<DVec3>,
    /// Direction that is up in the picture.
    pub up: Option<DVec3>,
    /// Vertical field of view, degrees.
    pub fov: Option<f64>,
    /// Plane that cuts elastic solids open.
    pub cut: Option<CameraCut>,
}

impl Default for PreviewOptions {
    fn default() -> PreviewOptions {
        PreviewOptions {
            size: None,
            every: 1,
            animation: true,
            gif: false,
            colour: Colour::Solid,
            separated: false,
            eye: None,
            target: None,
            up: None,
            fov: None,
            cut: None,
        }
    }
}

impl PreviewOptions {
    /// The camera of the scene with the options.
    fn camera(&self, manifest: &Manifest) -> Result<Camera, Error> {
        let mut camera = Camera::from(&manifest.camera);
        if self.eye.is_some() || self.target.is_some() || self.fov.is_some() {
            camera.keyframes.clear();
        }
        camera.eye = self.eye.unwrap_or(camera.eye);
        camera.target = self.target.unwrap_or(camera.target);
        camera.up = self.up.unwrap_or(camera.up);
        camera.fov = self.fov.unwrap_or(camera.fov);
        camera.cut = self.cut.or(camera.cut);
        let refuse = |option: &str, problem: &str, cure: &str| Err(Error::input(option, problem, cure));
        let numbers = [camera.eye, camera.target, camera.up];
        if !numbers
            .iter()
            .all(|x| x.is_finite() && x.abs().max_element() <= 1e6 * vector(manifest.size).max_element() as f64)
        {
            return refuse("camera", "a coordinate is not finite, or far beyond the domain", "give coordinates in m");
        }
        if !(camera.fov > 0.0 && camera.fov <= 150.0) {
            return refuse("--camera-fov", "is no field of view", "give an angle of at most 150 degrees; 35 is usual");
        }
        let Some(up) = camera.up.try_normalize() else {
            return refuse(
                "--camera-up",
                "has no direction",
                "give the direction that is up in the picture, such as 0,1,0",
            );
        };
        camera.up = up;
        let given = self.eye.is_some() || self.target.is_some() || self.up.is_some();
        let ahead = (camera.target - camera.eye).try_normalize();
        if given && ahead.is_none() {
            return refuse("--camera-eye", "is the target itself", "move it away from the target");
        }
        if given && ahead.is_some_and(|ahead| ahead.dot(up).abs() >= 1.0 - 1e-9) {
            return refuse(
                "--camera-eye",
                "looks along the camera's up",
                "move it, or give another direction with --camera-up",
            );
        }
        if let Some(CameraCut { axis, at }) = self.cut
            && !(at > 0.0 && at < manifest.size[axis])
        {
            let cure = format!("give a number between 0 and {}", manifest.size[axis]);
            return refuse("--camera-cut", "lies outside the domain", &cure);
        }
        Ok(camera)
    }
}

/// Result of `preview`.
#[derive(Clone, Debug, PartialEq)]
pub struct PreviewReport {
    /// `DIR/preview/NAME_%06d.png`, in order.
    pub pictures: Vec<PathBuf>,
    /// `DIR/preview/NAME.png`, an APNG: browsers play it.
    pub animation: Option<PathBuf>,
    /// `DIR/preview/NAME.gif`, the same.
    pub gif: Option<PathBuf>,
    /// Written frames with missing or incomplete files.
    pub missing: Vec<u64>,
}

/// Draws the frames of a run. `progress` is called with the number of finished and of all pictures, and returns whether to
/// continue.
///
/// # Errors
/// [`Error::Interrupted`] after `progress` returned false; [`Error::Input`] and [`Error::Output`] for files.
pub fn preview(
    run: &Path,
    options: &PreviewOptions,
    progress: &mut dyn FnMut(usize, usize) -> bool,
) -> Result<PreviewReport, Error> {
    let mut pictures = Pictures::new(run, options)?;
    pictures.draw(progress)?;
    pictures.finish()
}

/// Draws the pictures of a finished or running run.
pub struct Pictures {
    run: PathBuf,
    options: PreviewOptions,
    manifest: Manifest,
    camera: Camera,
    scene: PictureScene,
    surface: SolidSurface,
    drawn: BTreeMap<u64, PathBuf>,
}

impl Pictures {
    /// Reads the data common to all pictures. A folder without drawable frames is an error.
    pub fn new(run: &Path, options: &PreviewOptions) -> Result<Pictures, Error> {
        let manifest = Manifest::read(run)?;
        let frames = run.join("frames");
        let files = frame_files(&frames, &manifest)?;
        if options.colour != Colour::Solid && !manifest.solid_frames {
            return Err(Error::input(
                run.display().to_string(),
                "no frame has elastic solids to colour",
                "draw it without --colour-by",
            ));
        }
        if options.separated && !manifest.fields {
            return Err(Error::input(
                run.display().to_string(),
                "no frame has fields, which say what cells are separated",
                "draw it without --separated, or run it with output.fields = true",
            ));
        }
        let solid_files = files.values().filter_map(|files| files.solids.as_deref());
        let scale = Scale::over(options.colour, solid_files)?;
        let name = &manifest.scene.name;
        let obstacles = Triangles::new(match manifest.obstacles {
            true => read_obstacles(&frames.join(format!("{name}_obstacles.vtp")))?,
            false => Vec::new(),
        });
        let camera = options.camera(&manifest)?;
        let size = options.size.unwrap_or(camera.size);
        if !size.iter().all(|side| PICTURE_SIDES.contains(side)) {
            let what = match options.size {
                Some(_) => "--size".to_owned(),
                None => run.join("manifest.json").display().to_string(),
            };
            return Err(Error::input(
                what,
                format!("pictures of {} x {} pixels", size[0], size[1]),
                format!("sides have {} to {} pixels", PICTURE_SIDES.start(), PICTURE_SIDES.end()),
            ));
        }
        let view = View::new(&camera.pose(0.0), camera.up, size);
        let domain = vector(manifest.size);
        let up = upwards(vector(manifest.gravity), camera.up.as_vec3());
        let scene = PictureScene {
            liquid: None,
            obstacles,
            separated: Triangles::none(),
            solids: Triangles::none(),
            appearances: Vec::new(),
            scale,
            pixel: view.pixel(),
            domain,
            up,
            floor_lines: round_length(0.12 * domain.max_element()),
            // One sun for all pictures: light that followed the camera would flicker.
            sun: PictureScene::sun_for(&view, up),
        };
        Ok(Pictures {
            run: run.to_owned(),
            options: *options,
            manifest,
            camera,
            scene,
            surface: SolidSurface::none(),
            drawn: BTreeMap::new(),
        })
    }

    /// Draws all complete frames that are not drawn yet. `progress` is called with the number of finished and of all
    /// pictures, and returns whether to continue.
    ///
    /// # Errors
    /// [`Error::Interrupted`] after `progress` returned false; [`Error::Input`] and [`Error::Output`] for files.
    pub fn draw(&mut self, progress: &mut dyn FnMut(usize, usize) -> bool) -> Result<(), Error> {
        let files = frame_files(&self.run.join("frames"), &self.manifest)?;
        let files: Vec<(u64, FrameFiles)> = files.into_iter().step_by(self.options.every.max(1)).collect();
        let n = files.len();
        for (done, (frame, files)) in files.iter().enumerate() {
            if self.drawn.contains_key(frame) {
                continue;
            }
            if !progress(done, n) {
                return Err(Error::Interrupted);
            }
            let path = self.draw_frame(*frame, files)?;
            self.drawn.insert(*frame, path);
        }
        progress(n, n);
        Ok(())
    }

    fn draw_frame(&mut self, frame: u64, files: &FrameFiles) -> Result<PathBuf, Error> {
        let Pictures { options, manifest, camera, scene, surface, .. } = self;
        let time = frame as f64 / manifest.frames_per_second;
        let view = View::new(&camera.pose(time), camera.up, options.size.unwrap_or(camera.size));
        scene.pixel = view.pixel();
        let walls = Vec3::from_array(manifest.cells.map(|n| n as f32)) * manifest.dx as f32;
        if let Some(file) = &files.liquid {
            scene.liquid = Liquid::new(&read_surface(file, manifest)?, walls);
        }
        if options.separated {
            let fields = format!("{}_{frame:06}.vti", manifest.scene.name);
            let cells = read_separated(&self.run.join("frames").join(fields), manifest)?;
            scene.separated = Triangles::new(cubes(&cells, manifest.dx as f32));
        }
        // Moving obstacles have a file per frame.
        let obstacles = moved_obstacles_file(&manifest.scene.name, frame);
        let obstacles = self.run.join("frames").join(obstacles);
        if manifest.obstacles && obstacles.is_file() {
            scene.obstacles = Triangles::new(read_obstacles(&obstacles)?);
        }
        if let Some(file) = &files.solids {
            let frame = SolidFrame::read(file, options.colour)?;
            let (solids, appearances) = surface.coloured(&frame, options.colour);
            (scene.solids, scene.appearances) = (solids.without(before(camera.cut, view.eye)), appearances);
        }
        let (mut picture, depths) = scene.render(&view);
        draw_domain(&mut picture, &depths, &view, scene.domain);
        label_floor(&mut picture, &depths, &view, scene);
        let [_, line] = picture.font().extent(1);
        let corner = (line / 2) as i64;
        // Enough decimals to distinguish frames.
        let decimals = 1 + manifest.frames_per_second.log10().ceil().max(2.0) as usize;
        let time = format!("{time:.decimals$} s");
        picture.text(corner, corner, &time, DARK, |_, _| true);
        scene.scale.draw(&mut picture);
        let folder = self.run.join("preview");
        create_folder(&folder)?;
        let path = folder.join(format!("{}_{frame:06}.png", manifest.scene.name));
        picture.write(&path)?;
        Ok(path)
    }

    /// Writes the animation of the drawn frames.
    pub fn finish(self) -> Result<PreviewReport, Error> {
        let name = &self.manifest.scene.name;
        let path = self.run.join("preview").join(format!("{name}.png"));
        let gif = path.with_extension("gif");
        let animation = self.options.animation && !self.drawn.is_empty();
        if animation {
            let rate = self.manifest.frames_per_second;
            // Browsers slow down faster animations, so frames are skipped instead.
            let every = (rate / FASTEST_ANIMATION).ceil().max(1.0) as usize;
            let (numbers, pictures): (Vec<u64>, Vec<PathBuf>) = self.drawn.clone().into_iter().step_by(every).unzip();
            let seconds = seconds_shown(&numbers, rate);
            let shown: Vec<(PathBuf, f64)> = pictures.into_iter().zip(seconds).collect();
            picture::animate(&path, &shown)?;
            if self.options.gif {
                picture::animate_gif(&gif, &shown)?;
            }
        }
        let mut missing = Manifest::read(&self.run)?.progress.frames_written;
        missing.retain(|frame| self.options.every == 1 && !self.drawn.contains_key(frame));
        Ok(PreviewReport {
            missing,
            pictures: self.drawn.into_values().collect(),
            animation: animation.then_some(path),
            gif: (animation && self.options.gif).then_some(gif),
        })
    }
}

/// Files of a frame.
#[derive(Default)]
pub(super) struct FrameFiles {
    pub(super) liquid: Option<PathBuf>,
    solids: Option<PathBuf>,
}

/// Duration of each picture, s: until the next drawn frame, and for the last one as for the one before.
fn seconds_shown(numbers: &[u64], frames_per_second: f64) -> Vec<f64> {
    let mut frames: Vec<u64> = numbers.windows(2).map(|pair| pair[1] - pair[0]).collect();
    frames.push(frames.last().copied().unwrap_or(1));
    frames.into_iter().map(|frames| frames as f64 / frames_per_second).collect()
}

/// Complete frames in the folder by number. The liquid's file is its surface, markers or fields.
pub(super) fn frame_files(folder: &Path, manifest: &Manifest) -> Result<BTreeMap<u64, FrameFiles>, Error> {
    let name = &manifest.scene.name;
    let solids = manifest.solid_frames.then(|| (format!("{name}_"), "vtu"));
    // File name before and after the number.
    let liquid = match manifest {
        Manifest { surfaces: true, .. } => Some((format!("{name}_surface_"), "vtp")),
        Manifest { markers: true, level: false, .. } => Some((format!("{name}_"), "vtp")),
        Manifest { fields: true, .. } => Some((format!("{name}_"), "vti")),
        _ => None,
    };
    let Some((first, extension)) = liquid.as_ref().or(solids.as_ref()) else {
        let cure = match manifest.solids.is_empty() {
            true => "run the scene with output.particles, output.fields or output.surface on",
            false => "run the scene with output.solids on",
        };
        let problem = "the run writes no frames";
        return Err(Error::input(folder.display().to_string(), problem, cure));
    };
    let mut frames: BTreeMap<u64, FrameFiles> = BTreeMap::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let number = |kind: &Option<(String, &str)>| -> Option<u64> {
            let (prefix, extension) = kind.as_ref()?;
            let number = path.file_name()?.to_str()?.strip_prefix(prefix.as_str())?;
            number.strip_suffix(extension)?.strip_suffix('.')?.parse().ok()
        };
        if let Some(number) = number(&liquid) {
            frames.entry(number).or_default().liquid = Some(path);
        } else if let Some(number) = number(&solids) {
            frames.entry(number).or_default().solids = Some(path);
        }
    }
    frames.retain(|_, files| files.liquid.is_some() == liquid.is_some() && files.solids.is_some() == solids.is_some());
    if frames.is_empty() {
        let problem = format!("no frame {first}000000.{extension} or later");
        let cure = "let `cutwater run` write a frame first";
        return Err(Error::input(folder.display().to_string(), problem, cure));
    }
    Ok(frames)
}

/// Half space in front of the cutting plane, as seen from the eye.
fn before(cut: Option<CameraCut>, eye: Vec3) -> Option<HalfSpace> {
    let CameraCut { axis, at } = cut?;
    let at = at as f32;
    let side = if eye[axis] < at { -1.0 } else { 1.0 };
    Some(HalfSpace { normal: side * Vec3::AXES[axis], offset: side * at })
}

/// Axis nearest to the direction against gravity, or without gravity to the camera's up vector.
fn upwards(gravity: Vec3, camera: Vec3) -> Vec3 {
    let up = if gravity == Vec3::ZERO { camera } else { -gravity };
    let mut axis = Vec3::ZERO;
    let nearest = up.abs().max_position();
    axis[nearest] = 1.0_f32.copysign(up[nearest]);
    axis
}

/// 1, 2 or 5 times a power of ten near a length.
fn round_length(length: f32) -> f32 {
    let power = 10f32.powf(length.log10().floor());
    let rest = length / power;
    power
        * if rest < 1.5 {
            1.0
        } else if rest < 3.5 {
            2.0
        } else if rest < 7.5 {
            5.0
        } else {
            10.0
        }
}

pub(super) fn unreadable(path: &Path, problem: impl std::fmt::Display) -> Error {
    Error::input(path.display().to_string(), problem.to_string(), "give a folder that `cutwater run` wrote")
}

fn read_vtk(path: &Path) -> Result<DataSet, Error> {
    Vtk::import(path).map(|vtk| vtk.data).map_err(|problem| unreadable(path, problem))
}

pub(super) fn points(buffer: IOBuffer) -> Option<Vec<Vec3>> {
    let numbers: Vec<f32> = buffer.into_vec()?;
    Some(numbers.chunks_exact(3).map(Vec3::from_slice).collect())
}

pub(super) fn array(attributes: &[Attribute], name: &str) -> Option<IOBuffer> {
    attributes.iter().find_map(|attribute| match attribute {
        Attribute::DataArray(array) if array.name == name => Some(array.data.clone()),
        _ => None,
    })
}

/// The liquid's surface of a frame file: stored, or reconstructed from markers or fields.
pub(super) fn read_surface(path: &Path, manifest: &Manifest) -> Result<LiquidSurface, Error> {
    let missing = |what: &str| unreadable(path, format!("no {what}"));
    let grid = Grid { cells: manifest.cells, dx: manifest.dx };
    let surface = match read_vtk(path)? {
        DataSet::PolyData { pieces, .. } => {
            let Some(Piece::Inline(piece)) = pieces.into_iter().next() else {
                return Err(missing("inline data"));
            };
            let points = points(piece.points).ok_or_else(|| missing("f32 points"))?;
            if manifest.surfaces {
                return surface_mesh(points, piece.polys, &piece.data).ok_or_else(|| missing("surface"));
            }
            let settings = manifest.surface.map_or_else(SurfaceMesh::default, |record| SurfaceMesh {
                radius: record.radius,
                smoothing: record.smoothing,
            });
            LiquidSurface::from_markers(&points, &grid, &settings)
        }
        DataSet::ImageData { pieces, .. } => {
            let Some(Piece::Inline(piece)) = pieces.into_iter().next() else {
                return Err(missing("inline data"));
            };
            let phi = array(&piece.data.cell, "liquid_distance").and_then(IOBuffer::into_vec::<f32>);
            let phi = phi.filter(|phi| phi.len() == grid.n_cells());
            let phi = phi.ok_or_else(|| missing("liquid_distance for every cell"))?;
            if !manifest.level {
                LiquidSurface::from_distance(&phi, &grid)
            } else {
                let solid = array(&piece.data.cell, "solid_distance");
                let solid = solid.and_then(IOBuffer::into_vec::<f32>);
                let solid = solid.filter(|solid| solid.len() == grid.n_cells());
                let solid = solid.ok_or_else(|| missing("solid_distance for every cell"))?;
                let surface = LiquidSurface::from_level(&phi, &solid, &grid);
                let spray = match manifest.markers {
                    true => read_spray(&path.with_extension("vtp"))?,
                    false => Vec::new(),
                };
                surface.map(|mut surface| {
                    surface.add_spray(&spray, &grid);
                    surface
                })
            }
        }
        _ => return Err(missing("markers or fields")),
    };
    surface.map_err(|problem| unreadable(path, format!("no surface: {problem}")))
}

/// Positions of the markers that fly, m.
fn read_spray(path: &Path) -> Result<Vec<Vec3>, Error> {
    let missing = |what: &str| unreadable(path, format!("no {what}"));
    let DataSet::PolyData { pieces, .. } = read_vtk(path)? else {
        return Err(missing("markers"));
    };
    let Some(Piece::Inline(piece)) = pieces.into_iter().next() else {
        return Err(missing("inline data"));
    };
    let spray = array(&piece.data.point, "spray").and_then(IOBuffer::into_vec::<u8>);
    let spray = spray.ok_or_else(|| missing("spray"))?;
    let points = points(piece.points).filter(|points| points.len() == spray.len());
    let points = points.ok_or_else(|| missing("f32 points"))?;
    let markers = points.into_iter().zip(spray);
    Ok(markers.filter(|(_, flies)| *flies != 0).map(|(x, _)| x).collect())
}

/// Centres of the separated cells of a file of fields, m.
fn read_separated(path: &Path, manifest: &Manifest) -> Result<Vec<Vec3>, Error> {
    let DataSet::ImageData { pieces, .. } = read_vtk(path)? else {
        return Err(unreadable(path, "no fields"));
    };
    let Some(Piece::Inline(piece)) = pieces.into_iter().next() else {
        return Err(unreadable(path, "no inline data"));
    };
    let grid = Grid { cells: manifest.cells, dx: manifest.dx };
    let separated = array(&piece.data.cell, "separated").and_then(IOBuffer::into_vec::<u8>);
    let separated = separated.filter(|separated| separated.len() == grid.n_cells()).ok_or_else(|| {
        let cure = "draw it without --separated, or run the scene with liquid.separation";
        Error::input(path.display().to_string(), "does not say what cells are separated", cure)
    })?;
    let cells = separated.iter().enumerate().filter(|(_, separated)| **separated != 0);
    Ok(cells.map(|(cell, _)| grid.cell_centre(grid.cell_at(cell)).as_vec3()).collect())
}

/// Triangles of cubes about some points, half as wide as a cell.
fn cubes(centres: &[Vec3], dx: f32) -> Vec<Triangle> {
    let faces = (0..3).flat_map(|axis| [-1.0, 1.0].map(|side| (axis, side)));
    let faces: Vec<[Vec3; 4]> = faces
        .map(|(axis, side)| {
            let [n, a, b] = [0, 1, 2].map(|next| Vec3::AXES[(axis + next) % 3]);
            // Counterclockwise, seen from outside.
            [(-1.0, -1.0), (side, -side), (1.0, 1.0), (-side, side)]
                .map(|(x, y)| 0.25 * dx * (side * n + x * a + y * b))
        })
        .collect();
    let of = |&centre: &Vec3| {
        faces.iter().flat_map(move |&[a, b, c, d]| [[a, b, c], [a, c, d]].map(|of| of.map(|corner| centre + corner)))
    };
    let triangle = |corners| Triangle { corners, owner: Owner::Separated };
    centres.iter().flat_map(of).map(triangle).collect()
}

/// The stored mesh, if it is consistent.
fn surface_mesh(vertices: Vec<Vec3>, polygons: Option<VertexNumbers>, data: &Attributes) -> Option<LiquidSurface> {
    let Some(VertexNumbers::XML { connectivity, .. }) = polygons else {
        return None;
    };
    let normals = points(array(&data.point, "Normals")?)?;
    let known = |corner: &u64| (*corner as usize) < vertices.len();
    let whole = connectivity.iter().all(known) && normals.len() == vertices.len();
    let corners = connectivity.chunks_exact(3);
    let triangles = corners.map(|of| [0, 1, 2].map(|corner| of[corner] as u32));
    whole.then(|| LiquidSurface { triangles: triangles.collect(), vertices, normals })
}

/// Triangles of all obstacles. The surface of a container has a negative volume.
fn read_obstacles(path: &Path) -> Result<Vec<Triangle>, Error> {
    let missing = |what: &str| unreadable(path, format!("no {what}"));
    let DataSet::PolyData { pieces, .. } = read_vtk(path)? else {
        return Err(missing("surfaces"));
    };
    let mut all = Vec::new();
    for piece in pieces {
        let Piece::Inline(piece) = piece else {
            return Err(missing("inline data"));
        };
        let points = points(piece.points).ok_or_else(|| missing("f32 points"))?;
        let Some(VertexNumbers::XML { connectivity, .. }) = piece.polys else {
            return Err(missing("triangles"));
        };
        let owners: Vec<i32> = array(&piece.data.cell, "obstacle")
            .and_then(IOBuffer::into_vec)
            .ok_or_else(|| missing("obstacle numbers"))?;
        let mut volumes: BTreeMap<i32, f64> = BTreeMap::new();
        let mut triangles = Vec::new();
        for (corners, owner) in connectivity.chunks_exact(3).zip(owners) {
            let corner = |c: usize| points.get(corners[c] as usize).copied().ok_or_else(|| missing("such point"));
            let corners = [corner(0)?, corner(1)?, corner(2)?];
            let [a, b, c] = corners.map(Vec3::as_dvec3);
            *volumes.entry(owner).or_default() += a.dot(b.cross(c)) / 6.0;
            triangles.push((corners, owner));
        }
        all.extend(triangles.into_iter().map(|(corners, owner)| Triangle {
            corners,
            owner: match volumes[&owner] < 0.0 {
                true => Owner::Container,
                false => Owner::Obstacle,
            },
        }));
    }
    Ok(all)
}

/// The twelve edges of the domain, fainter when hidden.
fn draw_domain(picture: &mut Picture, depths: &[f32], view: &View, domain: Vec3) {
    let width = view.size[0];
    for edge in 0..12 {
        let axis = edge / 4;
        let mut from = Vec3::ZERO;
        from[(axis + 1) % 3] = domain[(axis + 1) % 3] * (edge % 2) as f32;
        from[(axis + 2) % 3] = domain[(axis + 2) % 3] * (edge / 2 % 2) as f32;
        let mut to = from;
        to[axis] = domain[axis];
        let (Some(a), Some(b)) = (view.project(from), view.project(to)) else {
            continue;
        };
        picture.line([a.0, a.1], [b.0, b.1], DARK, |t, x, y| {
            let depth = 1.0 / (1.0 / a.2 + (1.0 / b.2 - 1.0 / a.2) * t);
            let shown =
                usize::try_from(y).ok().and_then(|y| depths.get(usize::try_from(x).ok()?.min(width - 1) + width * y));
            let hidden = shown.is_some_and(|&shown| depth > 1.004 * shown);
            if hidden { 0.10 } else { 0.55 }
        });
    }
}

/// Labels (m) of the floor grid along the two edges nearest to the eye.
fn label_floor(picture: &mut Picture, depths: &[f32], view: &View, scene: &PictureScene) {
    let PictureScene { domain, up, floor_lines, .. } = *scene;
    let floor = domain.dot(up).min(0.0) * up;
    let [letter, line] = picture.font().extent(1).map(|pixels| pixels as f32);
    let [width, height] = view.size.map(|n| n as f32);
    let axes = [0, 1, 2].into_iter().filter(|&axis| up[axis] == 0.0);
    let axes: Vec<usize> = axes.collect();
    for (&axis, &other) in axes.iter().zip(axes.iter().rev()) {
        let far_side = view.eye[other] > 0.5 * domain[other];
        let (edge, outwards) = match far_side {
            true => (domain[other], 1.0),
            false => (0.0, -1.0),
        };
        let place = |along: f32| {
            let mut at = floor;
            at[axis] = along;
            at[other] = edge + outwards * 0.05 * domain.max_element();
            let (x, y, depth) = view.project(at)?;
            Some((Vec2::new(x, y), depth))
        };
        // Interval of labels without overlaps.
        let steps = (domain[axis] / floor_lines * (1.0 + 1e-5)) as usize;
        let texts = |step: usize| solids::label(step as f32 * floor_lines);
        let fits = |every: usize| {
            let places: Option<Vec<Vec2>> =
                (0..=steps).step_by(every).map(|step| Some(place(step as f32 * floor_lines)?.0)).collect();
            places.is_some_and(|places| {
                places.windows(2).enumerate().all(|(pair, ends)| {
                    let long = texts(pair * every).len().max(texts((pair + 1) * every).len());
                    let apart = (ends[1] - ends[0]).abs();
                    apart.x > letter * (long as f32 + 1.0) || apart.y > 1.1 * line
                })
            })
        };
        let Some(every) = [1, 2, 5, 10, 20].into_iter().find(|&every| fits(every)) else {
            continue;
        };
        for step in (0..=steps).step_by(every) {
            let text = texts(step) + if step == 0 { " m" } else { "" };
            let Some((at, depth)) = place(step as f32 * floor_lines) else {
                continue;
            };
            // Labels are upright: the floor below their centre is nearer, but does not hide them.
            let seen = |x: usize, y: usize| {
                let depth = depth.min(scene.floor_depth(view, x, y));
                depth < 1.004 * depths[x + view.size[0] * y]
            };
            let wide = letter * texts(step).len() as f32;
            let corner = at - 0.5 * Vec2::new(wide, line);
            let within = corner.x > 0.0 && corner.y > 0.0;
            if within && at.x + 0.5 * wide < width && at.y + 0.5 * line < height {
                picture.text(corner.x as i64, corner.y as i64, &text, DARK, seen);
            }
        }
    }
}

fn vector(x: [f64; 3]) -> Vec3 {
    Vec3::from_array(x.map(|x| x as f32))
}
