//! What the tests share: the device, random numbers, comparisons.

use std::collections::BTreeSet;
use std::fmt::{self, Formatter};
use std::io::Write;
use std::panic::Location;
use std::path::PathBuf;
use std::process::Command;
use std::sync::{Mutex, OnceLock};

use cutwater::gpu::{AdapterChoice, Gpu};
use cutwater::grid::Grid;
use cutwater::reference::Surface;
use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation};
use serde::de::{Deserialize, Deserializer, Error as _, MapAccess, SeqAccess, Visitor};
use serde_json::Value;

/// The one device of the test process; `None` without an adapter. The test then counts as skipped: see [`count_skipped`].
/// `REQUIRE_GPU=1` makes a missing adapter a failure.
#[track_caller]
pub(crate) fn gpu() -> Option<&'static Gpu> {
    static GPU: OnceLock<Result<Gpu, String>> = OnceLock::new();
    let gpu = GPU.get_or_init(|| {
        Gpu::new(&AdapterChoice::Best).map_err(|error| {
            eprintln!("{error}");
            error.to_string()
        })
    });
    match gpu {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let required = std::env::var("REQUIRE_GPU").is_ok_and(|value| value == "1");
            assert!(!required, "REQUIRE_GPU=1 and {error}");
            count_skipped(Location::caller());
            None
        }
    }
}

/// The device of [`gpu`], so that its kernels are compiled once.
#[track_caller]
pub(crate) fn adapter() -> AdapterChoice {
    gpu().map_or(AdapterChoice::Best, |gpu| AdapterChoice::Open(gpu.clone()))
}

/// Start of the line for a skipped test; its number and the name of the test follow.
pub(crate) const SKIPPED: &str = "skipped for want of a GPU, ";

/// Writes one numbered line per skipped test. libtest has no count of skipped tests, so the last number is the count. It captures
/// only what the printing macros write, so the line goes to standard error directly.
fn count_skipped(caller: &Location) {
    static TESTS: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    let thread = std::thread::current();
    // libtest names threads after tests, but with one thread it runs them on that of the process.
    let test = match thread.name() {
        Some("main") | None => caller.to_string(),
        Some(test) => test.to_owned(),
    };
    let mut tests = TESTS.lock().unwrap();
    if tests.insert(test.clone()) {
        let line = format!("{SKIPPED}{}: {test}\n", tests.len());
        std::io::stderr().write_all(line.as_bytes()).unwrap();
    }
}

/// The folder with `scenes` and `tests/data`: the repository, or the one in `CUTWATER_ROOT` where this binary was moved to another machine.
pub(crate) fn root() -> PathBuf {
    std::env::var_os("CUTWATER_ROOT").map_or_else(|| env!("CARGO_MANIFEST_DIR").into(), PathBuf::from)
}

/// The program, with the default action of signals: tests may run under nohup or in the background of a script, where some are ignored, and
/// the program leaves those alone. Of the same process id, since `env` replaces itself.
pub(crate) fn program() -> Command {
    let program = env!("CARGO_BIN_EXE_cutwater");
    if !cfg!(target_os = "linux") {
        return Command::new(program);
    }
    let mut command = Command::new("env");
    command.args(["--default-signal=INT,TERM,HUP", program]);
    command
}

/// A text has all these words.
#[track_caller]
pub(crate) fn assert_has(text: &str, words: &[&str]) {
    for word in words {
        assert!(text.contains(word), "{word}: {text}");
    }
}

/// A scene of `scenes/`.
pub(crate) fn project_scene(name: &str, scale: f64, overrides: &[&str]) -> Scene {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    let file = root().join(format!("scenes/{name}.toml"));
    Scene::load(&file, &overrides, scale).unwrap()
}

/// The scene of a text.
pub(crate) fn scene_from(text: &str, overrides: &[&str]) -> Scene {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    Scene::parse("test.toml".as_ref(), text, &overrides, 1.0).unwrap()
}

/// A simulation on the one device of the tests.
pub(crate) fn on_gpu(scene: &Scene) -> Simulation {
    Simulation::new(scene, &Backend::Gpu(adapter())).unwrap()
}

/// What active cells cover, seen from above, m^2: of a pool, its surface.
pub(crate) fn area_from_above(grid: &Grid, active: &[bool]) -> f64 {
    let cells = (0..grid.n_cells()).filter(|&cell| active[cell]);
    let columns: BTreeSet<[usize; 2]> = cells.map(|cell| grid.cell_at(cell)).map(|[i, _, k]| [i, k]).collect();
    columns.len() as f64 * grid.dx.powi(2)
}

/// Distances (m) to a surface that is too far for markers to know of it.
pub(crate) fn far_below(grid: &Grid) -> Vec<f64> {
    vec![-2.0 * grid.dx; grid.n_cells()]
}

/// A surface with the default radius of markers.
pub(crate) fn surface<'a>(grid: &Grid, distance: &'a [f64]) -> Surface<'a> {
    Surface { distance, radius: 0.87 * grid.dx }
}

/// SplitMix64 (Steele, Lea and Flood 2014): repeatable random numbers.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    /// 64 random bits.
    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [low, high).
    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Runs a test of this binary in processes with 1, 2 and 3 threads for lavapipe, which reads `LP_NUM_THREADS` when it starts, and
/// asserts that its `n` lines `digest ...` are the same. On other adapters this compares three processes.
pub(crate) fn same_with_any_number_of_threads(test: &str, n: usize) {
    let digests = ["1", "2", "3"].map(|threads| {
        let output = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", test, "--nocapture"])
            .env("LP_NUM_THREADS", threads)
            .output()
            .unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let digests: Vec<String> =
            text.lines().filter_map(|line| line.find("digest of ").map(|at| line[at..].to_owned())).collect();
        assert_eq!(digests.len(), n, "{threads} threads: {text}");
        digests
    });
    assert_eq!(digests[0], digests[1], "1 and 2 threads");
    assert_eq!(digests[0], digests[2], "1 and 3 threads");
}

/// A number that any bit of the values changes.
pub(crate) fn digest(values: impl IntoIterator<Item = f64>) -> u64 {
    values.into_iter().fold(0, |digest, value| Random(digest ^ value.to_bits()).bits())
}

/// A JSON text that the program wrote, in which no object has a key twice.
pub(crate) fn json(text: impl AsRef<[u8]>) -> Value {
    let Unique(value) = serde_json::from_slice(text.as_ref()).unwrap();
    value
}

/// A JSON value; an object with a key twice is an error, where readers keep one of the two in silence.
struct Unique(Value);

impl<'de> Deserialize<'de> for Unique {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Unique, D::Error> {
        deserializer.deserialize_any(UniqueKeys).map(Unique)
    }
}

struct UniqueKeys;

impl<'de> Visitor<'de> for UniqueKeys {
    type Value = Value;

    fn expecting(&self, text: &mut Formatter) -> fmt::Result {
        text.write_str("a JSON value")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E>(self, value: f64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Value, A::Error> {
        let mut values = Vec::new();
        while let Some(Unique(value)) = list.next_element()? {
            values.push(value);
        }
        Ok(Value::Array(values))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Value, A::Error> {
        let mut object = serde_json::Map::new();
        while let Some((key, Unique(value))) = map.next_entry::<String, Unique>()? {
            if object.contains_key(&key) {
                return Err(A::Error::custom(format!("the key `{key}` comes twice")));
            }
            object.insert(key, value);
        }
        Ok(Value::Object(object))
    }
}

#[test]
fn json_with_a_key_twice_is_refused() {
    let text = r#"{"a": [1, -2, 0.5, null, true, "x"], "b": {"a": {}}}"#;
    assert_eq!(json(text), serde_json::from_str::<Value>(text).unwrap());
    for twice in [r#"{"a": 1, "a": 1}"#, r#"[{"b": {"a": 1, "c": 2, "a": []}}]"#] {
        let error = serde_json::from_str::<Unique>(twice).err().unwrap();
        assert!(error.to_string().contains("`a` comes twice"), "{error}");
    }
}
