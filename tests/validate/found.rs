//! What was found out of each case, kept in a file as soon as it is there: a run that is stopped goes on from these.

use std::error::Error;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io;
use std::path::{Path, PathBuf};

use cutwater::measure::table::Machine;
use cutwater::output::write_atomically;
use serde::{Deserialize, Serialize};

use crate::page::Chart;
use crate::sheet::Row;

/// Rows and charts of a case, or of several.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Found {
    pub(crate) rows: Vec<Row>,
    pub(crate) charts: Vec<Chart>,
}

/// The folder of these files.
#[derive(Debug)]
pub(crate) struct Kept {
    folder: PathBuf,
}

impl Kept {
    /// Below `out`, a folder for this build and these reference data on this adapter: what others found is not theirs.
    pub(crate) fn new(out: &Path, machine: &Machine) -> Result<Kept, Box<dyn Error>> {
        let mut hasher = DefaultHasher::new();
        fs::read(std::env::current_exe()?)?.hash(&mut hasher);
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
        let mut data: Vec<PathBuf> = fs::read_dir(data)?
            .map(|entry| Ok(entry?.path()))
            .collect::<io::Result<_>>()?;
        data.sort();
        for file in data.iter().filter(|path| path.is_file()) {
            (file, fs::read(file)?).hash(&mut hasher);
        }
        (&machine.adapter, &machine.driver).hash(&mut hasher);
        let folder = out.join("cases").join(format!("{:016x}", hasher.finish()));
        fs::create_dir_all(&folder)?;
        Ok(Kept { folder })
    }

    /// Forgets all, also of other builds.
    pub(crate) fn forget_all(&self) -> io::Result<()> {
        fs::remove_dir_all(self.folder.parent().expect("it is below `cases`"))?;
        fs::create_dir_all(&self.folder)
    }

    /// Forgets a case: it is found again.
    pub(crate) fn forget(&self, id: &str) -> io::Result<()> {
        match fs::remove_file(self.file(id)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            removed => removed,
        }
    }

    /// What is kept of a case; nothing also where it cannot be read, as of numbers that are not finite: it is found again.
    pub(crate) fn of(&self, topic: &'static str, id: &str) -> Option<Found> {
        let text = fs::read(self.file(id)).ok()?;
        let mut found: Found = serde_json::from_slice(&text).ok()?;
        found.rows.iter_mut().for_each(|row| row.topic = topic);
        Some(found)
    }

    /// Keeps it; a folder that cannot be written is told at the end, when all else is.
    pub(crate) fn keep(&self, id: &str, found: &Found) {
        if let Ok(text) = serde_json::to_vec(found) {
            let _ = write_atomically(&self.file(id), &text);
        }
    }

    fn file(&self, id: &str) -> PathBuf {
        self.folder.join(format!("{}.json", id.replace('/', "-")))
    }
}
