//! Shaded pictures of a run, from its files alone: `manifest.json` and `frames/`.
//!
//! Rays are traced on the CPU in f32: liquid from the markers (or, with a fixed surface, from the cell fields) with
//! refraction, Fresnel reflection and colour by depth; elastic solids, in colours of their own or of their stress or change of
//! volume; obstacles; the floor with lines at round distances; the domain's edges. Every pixel is computed by itself, so pictures do not depend on the number of threads.

mod liquid;
mod picture;
mod shade;
mod solids;
mod triangles;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use glam::Vec3;
use vtkio::Vtk;
use vtkio::model::{Attribute, Attributes, DataSet, IOBuffer, Piece, VertexNumbers};

use super::atomic::create_folder;
use super::manifest::Manifest;
use crate::Error;
use liquid::LiquidField;
use picture::{Animation, Picture};
use shade::{Stage, View};
use solids::{Scale, Skin, SolidFrame};
use triangles::{Owner, Triangle, Triangles};

const DARK: [u8; 3] = [40, 46, 54];

/// What the colours of elastic solids stand for.
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
    /// The cell data that it is made from.
    fn field(self) -> Option<&'static str> {
        match self {
            Colour::Solid => None,
            Colour::Stress => Some("von_mises"),
            Colour::DetF => Some("det_f"),
        }
    }
}

/// What `preview` makes.
#[derive(Clone, Copy, Debug)]
pub struct PreviewOptions {
    /// Picture size, pixels; else the scene's.
    pub size: Option<[usize; 2]>,
    /// Every how many of the written frames; at least 1.
    pub every: usize,
    /// Whether to make the animation too.
    pub animation: bool,
    /// What the colours of elastic solids stand for.
    pub colour: Colour,
}

impl Default for PreviewOptions {
    fn default() -> PreviewOptions {
        PreviewOptions {
            size: None,
            every: 1,
            animation: true,
            colour: Colour::Solid,
        }
    }
}

/// What `preview` made.
#[derive(Clone, Debug, PartialEq)]
pub struct PreviewReport {
    /// `DIR/preview/NAME_%06d.png`, in order.
    pub pictures: Vec<PathBuf>,
    /// `DIR/preview/NAME.png`, an APNG: browsers play it.
    pub animation: Option<PathBuf>,
}

/// Renders the frames of a run directory. `progress` is told how many pictures are done, of how many, and says whether to go on.
///
/// # Errors
/// [`Error::Interrupted`] when `progress` said no; [`Error::Input`] and [`Error::Output`] for files.
pub fn preview(
    run: &Path,
    options: &PreviewOptions,
    progress: &mut dyn FnMut(usize, usize) -> bool,
) -> Result<PreviewReport, Error> {
    let manifest = Manifest::read(run)?;
    let name = &manifest.scene.name;
    let frames = frame_files(&run.join("frames"), &manifest)?;
    let frames: Vec<(u64, FrameFiles)> = frames.into_iter().step_by(options.every.max(1)).collect();
    if options.colour != Colour::Solid && !manifest.solid_frames {
        return Err(Error::input(
            run.display().to_string(),
            "no frame has elastic solids that could be coloured",
            "draw it without --colour",
        ));
    }
    let solid_files = frames
        .iter()
        .filter_map(|(_, files)| files.solids.as_deref());
    let scale = Scale::over(options.colour, solid_files)?;
    let folder = run.join("preview");
    create_folder(&folder)?;

    let camera = &manifest.camera;
    let vector = |x: [f64; 3]| Vec3::from_array(x.map(|x| x as f32));
    let size = options.size.unwrap_or(camera.size);
    let view = View::new(
        vector(camera.eye),
        vector(camera.target),
        vector(camera.up),
        camera.fov as f32,
        size,
    );
    let domain = vector(manifest.size);
    let up = upwards(vector(manifest.gravity), vector(camera.up));
    let obstacles = Triangles::new(match manifest.obstacles {
        true => read_obstacles(&run.join("frames").join(format!("{name}_obstacles.vtp")))?,
        false => Vec::new(),
    });
    let mut stage = Stage {
        liquid: None,
        obstacles: &obstacles,
        solids: Triangles::none(),
        looks: Vec::new(),
        scale: &scale,
        pixel: view.pixel(),
        domain,
        up,
        floor_lines: round_length(0.12 * domain.max_element()),
        sun: Stage::sun_for(&view, up),
    };

    let mut report = PreviewReport {
        pictures: Vec::new(),
        animation: None,
    };
    let mut animation = Animation::new();
    let mut skin = Skin::none();
    for (done, (frame, files)) in frames.iter().enumerate() {
        if !progress(done, frames.len()) {
            return Err(Error::Interrupted);
        }
        if let Some(file) = &files.liquid {
            stage.liquid = read_liquid(file, &manifest)?;
        }
        if let Some(file) = &files.solids {
            let frame = SolidFrame::read(file, options.colour)?;
            (stage.solids, stage.looks) = skin.dress(&frame, options.colour);
        }
        let (mut picture, depths) = stage.render(&view);
        draw_domain(&mut picture, &depths, &view, domain);
        caption(
            &mut picture,
            *frame as f64 / manifest.frames_per_second,
            stage.floor_lines,
        );
        scale.draw(&mut picture);
        let path = folder.join(format!("{name}_{frame:06}.png"));
        picture.write(&path)?;
        report.pictures.push(path);
        if options.animation {
            animation.push(&picture);
        }
    }
    if options.animation {
        let path = folder.join(format!("{name}.png"));
        let numbers: Vec<u64> = frames.iter().map(|&(number, _)| number).collect();
        animation.write(&path, &seconds_shown(&numbers, manifest.frames_per_second))?;
        report.animation = Some(path);
    }
    progress(frames.len(), frames.len());
    Ok(report)
}

/// What a picture is made from.
#[derive(Default)]
struct FrameFiles {
    liquid: Option<PathBuf>,
    solids: Option<PathBuf>,
}

/// How long each picture stays, s: until the time of the next frame that was written; the last as long as the one before it.
fn seconds_shown(numbers: &[u64], frames_per_second: f64) -> Vec<f64> {
    let mut frames: Vec<u64> = numbers.windows(2).map(|pair| pair[1] - pair[0]).collect();
    frames.push(frames.last().copied().unwrap_or(1));
    frames
        .into_iter()
        .map(|frames| frames as f64 / frames_per_second)
        .collect()
}

/// The frames in the folder by number, those with all their files: of the liquid markers where there are any, else fields.
fn frame_files(folder: &Path, manifest: &Manifest) -> Result<BTreeMap<u64, FrameFiles>, Error> {
    let name = &manifest.scene.name;
    let solids = manifest.solid_frames.then_some("vtu");
    let liquid = match (manifest.markers, manifest.fields) {
        (true, _) => Some("vtp"),
        (false, true) => Some("vti"),
        (false, false) => None,
    };
    let Some(first) = liquid.or(solids) else {
        let cure = match manifest.solids.is_empty() {
            true => "run the scene with output.particles or output.fields on",
            false => "run the scene with output.solids on",
        };
        let problem = "the run writes no frames";
        return Err(Error::input(folder.display().to_string(), problem, cure));
    };
    let mut found: BTreeMap<u64, FrameFiles> = BTreeMap::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let number = stem
            .strip_prefix(name.as_str())
            .and_then(|rest| rest.strip_prefix('_'))
            .and_then(|number| number.parse().ok());
        let extension = path.extension().and_then(|extension| extension.to_str());
        if let (Some(number), Some(_)) = (number, extension) {
            let files = found.entry(number).or_default();
            if extension == liquid {
                files.liquid = Some(path);
            } else if extension == solids {
                files.solids = Some(path);
            }
        }
    }
    found.retain(|_, files| {
        files.liquid.is_some() == liquid.is_some() && files.solids.is_some() == solids.is_some()
    });
    if found.is_empty() {
        let problem = format!("no frame {name}_000000.{first} or later");
        let cure = "let `cutwater run` write a frame first";
        return Err(Error::input(folder.display().to_string(), problem, cure));
    }
    Ok(found)
}

/// Against gravity along the nearest axis; without gravity the camera's up.
fn upwards(gravity: Vec3, camera: Vec3) -> Vec3 {
    let up = if gravity == Vec3::ZERO {
        camera
    } else {
        -gravity
    };
    let mut axis = Vec3::ZERO;
    let nearest = up.abs().max_position();
    axis[nearest] = 1.0_f32.copysign(up[nearest]);
    axis
}

/// 1, 2 or 5 times a power of ten, near a length.
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

fn unreadable(path: &Path, problem: impl std::fmt::Display) -> Error {
    Error::input(
        path.display().to_string(),
        problem.to_string(),
        "give a folder that `cutwater run` wrote",
    )
}

fn read_vtk(path: &Path) -> Result<DataSet, Error> {
    Vtk::import(path)
        .map(|vtk| vtk.data)
        .map_err(|problem| unreadable(path, problem))
}

/// Triples of a buffer of f32.
fn points(buffer: IOBuffer) -> Option<Vec<Vec3>> {
    let numbers: Vec<f32> = buffer.into_vec()?;
    Some(numbers.chunks_exact(3).map(Vec3::from_slice).collect())
}

fn array(attributes: &Attributes, name: &str) -> Option<IOBuffer> {
    attributes
        .cell
        .iter()
        .find_map(|attribute| match attribute {
            Attribute::DataArray(array) if array.name == name => Some(array.data.clone()),
            _ => None,
        })
}

/// The liquid of a frame file, where it has any.
fn read_liquid(path: &Path, manifest: &Manifest) -> Result<Option<LiquidField>, Error> {
    let missing = |what: &str| unreadable(path, format!("no {what}"));
    let dx = manifest.dx as f32;
    match read_vtk(path)? {
        DataSet::PolyData { pieces, .. } => {
            let mut markers = Vec::new();
            for piece in pieces {
                let Piece::Inline(piece) = piece else {
                    return Err(missing("inline data"));
                };
                markers.extend(points(piece.points).ok_or_else(|| missing("f32 points"))?);
            }
            let radius = manifest
                .marker_radius
                .ok_or_else(|| missing("marker_radius in manifest.json"))?
                as f32;
            let field = || LiquidField::from_markers(&markers, radius, manifest.cells, dx);
            Ok((!markers.is_empty()).then(field))
        }
        DataSet::ImageData { pieces, .. } => {
            let Some(Piece::Inline(piece)) = pieces.into_iter().next() else {
                return Err(missing("inline data"));
            };
            let phi = array(&piece.data, "liquid_distance").and_then(IOBuffer::into_vec::<f32>);
            let phi = phi.filter(|phi| phi.len() == manifest.cells.iter().product::<usize>());
            let phi = phi.ok_or_else(|| missing("liquid_distance for every cell"))?;
            Ok(Some(LiquidField::from_cells(phi, manifest.cells, dx)))
        }
        _ => Err(missing("markers or fields")),
    }
}

/// The triangles of all obstacles; those of a container have a negative volume together.
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
        let owners: Vec<i32> = array(&piece.data, "obstacle")
            .and_then(IOBuffer::into_vec)
            .ok_or_else(|| missing("obstacle numbers"))?;
        let mut volumes: BTreeMap<i32, f64> = BTreeMap::new();
        let mut triangles = Vec::new();
        for (corners, owner) in connectivity.chunks_exact(3).zip(owners) {
            let corner = |c: usize| {
                points
                    .get(corners[c] as usize)
                    .copied()
                    .ok_or_else(|| missing("such point"))
            };
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

/// The twelve edges of the domain, fainter behind what the picture shows.
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
            let shown = usize::try_from(y)
                .ok()
                .and_then(|y| depths.get(usize::try_from(x).ok()?.min(width - 1) + width * y));
            let hidden = shown.is_some_and(|&shown| depth > 1.004 * shown);
            if hidden { 0.10 } else { 0.55 }
        });
    }
}

/// The time, and how far apart the lines of the floor are.
fn caption(picture: &mut Picture, time: f64, floor_lines: f32) {
    let [width, height] = picture.size;
    let scale = (height / 270).max(1);
    let margin = 8 * scale;
    picture.text(margin, margin, scale, &format!("{time:.3} s"), DARK);
    let lines = format!("lines {} m", (f64::from(floor_lines) * 1e6).round() / 1e6);
    let across = 6 * scale * lines.len() + margin;
    let y = height.saturating_sub(margin + 7 * scale);
    picture.text(width.saturating_sub(across), y, scale, &lines, DARK);
}
