//! manifest.json: what ran, on what, with which options, and how far it came. `preview` starts from it.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::atomic::write_atomically;
use super::frames::FrameKinds;
use crate::Error;
use crate::elastic::Solids;
use crate::geometry::SourceFlow;
use crate::scene::{
    Camera, CameraCut, CameraKeyframe, Probe, Scene, SolidMesh, Surface, SurfaceMesh,
};

/// Everything in manifest.json. Written when the run starts and again with each frame and at the end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of cutwater.
    pub cutwater: String,
    /// The scene.
    pub scene: SceneRecord,
    /// Options of the run.
    pub options: RunOptions,
    /// The GPU; none with the CPU backend.
    pub adapter: Option<AdapterRecord>,
    /// Those that earlier sub-steps ran on, where the run went on on another; not in the file where there are none.
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
    /// Radius of the marker spheres, m; none with a fixed surface or without liquid.
    pub marker_radius: Option<f64>,
    /// Whether `frames/` has the surfaces of obstacles.
    pub obstacles: bool,
    /// Whether frames have VTP markers.
    pub markers: bool,
    /// Whether frames have VTI fields.
    pub fields: bool,
    /// Whether frames have surfaces; not in the file where they have not.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub surfaces: bool,
    /// How the mesh of the surface is made, for pictures too; none without markers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceRecord>,
    /// What the sources of the scene emit; not in the file where there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<SourceRecord>,
    /// The solids of the scene; not in the file where there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub solids: Vec<SolidRecord>,
    /// Units of the columns of probes.csv, by their names; not in the file where there are no probes.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub probe_units: BTreeMap<String, String>,
    /// Whether frames have VTU solids; not in the file where they have not.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub solid_frames: bool,
    /// 1/s
    pub frames_per_second: f64,
    /// Where `preview` looks from.
    pub camera: CameraRecord,
    /// Where the run stands.
    pub progress: Progress,
}

/// Which scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneRecord {
    /// File stem: the NAME of all frame files.
    pub name: String,
    /// File name, without folders.
    pub file: String,
    /// SHA-256 of the file's text and of all overrides, in hexadecimal.
    pub sha256: String,
}

/// What a source emits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceRecord {
    /// Velocity of the liquid, m/s.
    pub velocity: [f64; 3],
    /// Volume per second while it runs, less what walls cover, m^3/s.
    pub flow_rate: f64,
    /// s
    pub start: f64,
    /// s; none where it does not end.
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
    /// Its name.
    pub name: String,
    /// Nodes.
    pub nodes: usize,
    /// Tetrahedra.
    pub elements: usize,
    /// At rest, m^3.
    pub volume: f64,
    /// kg
    pub mass: f64,
    /// Name of its mesh file, without folders; none where the mesh is made.
    pub file: Option<String>,
    /// SHA-256 of that file, in hexadecimal.
    pub sha256: Option<String>,
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
    /// Its name.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Graphics interface, such as `vulkan`.
    pub backend: String,
    /// Whether it computes on the CPU.
    pub software: bool,
    /// The limits that decide what fits, by name.
    pub limits: BTreeMap<String, u64>,
}

/// A GPU that a run began on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EarlierAdapter {
    /// The GPU.
    pub adapter: Option<AdapterRecord>,
    /// Sub-steps done when the run went on on another.
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
    /// Vertical opening, degrees.
    pub fov: f64,
    /// Picture size, pixels.
    pub size: [usize; 2],
    /// Its path; not in the file where it rests.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub keyframes: Vec<CameraKeyframeRecord>,
    /// Where solids are cut open, the number of the axis and the place in m; not in the file where they are whole.
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
    /// Vertical opening, degrees.
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
            // An axis that there is not cuts nothing.
            cut: record
                .cut
                .filter(|(axis, _)| *axis < 3)
                .map(|(axis, at)| CameraCut { axis, at }),
        }
    }
}

/// [`SurfaceMesh`] in a file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceRecord {
    /// Distance of the surface from a marker alone, cells.
    pub radius: f64,
    /// Rounds of smoothing.
    pub smoothing: u32,
}

impl From<&SurfaceMesh> for SurfaceRecord {
    fn from(&SurfaceMesh { radius, smoothing }: &SurfaceMesh) -> SurfaceRecord {
        SurfaceRecord { radius, smoothing }
    }
}

/// Where a run stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// How it stands or ended.
    pub status: RunStatus,
    /// What went wrong.
    pub error: Option<String>,
    /// Numbers of the frames whose files are complete, in order.
    pub frames_written: Vec<u64>,
    /// Sub-steps done.
    pub steps: u64,
    /// Simulated time, s.
    pub time: f64,
    /// Wall-clock time, s; of all parts of a run that was interrupted.
    pub seconds: f64,
    /// What was noticed in all sub-steps done.
    #[serde(default)]
    pub tally: Tally,
    /// The health of each solid, in the order of the scene; not in the file where there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub solids: Vec<SolidHealth>,
}

/// Whether a solid still is a solid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SolidHealth {
    /// Whether it has had more than half its volume and less than 1 % of its elements inverted, for long enough where it starts deformed.
    pub sound: bool,
    /// Sub-steps in a row, up to the last, in which it had.
    #[serde(default)]
    pub sound_steps: u32,
    /// Sub-steps in a row, up to the last, with more than 5 % of its elements inverted.
    pub inverted_steps: u32,
    /// Sub-step in which it failed, from 0; none where it has not.
    pub failed_at: Option<u64>,
}

/// What is noticed sub-step by sub-step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Sub-steps with a solve that missed its tolerance.
    pub missed: u64,
    /// Sub-steps in which liquid had nowhere to go ([`crate::state::SolveStatus::Incompatible`]).
    #[serde(default)]
    pub squeezed: u64,
    /// Largest true relative residual of all solves.
    pub worst_residual: f64,
    /// Least and largest liquid volume over the volume to hold, where there is liquid.
    pub volume_ratio: Option<[f64; 2]>,
    /// Sub-steps longer than the CFL condition allows.
    pub floored: u64,
    /// Markers lost in obstacles and solids.
    pub dropped: u64,
    /// Largest number of markers, lost ones included.
    #[serde(default)]
    pub markers: u64,
    /// Sub-steps after which the liquid volume was more than 20 % off the volume to hold.
    #[serde(default)]
    pub volume_off: u64,
    /// Sub-steps with face speeds above 20 times what gravity, inflow and moving bodies explain.
    #[serde(default)]
    pub fast: u64,
    /// How deep solids lay in each other and in obstacles at most, m; where there is no liquid, in each other, in frames that are written.
    #[serde(default)]
    pub overlap: f64,
    /// Least det F of the elements of solids in all sub-steps, where there are any.
    pub min_det: Option<f64>,
    /// Elements with a det F of 0 or less after the last sub-step.
    pub inverted: usize,
}

impl Tally {
    /// Markers lost, over the largest number of markers.
    pub fn lost_share(&self) -> f64 {
        self.dropped as f64 / self.markers.max(1) as f64
    }
}

/// How a run stands or ended. A run that was killed keeps `running`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RunStatus {
    /// Started, not ended.
    Running,
    /// All frames are there.
    Finished,
    /// Ended with [`Progress::error`].
    Failed,
    /// The user interrupted.
    Interrupted,
}

impl Manifest {
    /// The manifest of a run that starts now.
    pub fn new(scene: &Scene, options: RunOptions, adapter: Option<AdapterRecord>) -> Manifest {
        let grid = scene.grid();
        let FrameKinds {
            markers,
            fields,
            solids: solid_frames,
            surface,
            ..
        } = FrameKinds::of(scene);
        let liquid = scene
            .liquid
            .as_ref()
            .filter(|liquid| liquid.surface == Surface::Markers);
        Manifest {
            cutwater: env!("CARGO_PKG_VERSION").to_owned(),
            scene: SceneRecord {
                name: scene.name.clone(),
                file: file_name(&scene.file),
                sha256: scene.hash.clone(),
            },
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
                tally: Tally {
                    volume_ratio: scene.liquid.as_ref().map(|_| [1.0; 2]),
                    ..Tally::default()
                },
                solids: vec![SolidHealth::default(); scene.solids.len()],
            },
        }
    }

    /// Refuses to go on with this run as one of another scene, or with other options. `file`: where it was read. Frames and adapter are not
    /// looked at.
    ///
    /// # Errors
    /// [`Error::Input`] that names what differs.
    pub fn ensure_same_run(&self, scene: &Scene, backend: &str, file: &Path) -> Result<(), Error> {
        let sets = |overrides: &[String]| match overrides {
            [] => "no --set".to_owned(),
            sets => format!("--set {}", sets.join(" --set ")),
        };
        let options = &self.options;
        let [name, now] = [&self.scene.name, &scene.name];
        let version = env!("CARGO_PKG_VERSION");
        let (problem, cure) = if self.cutwater != version {
            let problem = format!("of cutwater {}, and this is {version}", self.cutwater);
            (problem, "go on with that version".to_owned())
        } else if options.backend != backend {
            let problem = format!("on the backend {}, and this is {backend}", options.backend);
            (problem, format!("go on with --backend {}", options.backend))
        } else if options.scale != scene.scale {
            let problem = format!(
                "with --scale {}, and this is {}",
                options.scale, scene.scale
            );
            (problem, format!("go on with --scale {}", options.scale))
        } else if options.overrides != scene.overrides {
            let [then, now] = [&options.overrides, &scene.overrides].map(|all| sets(all));
            (
                format!("with {then}, and this is with {now}"),
                format!("go on with {then}"),
            )
        } else if name != now {
            let problem = format!("of a scene file {name}.toml, and this is {now}.toml");
            (problem, "give the scene its name back".to_owned())
        } else if self.scene.sha256 != scene.hash {
            let problem = "of another scene: the file, or a mesh that it names, has changed";
            (
                problem.to_owned(),
                "go on with the scene as it was".to_owned(),
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

    /// With what the sources emit.
    pub fn with_sources(self, flows: impl IntoIterator<Item = SourceFlow>) -> Manifest {
        Manifest {
            sources: flows.into_iter().map(SourceRecord::from).collect(),
            ..self
        }
    }

    /// With what the meshes of the scene's solids came to.
    ///
    /// # Errors
    /// [`Error::Input`] where a mesh file cannot be read a second time, for its hash.
    pub fn with_solids(mut self, scene: &Scene, solids: &Solids) -> Result<Manifest, Error> {
        for (solid, body) in scene.solids.iter().zip(&solids.bodies) {
            let file = match &solid.mesh {
                SolidMesh::File { file, .. } | SolidMesh::Surface { file, .. } => Some(file),
                _ => None,
            };
            self.solids.push(SolidRecord {
                name: body.name.clone(),
                nodes: body.nodes.len(),
                elements: body.elements.len(),
                volume: solids.volume[body.elements.clone()].iter().sum(),
                mass: solids.mass[body.nodes.clone()].iter().sum(),
                file: file.map(|file| file_name(file)),
                sha256: file.map(|file| hash(file)).transpose()?,
            });
        }
        Ok(self)
    }

    /// Writes `run/manifest.json`, whole or not at all.
    pub fn write(&self, run: &Path) -> Result<(), Error> {
        let path = run.join("manifest.json");
        let mut text =
            serde_json::to_vec_pretty(self).map_err(|problem| Error::output(&path, problem))?;
        text.push(b'\n');
        write_atomically(&path, &text)
    }

    /// Reads `run/manifest.json`.
    pub fn read(run: &Path) -> Result<Manifest, Error> {
        let path = run.join("manifest.json");
        let cure = "give the folder that `cutwater run --out` wrote";
        let text = fs::read(&path).map_err(|problem| {
            Error::input(path.display().to_string(), problem.to_string(), cure)
        })?;
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
        let cure = "leave the mesh file where the scene says while the run starts";
        Error::input(file.display().to_string(), problem.to_string(), cure)
    })?;
    let digest = Sha256::digest(bytes);
    Ok(digest.iter().map(|byte| format!("{byte:02x}")).collect())
}
