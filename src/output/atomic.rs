//! Atomic file writes and folder locks.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::Error;

const PARTIAL: &str = ".partial";

/// Writes to a temporary name in the same folder, syncs to disk and renames. A reader sees the old file or the new one, never a
/// part.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    write_atomically_with(path, |file| file.write_all(bytes))
}

pub(super) fn write_atomically_with(path: &Path, write: impl FnOnce(&mut File) -> io::Result<()>) -> Result<(), Error> {
    let name = path.file_name().ok_or_else(|| Error::output(path, "not a file name"))?.to_string_lossy();
    let partial = path.with_file_name(format!(".{name}{PARTIAL}"));
    let write = || -> io::Result<()> {
        let mut file = File::create(&partial)?;
        write(&mut file)?;
        file.sync_all()?;
        fs::rename(&partial, path)
    };
    write().map_err(|problem| {
        // Reports the first error; a leftover file is harmless.
        let _ = fs::remove_file(&partial);
        Error::unwritten(path, &problem)
    })
}

/// Whether a file name is that of a partially written file.
pub fn is_partial(name: &str) -> bool {
    name.starts_with('.') && name.ends_with(PARTIAL)
}

/// Syncs the names of a folder's files to disk.
pub(super) fn sync_folder(path: &Path) {
    // Some file systems cannot sync folders: only a power failure then loses names.
    if cfg!(unix) {
        let _ = File::open(path).and_then(|folder| folder.sync_all());
    }
}

pub(super) fn create_folder(path: &Path) -> Result<(), Error> {
    fs::create_dir_all(path).map_err(|problem| Error::unwritten(path, &problem))
}

/// Lock of a folder against other processes, until it is dropped or the process ends.
#[derive(Debug)]
pub struct FolderLock {
    path: PathBuf,
    /// Closing the file releases the lock.
    _file: File,
}

impl FolderLock {
    /// Locks a folder, creating it if absent.
    ///
    /// # Errors
    /// [`Error::Input`] if another process has the lock, [`Error::Output`] for a folder that is not writable.
    pub fn take(folder: &Path) -> Result<FolderLock, Error> {
        create_folder(folder)?;
        let path = folder.join(".lock");
        loop {
            let file = OpenOptions::new()
                .write(true)
                .create(true)
                .truncate(false)
                .open(&path)
                .map_err(|problem| Error::unwritten(&path, &problem))?;
            match file.try_lock() {
                Err(TryLockError::WouldBlock) => {
                    return Err(Error::input(
                        folder.display().to_string(),
                        "another process writes into the folder",
                        "wait for its end, or choose another folder with --out",
                    ));
                }
                // Without locks in the file system the folder is unguarded.
                Err(TryLockError::Error(_)) | Ok(()) => {}
            }
            // The previous owner may have removed its file after this one was opened.
            if is_at(&file, &path) {
                return Ok(FolderLock { path, _file: file });
            }
        }
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        // Before the lock is released: others that have opened the file notice it in `take`.
        let _ = fs::remove_file(&self.path);
    }
}

/// Whether an open file is the one with this name now.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let number = |of: io::Result<fs::Metadata>| of.map(|of| (of.dev(), of.ino())).ok();
    number(file.metadata()) == number(fs::metadata(path))
}

/// Other systems do not rename open files.
#[cfg(not(unix))]
fn is_at(_: &File, _: &Path) -> bool {
    true
}
