//! checkpoint.npz, from which a run resumes. numpy opens it: `numpy.load("DIR/checkpoint.npz")`.
//!
//! Floating-point arrays are f32 if that represents every value exactly, as for most device arrays, else f64. Fields have the
//! index order `[z, y, x]`. A new member of the state is one line in `arrays`, for writing and for reading.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use npyz::{AutoSerialize, NpyFile, Order, Serialize, WriterBuilder};
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::atomic::{sync_folder, write_atomically_with};
use super::manifest::Manifest;
use crate::Error;
use crate::grid::{Axis, Grid};
use crate::state::{Carried, State};

/// Version of the names and meanings of the arrays.
const FORMAT: u64 = 6;

/// State of a run at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Input of the next sub-step.
    pub state: State,
    /// State of the GPU backend beyond `state`.
    pub carried: Carried,
    /// Length of steps.csv, bytes.
    pub steps_bytes: u64,
    /// Length of probes.csv, bytes; 0 without.
    pub probes_bytes: u64,
    /// Manifest at that time.
    pub manifest: Manifest,
}

impl Checkpoint {
    /// `run/checkpoint.npz`
    pub fn path(run: &Path) -> PathBuf {
        run.join("checkpoint.npz")
    }

    /// Writes `run/checkpoint.npz` atomically.
    pub fn write(&mut self, run: &Path) -> Result<(), Error> {
        // The files that the checkpoint depends on must be on disk first.
        sync_folder(&run.join("frames"));
        self.write_file(&Checkpoint::path(run))?;
        sync_folder(run);
        Ok(())
    }

    /// Writes a file of its own atomically.
    pub fn write_file(&mut self, path: &Path) -> Result<(), Error> {
        let manifest = serde_json::to_vec(&self.manifest).map_err(|problem| Error::output(path, problem))?;
        write_atomically_with(path, |file| {
            let zip = ZipWriter::new(Quiet::new(BufWriter::new(file)));
            let mut to = Writing { zip };
            to.bytes("format", &FORMAT.to_string())?;
            to.bytes("cutwater", env!("CARGO_PKG_VERSION"))?;
            to.array("manifest", &[manifest.len()], manifest)?;
            arrays(self, &mut to)?;
            to.zip.finish()?.finish()
        })
    }

    /// Reads `run/checkpoint.npz`, if there is one.
    ///
    /// # Errors
    /// [`Error::Input`] for an unreadable or damaged file, or one of another version of cutwater.
    pub fn read(run: &Path) -> Result<Option<Checkpoint>, Error> {
        Checkpoint::read_file(&Checkpoint::path(run))
    }

    /// Reads a file, if there is one.
    ///
    /// # Errors
    /// As [`Checkpoint::read`].
    pub fn read_file(path: &Path) -> Result<Option<Checkpoint>, Error> {
        let refused = |problem: String, cure: &str| Err(Error::input(path.display().to_string(), problem, cure));
        let file = match File::open(path) {
            Ok(file) => file,
            Err(problem) if problem.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(problem) => return refused(problem.to_string(), "make it readable"),
        };
        let damaged = "restore an intact copy, or start the run again with --overwrite";
        let mut from = match ZipArchive::new(BufReader::new(file)) {
            Ok(zip) => Reading { zip },
            Err(problem) => return refused(format!("is no intact .npz: {problem}"), damaged),
        };
        let versions = from.text("format").and_then(|format| Ok([format, from.text("cutwater")?]));
        let [format, version] = match versions {
            Ok(versions) => versions,
            Err(Flaw(problem)) => return refused(problem, damaged),
        };
        if [&*format, &*version] != [&*FORMAT.to_string(), env!("CARGO_PKG_VERSION")] {
            return refused(
                format!(
                    "was written by cutwater {version} (format {format}), and this is {} (format {FORMAT})",
                    env!("CARGO_PKG_VERSION")
                ),
                "resume with that version, or start the run again with --overwrite",
            );
        }
        match from.checkpoint() {
            Ok(checkpoint) => Ok(Some(checkpoint)),
            Err(Flaw(problem)) => refused(problem, damaged),
        }
    }
}

/// Visits every array but `manifest`, `format` and `cutwater`, in order. `None` in a shape is any length.
fn arrays<A: Arrays>(checkpoint: &mut Checkpoint, with: &mut A) -> Result<(), A::Error> {
    let Checkpoint { state, carried, steps_bytes, probes_bytes, manifest } = checkpoint;
    let grid = Grid { cells: manifest.cells, dx: manifest.dx };
    let field = |[nx, ny, nz]: [usize; 3]| [Some(nz), Some(ny), Some(nx)];
    let cells = field(grid.cells);
    let nodes = Some(manifest.solids.iter().map(|solid| solid.nodes).sum());

    with.number("time", &mut state.time)?;
    with.count("step", &mut state.step)?;
    with.count("frame", &mut state.frame)?;
    with.number("dt_last", &mut state.dt_last)?;
    with.number("contact_step", &mut state.contact_step)?;
    for (axis, name) in Axis::ALL.into_iter().zip(["velocity_x", "velocity_y", "velocity_z"]) {
        let faces = field(grid.faces(axis));
        with.numbers(name, &faces, &mut state.velocity[axis.index()])?;
    }
    with.vectors("markers", None, &mut state.markers)?;
    with.vectors("marker_velocity", None, &mut state.marker_velocity)?;
    with.marks("spray", &[None], &mut state.spray)?;
    with.labels("component", &cells, &mut state.component)?;
    with.numbers("component_volume", &[None], &mut state.component_volume)?;
    with.count("markers_dropped", &mut state.markers_dropped)?;
    with.count("markers_left", &mut state.markers_left)?;
    with.count("markers_sunk", &mut state.markers_sunk)?;
    with.count("markers_emitted", &mut state.markers_emitted)?;
    with.count("sources_running", &mut state.sources_running)?;
    with.numbers("pressure", &cells, &mut state.pressure)?;
    with.numbers("liquid_distance", &cells, &mut state.liquid_distance)?;
    with.marks("active", &cells, &mut state.active)?;
    with.marks("ballistic", &cells, &mut state.ballistic)?;
    with.marks("separated", &cells, &mut state.separated)?;
    with.number("volume_0", &mut state.volume_0)?;
    with.numbers("cavity_volume", &[None], &mut state.cavity_volume)?;
    with.vectors("displacement", nodes, &mut state.displacement)?;
    with.vectors("node_velocity", nodes, &mut state.node_velocity)?;

    let [liquid, solids] = &mut carried.max_speed;
    with.number("max_speed_liquid", liquid)?;
    with.number("max_speed_solids", solids)?;
    with.numbers("potential", &cells, &mut carried.potential)?;
    with.vectors("displacement_high", nodes, &mut carried.displacement_high)?;
    with.vectors("displacement_low", nodes, &mut carried.displacement_low)?;
    with.vectors("scripted_displacement", nodes, &mut carried.scripted_displacement)?;
    with.vectors("scripted_velocity", nodes, &mut carried.scripted_velocity)?;

    with.count("steps_bytes", steps_bytes)?;
    with.count("probes_bytes", probes_bytes)
}

/// Destination or source of arrays. An empty list has the shape [0].
trait Arrays {
    type Error;

    fn number(&mut self, name: &str, value: &mut f64) -> Result<(), Self::Error>;

    fn count(&mut self, name: &str, value: &mut u64) -> Result<(), Self::Error>;

    fn numbers(&mut self, name: &str, shape: &[Option<usize>], values: &mut Vec<f64>) -> Result<(), Self::Error>;

    fn marks(&mut self, name: &str, shape: &[Option<usize>], values: &mut Vec<bool>) -> Result<(), Self::Error>;

    fn labels(&mut self, name: &str, shape: &[Option<usize>], values: &mut Vec<u32>) -> Result<(), Self::Error>;

    fn vectors(&mut self, name: &str, n: Option<usize>, values: &mut Vec<[f64; 3]>) -> Result<(), Self::Error>;
}

/// A file that stores its first error until the end and ignores all later writes. A ZipWriter that sees an error would print a
/// message when dropped.
struct Quiet<W: Write + Seek> {
    file: W,
    problem: Option<io::Error>,
    /// Position and end of the file.
    at: u64,
    end: u64,
}

impl<W: Write + Seek> Quiet<W> {
    fn new(file: W) -> Quiet<W> {
        Quiet { file, problem: None, at: 0, end: 0 }
    }

    /// Acts on the file unless an error has occurred.
    fn try_to<T>(&mut self, act: impl FnOnce(&mut W) -> io::Result<T>) {
        if self.problem.is_none() {
            self.problem = act(&mut self.file).err();
        }
    }

    fn finish(mut self) -> io::Result<()> {
        self.try_to(W::flush);
        self.problem.map_or(Ok(()), Err)
    }
}

impl<W: Write + Seek> Write for Quiet<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.try_to(|file| file.write_all(bytes));
        self.at += bytes.len() as u64;
        self.end = self.end.max(self.at);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.try_to(W::flush);
        Ok(())
    }
}

impl<W: Write + Seek> Seek for Quiet<W> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.end.checked_add_signed(by),
        };
        let at = at.ok_or(io::ErrorKind::InvalidInput)?;
        if at != self.at {
            self.try_to(|file| file.seek(SeekFrom::Start(at)));
        }
        self.at = at;
        Ok(at)
    }
}

struct Writing<W: Write + Seek> {
    zip: ZipWriter<W>,
}

impl<W: Write + Seek> Writing<W> {
    fn array<T: AutoSerialize + Serialize>(
        &mut self,
        name: &str,
        shape: &[usize],
        values: impl IntoIterator<Item = T>,
    ) -> io::Result<()> {
        let shape: Vec<u64> = shape.iter().map(|&n| n as u64).collect();
        let mut bytes = Vec::new();
        let mut array = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(&mut bytes).begin_nd()?;
        array.extend(values)?;
        array.finish()?;
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .large_file(bytes.len() > u32::MAX as usize);
        self.zip.start_file(format!("{name}.npy"), options)?;
        self.zip.write_all(&bytes)
    }

    fn bytes(&mut self, name: &str, text: &str) -> io::Result<()> {
        self.array(name, &[text.len()], text.bytes())
    }

    fn floats(&mut self, name: &str, shape: &[Option<usize>], values: &[f64]) -> io::Result<()> {
        let shape = shape_of(shape, values.len());
        if values.iter().all(|&value| f64::from(value as f32) == value) {
            self.array(name, &shape, values.iter().map(|&value| value as f32))
        } else {
            self.array(name, &shape, values.iter().copied())
        }
    }
}

/// Shape of `n` values; the first length may be open.
fn shape_of(shape: &[Option<usize>], n: usize) -> Vec<usize> {
    if n == 0 {
        return vec![0];
    }
    let rest: usize = shape[1..].iter().flatten().product();
    let first = [shape[0].unwrap_or(n / rest.max(1))];
    first.into_iter().chain(shape[1..].iter().flatten().copied()).collect()
}

impl<W: Write + Seek> Arrays for Writing<W> {
    type Error = io::Error;

    fn number(&mut self, name: &str, value: &mut f64) -> io::Result<()> {
        self.array(name, &[], [*value])
    }

    fn count(&mut self, name: &str, value: &mut u64) -> io::Result<()> {
        self.array(name, &[], [*value])
    }

    fn numbers(&mut self, name: &str, shape: &[Option<usize>], values: &mut Vec<f64>) -> io::Result<()> {
        self.floats(name, shape, values)
    }

    fn marks(&mut self, name: &str, shape: &[Option<usize>], values: &mut Vec<bool>) -> io::Result<()> {
        let shape = shape_of(shape, values.len());
        self.array(name, &shape, values.iter().copied())
    }

    fn labels(&mut self, name: &str, shape: &[Option<usize>], values: &mut Vec<u32>) -> io::Result<()> {
        let shape = shape_of(shape, values.len());
        self.array(name, &shape, values.iter().copied())
    }

    fn vectors(&mut self, name: &str, n: Option<usize>, values: &mut Vec<[f64; 3]>) -> io::Result<()> {
        self.floats(name, &[n, Some(3)], values.as_flattened())
    }
}

struct Reading {
    zip: ZipArchive<BufReader<File>>,
}

struct Flaw(String);

impl Reading {
    /// Bytes of an array's file; reading to its end verifies the checksum.
    fn bytes(&mut self, name: &str) -> Result<Vec<u8>, Flaw> {
        let damaged = |problem: String| Flaw(format!("array \"{name}\": {problem}"));
        let mut file = match self.zip.by_name(&format!("{name}.npy")) {
            Ok(file) => file,
            Err(ZipError::FileNotFound) => return Err(damaged("is missing".to_owned())),
            Err(problem) => return Err(damaged(problem.to_string())),
        };
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(|problem| damaged(problem.to_string()))?;
        Ok(bytes)
    }

    /// Converts an array; the outer error of `convert` is the expected type and shape.
    fn array<T>(
        &mut self,
        name: &str,
        convert: impl FnOnce(NpyFile<&[u8]>) -> Result<io::Result<Vec<T>>, String>,
    ) -> Result<Vec<T>, Flaw> {
        let bytes = self.bytes(name)?;
        let damaged = |problem: String| Flaw(format!("array \"{name}\": {problem}"));
        let array = NpyFile::new(&bytes[..]).map_err(|problem| damaged(problem.to_string()))?;
        let present = format!("{} of shape {:?}", array.dtype().descr(), array.shape());
        match convert(array) {
            Ok(Ok(values)) => Ok(values),
            Ok(Err(problem)) => Err(damaged(problem.to_string())),
            Err(expected) => Err(damaged(format!("is {present} instead of {expected}"))),
        }
    }

    fn text(&mut self, name: &str) -> Result<String, Flaw> {
        let bytes = self.array::<u8>(name, |array| match array.try_data() {
            Ok(data) => Ok(data.collect()),
            Err(_) => Err("bytes".to_owned()),
        })?;
        String::from_utf8(bytes).map_err(|problem| Flaw(format!("array \"{name}\": {problem}")))
    }

    fn checkpoint(&mut self) -> Result<Checkpoint, Flaw> {
        let manifest = serde_json::from_str(&self.text("manifest")?)
            .map_err(|problem| Flaw(format!("array \"manifest\": {problem}")))?;
        let mut checkpoint = Checkpoint {
            state: State::default(),
            carried: Carried::default(),
            steps_bytes: 0,
            probes_bytes: 0,
            manifest,
        };
        arrays(&mut checkpoint, self)?;
        Ok(checkpoint)
    }
}

/// Whether an array has a shape and C order.
fn fits(array: &NpyFile<&[u8]>, shape: &[Option<usize>]) -> bool {
    let present = array.shape();
    let same =
        |(present, expected): (&u64, &Option<usize>)| expected.is_none_or(|expected| *present == expected as u64);
    let fits = present.len() == shape.len() && present.iter().zip(shape).all(same);
    (fits || present == [0]) && (array.order() == Order::C || present.len() < 2)
}

/// The shape in numpy's notation.
fn name_of(shape: &[Option<usize>]) -> String {
    let lengths = shape.iter().map(|n| n.map_or("any".to_owned(), |n| n.to_string()));
    format!("shape [{}]", lengths.collect::<Vec<_>>().join(", "))
}

impl Arrays for Reading {
    type Error = Flaw;

    fn number(&mut self, name: &str, value: &mut f64) -> Result<(), Flaw> {
        let mut values = Vec::new();
        self.numbers(name, &[], &mut values)?;
        let [present] = values[..] else {
            return Err(Flaw(format!("array \"{name}\": is no number")));
        };
        *value = present;
        Ok(())
    }

    fn count(&mut self, name: &str, value: &mut u64) -> Result<(), Flaw> {
        let values = self.array::<u64>(name, |array| {
            let fits = array.shape().is_empty();
            let data = array.try_data().ok().filter(|_| fits);
            data.map(Iterator::collect).ok_or("a count (<u8, shape [])".to_owned())
        })?;
        *value = values[0];
        Ok(())
    }

    fn numbers(&mut self, name: &str, shape: &[Option<usize>], values: &mut Vec<f64>) -> Result<(), Flaw> {
        let present = self.array::<f64>(name, |array| {
            let expected = || format!("numbers (<f4 or <f8) of {}", name_of(shape));
            if !fits(&array, shape) {
                return Err(expected());
            }
            match array.try_data::<f64>() {
                Ok(data) => Ok(data.collect()),
                Err(array) => match array.try_data::<f32>() {
                    Ok(data) => Ok(data.map(|value| value.map(f64::from)).collect()),
                    Err(_) => Err(expected()),
                },
            }
        })?;
        if let Some(at) = present.iter().position(|value| !value.is_finite()) {
            let problem = format!("array \"{name}\": number {at} is {:?}", present[at]);
            return Err(Flaw(problem));
        }
        *values = present;
        Ok(())
    }

    fn marks(&mut self, name: &str, shape: &[Option<usize>], values: &mut Vec<bool>) -> Result<(), Flaw> {
        *values = self.array(name, |array| {
            let fits = fits(&array, shape);
            let data = array.try_data().ok().filter(|_| fits);
            data.map(Iterator::collect).ok_or_else(|| format!("marks (|b1) of {}", name_of(shape)))
        })?;
        Ok(())
    }

    fn labels(&mut self, name: &str, shape: &[Option<usize>], values: &mut Vec<u32>) -> Result<(), Flaw> {
        *values = self.array(name, |array| {
            let fits = fits(&array, shape);
            let data = array.try_data().ok().filter(|_| fits);
            data.map(Iterator::collect).ok_or_else(|| format!("labels (<u4) of {}", name_of(shape)))
        })?;
        Ok(())
    }

    fn vectors(&mut self, name: &str, n: Option<usize>, values: &mut Vec<[f64; 3]>) -> Result<(), Flaw> {
        let mut flat = Vec::new();
        self.numbers(name, &[n, Some(3)], &mut flat)?;
        *values = flat.as_chunks().0.to_vec();
        Ok(())
    }
}
