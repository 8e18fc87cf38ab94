//! manifest.json: scene, options, adapter and progress of a run. `preview` starts from it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::atomic::write_atomically;
use super::frames::FrameKinds;
use crate::Error;
use crate::effects::Effects;
use crate::elastic::Solids;
use crate::geometry::{SourceFlow, rest_from_file};
use crate::scene::{Camera, CameraCut, CameraKeyframe, Probe, Scene, Surface, SurfaceMesh};

/// Changed keys that a refusal names.
const CHANGES_SHOWN: usize = 4;

/// Contents of manifest.json, written at the start, with each frame and at the end. Optional members are absent rather than
/// empty.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of cutwater.
    pub cutwater: String,
    /// The scene.
    pub scene: SceneRecord,
    /// Options of the run.
    pub options: RunOptions,
    /// The GPU; `None` with the CPU backend.
    pub adapter: Option<AdapterRecord>,
    /// Adapters of earlier sub-steps, if the run resumed on another one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub earlier_adapters: Vec<EarlierAdapter>,
    /// Cells along x, y, z.
    pub cells: [usize; 3],
    /// Cell size, m.
    pub dx: f64,
    /// Extents, m.
    pub size: [f64; 3],
    /// Gravity, m/s^2.
    pub gravity: [f64; 3],
    /// Radius of the marker spheres, m; `None` without markers.
    pub marker_radius: Option<f64>,
    /// Whether `frames/` has the surfaces of obstacles.
    pub obstacles: bool,
    /// Whether frames have VTP markers.
    pub markers: bool,
    /// Whether frames have VTI fields.
    pub fields: bool,
    /// Whether the surface of the liquid is a level set: pictures show its zero level, not the markers.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub level: bool,
    /// Whether frames have surfaces.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub surfaces: bool,
    /// Settings of the surface mesh, for pictures too; `None` without markers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceRecord>,
    /// Flows of the sources.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<SourceRecord>,
    /// The solids of the scene.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub solids: Vec<SolidRecord>,
    /// Units of the columns of probes.csv by column.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub probe_units: BTreeMap<String, String>,
    /// Whether frames have VTU solids.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub solid_frames: bool,
    /// 1/s
    pub frames_per_second: f64,
    /// Camera of `preview`.
    pub camera: CameraRecord,
    /// Progress of the run.
    pub progress: Progress,
}

/// Identity of the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneRecord {
    /// File stem: the NAME of all frame files.
    pub name: String,
    /// File name, without folders.
    pub file: String,
    /// SHA-256 of the file's text and of all overrides, in hexadecimal.
    pub sha256: String,
    /// Values of the scene, as TOML by dotted key.
    #[serde(default)]
    pub values: BTreeMap<String, String>,
    /// SHA-256 of its mesh files.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub meshes: BTreeMap<String, String>,
}

impl From<&Scene> for SceneRecord {
    fn from(scene: &Scene) -> SceneRecord {
        SceneRecord {
            name: scene.name.clone(),
            file: file_name(&scene.file),
            sha256: scene.hash.clone(),
            values: scene.values.clone(),
            meshes: scene.meshes.clone(),
        }
    }
}

impl SceneRecord {
    /// Differences of a scene that change its results, each as a text. Comments, the camera, files of the run and its duration do not.
    fn changes(&self, scene: &Scene) -> Vec<String> {
        let free = |key: &str| {
            let table = key.split('.').next().unwrap_or_default();
            ["camera", "output", "surface"].contains(&table) || key == "time.duration"
        };
        let keys: BTreeSet<&String> = self.values.keys().chain(scene.values.keys()).collect();
        let mut changes = Vec::new();
        for key in keys.into_iter().filter(|key| !free(key)) {
            let change = match [&self.values, &scene.values].map(|values| values.get(key)) {
                [Some(then), Some(now)] if then != now => format!("was {then} and is {now}"),
                [Some(then), None] => format!("was {then} and is gone"),
                [None, Some(now)] => format!("is new: {now}"),
                _ => continue,
            };
            changes.push(format!("{key} {change}"));
        }
        let files: BTreeSet<&String> = self.meshes.keys().chain(scene.meshes.keys()).collect();
        let changed = files.into_iter().filter(|file| self.meshes.get(*file) != scene.meshes.get(*file));
        changes.extend(changed.map(|file| format!("the mesh file {file} has changed")));
        changes
    }
}

/// Flow of a source.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceRecord {
    /// Velocity of the liquid, m/s.
    pub velocity: [f64; 3],
    /// Flow rate through the open part of its faces, m^3/s.
    pub flow_rate: f64,
    /// s
    pub start: f64,
    /// s; `None` without end.
    pub end: Option<f64>,
}

impl From<SourceFlow> for SourceRecord {
    fn from(flow: SourceFlow) -> SourceRecord {
        SourceRecord {
            velocity: flow.velocity.to_array(),
            flow_rate: flow.flow_rate,
            start: flow.start,
            end: flow.end.is_finite().then_some(flow.end),
        }
    }
}

/// A solid and its mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SolidRecord {
    /// Name.
    pub name: String,
    /// Nodes.
    pub nodes: usize,
    /// Tetrahedra.
    pub elements: usize,
    /// Volume at rest, m^3.
    pub volume: f64,
    /// kg
    pub mass: f64,
    /// Name of its mesh file, without folders; `None` for generated meshes.
    pub file: Option<String>,
    /// SHA-256 of that file, in hexadecimal.
    pub sha256: Option<String>,
    /// Map from its coordinates to rest positions, m: the linear part by columns, then the translation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub placed: Option<[[f64; 3]; 4]>,
}

/// Options of the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunOptions {
    /// `gpu` or `cpu`.
    pub backend: String,
    /// Frames to compute, frame 0 not counted.
    pub frames: u64,
    /// `--scale`
    pub scale: f64,
    /// `--set`, as given.
    pub overrides: Vec<String>,
}

/// The GPU of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AdapterRecord {
    /// Name.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Graphics interface, such as `vulkan`.
    pub backend: String,
    /// Whether it computes on the CPU.
    pub software: bool,
    /// Relevant limits by name.
    pub limits: BTreeMap<String, u64>,
}

/// An adapter of earlier sub-steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EarlierAdapter {
    /// The GPU.
    pub adapter: Option<AdapterRecord>,
    /// Sub-steps done before the run resumed on another one.
    pub steps: u64,
}

/// [`Camera`] in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraRecord {
    /// Position, m.
    pub eye: [f64; 3],
    /// Point in the middle of the picture, m.
    pub target: [f64; 3],
    /// Up.
    pub up: [f64; 3],
    /// Vertical field of view, degrees.
    pub fov: f64,
    /// Picture size, pixels.
    pub size: [usize; 2],
    /// Path of a moving camera.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub keyframes: Vec<CameraKeyframeRecord>,
    /// Axis and position (m) of the plane that cuts solids.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cut: Option<(usize, f64)>,
}

/// [`CameraKeyframe`] in a file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraKeyframeRecord {
    /// s
    pub t: f64,
    /// Position, m.
    pub eye: [f64; 3],
    /// Point in the middle of the picture, m.
    pub target: [f64; 3],
    /// Vertical field of view, degrees.
    pub fov: f64,
}

impl From<&Camera> for CameraRecord {
    fn from(camera: &Camera) -> CameraRecord {
        let keyframes = camera.keyframes.iter();
        CameraRecord {
            eye: camera.eye.to_array(),
            target: camera.target.to_array(),
            up: camera.up.to_array(),
            fov: camera.fov,
            size: camera.size,
            keyframes: keyframes
                .map(|keyframe| CameraKeyframeRecord {
                    t: keyframe.time,
                    eye: keyframe.eye.to_array(),
                    target: keyframe.target.to_array(),
                    fov: keyframe.fov,
                })
                .collect(),
            cut: camera.cut.map(|cut| (cut.axis, cut.at)),
        }
    }
}

impl From<&CameraRecord> for Camera {
    fn from(record: &CameraRecord) -> Camera {
        let keyframes = record.keyframes.iter();
        Camera {
            eye: record.eye.into(),
            target: record.target.into(),
            up: record.up.into(),
            fov: record.fov,
            size: record.size,
            keyframes: keyframes
                .map(|keyframe| CameraKeyframe {
                    time: keyframe.t,
                    eye: keyframe.eye.into(),
                    target: keyframe.target.into(),
                    fov: keyframe.fov,
                })
                .collect(),
            // Ignores an invalid axis.
            cut: record.cut.filter(|(axis, _)| *axis < 3).map(|(axis, at)| CameraCut { axis, at }),
        }
    }
}

/// [`SurfaceMesh`] in a file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceRecord {
    /// Distance of the surface from an isolated marker, cells.
    pub radius: f64,
    /// Smoothing iterations.
    pub smoothing: u32,
}

impl From<&SurfaceMesh> for SurfaceRecord {
    fn from(&SurfaceMesh { radius, smoothing }: &SurfaceMesh) -> SurfaceRecord {
        SurfaceRecord { radius, smoothing }
    }
}

/// Progress of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Status.
    pub status: RunStatus,
    /// Error that ended the run.
    pub error: Option<String>,
    /// Numbers of the frames whose files are complete, in order.
    pub frames_written: Vec<u64>,
    /// Sub-steps done.
    pub steps: u64,
    /// Simulated time, s.
    pub time: f64,
    /// Wall-clock time, s, including all parts of a resumed run.
    pub seconds: f64,
    /// Counts of all sub-steps done.
    #[serde(default)]
    pub tally: Tally,
    /// Health of each solid, in the order of the scene.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub solids: Vec<SolidHealth>,
}

/// Health of a solid: whether its elements remain valid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SolidHealth {
    /// Whether it has been sound: more than half its volume and less than 1 % inverted elements, for long enough if it
    /// starts deformed.
    pub sound: bool,
    /// Number of last successive sound sub-steps.
    #[serde(default)]
    pub sound_steps: u32,
    /// Number of last successive sub-steps with more than 5 % inverted elements.
    pub inverted_steps: u32,
    /// Sub-step in which it failed, from 0.
    pub failed_at: Option<u64>,
}

/// Counts and extremes over the sub-steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Sub-steps with a solve that missed its tolerance, or whose separated cells did not settle.
    pub missed: u64,
    /// Sub-steps with an incompatible boundary flux ([`crate::state::SolveStatus::Incompatible`]).
    #[serde(default)]
    pub squeezed: u64,
    /// Largest true relative residual of all solves.
    pub worst_residual: f64,
    /// Least and largest ratio of liquid volume to target volume.
    pub volume_ratio: Option<[f64; 2]>,
    /// Sub-steps longer than the CFL condition allows.
    pub floored: u64,
    /// Markers lost in obstacles and solids.
    pub dropped: u64,
    /// Largest number of markers, including lost ones.
    #[serde(default)]
    pub markers: u64,
    /// Sub-steps with a liquid volume more than 20 % off the target.
    #[serde(default)]
    pub volume_off: u64,
    /// Sub-steps with face speeds above 20 times those that gravity, inflow and moving bodies explain.
    #[serde(default)]
    pub fast: u64,
    /// Sub-steps with a pressure more than an atmosphere below that of the air.
    #[serde(default)]
    pub tension: u64,
    /// Largest overlap of solids with each other and with obstacles, m. Without liquid: of solids with each other, in
    /// written frames.
    #[serde(default)]
    pub overlap: f64,
    /// Least det F of all sub-steps, in scenes with solids.
    pub min_det: Option<f64>,
    /// Elements with det F <= 0 after the last sub-step.
    pub inverted: usize,
}

impl Tally {
    /// Lost markers over the largest number of markers.
    pub fn lost_share(&self) -> f64 {
        self.dropped as f64 / self.markers.max(1) as f64
    }
}

/// Status of a run. A killed run remains `running`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RunStatus {
    /// Started, not ended.
    Running,
    /// All frames are written.
    Finished,
    /// Ended with [`Progress::error`].
    Failed,
    /// Interrupted by the user.
    Interrupted,
}

impl Manifest {
    /// Manifest of a new run.
    pub fn new(scene: &Scene, options: RunOptions, adapter: Option<AdapterRecord>) -> Manifest {
        let grid = scene.grid();
        let FrameKinds { markers, fields, solids: solid_frames, surface, .. } = FrameKinds::of(scene);
        let liquid = scene.liquid.as_ref().filter(|liquid| liquid.surface == Surface::Markers);
        Manifest {
            cutwater: env!("CARGO_PKG_VERSION").to_owned(),
            scene: SceneRecord::from(scene),
            options,
            adapter,
            earlier_adapters: Vec::new(),
            cells: grid.cells,
            dx: grid.dx,
            size: grid.size().to_array(),
            gravity: scene.domain.gravity.to_array(),
            marker_radius: liquid.map(|liquid| liquid.marker_radius * grid.dx),
            obstacles: !scene.obstacles.is_empty(),
            markers,
            fields,
            level: Effects::of(scene).level,
            surfaces: surface.is_some(),
            surface: liquid.map(|_| SurfaceRecord::from(&scene.surface)),
            sources: Vec::new(),
            solids: Vec::new(),
            probe_units: probe_units(&scene.probes),
            solid_frames,
            frames_per_second: scene.time.frames_per_second,
            camera: CameraRecord::from(&scene.camera),
            progress: Progress {
                status: RunStatus::Running,
                error: None,
                frames_written: Vec::new(),
                steps: 0,
                time: 0.0,
                seconds: 0.0,
                tally: Tally { volume_ratio: scene.liquid.as_ref().map(|_| [1.0; 2]), ..Tally::default() },
                solids: vec![SolidHealth::default(); scene.solids.len()],
            },
        }
    }

    /// Refuses to resume this run with another scene or other options. `file` is its source. Frames, adapter, camera and files may differ.
    pub fn ensure_same_run(&self, scene: &Scene, backend: &str, file: &Path) -> Result<(), Error> {
        let options = &self.options;
        let [name, now] = [&self.scene.name, &scene.name];
        let version = env!("CARGO_PKG_VERSION");
        let changes = self.scene.changes(scene);
        let (problem, cure) = if self.cutwater != version {
            let problem = format!("of cutwater {}, and this is {version}", self.cutwater);
            (problem, "resume with that version".to_owned())
        } else if options.backend != backend {
            let problem = format!("on the backend {}, and this is {backend}", options.backend);
            (problem, format!("resume with --backend {}", options.backend))
        } else if options.scale != scene.scale {
            let problem = format!("with --scale {}, and this is {}", options.scale, scene.scale);
            (problem, format!("resume with --scale {}", options.scale))
        } else if name != now {
            let problem = format!("of a scene file {name}.toml, and this is {now}.toml");
            (problem, "restore the name of the scene".to_owned())
        } else if self.scene.sha256 != scene.hash && !changes.is_empty() {
            let more = changes.len().saturating_sub(CHANGES_SHOWN);
            let shown = &changes[..changes.len() - more];
            let problem = match more {
                0 => shown.join("; "),
                _ => format!("{}; and {more} more", shown.join("; ")),
            };
            (
                format!("of another scene: {problem}"),
                "restore the scene file and its --set and --without; comments, [camera], [output] and the duration may change"
                    .to_owned(),
            )
        } else {
            return Ok(());
        };
        Err(Error::input(
            file.display().to_string(),
            format!("the run is {problem}"),
            format!("{cure}, choose another folder with --out, or start again with --overwrite"),
        ))
    }

    /// Refuses to resume a run whose written frames have other files than the frames of this scene.
    pub fn ensure_same_frames(&self, scene: &Scene, file: &Path) -> Result<(), Error> {
        let Some(last) = self.progress.frames_written.last() else {
            return Ok(());
        };
        let kinds = FrameKinds::of(scene);
        let pairs = [
            ("output.particles", self.markers, kinds.markers),
            ("output.fields", self.fields, kinds.fields),
            ("output.solids", self.solid_frames, kinds.solids),
            ("output.surface", self.surfaces, kinds.surface.is_some()),
        ];
        let other = pairs.into_iter().find(|(_, then, now)| then != now);
        let mesh = Some(SurfaceRecord::from(&scene.surface));
        let (problem, cure) = if let Some((key, then, _)) = other {
            let with = if then { "with" } else { "without" };
            (
                format!("frames 0 to {last} were written {with} {key}, and later ones would differ"),
                format!("set {key} = {then}"),
            )
        } else if self.surfaces && self.surface.is_some() && self.surface != mesh {
            (
                format!("the surfaces of frames 0 to {last} have other [surface] settings"),
                "restore [surface]".to_owned(),
            )
        } else {
            return Ok(());
        };
        Err(Error::input(
            file.display().to_string(),
            problem,
            format!("{cure}, choose another folder with --out, or start again with --overwrite"),
        ))
    }

    /// Whether a frame was written only because the run ended with it.
    pub fn is_extra(&self, frame: u64) -> bool {
        let every = self.scene.values.get("output.every");
        let every = every.and_then(|every| every.parse().ok()).unwrap_or(1_u64);
        frame == self.options.frames && !frame.is_multiple_of(every)
    }

    /// Adds the flows of the sources.
    pub fn with_sources(self, flows: impl IntoIterator<Item = SourceFlow>) -> Manifest {
        Manifest { sources: flows.into_iter().map(SourceRecord::from).collect(), ..self }
    }

    /// Adds the meshes of the solids; hashes their mesh files.
    pub fn with_solids(mut self, scene: &Scene, solids: &Solids) -> Result<Manifest, Error> {
        for (number, (solid, body)) in scene.solids.iter().zip(&solids.bodies).enumerate() {
            let what = scene.at(&format!("solid[{number}]"));
            let placed = rest_from_file(solid, &what)?;
            let file = solid.mesh.file();
            self.solids.push(SolidRecord {
                name: body.name.clone(),
                nodes: body.nodes.len(),
                elements: body.elements.len(),
                volume: solids.volume[body.elements.clone()].iter().sum(),
                mass: solids.mass[body.nodes.clone()].iter().sum(),
                file: file.map(|file| file_name(file)),
                sha256: file.map(|file| hash(file)).transpose()?,
                placed: Some(placed.map(|vector| vector.to_array())),
            });
        }
        Ok(self)
    }

    /// Writes `run/manifest.json` atomically.
    pub fn write(&self, run: &Path) -> Result<(), Error> {
        let path = run.join("manifest.json");
        let mut text = serde_json::to_vec_pretty(self).map_err(|problem| Error::output(&path, problem))?;
        text.push(b'\n');
        write_atomically(&path, &text)
    }

    /// Reads `run/manifest.json`.
    pub fn read(run: &Path) -> Result<Manifest, Error> {
        let path = run.join("manifest.json");
        let cure = "give the folder that `cutwater run --out` wrote";
        let text =
            fs::read(&path).map_err(|problem| Error::input(path.display().to_string(), problem.to_string(), cure))?;
        serde_json::from_slice(&text)
            .map_err(|problem| Error::input(path.display().to_string(), problem.to_string(), cure))
    }
}

/// Units of the columns of probes, by their names.
fn probe_units(probes: &[Probe]) -> BTreeMap<String, String> {
    let units = |probe: &Probe| {
        let units = probe.units().iter().map(|&unit| unit.to_owned());
        probe.columns().into_iter().zip(units).collect::<Vec<_>>()
    };
    probes.iter().flat_map(units).collect()
}

fn file_name(file: &Path) -> String {
    let name = file.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// SHA-256 of a file, in hexadecimal.
fn hash(file: &Path) -> Result<String, Error> {
    let bytes = fs::read(file).map_err(|problem| {
        let cure = "do not move or remove mesh files of the scene while the run starts";
        Error::input(file.display().to_string(), problem.to_string(), cure)
    })?;
    let digest = Sha256::digest(bytes);
    Ok(digest.iter().map(|byte| format!("{byte:02x}")).collect())
}
