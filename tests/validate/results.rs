//! Results of each case, stored in a file at once: `--resume` continues from these.

use std::error::Error;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io;
use std::path::{Path, PathBuf};

use cutwater::measure::bench::Machine;
use cutwater::output::write_atomically;
use serde::{Deserialize, Serialize};

use crate::page::Chart;
use crate::sheet::Row;

/// Rows and charts of a case, or of several.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Results {
    pub(crate) rows: Vec<Row>,
    pub(crate) charts: Vec<Chart>,
}

/// A folder with a file of results per case.
#[derive(Debug)]
pub(crate) struct ResultStore {
    folder: PathBuf,
}

impl ResultStore {
    /// Below `out`, a folder for this build, these reference data, this adapter and these settings.
    pub(crate) fn new(out: &Path, machine: &Machine, settings: &[String]) -> Result<ResultStore, Box<dyn Error>> {
        let mut hasher = DefaultHasher::new();
        fs::read(std::env::current_exe()?)?.hash(&mut hasher);
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
        let mut data: Vec<PathBuf> = fs::read_dir(data)?.map(|entry| Ok(entry?.path())).collect::<io::Result<_>>()?;
        data.sort();
        for file in data.iter().filter(|path| path.is_file()) {
            (file, fs::read(file)?).hash(&mut hasher);
        }
        (&machine.adapter, &machine.driver, settings).hash(&mut hasher);
        let folder = out.join("cases").join(format!("{:016x}", hasher.finish()));
        fs::create_dir_all(&folder)?;
        Ok(ResultStore { folder })
    }

    /// Removes the results of other builds and adapters.
    pub(crate) fn remove_others(&self) -> io::Result<()> {
        let all = self.folder.parent().expect("it is below `cases`");
        for entry in fs::read_dir(all)? {
            let folder = entry?.path();
            if folder != self.folder {
                fs::remove_dir_all(folder)?;
            }
        }
        Ok(())
    }

    /// Removes the results of a case.
    pub(crate) fn remove(&self, id: &str) -> io::Result<()> {
        match fs::remove_file(self.file(id)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            removed => removed,
        }
    }

    /// Stored results of a case. None also where the file cannot be read, as with numbers that are not finite.
    pub(crate) fn load(&self, topic: &'static str, id: &str) -> Option<Results> {
        let text = fs::read(self.file(id)).ok()?;
        let mut results: Results = serde_json::from_slice(&text).ok()?;
        results.rows.iter_mut().for_each(|row| row.topic = topic);
        Some(results)
    }

    /// Stores the results. A folder that cannot be written is reported when the tables are written.
    pub(crate) fn store(&self, id: &str, results: &Results) {
        if let Ok(text) = serde_json::to_vec(results) {
            let _ = write_atomically(&self.file(id), &text);
        }
    }

    fn file(&self, id: &str) -> PathBuf {
        self.folder.join(format!("{}.json", id.replace('/', "-")))
    }
}
